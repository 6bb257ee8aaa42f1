"""Distances between the cells of two maps, counted in cells where both maps have the same lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import cached, find_occupied
from evalkit.metrics.neighbourhoods import build_kd_tree

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_SAME = 1e-6  # cells: lattices displaced by less are the same
_STRIDES = 1, 2, 4, 8
REACH = sum(_STRIDES)
"""Walls up to 15 cells away are looked for on the lattice; a tree finds those farther away."""

_NONE = 100
"""Rows to the nearest occupied cell of a column without one."""


def distances_to_walls_m(grid: OccupancyGrid, places: Ints, other: OccupancyGrid) -> Floats:
    """Return the distance (N,) in metres between the centres of cells of a grid and the nearest occupied cell of
    another grid, of which there is at least one.

    ``places`` (N,): cells of the grid, row times width plus column. The grids may differ in origin and resolution.
    """
    rows, columns = np.divmod(places, grid.shape[1])
    shift = np.array([grid.origin_y - other.origin_y, grid.origin_x - other.origin_x]) / other.resolution_m
    whole = np.round(shift)
    alike = abs(grid.resolution_m / other.resolution_m - 1.0) * max(*grid.shape, *other.shape) < _SAME
    if not alike or np.abs(shift - whole).max() > _SAME:
        return np.asarray(build_wall_tree(other).query(_centres(grid, rows, columns))[0])
    down, right = whole.astype(np.int64)
    squares, far = find_squared_distances(rows + down, columns + right, other)
    distances = np.sqrt(squares) * other.resolution_m
    if len(far):
        distances[far] = build_wall_tree(other).query(_centres(grid, rows[far], columns[far]))[0]
    return np.asarray(distances)


@cached
def build_wall_tree(grid: OccupancyGrid) -> cKDTree:
    """Return a k-d tree of the centres of the occupied cells in the world (m), in the order of rows."""
    return build_kd_tree(grid.centres(find_occupied(grid)))


def find_squared_distances(rows: Ints, columns: Ints, grid: OccupancyGrid) -> tuple[Ints, Ints]:
    """Return the squared distance (N,) in cells to the nearest occupied cell of a grid, and which places (K,) of N
    have none within 15 cells: their squares mean nothing.

    Rows and columns (N,) may lie outside. From the nearest occupied cell of each column, the columns around a place are
    compared until no farther one can be nearer (Felzenszwalb and Huttenlocher, 2012, with a bounded search).
    """
    height, width = grid.shape
    inside = np.clip(rows, 0, height - 1)
    beyond, starts, apart = np.abs(rows - inside), inside * width, _count_rows(grid).ravel()
    squares, left = np.full(len(rows), 2 * _NONE**2), np.arange(len(rows))
    for step in range(REACH + 1):
        own, start, outside, nearest = columns[left], starts[left], beyond[left], squares[left]
        for side in (-step, step):
            column = np.clip(own + side, 0, width - 1)
            nearest = np.minimum(nearest, (apart[start + column] + outside) ** 2 + (column - own) ** 2)
        squares[left] = nearest
        left = left[nearest > (step + 1) ** 2]
        if not len(left):
            break
    return squares, left


@cached
def _count_rows(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Return the rows (H, W) between each cell and the nearest occupied cell of its column, 100 if more than 15."""
    rows = np.where(find_occupied(grid), np.uint8(0), np.uint8(_NONE))
    for stride in _STRIDES:
        above, below = rows[:-stride] + np.uint8(stride), rows[stride:] + np.uint8(stride)
        np.minimum(rows[stride:], above, out=rows[stride:])
        np.minimum(rows[:-stride], below, out=rows[:-stride])
    return rows


def _centres(grid: OccupancyGrid, rows: Ints, columns: Ints) -> Floats:
    """Return the centres (N, 2) of cells in the world (m)."""
    cells = np.stack([columns, rows], axis=-1).astype(np.float64)
    return np.asarray([grid.origin_x, grid.origin_y] + (cells + 0.5) * grid.resolution_m)
