"""Ghost walls, and hits in free space, on maps written by hand."""

import numpy as np
import pytest

from evalkit.core.grid import OccupancyGrid
from evalkit.report.html.map_defects import find_ghosts, find_violations


def room():
    """A room of 4 x 4 m at 10 cm resolution: free inside, a wall along the lower edge."""
    log_odds = np.full((40, 40), -3.0, dtype=np.float32)
    log_odds[0] = 3.0
    return log_odds


def grid(log_odds):
    return OccupancyGrid(log_odds, np.ones_like(log_odds, dtype=bool), 0.1, 0.0, 0.0)


def test_a_ghost_is_a_wall_far_from_every_true_wall():
    mapped = room()
    mapped[2, 5] = mapped[10, 7] = 3.0  # 0.2 m and 1 m above the wall
    assert find_ghosts(grid(mapped), grid(room())) == pytest.approx(np.array([[0.75, 1.05]]))


def test_a_hit_in_free_space_is_a_violation_unless_it_is_next_to_a_wall():
    points = np.array(
        [[1.02, 2.01], [1.03, 2.02], [2.0, 0.12], [9.0, 9.0]]
    )  # the same cell twice, at the wall, outside
    assert find_violations(points, grid(room())) == pytest.approx(np.array([[1.05, 2.05]]))
