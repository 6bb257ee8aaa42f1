"""Distances between cells of two maps, compared with brute force on lattices that agree and that do not."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.metrics.lattice import REACH, distances_to_walls_m, find_squared_distances


def make_grid(walls: Bools, resolution_m: float, origin_x: float, origin_y: float) -> OccupancyGrid:
    log_odds = np.where(walls, np.float32(3.0), np.float32(-3.0))
    return OccupancyGrid(log_odds, np.ones_like(walls), resolution_m, origin_x, origin_y)


def pick(shape: tuple[int, int], share: float, seed: int) -> Bools:
    return np.random.default_rng(seed).random(shape) < share


@pytest.mark.parametrize("share", [0.3, 0.01, 0.0005])
@pytest.mark.parametrize(
    ("resolution_m", "x", "y"),
    [
        (0.05, 0.0, 0.0), (0.05, -1.35, 2.4), (0.05, 30.0, -41.0), (0.05, 0.52, 0.0), (0.05, 0.0, -0.01),
        (0.1, 0.0, 0.0),
    ],
)  # fmt: skip
def test_distances_equal_brute_force(share: float, resolution_m: float, x: float, y: float) -> None:
    own, walls = pick((70, 90), 0.05, 0), pick((64, 101), share, 1)
    walls[0, 0] = True
    grid, other = make_grid(own, resolution_m, x, y), make_grid(walls, 0.05, 0.0, 0.0)
    offsets = grid.centres(own)[:, None] - other.centres(walls)[None]
    expected = np.sqrt(np.sum(offsets**2, axis=-1)).min(axis=1)
    assert distances_to_walls_m(grid, np.flatnonzero(own), other) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("size", [1, 41])  # the place is outside, inside
@pytest.mark.parametrize(("row", "column"), [(REACH, 0), (-REACH, 0), (0, REACH), (0, -REACH), (9, -12), (-12, 9)])
def test_a_wall_is_found_up_to_fifteen_cells_away_in_any_direction(row: int, column: int, size: int) -> None:
    marked = np.zeros((size, size), np.bool_)
    marked[size // 2, size // 2] = True
    rows, columns = size // 2 + np.array([row, 2 * row]), size // 2 + np.array([column, 2 * column])
    squares, far = find_squared_distances(rows, columns, make_grid(marked, 0.05, 0.0, 0.0))
    assert squares[0] == REACH**2
    assert far.tolist() == [1]
