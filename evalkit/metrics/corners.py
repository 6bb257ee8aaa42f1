"""Corners of the walls of a map."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from evalkit.core.arrays import Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.metrics.filters import filter_image, gaussian_weights
from evalkit.metrics.metric import cached, find_occupied

APART_M = 0.2
MIN_RESPONSE = 1.8e-5
"""In units of (occupied - free)^4. Right angles of walls 2 to 5 cells thick give 2e-5 to 1e-4, slanted walls less."""
_EDGE_REACH = 4
_WINDOW_CELLS, _WINDOW_REACH = 1.5, 6
"""Where the Gaussians of 1 cell and of the window are cut off (cells): four standard deviations."""

_BLOCK = 4096
"""Cells whose surroundings are in memory at once."""
_RIM = 8
"""Empty cells around the occupied ones, in which corners are detected, too."""


@cached
def find_corners(grid: OccupancyGrid) -> Floats:
    """Return the corners (K, 2) of the occupied cells in the world (m).

    Laplacian of Gaussian (1 cell) of the 0/1 image, Harris response (window 1.5 cells, k = 0.05), peaks above an
    absolute threshold, at most one within 0.2 m.
    """
    occupied = find_occupied(grid)
    if not occupied.any():
        return np.zeros((0, 2))
    rows, columns = (np.flatnonzero(occupied.any(axis=axis)) for axis in (1, 0))
    around = _RIM + 2 * _EDGE_REACH + _WINDOW_REACH  # what the filters take off, and the rim that is left
    image = np.pad(occupied[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], around).astype(np.float32)
    smooth, slope, bend = (gaussian_weights(1.0, _EDGE_REACH, order) for order in range(3))
    edges = filter_image(image, bend, smooth) + filter_image(image, smooth, bend)
    x, y = filter_image(edges, smooth, slope), filter_image(edges, slope, smooth)
    places = _find_peaks(_compute_responses(x, y), max(int(np.ceil(APART_M / grid.resolution_m)), 1))
    count, cluster = _join_adjacent(places)
    sizes = np.bincount(cluster, minlength=count)
    at = np.stack([np.bincount(cluster, along, minlength=count) / sizes for along in places], axis=-1)
    cells = at[:, ::-1] - _RIM + [columns[0], rows[0]]
    return np.asarray([grid.origin_x, grid.origin_y] + (cells + 0.5) * grid.resolution_m)


def _compute_responses(x: NDArray[np.float32], y: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the Harris response (H - 12, W - 12) of gradients (H, W), or 0 in cells where it does not exceed the
    threshold.

    Only in the few cells where it could, the products of both gradients are smoothed.
    """
    weights = gaussian_weights(_WINDOW_CELLS, _WINDOW_REACH)
    xx, yy = (filter_image(square, weights, weights) for square in (x * x, y * y))
    products, traces, side = xx * yy, 0.05 * (xx + yy) ** 2, len(weights)
    rows, columns = np.divmod(np.flatnonzero(products - traces > 0.999 * MIN_RESPONSE), xx.shape[1])
    around = sliding_window_view(x * y, (side, side))
    responses = np.zeros_like(xx)
    for begin in range(0, len(rows), _BLOCK):
        at = rows[begin : begin + _BLOCK], columns[begin : begin + _BLOCK]
        xy = filter_image(around[at].reshape(-1, side), weights, weights)[::side, 0]
        responses[at] = products[at] - xy * xy - traces[at]
    return responses


def _find_peaks(response: NDArray[np.float32], reach: int) -> tuple[Ints, Ints]:
    """Return row and column (K,) of the cells above the threshold with no higher response (H, W) within ``reach`` rows
    and columns: few are above it, so that no filter passes over all cells.
    """
    rows, columns = np.divmod(np.flatnonzero(response > MIN_RESPONSE), response.shape[1])
    around = np.pad(response, reach, constant_values=-np.inf)
    for down, right in np.ndindex(2 * reach + 1, 2 * reach + 1):
        highest = around[rows + down, columns + right] <= response[rows, columns]
        rows, columns = rows[highest], columns[highest]
    return rows, columns


def _join_adjacent(places: tuple[Ints, Ints]) -> tuple[int, Ints]:
    """Return the number of groups of cells that touch each other, and the group (K,) of each cell.

    ``places``: row and column (K,), in the order of rows; groups are counted in the order of their first cells.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    cells, size = np.stack(places, axis=-1), len(places[0])
    if not size:
        return 0, np.zeros(0, np.int64)
    one, other = cKDTree(cells).query_pairs(1.5, output_type="ndarray").T
    links = coo_matrix((np.ones(len(one)), (one, other)), shape=(size, size))
    count, groups = connected_components(links, directed=False)
    return int(count), np.asarray(groups, np.int64)
