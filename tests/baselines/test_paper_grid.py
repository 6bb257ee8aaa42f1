"""The log-odds grid of the paper: the cells that a beam crosses, the added log-odds, and the growth of the map."""

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from evalkit.core.errors import BadParameter
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import paper
from evalkit_baselines.paper import grid as paper_grid
from evalkit_baselines.paper.grid import LogOddsGrid, bresenham, exact

WIDTH = 10_001  # wide enough that a flat index separates row and column


def scan(ranges, angles, range_max_m=12.0):
    return Scan(0, np.asarray(ranges, dtype=float), np.asarray(angles, dtype=float), 0.0, range_max_m)


def cells(occupancy):
    """Return the log-odds by (column, row) of the world, in cells."""
    rows, columns = np.nonzero(occupancy.observed)
    left = round(occupancy.origin_x / occupancy.resolution_m)
    bottom = round(occupancy.origin_y / occupancy.resolution_m)
    return {
        (int(column) + left, int(row) + bottom): float(occupancy.log_odds[row, column])
        for row, column in zip(rows, columns, strict=True)
    }


def build_map(*updates, **parameters: Any):
    mapper = LogOddsGrid(**parameters)
    for one, pose in updates:
        mapper.update(one, pose)
    return cells(mapper.grid())


def crossed_cells(traversal, start, end):
    """Return the cells (column, row) of one beam, from cell coordinates."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    beams, offsets = traversal(start, end[None], WIDTH)
    assert set(beams.tolist()) <= {0}
    rows = np.round(offsets / WIDTH).astype(int)
    columns = offsets - rows * WIDTH
    first = np.floor(start).astype(int)
    return list(zip((columns + first[0]).tolist(), (rows + first[1]).tolist(), strict=True))


def walk_exactly(start, end):
    """Return the cells of Amanatides and Woo's walk in exact arithmetic, as the reference."""
    start, end = [Fraction(v) for v in start], [Fraction(v) for v in end]
    cell, last = [math.floor(v) for v in start], [math.floor(v) for v in end]
    step = [1 if b >= a else -1 for a, b in zip(start, end, strict=True)]

    def share(axis):  # of the beam at the next grid line of an axis
        if cell[axis] == last[axis]:
            return Fraction(2)
        line = cell[axis] + (step[axis] > 0)
        return (line - start[axis]) / (end[axis] - start[axis])

    seen = [tuple(cell)]
    while cell != last:
        x, y = share(0), share(1)
        if x <= y:
            cell[0] += step[0]
        if y <= x:
            cell[1] += step[1]
        seen.append(tuple(cell))
    return seen


def bresenham_1965(start, end):
    """Return the cells of the scalar algorithm with its running difference, in the octant of the beam."""
    (x, y), (end_x, end_y) = start, end
    dx, dy = abs(end_x - x), abs(end_y - y)
    step_x, step_y = (1 if end_x >= x else -1), (1 if end_y >= y else -1)
    steep = dy > dx
    longer, shorter = max(dx, dy), min(dx, dy)
    difference = 2 * shorter - longer
    line = [(x, y)]
    for _ in range(longer):
        aside = difference >= 0
        difference += 2 * shorter - 2 * longer * aside
        x += step_x * (aside if steep else 1)
        y += step_y * (1 if steep else aside)
        line.append((x, y))
    return line


# crossed cells


def test_random_beams_cross_exactly_the_cells_of_the_exact_walk():
    rng = np.random.default_rng(0)
    for _ in range(300):
        start, end = rng.uniform(-30, 30, (2, 2))
        assert set(crossed_cells(exact, start, end)) == set(walk_exactly(start, end))


def test_beams_between_quarter_cells_cross_exactly_the_cells_of_the_exact_walk():
    rng = np.random.default_rng(1)
    for _ in range(500):  # includes corners, grid lines, borders and zero lengths
        start, end = rng.integers(-16, 17, (2, 2)) / 4.0
        found = set(crossed_cells(exact, start, end))
        wanted = set(walk_exactly(start, end))
        assert found == wanted, (start, end)


