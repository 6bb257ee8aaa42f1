"""One metric of one method over one sequence, and how far two of them are apart, each with its interval."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Literal

import numpy as np
from scipy import stats

from evalkit.core.se2 import Floats
from evalkit.stats.bootstrap import DRAWS, BootstrapDraws, expanded_percentile_interval
from evalkit.stats.intervals import CONFIDENCE, Interval
from evalkit.stats.paired_tests import detectable_standard_errors

# Of more scans left to the guess than this (%), it is the guess that would be ranked.
MAX_GUESSED = 50.0


@dataclass(frozen=True, slots=True)
class Cell:
    """One metric of one method over one sequence.

    ``values``: one per complete run that has a score, in the order of the records. ``partial``: the same for runs that
    ended early; they never enter a median. ``reason``: why there is no value, "" where there is one. ``seeds``: those
    of ``values``; ``drawn``: what each might as well have been, None where nobody can tell. ``guessed_percent``: scans
    it left to the guess, 0 where unknown.
    """

    method: str
    values: tuple[float, ...]
    partial: tuple[float, ...]
    complete: int
    expected: int
    support: int
    reason: str
    seeds: tuple[int | None, ...] = ()
    guessed_percent: float = 0.0
    drawn: tuple[BootstrapDraws | None, ...] = field(default=(), compare=False, repr=False)

    @property
    def median(self) -> float | None:
        """The middle of the complete runs; None without any."""
        return median(self.values) if self.values else None

    @property
    def rankable(self) -> bool:
        """Whether every run was completed and scored, by registering: nobody leads by the runs it survived."""
        return self.complete == self.expected == len(self.values) and self.registers

    @property
    def registers(self) -> bool:
        """Whether the answers are its own: not where most scans were left to the guess."""
        return self.guessed_percent <= MAX_GUESSED


@dataclass(frozen=True, slots=True)
class Apart:
    """How far one cell lies above another, run by run, with the interval of that difference.

    ``error`` is its standard error with ``spare`` degrees of freedom. ``by``: what was drawn, stretches of the runs
    (and the runs, where there are several), or only the runs.
    """

    interval: Interval
    error: float
    spare: float
    by: Literal["stretches", "runs"]

    @property
    def detectable(self) -> float:
        """The difference that these runs would have shown with 80 % power at 5 %."""
        return self.error * detectable_standard_errors(self.spare)


def interval(cell: Cell) -> Interval | None:
    """The median over the runs with its 95 % interval; None where nothing can be drawn from within the runs."""
    known = [one for one in cell.drawn if one is not None]
    if not known or len(known) < len(cell.values):
        return None
    blocks = sum(one.blocks for one in known)
    draws = over_runs([one.values for one in known])
    return expanded_percentile_interval(median(cell.values), draws, cell.support, blocks)


def apart(one: Cell, other: Cell) -> Apart | None:
    """``one - other`` over the seeds both have; None where one run each has nothing to draw from.

    The same stretches of the same runs are drawn for both, and the runs where there are several. Where there is nothing
    to draw within a run, Student's t over the runs.
    """
    pairs = _pairs(one, other)
    if not pairs:
        return None
    differences = [ours - theirs for ours, theirs, _, _ in pairs]
    drawn = [(a, b) for _, _, a, b in pairs if a is not None and b is not None and len(a.values) == len(b.values)]
    if len(drawn) == len(pairs):
        blocks = sum(min(a.blocks, b.blocks) for a, b in drawn)
        draws = over_runs([a.values - b.values for a, b in drawn])
        found = expanded_percentile_interval(median(differences), draws, len(pairs), blocks)
        return Apart(found, float(draws.std()), max(blocks - 1.0, 1.0), "stretches")
    if len(pairs) < 2:
        return None
    return _students(differences)


def over_runs(draws: Sequence[Floats]) -> Floats:
    """Draws (D,) of the median over runs: the runs are drawn too, with what was drawn within each."""
    table = np.stack(draws)
    if len(table) == 1:
        return draws[0]
    chosen = np.random.default_rng(0).integers(0, len(table), (DRAWS, len(table)))
    return np.asarray(np.median(table[chosen, np.arange(DRAWS)[:, None]], axis=1))


def _pairs(one: Cell, other: Cell) -> list[tuple[float, float, BootstrapDraws | None, BootstrapDraws | None]]:
    theirs = {seed: (value, drawn) for seed, value, drawn in _runs(other)}
    return [(value, theirs[seed][0], drawn, theirs[seed][1]) for seed, value, drawn in _runs(one) if seed in theirs]


def _runs(cell: Cell) -> list[tuple[int | None, float, BootstrapDraws | None]]:
    drawn = cell.drawn or (None,) * len(cell.values)
    return list(zip(cell.seeds, cell.values, drawn, strict=True))


def _students(differences: Sequence[float]) -> Apart:
    series, spare = np.asarray(differences), len(differences) - 1
    middle, error = float(series.mean()), float(series.std(ddof=1)) / math.sqrt(len(series))
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2.0, spare)) * error
    return Apart(Interval(middle, middle - half, middle + half, len(series)), error, spare, "runs")
