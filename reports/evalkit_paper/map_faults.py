"""What is wrong with a map, and where: walls that are not there, walls drawn thick, walls that were wiped out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import CLEARED, NOISE_M
from evalkit.metrics.maps import nearest_distances_m

GHOST_M = 0.2
"""An occupied cell this far from every true wall is a ghost: four times the range noise (1 sigma)."""

SMEAR_M = 0.1
TOGETHER_M = 0.15
"""Ghosts nearer to each other than this are one."""


@dataclass(frozen=True, eq=False)
class Faults:
    """Faults of a map by its cells (H, W), and true walls it says are free.

    ``ghosts``: occupied, farther than ``GHOST_M`` from any true wall. ``smeared``: occupied, farther than ``SMEAR_M``.
    ``wiped`` (K, 2): centres (m) of true wall cells that are free on the map, with none occupied within ``GHOST_M``.
    """

    occupied: Bools
    ghosts: Bools
    smeared: Bools
    wiped: Floats


@dataclass(frozen=True, slots=True)
class Cluster:
    """Cells that lie together: how many, their middle (m), their reach (m), and how far off a true wall at most (m)."""

    cells: int
    x: float
    y: float
    reach_m: float
    off_m: float


def faults(mapped: OccupancyGrid, true: OccupancyGrid) -> Faults:
    """Where a map differs from the true one, which need not share origin or resolution; both must have walls."""
    occupied, walls = mapped.occupied(), true.centres(true.occupied())
    off = np.zeros(mapped.shape)
    off[occupied] = nearest_distances_m(mapped.centres(occupied), walls)
    ghosts = occupied & (off > GHOST_M)
    missing = walls[nearest_distances_m(walls, mapped.centres(occupied)) > GHOST_M]
    return Faults(
        occupied, ghosts, occupied & (off > SMEAR_M) & ~ghosts, missing[_looked_up(mapped.free(), mapped, missing)]
    )


def clusters(points: Floats, walls: Floats) -> tuple[Cluster, ...]:
    """Points (N, 2) that lie together, most first; ``walls`` (M, 2), M > 0, are what they stand off from."""
    if not len(points):
        return ()
    near = cKDTree(points).query_pairs(TOGETHER_M, output_type="ndarray").astype(np.int32)  # old SciPy takes no other
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(points), len(points)))
    count, labels = connected_components(links, directed=False)
    off = nearest_distances_m(points, walls)
    found = [_cluster(points[labels == label], off[labels == label]) for label in range(count)]
    return tuple(sorted(found, key=lambda cluster: -cluster.cells))


def _cluster(points: Floats, off: Floats) -> Cluster:
    x, y = points.mean(axis=0).tolist()
    return Cluster(len(points), x, y, float(np.hypot(*np.ptp(points, axis=0))), float(off.max()))


def contradicted(hits: Floats, other: OccupancyGrid) -> Bools:
    """Which hits (N, 2) lie in free space of another map: a cell it has cleared, and no occupied one within 0.1 m."""
    cleared = other.observed & (other.log_odds < CLEARED)
    suspects = _looked_up(cleared, other, hits)
    walls = other.centres(other.occupied())
    if suspects.any() and len(walls):
        suspects[suspects] = nearest_distances_m(hits[suspects], walls) > NOISE_M
    return suspects


def _looked_up(marked: Bools, grid: OccupancyGrid, points: Floats) -> Bools:
    """Whether the cells points (N, 2) fall in are marked; False outside."""
    columns, rows = np.floor((points - [grid.origin_x, grid.origin_y]) / grid.resolution_m).astype(np.int64).T
    height, width = grid.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    found = np.zeros(len(points), dtype=np.bool_)
    found[inside] = marked[rows[inside], columns[inside]]
    return found