def test_many_beams_at_once_equal_single_beams():
    rng = np.random.default_rng(2)
    start, ends = rng.uniform(-5, 5, 2), rng.uniform(-20, 20, (40, 2))
    for traversal in (exact, bresenham):
        beams, offsets = traversal(start, ends, WIDTH)
        for beam, end in enumerate(ends):
            alone = traversal(start, end[None], WIDTH).offsets
            assert sorted(offsets[beams == beam].tolist()) == sorted(alone.tolist())


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ((0.5, 0.5), (3.5, 0.5), {(0, 0), (1, 0), (2, 0), (3, 0)}),
        ((0.5, 0.5), (2.5, 2.5), {(0, 0), (1, 1), (2, 2)}),  # through corners
        ((0.5, 2.5), (2.5, 0.5), {(0, 2), (1, 1), (2, 0)}),
        ((2.5, 2.5), (0.5, 0.5), {(2, 2), (1, 1), (0, 0)}),
        ((0.5, 1.0), (2.5, 1.0), {(0, 1), (1, 1), (2, 1)}),  # along a grid line: the cells above it
        ((1.0, 2.5), (1.0, -0.5), {(1, 2), (1, 1), (1, 0), (1, -1)}),
        ((0.5, 0.5), (2.0, 0.5), {(0, 0), (1, 0), (2, 0)}),  # ends on a border: in the cell beyond
        ((2.5, 0.5), (1.0, 0.5), {(2, 0), (1, 0)}),
        ((0.5, 0.5), (0.5, 0.5), {(0, 0)}),
        ((-0.5, -0.5), (-2.5, -1.5), {(-1, -1), (-2, -1), (-2, -2), (-3, -2)}),
    ],
)
def test_cells_of_simple_beams_equal_the_hand_calculation(start, end, expected):
    assert set(crossed_cells(exact, start, end)) == expected == set(walk_exactly(start, end))


def test_a_tiny_slope_at_a_border_stays_finite():
    assert set(crossed_cells(exact, (0.0, 0.5), (-1e-300, 4.5))) == {(0, 0), *((-1, row) for row in range(5))}
    assert set(crossed_cells(exact, (0.0, 0.5), (6e-17, 4.5))) == {(0, row) for row in range(5)}


def test_bresenham_equals_the_scalar_algorithm_of_1965():
    rng = np.random.default_rng(3)
    for _ in range(300):
        start, end = rng.integers(-25, 26, (2, 2))
        assert sorted(crossed_cells(bresenham, start + 0.5, end + 0.5)) == sorted(bresenham_1965(start, end))


# added log-odds


def test_one_beam_frees_the_cells_before_its_end_and_occupies_its_end():
    found = build_map((scan([0.2], [0.0]), Pose(0.025, 0.025)))
    assert set(found) == {(0, 0), (1, 0), (2, 0), (3, 0), (4, 0)}
    assert [found[column, 0] for column in range(5)] == pytest.approx([-0.847] * 4 + [0.847])


def test_the_constants_are_the_log_odds_of_seven_in_ten():
    mapper = LogOddsGrid()
    assert mapper.l_occ == pytest.approx(math.log(0.7 / 0.3), abs=5e-4)
    assert mapper.l_free == pytest.approx(math.log(0.3 / 0.7), abs=5e-4)


def test_the_probability_of_log_odds_is_equation_10():
    mapper = LogOddsGrid(l_occ=math.log(0.7 / 0.3), l_free=math.log(0.3 / 0.7))
    mapper.update(scan([0.2], [0.0]), Pose(0.025, 0.025))
    assert mapper.grid().probability()[0] == pytest.approx([0.3, 0.3, 0.3, 0.3, 0.7], abs=1e-6)


def test_the_sensor_is_at_its_pose():
    turned = build_map((scan([2.0], [math.pi / 4]), Pose(0.5, -3.5, math.pi / 4)), resolution_m=1.0)
    assert turned == pytest.approx({(0, -4): -0.847, (0, -3): -0.847, (0, -2): 0.847})


def test_log_odds_are_added_up_to_the_bounds():
    beam = scan([2.0], [0.0]), Pose(0.5, 0.5)
    assert build_map(*[beam] * 3, resolution_m=1.0)[2, 0] == pytest.approx(3 * 0.847)
    found = build_map(*[beam] * 9, resolution_m=1.0, l_max=3.0)
    assert found == pytest.approx({(0, 0): -5.0, (1, 0): -5.0, (2, 0): 3.0})


def test_a_clamped_cell_changes_with_the_next_opposite_beam():
    wall, beyond = (scan([2.0], [0.0]), Pose(0.5, 0.5)), (scan([3.0], [0.0]), Pose(0.5, 0.5))
    assert build_map(*[wall] * 20, beyond, resolution_m=1.0)[2, 0] == pytest.approx(5.0 - 0.847)


def test_a_scan_updates_each_cell_once_and_occupied_wins():
    fan = scan([2.0, 2.0, 3.0], [0.0, 0.01, 0.0])
    found = build_map((fan, Pose(0.5, 0.5)), resolution_m=1.0)
    assert found == pytest.approx({(0, 0): -0.847, (1, 0): -0.847, (2, 0): 0.847, (3, 0): 0.847})


def test_every_beam_updates_its_cells_in_the_literal_reading():
    fan = scan([2.0, 2.0, 3.0], [0.0, 0.01, 0.0])
    found = build_map((fan, Pose(0.5, 0.5)), resolution_m=1.0, once_per_scan=False)
    assert found == pytest.approx({(0, 0): -3 * 0.847, (1, 0): -3 * 0.847, (2, 0): 0.847, (3, 0): 0.847})


