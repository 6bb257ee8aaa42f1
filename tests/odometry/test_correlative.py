"""Correlative matching: the search equals an exhaustive one, and finds a known motion anywhere in the map."""

import math

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.odometry.correlative import (
    MAX_CELLS,
    PEAK_M,
    PEAK_RAD,
    ScoreGrid,
    Window,
    bounded_search,
    branch_and_bound,
    other_headings,
    windows_around,
)

WALLS = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [4.0, 2.0], [4.0, 4.5], [0.0, 4.5]])


def room(spacing_m=0.05):
    """Return points on the walls of an L-shaped room, which looks different at every pose."""
    sides = np.roll(WALLS, -1, axis=0) - WALLS
    along = [np.arange(0.0, np.hypot(*side), spacing_m)[:, None] / np.hypot(*side) for side in sides]
    return np.concatenate([corner + share * side for corner, side, share in zip(WALLS, sides, along, strict=True)])


def score_of(points, target, motion, cell_m, sigma_m):
    """Return the score by its definition: a Gaussian of the distance from a point's cell to the nearest mean."""
    keys, members = np.unique(np.floor(target / cell_m), axis=0, return_inverse=True)
    means = np.array([target[members.ravel() == key].mean(axis=0) for key in range(len(keys))])
    centres = (np.floor(motion.transform(points) / cell_m) + 0.5) * cell_m
    distance = np.linalg.norm(centres[:, None] - means, axis=-1).min(axis=1)
    values = np.round(255 * np.exp(-0.5 * (distance / sigma_m) ** 2))
    return np.where(distance <= 3 * sigma_m, values, 0).mean() / 255


def exhaustive(points, target, window, angles, cell_m, sigma_m, prior=None):
    """Return the best score of all motions of the lattice."""
    steps = [np.arange(-int(half / cell_m + 1e-9), int(half / cell_m + 1e-9) + 1) for half in (window.x_m, window.y_m)]
    best = 0.0
    for angle in angles:
        for x in steps[0] * cell_m:
            for y in steps[1] * cell_m:
                motion = Pose(window.centre.x + x, window.centre.y + y, window.centre.theta + angle)
                score = score_of(points, target, motion, cell_m, sigma_m)
                best = max(best, score * (1.0 if prior is None else float(prior(abs(x), abs(y), angle))))
    return best


def gentle_prior(x, y, theta):
    return np.exp(-2.0 * np.hypot(x, y) - 0.5 * np.abs(theta))


@pytest.mark.parametrize("prior", [None, gentle_prior])
@pytest.mark.parametrize("seed", range(4))
def test_the_search_returns_the_score_of_an_exhaustive_search(seed, prior):
    rng = np.random.default_rng(seed)
    target, source = rng.uniform(-1.0, 1.0, (30, 2)), rng.uniform(-1.2, 1.2, (15, 2))
    cell_m, sigma_m = 0.0837, 0.12  # no point lies on the border of a cell
    centre = Pose(0.013, 0.019, math.pi if seed % 2 else 0.3)
    window = Window(centre, 0.5, 0.3, math.pi if seed == 3 else 0.4, step_rad=0.7 if seed == 3 else 0.21)
    angles = window.angles(cell_m, 1.0)
    grid = ScoreGrid.from_points(target, cell_m, sigma_m, depth=seed)
    found = branch_and_bound(grid, source, window, prior=prior)
    assert found is not None
    expected = exhaustive(source, target, window, angles, cell_m, sigma_m, prior)
    assert found.score == pytest.approx(expected, abs=1e-12)
    moved = found.target_from_source
    weight = 1.0 if prior is None else prior(moved.x - centre.x, moved.y - centre.y, (centre.inverse() @ moved).theta)
    assert score_of(source, target, moved, cell_m, sigma_m) * weight == pytest.approx(found.score, abs=1e-12)


