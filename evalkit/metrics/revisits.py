"""Errors at revisited places: relations between two visits, made from the ground truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints, spread_indices
from evalkit.core.ground_truth import Relations
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import NO_TRUE_TRAJECTORY, Evidence, make_metrics, make_score
from evalkit.metrics.relations import compute_estimated_motions, symmetric_errors

NEAR_M = 1.0
COVERED_M = 100.0
COVERED_SHARE = 0.25
LEAST_COVERED = 2.0
"""Path between two visits in units of their largest distance: one that is driven straight on is no return."""

EVERY_M = 0.2
MAX_REVISITS = 2000

NO_REVISIT = "the true path does not revisit a place"

MAX_OFF_M = 0.15
MAX_OFF_RAD = 0.02
"""An automatic relation with a larger error is an outlier (Cartographer's defaults)."""


def find_revisits(reference: Trajectory, near_m: float = NEAR_M, covered_m: float | None = None) -> Relations:
    """Return the reference's motions between two visits of a place: the nearest pose of each later pass within
    ``near_m``.

    ``covered_m``: least path length between the visits; default: 100 m as in Cartographer's automatic relations (Hess
    et al., ICRA 2016), or a quarter of a path shorter than 400 m, and at least twice ``near_m``. Places are examined
    every 0.2 m of path. At most 2,000 pairs are kept, evenly spaced.
    """
    steps = np.linalg.norm(np.diff(reference.poses[:, :2], axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])[: len(reference)]
    shortest = max(min(COVERED_M, COVERED_SHARE * reference.path_m), LEAST_COVERED * near_m)
    covered = shortest if covered_m is None else covered_m
    places = np.unique(np.searchsorted(path, np.arange(0.0, reference.path_m, EVERY_M)))
    pairs = list(_find_visits(reference.poses[:, :2], path, places, covered, near_m))
    chosen = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    chosen = chosen[spread_indices(len(chosen), MAX_REVISITS)]
    first, second = chosen.T
    motions = se2.between(reference.poses[first], reference.poses[second])
    return Relations(reference.stamps_ns[first], reference.stamps_ns[second], motions)


@lru_cache(maxsize=2)
def find_all_revisits(reference: Trajectory) -> Relations:
    """Return ``find_revisits`` of a trajectory with its defaults; the last ones are kept for other metrics."""
    return find_revisits(reference)


def _find_visits(
    positions: Floats, path: Floats, places: Ints, covered_m: float, near_m: float
) -> Iterator[tuple[int, int]]:
    """Yield each place with the nearest pose of each later stretch of path within ``near_m`` of it."""
    from scipy.spatial import cKDTree

    begin = np.searchsorted(path, path[places] + covered_m)
    around = cKDTree(positions).query_ball_point(positions[places], near_m * (1.0 + 1e-9), return_sorted=True)
    for place, earliest, found in zip(places.tolist(), begin.tolist(), around, strict=True):
        later = np.asarray(found, dtype=np.int64)
        later = later[later >= earliest]
        apart = np.linalg.norm(positions[later] - positions[place], axis=1)
        later, apart = later[apart <= near_m], apart[apart <= near_m]
        ends = np.flatnonzero(np.diff(later) > 1) + 1
        for stretch, distances in zip(np.split(later, ends), np.split(apart, ends), strict=True):
            if len(stretch):
                yield place, int(stretch[np.argmin(distances)])


def within_limits(errors: Floats, metres: float = MAX_OFF_M, radians: float = MAX_OFF_RAD) -> Bools:
    """Return which errors (M, 2) in metres and radians are within both limits."""
    return np.asarray((errors[:, 0] <= metres) & (errors[:, 1] <= radians))


def _make_mean(column: int) -> Callable[[Floats], float]:
    def mean(errors: Floats) -> float:
        return float(np.mean(np.degrees(errors[:, column]) if column else errors[:, column]))

    return mean


def _make_score_function(measure: Callable[[Floats], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        reference = evidence.truth.trajectory
        if reference is None or len(reference) < 2:
            return Score(None, reason=NO_TRUE_TRAJECTORY)
        visits = find_all_revisits(reference)
        if len(visits) == 0:
            return Score(None, reason=NO_REVISIT)
        motions, covered = compute_estimated_motions(evidence.run.estimate, visits)
        if not covered.any():
            return Score(None, reason=f"the estimate covers none of {len(visits)} revisits")
        errors = symmetric_errors(motions, visits.first_from_second[covered])
        return make_score(measure(errors), len(errors))

    return compute


METRICS = make_metrics(
    "revisits",
    {
        "revisit_mean_m": _make_score_function(_make_mean(0)),
        "revisit_mean_deg": _make_score_function(_make_mean(1)),
        "revisit_within_percent": _make_score_function(lambda errors: 100.0 * float(within_limits(errors).mean())),
    },
    NEAR_M=NEAR_M,
    MAX_OFF_M=MAX_OFF_M,
    MAX_OFF_RAD=MAX_OFF_RAD,
)