@pytest.mark.parametrize("traversal", ["exact", "bresenham"])
def test_every_beam_adds_the_same_as_alone(traversal):
    rng = np.random.default_rng(4)
    ranges, angles, pose = rng.uniform(0.5, 6.0, 60), rng.uniform(-3, 3, 60), Pose(0.3, -0.2, 0.4)
    settings: dict[str, Any] = {"resolution_m": 0.25, "traversal": traversal, "l_min": -1000.0, "l_max": 1000.0}
    together = build_map((scan(ranges, angles), pose), once_per_scan=False, **settings)
    alone = build_map(*((scan([r], [a]), pose) for r, a in zip(ranges, angles, strict=True)), **settings)
    assert together == pytest.approx(alone, abs=1e-4)


def test_an_exactly_crossed_corner_counts_once_per_beam():
    diagonal = scan([2.5 * math.sqrt(2.0)], [math.pi / 4])
    found = build_map((diagonal, Pose(0.5, 0.5)), resolution_m=1.0, once_per_scan=False)
    assert max(abs(value) for value in found.values()) == pytest.approx(0.847)
    assert {(0, 0), (1, 1), (2, 2)} <= set(found)


def test_a_beam_of_zero_length_only_occupies():
    assert build_map((scan([0.0], [0.0]), Pose(0.5, 0.5)), resolution_m=1.0) == pytest.approx({(0, 0): 0.847})


# beams without return


def test_invalid_beams_and_beams_without_return_update_no_cells():
    assert build_map((scan([np.nan, np.inf], [0.0, 1.0]), Pose())) == {}


def test_beams_without_return_free_their_cells_where_enabled():
    lost = scan([np.inf, np.nan], [0.0, 1.5], range_max_m=3.0)
    for once in (True, False):
        found = build_map((lost, Pose(0.5, 0.5)), resolution_m=1.0, clear_no_returns=True, once_per_scan=once)
        assert found == pytest.approx(dict.fromkeys([(0, 0), (1, 0), (2, 0), (3, 0)], -0.847))


def test_an_invalid_beam_does_not_change_a_neighbouring_valid_one():
    alone = build_map((scan([2.0], [0.3]), Pose(1.0, 2.0, 0.1)))
    assert build_map((scan([np.nan, 2.0, np.inf], [0.0, 0.3, 1.0]), Pose(1.0, 2.0, 0.1))) == alone


# growth


def test_a_map_without_scans_has_no_cells():
    assert LogOddsGrid().grid().shape == (0, 0)


def test_growing_keeps_every_cell_at_its_position():
    fan = scan(np.full(40, 3.0), np.linspace(-3, 3, 40))
    places = [Pose(0, 0), Pose(60.0, 0.0, 1.0), Pose(-45.0, -80.0), Pose(10.0, 90.0, 2.0)]
    together = build_map(*((fan, place) for place in places), resolution_m=0.1)
    apart = {}
    for place in places:
        apart |= build_map((fan, place), resolution_m=0.1)
    assert together == pytest.approx(apart)


def test_a_returned_map_does_not_change():
    mapper = LogOddsGrid()
    mapper.update(scan([1.0], [0.0]), Pose())
    before = mapper.grid()
    kept = before.log_odds.copy()
    mapper.update(scan([1.0], [0.0]), Pose())
    np.testing.assert_array_equal(before.log_odds, kept)


def test_the_map_is_cropped_to_the_observed_cells():
    mapper = LogOddsGrid(resolution_m=0.5)
    mapper.update(scan([1.0], [0.0]), Pose(-7.25, 3.25))
    occupancy = mapper.grid()
    assert (occupancy.shape, occupancy.origin_x, occupancy.origin_y) == ((1, 3), -7.5, 3.0)
    assert occupancy.centres(occupancy.occupied()).tolist() == [[-6.25, 3.25]]


def test_a_diverged_trajectory_raises_with_advice():
    mapper = LogOddsGrid()
    mapper.update(scan([1.0], [0.0]), Pose())
    with pytest.raises(BadParameter, match=r"resolution_m.*larger cells.* m x"):
        mapper.update(scan([1.0], [0.0]), Pose(1e5, 1e5))
    assert mapper.grid().shape[0] == 1  # the existing cells stay


# parameters


def test_the_defaults_of_the_class_are_those_of_its_parameters():
    made = paper.MAPPER.make(**resolve_parameters("log-odds", paper_grid.PARAMETERS, {}))
    assert repr(made) == repr(LogOddsGrid())
    assert paper.MAPPER.parameters == paper_grid.PARAMETERS


def test_a_positive_l_free_raises():
    with pytest.raises(BadParameter, match="l_free"):
        LogOddsGrid(l_free=0.847)