@pytest.mark.parametrize("theta", [0.0, 1.3, math.pi, -2.0])
def test_a_scan_is_found_in_the_whole_map_at_any_angle(theta):
    truth = Pose(2.5, 1.5, theta)
    seen = room()[:150]
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.1, depth=6)
    found = branch_and_bound(grid, truth.inverse().transform(seen), Window.whole(grid), min_score=0.8)
    assert found is not None
    left = truth.inverse() @ found.target_from_source
    assert math.hypot(left.x, left.y) < 0.08  # a cell and a half
    assert abs(left.theta) < 0.02


def test_no_motion_is_returned_where_none_reaches_the_minimum_score():
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.05, depth=6)
    circle = np.stack([1.5 * np.cos(np.arange(100)), 1.5 * np.sin(np.arange(100))], axis=1)
    window = Window(Pose(*grid.centre), 2.0, 2.0, 0.3)
    best = branch_and_bound(grid, circle, window)
    assert best is not None
    assert branch_and_bound(grid, circle, window, min_score=best.score) is None
    assert bounded_search(grid, circle, window) == (best, best.score)
    for least in (best.score, best.score + 0.1, 1.0):
        none, bound = bounded_search(grid, circle, window, least)
        assert none is None
        assert best.score <= bound <= least
    assert bounded_search(grid, circle, Window(Pose(50.0), 1.0, 1.0, 0.1)) == (None, 0.0)
    again = branch_and_bound(grid, circle, window, min_score=best.score - 1e-6)
    assert again is not None
    assert again.score == best.score


def test_the_score_is_that_of_the_cell_at_its_centre_and_their_mean_between_two():
    """One point in the middle of a cell of 10 cm: the score of a cell follows from its distance, as a byte."""
    grid = ScoreGrid.from_points(np.array([[0.05, 0.05]]), cell_m=0.1, sigma_m=0.1, depth=1)
    centre, beside, corner = (round(255 * math.exp(-0.5 * squared)) / 255 for squared in (0.0, 1.0, 2.0))
    points = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1], [0.0, -0.1], [0.05, 0.0], [0.0, 0.05], [0.05, 0.05]]) + 0.05
    halfway = (centre + beside) / 2
    expected = [centre, beside, beside, beside, halfway, halfway, (centre + 2 * beside + corner) / 4]
    assert grid.score(points) == pytest.approx(expected)


def test_the_whole_window_is_as_large_as_the_grid():
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.05, depth=3)
    window = Window.whole(grid)
    height, width = grid.levels[0].shape
    assert (2 * window.x_m, 2 * window.y_m) == pytest.approx((0.05 * width, 0.05 * height))
    assert (window.centre.x, window.centre.y) == grid.centre


def test_the_angles_of_a_window_end_where_it_ends():
    angles = Window(Pose(), 0.0, 0.0, 0.1, step_rad=0.05).angles(0.05, 10.0)
    assert angles == pytest.approx([-0.1, -0.05, 0.0, 0.05, 0.1])


@pytest.mark.parametrize("turned", [False, True])
def test_a_narrow_window_is_searched_to_its_ends_and_no_farther(turned):
    truth = Pose(2.5, 1.5, 0.4)
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.1, depth=6)
    source = truth.inverse().transform(room())
    centre = Pose(truth.x - 0.9, truth.y, 0.4) if turned else Pose(truth.x, truth.y - 0.9, 0.4)
    found = branch_and_bound(grid, source, Window(centre, *((1.0, 0.1) if turned else (0.1, 1.0)), 0.02))
    assert found is not None
    assert math.hypot(found.target_from_source.x - truth.x, found.target_from_source.y - truth.y) < 0.04


def test_far_fewer_motions_are_evaluated_than_exist():
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.05, depth=6)
    window = Window.whole(grid)
    source = Pose(2.5, 1.5, 0.4).inverse().transform(room())
    motions = grid.levels[0].size * len(window.angles(0.05, 5.0))
    found = branch_and_bound(grid, source, window)
    assert found is not None
    assert found.evaluated < 0.01 * motions


