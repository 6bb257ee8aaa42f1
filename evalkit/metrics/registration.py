"""How well scans lie on each other under the estimate: measured alike for all, and as the back ends say themselves."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.table import Evidence, Metric, PlacedScan, PlacedScans, cached, make_score, with_support

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_PAIR_M = 0.5
KEYFRAMES = 10
KEYFRAME_M = 0.5
KEYFRAME_RAD = np.radians(20.0)
MIN_PAIRS = 10
"""Residuals of fewer pairs are not accepted."""

MAX_SCANS = 100
"""Of more mapped scans, this many are measured against the map, evenly spaced."""

MAX_STEP_M = 2.0
"""Scans farther apart (median) than this are no longer neighbours."""


def find_nearest(source: Floats, target: cKDTree, max_pair_m: float = MAX_PAIR_M) -> tuple[Floats, Ints]:
    """Distance and index (N,) of the target point nearest to each source point (N, 2); inf where none is so near."""
    distances, indices = target.query(source, distance_upper_bound=max_pair_m)
    return np.asarray(distances, dtype=np.float64), np.asarray(indices, dtype=np.int64)


def keep_one_to_one(distances: Floats, nearest: Ints) -> Floats:
    """Distances (K,) of the pairs that stay when each target point keeps only its closest source point (paper)."""
    order = np.argsort(distances, kind="stable")
    order = order[np.isfinite(distances[order])]
    _, closest = np.unique(nearest[order], return_index=True)
    return distances[order][closest]


def scan_to_scan_residuals(successive: Iterable[tuple[PlacedScan, PlacedScan]]) -> Floats:
    """Per pair of scans (K, 2): mean distance (m) of the points paired, and the share of the later scan that is paired.

    A pair with fewer than ten pairs of points has a distance of nan, and one with an empty scan is left out.
    """
    return _residuals((_points(later), build_kd_tree(_points(earlier))) for earlier, later in successive)


def scan_to_map_residuals(mapped: PlacedScans) -> Floats:
    """Per measured scan (K, 2): mean distance (m) of its pairs with the last keyframes, and the share of it paired.

    A keyframe is a scan whose sensor moved 0.5 m or 20 deg from the keyframe before; ten make the local map.
    """
    return _residuals(_against_local_map(mapped))


def median_step_m(pairs: Iterable[tuple[PlacedScan, PlacedScan]]) -> float:
    """Median distance the sensor went from one scan of a pair to the other."""
    return float(np.median([np.hypot(*(later[:2] - earlier[:2])) for (_, earlier), (_, later) in pairs]))


def find_keyframes(poses: Floats) -> Ints:
    """Indices (K,) of the poses (N, 3) that moved 0.5 m or 20 deg from the keyframe before; the first is one."""
    found = [0]
    for index in range(1, len(poses)):
        x, y, theta = se2.between(poses[found[-1]], poses[index])
        if np.hypot(x, y) >= KEYFRAME_M or abs(theta) >= KEYFRAME_RAD:
            found.append(index)
    return np.array(found, dtype=np.int64)


def _against_local_map(mapped: PlacedScans) -> Iterator[tuple[Floats, cKDTree]]:
    frames = find_keyframes(np.array([pose for _, pose in mapped]))
    tree, until = build_kd_tree(np.zeros((0, 2))), 0
    for index in _measured(len(mapped)):
        before = int(np.searchsorted(frames, index))  # keyframes strictly before this scan
        if before != until:
            clouds = [_points(mapped[k]) for k in frames[:before][-KEYFRAMES:]]
            tree, until = build_kd_tree(np.concatenate(clouds)), before
        yield _points(mapped[index]), tree


def _measured(count: int) -> list[int]:
    """The indices of the scans to measure; never the first, which has nothing before it."""
    return [int(i) for i in np.unique(np.linspace(1, count - 1, min(MAX_SCANS, count - 1)).astype(int))]


def _points(placed: PlacedScan) -> Floats:
    scan, world_from_sensor = placed
    return se2.transform(world_from_sensor, scan.points())


def _residuals(clouds: Iterator[tuple[Floats, cKDTree]]) -> Floats:
    rows = [np.zeros((0, 2))]
    for source, target in clouds:
        if len(source) == 0 or target.n == 0:
            continue
        distances, indices = find_nearest(source, target)
        pairs = keep_one_to_one(distances, indices)
        mean = pairs.mean() if len(pairs) >= MIN_PAIRS else np.nan
        rows.append(np.array([[mean, np.isfinite(distances).mean()]]))
    return np.concatenate(rows)


def _successive(evidence: Evidence) -> Score:
    if not evidence.successive:
        return Score(None, 0, "no two scans in a row were answered")
    step = median_step_m(evidence.successive)
    if step > MAX_STEP_M:
        return Score(None, 0, f"successive scans are {step:.1f} m apart: too far to lie on each other")
    return _median(scan_to_scan_residuals(evidence.successive), 0)


def _mapped(column: int, evidence: Evidence) -> Score:
    if len(evidence.mapped) < 2:
        return Score(None, 0, "fewer than two mapped scans")
    step = median_step_m(pairwise(evidence.mapped))
    if step > MAX_STEP_M:
        return Score(None, 0, f"mapped scans are {step:.1f} m apart: too far to lie on each other")
    return _median(_to_map(evidence), column)


@cached
def _to_map(evidence: Evidence) -> Floats:
    return scan_to_map_residuals(evidence.mapped)


def _median(residuals: Floats, column: int) -> Score:
    values = residuals[:, column]
    values = values[np.isfinite(values)]
    if len(values) == 0:
        return Score(None, 0, f"no scan has {MIN_PAIRS} pairs within {MAX_PAIR_M:g} m")
    return make_score(np.median(values) * (100.0 if column else 1.0), len(values))


def _own(stage: str, field: Literal["error", "iterations"], evidence: Evidence) -> Score:
    values = evidence.run.steps[f"{stage}_{field}"].astype(np.float64)
    told = np.isfinite(values) if field == "error" else values > 0.0
    if not told.any():
        return Score(None, 0, "the back end tells none")
    return make_score(np.median(values[told]), int(told.sum()))


def _share(field: Literal["accepted", "converged"], evidence: Evidence) -> Score:
    """Per cent of scans whose last stage says no."""
    steps = evidence.run.steps
    last = np.where(steps[f"s2m_{field}"] >= 0, steps[f"s2m_{field}"], steps[f"s2s_{field}"])
    told = last[last >= 0]
    if len(told) == 0:
        return Score(None, 0, "not told by the back end")
    return make_score(100.0 * np.mean(told == 0), len(told))


PAPER = "the paper, eq. 5 and figure 9; the same pairs for every back end: evalkit"
LOOKS_GOOD = "a match that is smoothly wrong, as along a corridor; points farther off than 0.5 m; rest at one place"

_ROWS = (
    Metric("s2s_m", "S2S residual", "m", "lower", "residuals",
           "Mean distance over the one-to-one nearest pairs within 0.5 m between a scan and the next one of the "
           "sequence under the estimated trajectory; median over at most 100 such steps, the same for every back end.",
           PAPER, LOOKS_GOOD, _successive, 4),
    Metric("s2m_m", "S2M residual", "m", "lower", "residuals",
           "The same between a mapped scan and the local map of the last ten keyframes among the mapped scans (0.5 m "
            "or "
           "20 deg apart).", PAPER, LOOKS_GOOD, partial(_mapped, 0), 4, headline=True),
    Metric("s2m_paired_percent", "S2M points paired", "%", "higher", "residuals",
           "Points of a mapped scan within 0.5 m of the local map of the last 10 keyframes; median over them.",
           "evalkit", "how well the paired points lie; new places are seen without a fault of the estimate",
           partial(_mapped, 1), 1),
    Metric("guess_kept_percent", "guess kept", "%", "lower", "residuals",
           "Scans after the first of which the last stage's answer was not accepted (too few pairs, or nothing moved "
           "to the last digit), so that the guess it started from stands in its place.", "evalkit",
           "whether the answers accepted are right; back ends that do not tell", partial(_share, "accepted"), 1,
           headline=True),
    Metric("not_converged_percent", "not converged", "%", "lower", "residuals",
           "Scans after the first of which the last stage ended without meeting its own criterion of convergence.",
           "the back end", "what it converged to; not comparable between methods with different criteria",
           partial(_share, "converged"), 1),
    *(Metric(f"own_{stage}_m", f"own {stage.upper()} error", "m", "", "residuals",
             f"The error the back end itself reports for its {words} stage, by its own definition; median over scans.",
             "the back end", "everything the back end does not look at; not comparable between back ends",
             partial(_own, stage, "error"), 4) for stage, words in (("s2s", "scan-to-scan"), ("s2m", "scan-to-map"))),
    *(Metric(f"{stage}_iterations", f"{stage.upper()} iterations", "", "", "residuals",
             f"Iterations of the {words} stage; median over scans.", "the back end",
             "what one iteration costs; not comparable between methods",
             partial(_own, stage, "iterations"), 1)
      for stage, words in (("s2s", "scan-to-scan"), ("s2m", "scan-to-map"))),
)  # fmt: skip

_FAR = "... scans are ... m apart: too far to lie on each other"
_FEW = "no scan has ... pairs within ... m"

METRICS = with_support(
    _ROWS,
    {
        "s2s_m": ("pairs of successive scans", ("no two scans in a row were answered", _FAR, _FEW)),
        "s2m_m": ("mapped scans", ("fewer than two mapped scans", _FAR, _FEW)),
        "s2m_paired_percent": ("mapped scans", ("fewer than two mapped scans", _FAR, _FEW)),
        "guess_kept_percent": ("scans of which the back end tells it", ("not told by the back end",)),
        "not_converged_percent": ("scans of which the back end tells it", ("not told by the back end",)),
        "*": ("scans of which the back end tells it", ("the back end tells none",)),
    },
)
