"""Residuals between scans under the estimate: computed equally for all methods, and as reported by back ends."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import Evidence, PlacedScan, PlacedScans, cached, make_metrics, make_score, place_hits
from evalkit.metrics.neighbourhoods import build_kd_tree

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_PAIR_M = 0.5
KEYFRAMES = 10
KEYFRAME_M = 0.5
KEYFRAME_RAD = np.radians(20.0)
MIN_PAIRS = 10
"""Residuals of fewer pairs are rejected."""

MAX_SCANS = 100
"""At most this many scans are compared with the local map, evenly spaced."""

MAX_STEP_M = 2.0
"""Scans farther apart (median) are not compared."""


def find_nearest(source: Floats, target: cKDTree, max_pair_m: float = MAX_PAIR_M) -> tuple[Floats, Ints]:
    """Return distance and index (N,) of the target point nearest to each source point (N, 2); inf beyond the limit."""
    distances, indices = target.query(source, distance_upper_bound=max_pair_m)
    return np.asarray(distances, dtype=np.float64), np.asarray(indices, dtype=np.int64)


def keep_one_to_one(distances: Floats, nearest: Ints) -> Floats:
    """Return the distances (K,) of the pairs in which each target point keeps only its closest source point (paper)."""
    closest = np.full(int(nearest.max(initial=0)) + 1, np.inf)
    np.minimum.at(closest, nearest, distances)
    return np.asarray(closest[np.isfinite(closest)])


def scan_to_scan_residuals(successive: Iterable[tuple[PlacedScan, PlacedScan]]) -> Floats:
    """Return for each pair of scans (K, 2): mean distance of paired points (m), and the paired share of the later scan.

    A pair of scans with fewer than ten pairs of points has a distance of nan; pairs with an empty scan are omitted.
    """
    return _compute_residuals((place_hits(later), build_kd_tree(place_hits(earlier))) for earlier, later in successive)


def scan_to_map_residuals(mapped: PlacedScans) -> Floats:
    """Return for each measured scan (K, 2): mean distance (m) of its pairs with the last keyframes, and its paired
    share.

    A keyframe is a scan whose sensor moved 0.5 m or 20 deg since the previous keyframe; ten keyframes are the local
    map.
    """
    return _compute_residuals(_iterate_local_maps(mapped))


def median_step_m(pairs: Iterable[tuple[PlacedScan, PlacedScan]]) -> float:
    """Return the median distance of the sensor between the scans of a pair."""
    return float(np.median([np.hypot(*(later[:2] - earlier[:2])) for (_, earlier), (_, later) in pairs]))


def find_keyframes(poses: Floats) -> Ints:
    """Return the indices (K,) of the poses (N, 3) that moved 0.5 m or 20 deg since the previous keyframe, and the
    first.
    """
    indices = [0]
    for index in range(1, len(poses)):
        x, y, theta = se2.between(poses[indices[-1]], poses[index])
        if np.hypot(x, y) >= KEYFRAME_M or abs(theta) >= KEYFRAME_RAD:
            indices.append(index)
    return np.array(indices, dtype=np.int64)


def _iterate_local_maps(mapped: PlacedScans) -> Iterator[tuple[Floats, cKDTree]]:
    frames = find_keyframes(np.array([pose for _, pose in mapped]))
    tree, until = build_kd_tree(np.zeros((0, 2))), 0
    for index in (1 + spread_indices(len(mapped) - 1, MAX_SCANS)).tolist():  # the first has no predecessor
        before = int(np.searchsorted(frames, index))  # keyframes strictly before this scan
        if before != until:
            clouds = [place_hits(mapped[k]) for k in frames[:before][-KEYFRAMES:]]
            tree, until = build_kd_tree(np.concatenate(clouds)), before
        yield place_hits(mapped[index]), tree


def _compute_residuals(clouds: Iterator[tuple[Floats, cKDTree]]) -> Floats:
    rows = [np.zeros((0, 2))]
    for source, target in clouds:
        if len(source) == 0 or target.n == 0:
            continue
        distances, indices = find_nearest(source, target)
        pairs = keep_one_to_one(distances, indices)
        mean = pairs.mean() if len(pairs) >= MIN_PAIRS else np.nan
        rows.append(np.array([[mean, np.isfinite(distances).mean()]]))
    return np.concatenate(rows)


def _score_successive(evidence: Evidence) -> Score:
    if not evidence.successive:
        return Score(None, reason=_NO_PAIR)
    step = median_step_m(evidence.successive)
    if step > MAX_STEP_M:
        return Score(None, reason=f"successive scans are {step:.1f} m apart: too far to overlap")
    return _score_median(scan_to_scan_residuals(evidence.successive), 0)


def _score_mapped(column: int, evidence: Evidence) -> Score:
    if len(evidence.mapped) < 2:
        return Score(None, reason=_TOO_FEW)
    step = median_step_m(pairwise(evidence.mapped))
    if step > MAX_STEP_M:
        return Score(None, reason=f"mapped scans are {step:.1f} m apart: too far to overlap")
    return _score_median(_compute_map_residuals(evidence), column)


@cached
def _compute_map_residuals(evidence: Evidence) -> Floats:
    return scan_to_map_residuals(evidence.mapped)


def _score_median(residuals: Floats, column: int) -> Score:
    values = residuals[:, column]
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Score(None, reason=f"no scan has {MIN_PAIRS} pairs within {MAX_PAIR_M:g} m")
    return make_score(np.median(values) * (100.0 if column else 1.0), len(values))


def _score_own_values(stage: str, field: Literal["error", "iterations"], evidence: Evidence) -> Score:
    values = evidence.run.steps[f"{stage}_{field}"].astype(np.float64)
    reported = np.isfinite(values) if field == "error" else values > 0.0
    if not reported.any():
        return Score(None, reason=_NOT_REPORTED)
    return make_score(np.median(values[reported]), int(reported.sum()))


def _score_share(field: Literal["accepted", "converged"], evidence: Evidence) -> Score:
    """Return the percentage of scans whose last stage reports ``False``."""
    steps = evidence.run.steps
    last = np.where(steps[f"s2m_{field}"] >= 0, steps[f"s2m_{field}"], steps[f"s2s_{field}"])
    reported = last[last >= 0]
    if len(reported) == 0:
        return Score(None, reason=_NOT_REPORTED)
    return make_score(100.0 * np.mean(reported == 0), len(reported))


_NO_PAIR = "no two successive scans have poses"
_TOO_FEW = "fewer than two mapped scans"
_NOT_REPORTED = "not reported by the back end"


METRICS = make_metrics(
    "registration",
    {
        "s2s_m": _score_successive,
        "s2m_m": partial(_score_mapped, 0),
        "s2m_paired_percent": partial(_score_mapped, 1),
        "guess_kept_percent": partial(_score_share, "accepted"),
        "not_converged_percent": partial(_score_share, "converged"),
        "own_s2s_m": partial(_score_own_values, "s2s", "error"),
        "own_s2m_m": partial(_score_own_values, "s2m", "error"),
        "s2s_iterations": partial(_score_own_values, "s2s", "iterations"),
        "s2m_iterations": partial(_score_own_values, "s2m", "iterations"),
    },
)
