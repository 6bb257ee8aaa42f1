"""One metric of one method over one sequence: the values of its runs, their median and its interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import median
from typing import Literal

import numpy as np

from evalkit.core.run_result import LostTrack
from evalkit.core.run_status import RunStatus
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import Group, Metric
from evalkit.report.analysis.record_bootstrap import RecordBootstrap
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import DRAWS, BootstrapDraws, expanded_percentile_interval
from evalkit.stats.intervals import Interval
from evalkit.stats.runs import runs_interval

MAX_GUESSED = 50.0
"""Above this share of scans (%) that keep the initial guess, the result is the guess's: the method is not ranked."""

GUESSED = "guess_kept_percent"

DECIDING: tuple[Group, ...] = ("relations", "drift", "map against truth", "localisation", "map consistency")
"""Groups of metrics that may decide a sequence: official relations first, then a true trajectory or map, then the fit
to a known map, then the consistency of the maps drawn."""
WITH_TRUTH: tuple[Group, ...] = DECIDING[:3]

STATUS_LABELS: dict[RunStatus, str] = {
    RunStatus.COMPLETE: "complete",
    RunStatus.FAILED: "failed",
    RunStatus.CRASHED: "crashed",
    RunStatus.TIMEOUT: "timed out",
    RunStatus.OUT_OF_MEMORY: "out of memory",
    RunStatus.NOT_INSTALLED: "not installed",
    RunStatus.DATA_MISSING: "data missing",
    RunStatus.INTERRUPTED: "interrupted",
    RunStatus.SKIPPED: "not run yet",
}


@dataclass(frozen=True, slots=True)
class Spread:
    """Bounds beside the median of ``runs`` runs, in the metric's unit.

    ``kind``: a 95 % "interval", or the lowest and highest value: "perturbed" of a recording under small perturbations,
    "range" of two runs, which have no interval.
    """

    low: float
    high: float
    runs: int
    kind: Literal["interval", "perturbed", "range"]


def choose_spread(
    runs: int, perturbed: bool, interval: tuple[float, float] | None, extremes: tuple[float, float] | None
) -> Spread | None:
    """Return the bounds to state beside a median, on the page and in exported tables; None of one run without any.

    ``extremes``: the lowest and highest value of the runs, None without a value.
    """
    if perturbed and runs > 1 and extremes is not None:
        return Spread(*extremes, runs, "perturbed")
    if interval is not None:
        return Spread(*interval, runs, "interval")
    return Spread(*extremes, runs, "range") if runs > 1 and extremes is not None else None


