"""Holds the step from one scan to the next against the truth by where it puts the scan's own points."""

from __future__ import annotations

import numpy as np

from evalkit.core import se2
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.table import Evidence, Metric, make_score, with_support
from evalkit.metrics.trajectory import MAX_GAP_S, UNMATCHED, can_interpolate

_NEAREST = 1e-6
"""A point so near to the centroid, as a share of the cloud's reach, has no direction to be turned away from."""


def pair_error(points: Floats, true: Floats, estimated: Floats) -> float:
    """How far off a registration puts points (N, 2), N > 1, as a share of their distance from their centroid.

    (1/N) sum |p_i - q_i| / |p_i - c|: p_i are the points under the true ``target_from_source`` (3,), q_i under the
    estimated one, c is the centroid of the p_i (Fontana et al., RAS 140, 2021). One number for rotation and
    translation, the same at every scale of the scene; nan where all points are one.
    """
    right, found = se2.transform(true, points), se2.transform(estimated, points)
    reach = np.linalg.norm(right - right.mean(axis=0), axis=1)
    apart = reach > _NEAREST * max(float(reach.max()), _NEAREST)
    return float(np.mean(np.linalg.norm(found - right, axis=1)[apart] / reach[apart])) if apart.any() else float("nan")


def pair_errors(evidence: Evidence, truth: Trajectory, world_from_start: Floats) -> Floats:
    """The pair error (K,) of the later scan of each pair of successive scans whose true poses are known.

    ``world_from_start`` (3,): the alignment under which the scans were placed.
    """
    found = []
    for (earlier, world_from_earlier), (later, world_from_later) in evidence.successive:
        stamps, points = np.array([earlier.stamp_ns, later.stamp_ns]), later.points()
        if len(points) < 2 or not can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S).all():
            continue
        world_from_base = se2.compose(world_from_start, evidence.run.estimate.at(stamps))
        base_from_sensor = se2.between(world_from_base, np.stack([world_from_earlier, world_from_later]))
        true = se2.between(*se2.compose(truth.at(stamps), base_from_sensor))
        found.append(pair_error(points, true, se2.between(world_from_earlier, world_from_later)))
    values = np.array(found, dtype=np.float64)
    return np.asarray(values[~np.isnan(values)])


def _median(evidence: Evidence) -> Score:
    truth, matched = evidence.truth.trajectory, evidence.matched
    if isinstance(matched, str):
        return Score(None, 0, matched)
    if truth is None or matched is None:
        return Score(None, 0, "no true trajectory")
    values = pair_errors(evidence, truth, matched.world_from_start.row)
    return make_score(np.median(values), len(values)) if len(values) else Score(None, 0, _NONE)


_NONE = "no two successive scans with hits have true poses"

_ROWS = (
    Metric("pair_error", "pair error", "", "lower", "drift",
           "How far the step to the next scan puts that scan's points from where the true step puts them, each divided "
           "by its distance from their centroid; mean over points, median over at most 100 steps, the same for every "
           "back end.", "Fontana et al., Robotics and Autonomous Systems 140, 2021",
           "drift too slow for one step; where on the scan the error is; points near the centroid weigh most", _median,
           5),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "*": (
            "pairs of successive scans",
            (*UNMATCHED, _NONE),
        )
    },
)
