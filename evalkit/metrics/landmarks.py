"""Compare corners and hits with those of the ground-truth map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import NO_HIT
from evalkit.metrics.corners import find_corners
from evalkit.metrics.lattice import build_wall_tree
from evalkit.metrics.maps import NO_TRUE_WALL
from evalkit.metrics.metric import (
    NO_TRUE_MAP,
    Evidence,
    PlacedScans,
    find_occupied,
    make_metrics,
    make_score,
    place_hits,
    with_true_grid,
)

CUTOFF_M = 0.5
ORDER = 1.0
BESIDE_M = 0.5
MIN_HITS = 100
MAX_HITS = 40_000


def ospa(one: ArrayLike, other: ArrayLike, cutoff_m: float = CUTOFF_M, order: float = ORDER) -> float:
    """Return the OSPA distance of two sets of points (N, 2), (M, 2) in metres: position errors, misses and false
    points.

    [(1/n) (min over assignments of sum min(c, d)^p + c^p (n - m))]^(1/p), m <= n (Schuhmacher et al., IEEE TSP 56(8),
    2008): each point without a partner counts as the cutoff c. 0 for two empty sets.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    first, second = (np.asarray(points, dtype=np.float64).reshape(-1, 2) for points in (one, other))
    larger, smaller = max(len(first), len(second)), min(len(first), len(second))
    if larger == 0:
        return 0.0
    costs = np.minimum(cdist(first, second), cutoff_m) ** order
    paired = float(costs[linear_sum_assignment(costs)].sum())
    return float(((paired + cutoff_m**order * (larger - smaller)) / larger) ** (1.0 / order))


def signed_offsets(mapped: PlacedScans, true: OccupancyGrid) -> Floats:
    """Return the distance (K,) of each hit behind the nearest true wall cell, as seen from the sensor (m; negative:
    before).

    Hits without a wall within ``BESIDE_M`` are omitted.
    """
    walls, thin = true.centres(find_occupied(true)), max(sum(int(scan.hits.sum()) for scan, _ in mapped) // MAX_HITS, 1)
    if not len(walls) or not mapped:
        return np.zeros(0)
    scans = [place_hits(placed)[::thin] for placed in mapped]
    points = np.concatenate(scans)
    sensors = np.repeat([world_from_sensor[:2] for _, world_from_sensor in mapped], list(map(len, scans)), axis=0)
    apart, nearest = map(np.asarray, build_wall_tree(true).query(points, distance_upper_bound=BESIDE_M))
    near = np.isfinite(apart)
    from_wall, beams = points[near] - walls[nearest[near]], points[near] - sensors[near]
    return np.asarray(np.copysign(apart[near], np.sum(from_wall * beams, axis=1)))


def _score_corners(mapped: OccupancyGrid, true: OccupancyGrid) -> Score:
    mapped_corners, true_corners = find_corners(mapped), find_corners(true)
    if not len(true_corners):
        return Score(None, len(mapped_corners), _NO_CORNER)
    return make_score(ospa(mapped_corners, true_corners), len(mapped_corners) + len(true_corners))


def _score_offset(evidence: Evidence) -> Score:
    true = evidence.truth.grid
    if true is None or not find_occupied(true).any():
        return Score(None, reason=NO_TRUE_MAP if true is None else NO_TRUE_WALL)
    if not any(scan.hits.any() for scan, _ in evidence.mapped):
        return Score(None, reason=NO_HIT)
    offsets = signed_offsets(evidence.mapped, true)
    if len(offsets) < MIN_HITS:
        return Score(None, len(offsets), f"only {len(offsets)} hits are within {BESIDE_M:g} m of a true wall")
    return make_score(offsets.mean(), len(offsets))


_NO_CORNER = "the ground-truth map has no corner"


METRICS = make_metrics(
    "landmarks",
    {
        "map_wall_offset_m": _score_offset,
        "map_corner_ospa_m": with_true_grid(_score_corners),
    },
    BESIDE_M=BESIDE_M,
    CUTOFF_M=CUTOFF_M,
    ORDER=ORDER,
)
