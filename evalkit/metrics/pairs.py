"""Error of the step from one scan to the next, measured by the displacement of the scan's own points."""

from __future__ import annotations

import numpy as np

from evalkit.core import se2
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import NO_TRUE_TRAJECTORY, Evidence, Unmatched, make_metrics, make_score
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate

_NEAREST = 1e-6
"""Points nearer to the centroid than this share of the cloud's radius are omitted: the quotient is undefined."""


def pair_error(points: Floats, true: Floats, estimated: Floats) -> float:
    """Return the mean displacement of points (N, 2), N > 1, by a registration error, relative to their centroid
    distance.

    (1/N) sum |p_i - q_i| / |p_i - c|: p_i are the points under the true ``target_from_source`` (3,), q_i under the
    estimated one, c is the centroid of the p_i (Fontana et al., RAS 140, 2021). One number for rotation and
    translation, invariant to the scale of the scene; nan if all points coincide.
    """
    correct, placed = se2.transform(true, points), se2.transform(estimated, points)
    reach = np.linalg.norm(correct - correct.mean(axis=0), axis=1)
    apart = reach > _NEAREST * max(float(reach.max()), _NEAREST)
    return (
        float(np.mean(np.linalg.norm(placed - correct, axis=1)[apart] / reach[apart])) if apart.any() else float("nan")
    )


def pair_errors(evidence: Evidence, truth: Trajectory, world_from_start: Floats) -> Floats:
    """Return the pair error (K,) of the later scan of each pair of successive scans with known true poses.

    ``world_from_start`` (3,): the alignment of the placed scans.
    """
    pairs = evidence.successive
    stamps = np.array([[scan.stamp_ns for scan, _ in pair] for pair in pairs], np.int64).reshape(-1, 2)
    known = can_interpolate(truth.stamps_ns, stamps.ravel(), MAX_GAP_S).reshape(-1, 2).all(axis=1)
    known &= np.array([np.count_nonzero(later.hits) > 1 for _, (later, _) in pairs], np.bool_)
    at = stamps[known].ravel()
    placed = np.array([[pose for _, pose in pair] for pair in pairs]).reshape(-1, 2, 3)[known]
    world_from_base = se2.compose(world_from_start, evidence.run.estimate.at(at)).reshape(-1, 2, 3)
    true = se2.compose(truth.at(at).reshape(-1, 2, 3), se2.between(world_from_base, placed))
    steps = (se2.between(poses[:, 0], poses[:, 1]) for poses in (true, placed))
    scans = [pairs[index][1][0] for index in np.flatnonzero(known)]
    values = np.array([pair_error(scan.points(), *of) for scan, *of in zip(scans, *steps, strict=True)], np.float64)
    return np.asarray(values[~np.isnan(values)])


def _score_median(evidence: Evidence) -> Score:
    truth, matched = evidence.truth.trajectory, evidence.matched
    if isinstance(matched, Unmatched):
        return Score(None, reason=matched.reason)
    if truth is None:
        return Score(None, reason=NO_TRUE_TRAJECTORY)
    values = pair_errors(evidence, truth, matched.world_from_start.row)
    return make_score(np.median(values), len(values)) if len(values) else Score(None, reason=_NONE)


_NONE = "no two successive scans with hits have true poses"

METRICS = make_metrics(
    "pairs",
    {
        "pair_error": _score_median,
    },
)
