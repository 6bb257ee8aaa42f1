"""Map cells compared with ground truth: maps of a few cells, calculated by hand."""

import math

import numpy as np
import pytest

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics import occupancy
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap
from evalkit.metrics.occupancy import METRICS, find_true_states, log_loss, wall_width_m


def grid(rows, resolution_m=0.1, x=0.0, y=0.0, observed=None):
    log_odds = np.array(rows, dtype=np.float32)
    return OccupancyGrid(log_odds, log_odds != 0.0 if observed is None else observed, resolution_m, x, y)


def test_a_true_cell_of_half_the_size_marks_the_cell_that_contains_its_centre():
    true = grid([[-5, 0, 0, 5]], resolution_m=0.05)  # centres 0.025 free, 0.175 occupied
    occupied, free = find_true_states(grid([[1, 1, 1]]), true)
    assert occupied.tolist() == [[False, True, False]]
    assert free.tolist() == [[True, False, False]]


@pytest.mark.parametrize(("columns", "rows"), [(0, 0), (1, 0), (-2, 1), (2, -1), (5, 0), (0, -4)])
def test_a_true_map_displaced_by_whole_cells_marks_the_cells_below_it(columns, rows):
    states = np.random.default_rng(3).choice([-5.0, 0.0, 5.0], (3, 4))
    found = find_true_states(grid(np.ones((3, 4))), grid(states, x=0.1 * columns, y=0.1 * rows))
    for row, column in np.ndindex(3, 4):
        y, x = row - rows, column - columns
        state = states[y, x] if 0 <= y < 3 and 0 <= x < 4 else 0.0
        assert [bool(kind[row, column]) for kind in found] == [state > 0.0, state < 0.0]


def test_a_centre_on_an_edge_counts_for_both_cells_and_walls_win_over_free_space():
    true = grid([[5, -5]], resolution_m=0.05, x=0.075)  # centres 0.1, on the edge, and 0.15
    occupied, free = find_true_states(grid([[1, 1]]), true)
    assert occupied.tolist() == [[True, True]]
    assert not free.any()


def test_a_perfect_wall_between_two_cells_makes_both_occupied_in_the_log_loss():
    true = grid([[-5, 5, -5]], resolution_m=0.1, x=-0.05)  # centres 0, 0.1 and 0.2: all on edges
    value, cells = log_loss(grid([[4, 4]]), true)
    assert (value, cells) == (pytest.approx(np.log1p(np.exp(-4.0))), 2)
    assert "in it or on its edge" in next(one for one in METRICS if one.name == "map_log_loss").definition


@pytest.mark.parametrize("upright", [False, True])
def test_two_true_cells_within_one_cell_of_the_map_leave_its_neighbour_unknown(upright):
    states = np.array([[5.0, -5.0]])
    mapped, true = (grid(one.T if upright else one, cell) for one, cell in ((np.ones((1, 2)), 0.1), (states, 0.05)))
    occupied, free = find_true_states(mapped, true)
    assert (occupied.ravel().tolist(), free.any()) == ([True, False], False)


def test_a_coarser_ground_truth_is_rejected():
    with pytest.raises(ValueError, match="coarser"):
        find_true_states(grid([[1.0]], 0.05), grid([[5.0]], 0.1))


def test_log_loss_is_the_mean_surprise_and_ln_2_for_unknown_cells():
    true = grid([[-5, -5, 5, 5]], resolution_m=0.1)
    unsure = grid([[0.0] * 4], observed=np.ones((1, 4), dtype=bool))
    assert log_loss(unsure, true) == pytest.approx((math.log(2.0), 4))
    # p(occupied) = 0.2 for a free cell and 0.9 for a wall; the other two cells are unobserved
    mapped = grid([[math.log(0.25), 0.0, math.log(9.0), 0.0]])
    assert log_loss(mapped, true) == pytest.approx((-0.5 * (math.log(0.8) + math.log(0.9)), 2))


def test_log_loss_is_minimal_for_the_true_probability():
    true = grid([[5.0] * 7 + [-5.0] * 3])
    losses = {p: log_loss(grid([[math.log(p / (1.0 - p))] * 10]), true)[0] for p in (0.5001, 0.6, 0.7, 0.8, 0.9)}
    assert min(losses, key=losses.get) == 0.7


def test_log_loss_of_unobserved_cells_is_nan():
    value, cells = log_loss(grid([[0.0]]), grid([[5.0]]))
    assert math.isnan(value)
    assert cells == 0


@pytest.mark.parametrize(("thick", "resolution_m"), [(1, 0.05), (3, 0.05), (2, 0.1)])
def test_a_straight_wall_is_as_wide_as_its_cells(thick, resolution_m):
    rows = np.full((60, 60), -5.0)
    rows[20 : 20 + thick, :] = 5.0
    assert wall_width_m(grid(rows, resolution_m)) == pytest.approx(thick * resolution_m, rel=0.02)


def test_a_map_without_walls_has_no_width():
    assert math.isnan(wall_width_m(grid([[-5.0]])))


def scores(mapped, true):
    evidence = Evidence(RunResult(np.zeros(0, STEP), 0), Truth("t", grid=true), grid=mapped or MissingMap(NO_POSES))
    return {metric.name: metric.compute(evidence) for metric in occupancy.METRICS}


def test_the_metric_table_contains_log_loss_and_wall_width_or_a_reason():
    rows = np.full((60, 60), -5.0)
    rows[20:23, :] = 5.0
    found = scores(grid(rows), grid(rows))
    assert found["map_log_loss"].value == pytest.approx(math.log1p(math.exp(-5.0)), rel=1e-6)
    assert found["map_log_loss"].support == 3600
    assert found["wall_width_m"].value == pytest.approx(0.3, rel=0.02)
    assert scores(grid(rows), None)["map_log_loss"].reason == "no ground-truth map"
    assert scores(None, grid(rows))["map_log_loss"].reason == "no map: the run has no poses"
    coarse = scores(grid(rows), grid(rows, 0.2))["map_log_loss"]
    assert coarse.reason == "the cells of the ground-truth map (0.2 m) are coarser than those of the map"
    lonely = scores(grid([[5.0, -5.0], [-5.0, -5.0]]), None)["wall_width_m"]
    assert lonely.reason == "no occupied cells lie along a line"


def test_cells_half_as_large_are_placed_from_any_origin():
    """The centre of each true cell lies in the map's cell by plain division, off all edges."""
    states = np.random.default_rng(4).choice([-5.0, 0.0, 5.0], (9, 14))
    true = grid(states, 0.05, x=-1.013, y=2.517)
    mapped = grid(np.ones((6, 8)), 0.1, x=-0.93, y=2.41)
    occupied, free = np.zeros((6, 8), bool), np.zeros((6, 8), bool)
    for row, column in np.ndindex(states.shape):
        y = math.floor((2.517 + (row + 0.5) * 0.05 - 2.41) / 0.1)
        x = math.floor((-1.013 + (column + 0.5) * 0.05 + 0.93) / 0.1)
        if 0 <= y < 6 and 0 <= x < 8:
            occupied[y, x] |= states[row, column] > 0
            free[y, x] |= states[row, column] < 0
    assert occupied.any()
    found = find_true_states(mapped, true)
    assert found[0].tolist() == occupied.tolist()
    assert found[1].tolist() == (free & ~occupied).tolist()