def test_outside_the_grid_the_score_is_zero():
    grid = ScoreGrid.from_points(room(), cell_m=0.05, sigma_m=0.05, depth=3)
    for far in (Pose(50.0, 0.0), Pose(-50.0, -50.0), Pose(0.0, 1e12)):
        assert branch_and_bound(grid, room(), Window(far, 1.0, 1.0, 0.1)) is None
    assert branch_and_bound(grid, np.empty((0, 2)), Window(Pose(), 1.0, 1.0, 0.1)) is None


def test_a_full_circle_has_each_angle_once_and_the_centre_among_them():
    for step in (0.5, 0.1, math.pi / 3):
        angles = Window(Pose(), 0.0, 0.0, math.pi, step).angles(0.05, 10.0)
        turns = np.sort(np.mod(angles, 2 * math.pi))
        gaps = np.diff(np.append(turns, turns[0] + 2 * math.pi))
        assert gaps == pytest.approx(np.full(len(angles), 2 * math.pi / len(angles)))
        assert gaps.max() <= step + 1e-12
        assert 0.0 in angles


def test_the_default_step_moves_the_farthest_point_by_one_cell():
    angles = Window(Pose(), 0.0, 0.0, 0.5).angles(0.05, 10.0)
    chord = 2 * 10.0 * math.sin((angles[1] - angles[0]) / 2)
    assert chord == pytest.approx(0.05)
    assert (angles[0], angles[-1]) == pytest.approx((-0.5, 0.5), abs=0.005)


def test_a_map_that_would_need_too_much_memory_is_refused_with_a_reason():
    with pytest.raises(ValueError, match=r"spread over 1000\d+ m by \d+ m, more than .* cells of 0.05 m"):
        ScoreGrid.from_points(np.array([[0.0, 0.0], [1e6, 1e6]]), 0.05, 0.1, 3)
    with pytest.raises(ValueError, match="at least one target point"):
        ScoreGrid.from_points(np.empty((0, 2)), 0.05, 0.1, 3)
    with pytest.raises(ValueError, match="not negative"):
        Window(Pose(), -1.0, 0.0, 0.1)


def test_the_score_interpolates_towards_the_right_neighbour_on_every_side():
    grid = ScoreGrid.from_points(np.array([[0.05, 0.05]]), cell_m=0.1, sigma_m=0.1, depth=1)
    aside = np.array([[0.03, 0.02], [0.12, 0.07], [0.02, 0.13], [0.08, 0.16]])
    expected = grid.score(0.05 + aside)
    assert (expected > 0.1).all()
    for signs in ([-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]):
        assert grid.score(0.05 + aside * signs) == pytest.approx(expected)


@pytest.mark.parametrize("best", [Pose(0.3, -0.2, 0.0), Pose(1.9, 0.9, 0.0), Pose(-2.4, 0.0, 0.0), Pose(3.4, 0.0)])
def test_the_windows_around_a_motion_cover_the_others_once(best):
    window = Window(Pose(0.5, -0.5, 0.25), 3.0, 1.7, 0.2)
    parts = windows_around(window, best)
    assert {(part.centre.theta, part.theta_rad) for part in parts} == {(0.25, 0.2)}
    for x, y in np.random.default_rng(0).uniform([-2.5, -2.2], [3.5, 1.2], (500, 2)):
        covering = sum(abs(x - part.centre.x) < part.x_m and abs(y - part.centre.y) < part.y_m for part in parts)
        assert covering == (abs(x - best.x) > PEAK_M or abs(y - best.y) > PEAK_M)


def test_a_grid_has_at_most_four_thousand_cells_a_side():
    """Cells of 1 m and 0.1 m of scatter: two cells beside the points, another for the level, and one to be beyond."""
    square = np.array([[0.5, 0.5], [4089.5, 4089.5]])
    assert ScoreGrid.from_points(square, 1.0, 0.1, 0).levels[0].size == MAX_CELLS == 4096**2
    with pytest.raises(ValueError, match="points: they spread over 4097 m by 4096 m"):
        ScoreGrid.from_points(np.add(square, [[0.0, 0.0], [1.0, 0.0]]), 1.0, 0.1, 0)


