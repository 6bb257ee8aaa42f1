"""The true map of a simulated world."""

import numpy as np
import pytest

from evalkit.core.world import World, closed_outline
from evalkit_datasets.worlds.true_map import build_true_grid

ROOM = World(closed_outline([(0, 0), (4, 0), (4, 3), (0, 3)]))


def test_the_true_map_of_a_square_has_its_area_and_its_walls():
    grid = build_true_grid(World(closed_outline([(0, 0), (4, 0), (4, 4), (0, 4)])), 0.05, [(2.0, 2.0)])
    assert grid.occupied().sum() == 4 * 80  # 81 cells per side, with shared corners
    assert grid.free().sum() == 79**2
    walls = grid.centres(grid.occupied())
    np.testing.assert_allclose(np.abs(walls - 2.0).max(axis=1), 2.0, atol=1e-9)
    assert set(np.unique(grid.log_odds)) == {-5.0, 0.0, 5.0}


def test_the_true_map_of_a_room_with_a_pillar_approaches_the_exact_area():
    world = World(closed_outline([(0, 0), (10, 0), (10, 10), (0, 10)]), [[3.0, 6.0, 1.5]])
    grid = build_true_grid(world, 0.05, [(1.0, 1.0), (9.0, 1.0), (9.0, 9.0), (1.0, 9.0)])
    area = (grid.free().sum() + 0.5 * grid.occupied().sum()) * 0.05**2
    assert area == pytest.approx(100.0 - np.pi * 1.5**2, rel=2e-3)


def test_the_true_map_marks_exactly_the_cells_crossed_by_a_slanted_wall():
    turn = np.radians(37.0)
    corners = np.array([(-2, -2), (2, -2), (2, 2), (-2, 2)]) @ np.array(
        [[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]
    )
    grid = build_true_grid(World(closed_outline(corners)), 0.1, [(0.0, 0.0)])
    share = np.linspace(0.0, 1.0, 200_001)[:, None]
    walked = np.concatenate([a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)])
    passed = np.zeros(grid.shape, dtype=bool)
    columns, rows = np.floor((walked - [grid.origin_x, grid.origin_y]) / 0.1).astype(int).T
    passed[rows, columns] = True
    assert not (grid.occupied() & ~passed).any()
    left_out = grid.centres(passed & ~grid.occupied())  # only at the tips, which have no adjacent free cell
    assert np.linalg.norm(left_out[:, None] - corners, axis=2).min(axis=1).max(initial=0.0) < 0.2


def test_the_true_map_contains_only_visible_cells():
    box, outside = closed_outline([(5, 1), (6, 1), (6, 2), (5, 2)]), closed_outline([(-3, 0), (-2, 0), (-2, 1)])
    walls = closed_outline([(0, 0), (10, 0), (10, 4), (0, 4)])
    grid = build_true_grid(World(np.concatenate([walls, box, outside])), 0.1, [(1.0, 1.5)])

    def state(x, y):
        row, column = int((y - grid.origin_y) / 0.1), int((x - grid.origin_x) / 0.1)
        return "unknown" if not grid.observed[row, column] else "wall" if grid.occupied()[row, column] else "free"

    assert [state(1.0, 1.5), state(5.0, 1.5), state(10.0, 3.5), state(8.0, 3.5)] == ["free", "wall", "wall", "free"]
    assert [state(5.5, 1.5), state(6.0, 1.5), state(8.0, 1.5), state(10.0, 1.5)] == [
        "unknown"
    ] * 4  # in and behind the box
    assert grid.origin_x > -0.2  # cells outside do not exist


def test_the_true_map_ends_at_the_lidar_range():
    grid = build_true_grid(World([[-50.0, 0.0, 50.0, 0.0], [-50.0, 2.0, 50.0, 2.0]]), 0.1, [(0.0, 1.0)], range_m=12.0)
    x = grid.centres(grid.free())[:, 0]
    assert np.abs(x).max() == pytest.approx(12.0, abs=0.11)


def test_a_position_on_a_wall_is_rejected():
    with pytest.raises(ValueError, match="is on a boundary"):
        build_true_grid(ROOM, 0.05, [(4.0, 1.0)])
