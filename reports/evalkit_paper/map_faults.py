"""Find faults of a map: ghost walls, smeared walls, missing walls."""

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
from evalkit.metrics.neighbourhoods import nearest_distances_m

GHOST_M = 0.2
"""An occupied cell farther than this (m) from every true wall is a ghost: four times the range noise (1 sigma)."""

SMEAR_M = 0.1
TOGETHER_M = 0.15
"""Ghost cells nearer to each other than this (m) form one cluster."""


@dataclass(frozen=True, eq=False)
class Faults:
    """Faults of a map as masks (H, W), and true walls that are free on the map.

    ``ghosts``: occupied and farther than ``GHOST_M`` from any true wall. ``smeared``: occupied and farther than
    ``SMEAR_M``. ``missing`` (K, 2): centres (m) of true wall cells that are free on the map, with no occupied cell
    within ``GHOST_M``.
    """

    occupied: Bools
    ghosts: Bools
    smeared: Bools
    missing: Floats


@dataclass(frozen=True, slots=True)
class CellCluster:
    """Connected cells: count, centre (m), extent (m), and largest distance to a true wall (m)."""

    cells: int
    x: float
    y: float
    extent_m: float
    wall_distance_m: float


def find_faults(mapped: OccupancyGrid, true: OccupancyGrid) -> Faults:
    """Find the faults of a map. The true map may have another origin and resolution; both must have walls."""
    occupied, walls = mapped.occupied(), true.centres(true.occupied())
    off = np.zeros(mapped.shape)
    off[occupied] = nearest_distances_m(mapped.centres(occupied), walls)
    ghosts = occupied & (off > GHOST_M)
    unseen = walls[nearest_distances_m(walls, mapped.centres(occupied)) > GHOST_M]
    return Faults(
        occupied, ghosts, occupied & (off > SMEAR_M) & ~ghosts, unseen[look_up(mapped.free(), mapped, unseen)]
    )


def find_clusters(points: Floats, walls: Floats) -> tuple[CellCluster, ...]:
    """Group points (N, 2) into clusters, largest first; ``walls`` (M, 2), M > 0, are the true walls."""
    if not len(points):
        return ()
    near = cKDTree(points).query_pairs(TOGETHER_M, output_type="ndarray").astype(np.int32)  # required by old SciPy
    links = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), shape=(len(points), len(points)))
    count, labels = connected_components(links, directed=False)
    off = nearest_distances_m(points, walls)
    found = [_cluster(points[labels == label], off[labels == label]) for label in range(count)]
    return tuple(sorted(found, key=lambda cluster: -cluster.cells))


def _cluster(points: Floats, off: Floats) -> CellCluster:
    x, y = points.mean(axis=0).tolist()
    return CellCluster(len(points), x, y, float(np.hypot(*np.ptp(points, axis=0))), float(off.max()))


def find_contradicted(hits: Floats, other: OccupancyGrid) -> Bools:
    """Which hits (N, 2) lie in free space of another map: a cleared cell with no occupied cell within 0.1 m."""
    cleared = other.observed & (other.log_odds < CLEARED)
    suspects = look_up(cleared, other, hits)
    walls = other.centres(other.occupied())
    if suspects.any() and len(walls):
        suspects[suspects] = nearest_distances_m(hits[suspects], walls) > NOISE_M
    return suspects


def look_up(marked: Bools, grid: OccupancyGrid, points: Floats) -> Bools:
    """Whether the cells of points (N, 2) are marked; False outside the grid."""
    rows, columns, inside = grid.find_cells(points)
    return np.asarray(inside & marked[rows, columns])
