"""Where a map is wrong: ghost walls, and hits in space that the whole run found free."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.metrics.consistency import CLEARED, look_up_cells
from evalkit.metrics.neighbourhoods import nearest_distances_m

GHOST_M = 0.2
"""Occupied cells farther than this from every true wall are ghost walls; hits in free cells farther than this from
every wall of the map are free-space violations. At least four times the range noise (1 sigma)."""


def find_ghosts(mapped: OccupancyGrid, true: OccupancyGrid) -> Floats:
    """Return centres (K, 2) of occupied cells farther than ``GHOST_M`` from every true wall (m)."""
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    if not len(ours) or not len(theirs):
        return ours
    return np.asarray(ours[nearest_distances_m(ours, theirs) > GHOST_M])


def find_violations(points: Floats, grid: OccupancyGrid) -> Floats:
    """Return centres (K, 2) of the map's cells that contain hits (N, 2) although the whole run found them free.

    Free: cleared by the definition of the consistency metrics (log-odds below -1), without an occupied cell within
    ``GHOST_M``.
    """
    log_odds, observed = look_up_cells(points, grid)
    suspects = points[observed & (log_odds < CLEARED)]
    walls = grid.centres(grid.occupied())
    if len(walls) and len(suspects):
        suspects = suspects[np.isinf(cKDTree(walls).query(suspects, distance_upper_bound=GHOST_M)[0])]
    rows, columns, _ = grid.find_cells(suspects)
    high = grid.shape[0]
    cells = np.unique(columns * high + rows)  # integers are much faster than pairs
    corners = np.stack([cells // high, cells % high], axis=-1).astype(np.float64)
    return np.asarray([grid.origin_x, grid.origin_y] + (corners + 0.5) * grid.resolution_m)
