"""The objective of the search: lost runs first, then the geometric mean of the errors; the front of error and cost."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.tune.space import TuningCandidate
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.design.responses import Response, bounded_value, find_loss_reason
from evalkit.design.run_points import RunScores
from evalkit.metrics.runtime import COST
from evalkit.stats.intervals import Interval, student_quantile
from evalkit.stats.runs import paired_runs

MIN_GAIN = 0.05
"""A smaller gain, as a share of the error, does not count as better; the report uses the same."""


@dataclass(frozen=True, eq=False)
class ScoredCandidate:
    """A point with its runs.

    ``errors`` (R,) in the objective's unit, lost runs at the bound; ``lost`` (R,): why a run is lost, or "";
    ``cpu_ms``: median CPU time of a scan; ``cpu_s``: CPU time of all runs; ``failed``: no run was completed.

    Points that lose equally many runs are ordered by the geometric mean of the errors. In logarithms, halving 2 cm
    counts as much as halving 20 cm, so that no single long sequence decides, and the report tests the same ratios. Lost
    runs come first, because small errors elsewhere do not make up for a lost robot.
    """

    candidate: TuningCandidate
    errors: Floats
    lost: tuple[str, ...]
    cpu_ms: float
    cpu_s: float
    failed: bool

    @property
    def error(self) -> float:
        """The geometric mean of the errors, in the objective's unit."""
        return float(np.exp(np.mean(np.log(self.errors))))

    @property
    def losses(self) -> int:
        """The number of lost runs."""
        return sum(map(bool, self.lost))

    @property
    def order(self) -> tuple[int, float]:
        """The sort key, smaller is better; rounded to nine digits, so that rounding errors decide nothing."""
        return self.losses, round(math.log(self.error), 9)


def score_candidate(candidate: TuningCandidate, results: Sequence[RunScores], objective: Response) -> ScoredCandidate:
    """A point with the results of its runs."""
    errors = np.array([max(bounded_value(result, objective), 1e-12) for result in results])
    costs_ms = [cost for result in results if (cost := result["scores"][COST]) is not None]
    return ScoredCandidate(
        candidate,
        errors,
        tuple(find_loss_reason(result, (objective,)) for result in results),
        float(np.median(costs_ms)) if costs_ms else math.nan,
        float(sum(result["cpu_s"] for result in results)),
        all(result["status"] != "complete" for result in results),
    )


def find_best_candidate(tried: Sequence[ScoredCandidate]) -> ScoredCandidate:
    """The best point; the earliest of equal ones, so that the default wins a tie."""
    return min(tried, key=lambda one: one.order)


def compute_error_ratio(ours: ScoredCandidate, theirs: ScoredCandidate) -> Interval:
    """The geometric mean ratio of errors over the same runs with its 95 % interval (Student's t); below 1 is better."""
    runs = len(ours.errors)
    found = paired_runs(ours.errors, theirs.errors)
    if found is None:
        raise ValueError(f"a ratio with its interval takes at least two runs, got {runs}")
    half = student_quantile(runs - 1) * found.error
    return Interval(math.exp(found.mean), math.exp(found.mean - half), math.exp(found.mean + half), runs)


def is_better(ours: ScoredCandidate, theirs: ScoredCandidate, ratio: Interval) -> bool:
    """Whether a point loses no more runs than another, is at least 5 % better, and its whole interval is below 1."""
    return ours.losses <= theirs.losses and ratio.high < 1.0 and ratio.value <= 1.0 - MIN_GAIN


def mark_pareto_front(tried: Sequence[ScoredCandidate]) -> Bools:
    """Marks of the points on the Pareto front of training error and CPU time; a point that loses a run is not on it."""
    errors = np.array([math.inf if one.losses else one.error for one in tried])
    return find_pareto_front(np.array([one.cpu_ms for one in tried]), errors)


def find_pareto_front(costs: Floats, errors: Floats) -> Bools:
    """Marks (N,) of the points on the Pareto front; smaller is better in both.

    A point dominates another if it is no worse in both and better in one. Points with a value that is not finite are
    not on the front; equal points are on it together.
    """
    both = np.column_stack([costs, errors]).astype(np.float64).reshape(-1, 2)
    known = np.asarray(np.isfinite(both).all(axis=1))
    no_worse = (both[None, :, :] <= both[:, None, :]).all(axis=2)
    better = (both[None, :, :] < both[:, None, :]).any(axis=2)
    dominated = (no_worse & better & known[None, :]).any(axis=1)
    return np.asarray(known & ~dominated)