@dataclass(frozen=True, slots=True)
class MethodScore:
    """One metric of one method over one sequence, in the metric's unit.

    ``values``: one per complete run with a score, in the order of the runs; ``seeds``: theirs. ``partial``: values of
    runs that ended early, which enter no median. ``complete`` of ``expected`` runs completed, without those that were
    interrupted: they say nothing about the method. ``reason``: why there is
    no value, "" if there is one. ``guessed_percent``: share of scans that kept the initial guess, 0 if unknown.
    ``draws``: bootstrap draws of each value, None where the metric has none. ``interval``: the median over the runs
    with its 95 % interval: over three or more runs by Student's t; of one run by its draws, which describes this run
    alone; else None. ``lost``: the first loss of the track in its runs, None if all held it. ``lost_runs``: how many
    lost it; ``found_runs``: how many of these found it again. ``tuned``: settings of the method were chosen on this
    data set. ``perturbed``: the repetitions are perturbations of a recording.
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
    draws: tuple[BootstrapDraws | None, ...] = field(default=(), compare=False, repr=False)
    interval: Interval | None = None
    lost: LostTrack | None = None
    tuned: bool = False
    perturbed: bool = False
    lost_runs: int = 0
    found_runs: int = 0

    @property
    def spread(self) -> Spread | None:
        """The bounds to state beside the median."""
        interval = (self.interval.low, self.interval.high) if self.interval is not None else None
        extremes = (min(self.values), max(self.values)) if self.values else None
        return choose_spread(len(self.values), self.perturbed, interval, extremes)

    @property
    def median(self) -> float | None:
        """The median over the complete runs; None without any."""
        return median(self.values) if self.values else None

    @property
    def rankable(self) -> bool:
        """Whether every run completed, has a value, held the track and registered, on data it was not tuned on."""
        return self.whole and self.registers and self.lost is None and not self.tuned

    @property
    def whole(self) -> bool:
        """Whether every run completed and has a value."""
        return bool(self.values) and self.complete == self.expected == len(self.values)

    @property
    def registers(self) -> bool:
        """Whether at most ``MAX_GUESSED`` percent of the scans kept the initial guess."""
        return self.guessed_percent <= MAX_GUESSED


def compute_score(
    runs: Sequence[RunRecord], metric: Metric, bootstrap: RecordBootstrap, tuned: bool = False
) -> MethodScore:
    """Compute the score of one method's runs over one sequence. ``tuned``: its settings were chosen on these data."""
    complete = [run for run in runs if run.result.is_complete]
    scored = [(run, run.scores.by_metric[metric.name]) for run in complete if metric.name in run.scores.by_metric]
    known = [(run, score.value, score.support) for run, score in scored if score.value is not None]
    partial = [
        run.scores.by_metric[metric.name].value
        for run in select_unfinished(runs)
        if metric.name in run.scores.by_metric
    ]
    values = tuple(value for _, value, _ in known)
    losses = [run.scores.lost for run in runs if run.scores.lost is not None]
    support = int(median(support for *_, support in known)) if known else 0
    draws = tuple(bootstrap.draws(run, metric.name) for run, *_ in known)
    return MethodScore(
        runs[0].method,
        values,
        tuple(value for value in partial if value is not None),
        len(complete),
        sum(run.result.status != RunStatus.INTERRUPTED for run in runs),
        support,
        "" if known else _reason_without_value(runs, metric),
        tuple(run.seed for run, *_ in known),
        guessed_percent(complete),
        draws,
        runs_interval(values) if len(values) > 1 else _compute_interval(values, draws, support),
        None if metric.group == "runtime" or metric.slam_only else find_loss(runs),
        tuned and metric.group != "runtime",
        runs[0].spec.sequence.perturbed,
        len(losses),
        sum(loss.recovered_at_s is not None for loss in losses),
    )


def find_loss(runs: Sequence[RunRecord]) -> LostTrack | None:
    """Return the earliest loss of the track in these runs; None if all held it."""
    return min((run.scores.lost for run in runs if run.scores.lost is not None), key=lambda one: one.at_s, default=None)


def median_over_runs(draws: Sequence[Floats]) -> Floats:
    """Return draws (D,) of the median over runs: resample the runs, each with the draws (D,) within it."""
    table = np.stack(draws)
    if len(table) == 1:
        return draws[0]
    chosen = np.random.default_rng(0).integers(0, len(table), (DRAWS, len(table)))
    return np.asarray(np.median(table[chosen, np.arange(DRAWS)[:, None]], axis=1))


def select_unfinished(runs: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """Return the runs that did not complete, in order."""
    return tuple(run for run in runs if not run.result.is_complete)


def guessed_percent(runs: Sequence[RunRecord]) -> float:
    """Return the share of scans (%) that kept the initial guess, the median over the runs; 0 if unknown."""
    scores = [run.scores.by_metric[GUESSED].value for run in runs if GUESSED in run.scores.by_metric]
    known = [value for value in scores if value is not None]
    return median(known) if known else 0.0


def _compute_interval(values: Sequence[float], draws: Sequence[BootstrapDraws | None], support: int) -> Interval | None:
    """Return the bootstrap interval of one run."""
    one = draws[0] if draws else None
    return None if one is None else expanded_percentile_interval(values[0], one.values, support, one.blocks)


def _reason_without_value(runs: Sequence[RunRecord], metric: Metric) -> str:
    complete = [run for run in runs if run.result.is_complete and metric.name in run.scores.by_metric]
    reasons = [run.scores.by_metric[metric.name].reason for run in complete]
    reasons += [f"{STATUS_LABELS[run.result.status]}: {run.result.reason}" for run in select_unfinished(runs)]
    return "; ".join(dict.fromkeys(reasons)) or "not scored"
