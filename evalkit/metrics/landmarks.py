"""Holds single things of a map against the true ones: its corners, and the hits beside true walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import NO_HIT, find_corners, find_mapped_corners
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.table import DIVERGED, Evidence, Metric, PlacedScans, make_score, with_support

CUTOFF_M = 0.5
ORDER = 1.0
BESIDE_M = 0.5
MIN_HITS = 100
MAX_HITS = 40_000


def ospa(one: ArrayLike, other: ArrayLike, cutoff_m: float = CUTOFF_M, order: float = ORDER) -> float:
    """How far apart two sets of points (N, 2), (M, 2) are (m): place, misses and false ones in one number.

    [(1/n) (min over assignments of sum min(c, d)^p + c^p (n - m))]^(1/p), m <= n (Schuhmacher et al., IEEE TSP 56(8),
    2008): each point without a partner counts as the cutoff c. 0 for two empty sets.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    first, second = (np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in (one, other))
    most, least = max(len(first), len(second)), min(len(first), len(second))
    if most == 0:
        return 0.0
    costs = np.minimum(cdist(first, second), cutoff_m) ** order
    paired = float(costs[linear_sum_assignment(costs)].sum())
    return float(((paired + cutoff_m**order * (most - least)) / most) ** (1.0 / order))


def signed_offsets(mapped: PlacedScans, true: OccupancyGrid, within_m: float = BESIDE_M) -> Floats:
    """How far behind the nearest true wall cell each hit (K,) lies, seen from the sensor (m; below zero: before it).

    Hits without a wall within ``within_m`` are left out.
    """
    walls = true.centres(true.occupied())
    found = [np.zeros(0)]
    if not len(walls):
        return found[0]
    tree, thin = build_kd_tree(walls), max(sum(int(scan.hits.sum()) for scan, _ in mapped) // MAX_HITS, 1)
    for scan, world_from_sensor in mapped:
        points = se2.transform(world_from_sensor, scan.points())[::thin]
        apart, nearest = map(np.asarray, tree.query(points, distance_upper_bound=within_m))
        near = np.isfinite(apart)
        offsets, beams = points[near] - walls[nearest[near]], points[near] - world_from_sensor[:2]
        found.append(np.copysign(apart[near], np.sum(offsets * beams, axis=1)))
    return np.concatenate(found)


def _corners(evidence: Evidence) -> Score:
    true = evidence.truth.grid
    if true is None:
        return Score(None, 0, "no true map")
    if evidence.grid is None:
        return Score(None, 0, f"no map: {evidence.no_grid}")
    ours, theirs = find_mapped_corners(evidence), find_corners(true)
    if not len(theirs):
        return Score(None, len(ours), "the true map shows no corner")
    return make_score(ospa(ours, theirs), len(ours) + len(theirs))


def _offset(evidence: Evidence) -> Score:
    true = evidence.truth.grid
    if true is None or not true.occupied().any():
        return Score(None, 0, "no true map" if true is None else "the true map has no wall")
    if not any(scan.hits.any() for scan, _ in evidence.mapped):
        return Score(None, 0, NO_HIT)
    found = signed_offsets(evidence.mapped, true)
    if len(found) < MIN_HITS:
        return Score(None, len(found), f"only {len(found)} hits are within {BESIDE_M:g} m of a true wall")
    return make_score(found.mean(), len(found))


_ROWS = (
    Metric("map_wall_offset_m", "signed wall offset", "m", "", "map against truth",
           f"How far behind the nearest true wall cell the hits lie, seen from the sensor, mean over those within "
           f"{BESIDE_M:g} m of one: above zero rooms come out too large, below too small.", "evalkit",
           "errors that push walls as often out as in; half a cell of the true map", _offset, 4),
    Metric("map_corner_ospa_m", "corners, OSPA", "m", "lower", "map against truth",
           f"Optimal sub-pattern assignment distance (order {ORDER:g}, cutoff {CUTOFF_M:g} m) between the corners of "
           "both maps: a missing or a false corner counts as the cutoff.",
           "Schuhmacher, Vo and Vo, IEEE TSP 56(8), 2008", "everything but corners; corners that the detector misses "
           "in the true map too, which depend on its cell size", _corners),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "map_wall_offset_m": (
            "hits beside a true wall",
            ("no true map", "the true map has no wall", NO_HIT, "only ... hits are within ... m of a true wall"),
        ),
        "map_corner_ospa_m": (
            "corners of both maps",
            ("no true map", "no map: ...", "the true map shows no corner", DIVERGED),
        ),
    },
)
