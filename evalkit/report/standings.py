"""Who stands where: medians over seeds of the complete runs, and who leads by more than the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.metrics.table import Group, Metric
from evalkit.report.comparison import Comparison
from evalkit.types import Status, Trial

# The published relations are only good to this much themselves, whatever two contestants differ by.
RELATIONS_FLOOR = {"m": 0.03, "deg": 0.4, "°": 0.4}

# What decides a sequence: official relations where they exist, then a true trajectory, then maps.
DECIDING: tuple[Group, ...] = ("relations", "drift", "map against truth", "map consistency")
WITH_TRUTH: tuple[Group, ...] = DECIDING[:3]

# What the bar cannot compete in, because it registers nothing.
WITHOUT_BAR: tuple[Group, ...] = ("residuals", "runtime")

# What no contestant can be blamed for.
NOT_POSSIBLE: tuple[Status, ...] = ("not-installed", "data-missing")

STATUS: dict[Status, str] = {
    "complete": "complete",
    "failed": "failed",
    "crashed": "crashed",
    "timeout": "timed out",
    "out-of-memory": "out of memory",
    "not-installed": "not installed",
    "data-missing": "data missing",
}

Level = Literal["clear", "within the noise floor", "overlapping seeds", "equal as printed"]


@dataclass(frozen=True, slots=True)
class Cell:
    """One metric of one contestant over one sequence.

    ``values``: one per complete run that has a score, in the order of the trials. ``partial``: the same for runs that
    ended early; they never enter a median. ``reason``: why there is no value, "" where there is one.
    """

    contestant: str
    values: tuple[float, ...]
    partial: tuple[float, ...]
    complete: int
    expected: int
    support: int
    reason: str

    @property
    def median(self) -> float | None:
        """The middle of the complete runs; None without any."""
        return median(self.values) if self.values else None

    @property
    def rankable(self) -> bool:
        """Whether every run was completed and scored: nobody leads by the runs it survived."""
        return self.complete == self.expected == len(self.values)


@dataclass(frozen=True, slots=True)
class Standing:
    """One metric over one sequence. ``ranked``: the rankable cells, best first; ``level``: those level with it."""

    sequence: str
    metric: Metric
    cells: tuple[Cell, ...]
    ranked: tuple[Cell, ...]
    level: tuple[Cell, ...]
    why_level: Level

    @property
    def winner(self) -> Cell | None:
        """The one that leads by more than the noise; None where several are level, or nobody else can be compared."""
        return self.level[0] if len(self.level) == 1 and len(self.ranked) > 1 else None

    def of(self, contestant: str) -> Cell | None:
        """The cell of a contestant; None if it is not in this sequence."""
        return next((cell for cell in self.cells if cell.contestant == contestant), None)


def standing(comparison: Comparison, sequence: str, metric: Metric) -> Standing:
    """Where all contestants stand in one metric over one sequence."""
    cells = tuple(_cell(trials, metric) for trials in comparison.by_contestant(sequence).values())
    bars = contestant_of(comparison, "bar") if metric.group in WITHOUT_BAR else ()
    ranked = ranking(metric, [cell for cell in cells if cell.contestant not in bars])
    level = tuple(cell for cell in ranked if cell is ranked[0] or difference(metric, ranked[0], cell) != "clear")
    why = difference(metric, ranked[0], level[1]) if len(level) > 1 else "clear"
    return Standing(sequence, metric, cells, ranked, level, why)


def ranking(metric: Metric, cells: Sequence[Cell]) -> tuple[Cell, ...]:
    """The rankable cells, best first; empty where neither direction is better."""
    if not metric.better:
        return ()
    sign = 1.0 if metric.better == "lower" else -1.0
    return tuple(sorted((c for c in cells if c.rankable), key=lambda c: sign * median(c.values)))


def difference(metric: Metric, one: Cell, other: Cell) -> Level:
    """Whether two cells with values differ clearly, or why nobody should say so."""
    ours, theirs = median(one.values), median(other.values)
    if abs(ours - theirs) < noise_floor(metric):
        return "within the noise floor"
    if max(len(one.values), len(other.values)) > 1 and _overlap(one.values, other.values):
        return "overlapping seeds"
    if round(ours, metric.digits) == round(theirs, metric.digits):
        return "equal as printed"
    return "clear"


def noise_floor(metric: Metric) -> float:
    """The difference below which the truth itself cannot tell two contestants apart (the metric's unit); 0: none."""
    return RELATIONS_FLOOR.get(metric.unit, 0.0) if metric.group == "relations" else 0.0


def worse(metric: Metric, one: Cell | None, other: Cell | None) -> bool:
    """Whether one cell is worse than another by more than the noise; False where they cannot be compared."""
    if not metric.better or one is None or other is None or not one.values or not other.values:
        return False
    behind = median(one.values) - median(other.values)
    if metric.better == "higher":
        behind = -behind
    return behind > 0.0 and difference(metric, one, other) == "clear"


def deciding(comparison: Comparison, sequence: str) -> Standing | None:
    """The standing that decides a sequence: the first headline metric, by strength of evidence, with any value."""
    headline = [metric for metric in comparison.metrics if metric.headline and metric.better]
    for group in DECIDING:
        for metric in headline:
            if metric.group == group:
                found = standing(comparison, sequence, metric)
                if any(cell.values for cell in found.cells):
                    return found
    return None


def contestant_of(comparison: Comparison, role: str) -> tuple[str, ...]:
    """The labels of the contestants with a role, in order."""
    return tuple(label for label in comparison.contestant_labels if comparison.contestants[label].role == role)


def unfinished(trials: Sequence[Trial]) -> tuple[Trial, ...]:
    """The trials that did not complete, in order."""
    return tuple(trial for trial in trials if trial.run.status != "complete")


def _cell(trials: Sequence[Trial], metric: Metric) -> Cell:
    complete = [trial for trial in trials if trial.run.status == "complete"]
    scores = [trial.scores[metric.name] for trial in complete if metric.name in trial.scores]
    values = tuple(score.value for score in scores if score.value is not None)
    ended = [trial.scores[metric.name] for trial in unfinished(trials) if metric.name in trial.scores]
    partial = tuple(score.value for score in ended if score.value is not None)
    supports = [score.support for score in scores if score.value is not None]
    return Cell(
        trials[0].contestant,
        values,
        partial,
        len(complete),
        len(trials),
        int(median(supports)) if supports else 0,
        "" if values else _why_none(trials, metric),
    )


def _why_none(trials: Sequence[Trial], metric: Metric) -> str:
    reasons = [
        trial.scores[metric.name].reason
        for trial in trials
        if trial.run.status == "complete" and metric.name in trial.scores
    ]
    reasons += [f"{STATUS[trial.run.status]}: {trial.run.reason}" for trial in unfinished(trials)]
    return "; ".join(dict.fromkeys(reasons)) or "not scored"


def _overlap(one: Sequence[float], other: Sequence[float]) -> bool:
    return min(one) <= max(other) and min(other) <= max(one)