@pytest.mark.parametrize("depth", [0, 2, 3])
@pytest.mark.parametrize("cell_m", [0.25, 0.5])
def test_points_anywhere_on_the_plane_are_scored_by_their_distance_and_bounded_by_the_maxima(depth, cell_m):
    """One point at the centre of its cell; levels are maxima over squares from each cell upwards."""
    at = np.array([-7.0, 30.0]) + 0.5 * cell_m
    grid = ScoreGrid.from_points(at[None], cell_m, cell_m, depth)
    assert len(grid.levels) == depth + 1
    for across, up in ((0, 0), (1, 0), (0, -2), (2, 2), (-3, 0), (3, 1), (0, 4)):
        squared = across**2 + up**2
        expected = round(255 * math.exp(-0.5 * squared)) / 255 if squared <= 9 else 0.0
        assert grid.score(at + cell_m * np.array([across, up])) == pytest.approx(expected)
    assert grid.score(np.array([[1e4, 0.0], [-1e4, 0.0], [0.0, 1e4], [0.0, -1e4]])).tolist() == [0.0] * 4
    for level, found in enumerate(grid.levels):
        height, width = found.shape
        for row, column in np.argwhere(found).tolist():
            square = grid.levels[0][row : row + 2**level, column : column + 2**level]
            assert found[row, column] == square.max()
        assert np.count_nonzero(found[:, [0, -1]]) == np.count_nonzero(found[[0, -1]]) == 0
        assert (height, width) == grid.levels[0].shape


def test_other_headings_are_those_more_than_twenty_degrees_away():
    window = other_headings(Pose(1.0, 2.0, 0.5))
    assert (window.x_m, window.y_m, window.theta_rad) == (0.5, 0.5, math.pi - math.radians(20.0))
    assert (0.5, math.radians(20.0)) == (PEAK_M, PEAK_RAD)
    assert (window.centre.x, window.centre.y) == (1.0, 2.0)
    assert abs((window.centre.inverse() @ Pose(1.0, 2.0, 0.5)).theta) == pytest.approx(math.pi)


@pytest.mark.parametrize(
    ("step_rad", "reach_m", "step"),
    [(0.0, 10.0, 2.0 * math.asin(0.005)), (0.0, 0.01, 2.0 * math.asin(0.5)), (0.2, 10.0, 0.2)],
)
def test_the_step_of_the_angles_moves_the_farthest_point_by_a_cell(step_rad, reach_m, step):
    """Cells of 10 cm: the chord of a step at the range of the farthest point, at least a cell away."""
    angles = Window(Pose(), 0.0, 0.0, 1.5, step_rad).angles(0.1, reach_m)
    assert np.diff(angles) == pytest.approx(step)
    assert (angles.min(), angles.max()) == pytest.approx(
        (-math.floor(1.5 / step) * step, math.floor(1.5 / step) * step)
    )
    around = Window(Pose(), 0.0, 0.0, math.pi, step_rad).angles(0.1, reach_m)
    count = math.ceil(2.0 * math.pi / step)
    assert len(around) == count
    assert np.diff(around) == pytest.approx(2.0 * math.pi / count)
    assert 0.0 in around


@pytest.mark.parametrize("name", ["x_m", "y_m", "theta_rad", "step_rad"])
def test_extents_of_a_window_are_not_negative(name):
    extents = {"x_m": 0.0, "y_m": 0.0, "theta_rad": 0.0, "step_rad": 0.0}
    assert Window(Pose(), **extents).x_m == 0.0
    with pytest.raises(ValueError, match="expected extents that are not negative"):
        Window(Pose(), **{**extents, name: -1e-9})
