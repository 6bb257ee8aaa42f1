"""The correlative matcher: known motions, flat directions, ties, and targets that are far away or empty."""

import math

import numpy as np
import pytest

from evalkit.commands.validate.rules.scenes import drive
from evalkit.core.errors import BadParameter
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.odometry.correlative import ScoreGrid
from evalkit_baselines.correlative_matcher import CorrelativeMatcher, fit_peak


def wall(begin, end, spacing_m=0.02):
    begin, end = np.array(begin), np.array(end)
    return begin + np.arange(0.0, 1.0, spacing_m / np.hypot(*(end - begin)))[:, None] * (end - begin)


def corner():
    """Return two walls, 3 m and 2 m, that meet in a corner."""
    return np.concatenate([wall([-1.0, 1.0], [2.0, 1.0]), wall([2.0, 1.0], [2.0, -1.0])])


def l_room():
    """Return the walls of an L-shaped room of 6 m by 4.5 m."""
    corners = [[-3.0, -2.0], [3.0, -2.0], [3.0, 0.0], [1.0, 0.0], [1.0, 2.5], [-3.0, 2.5]]
    return np.concatenate([wall(begin, end) for begin, end in zip(corners, corners[1:] + corners[:1], strict=True)])


def corridor():
    """Return two parallel walls along x, far longer than what is seen of them."""
    return np.concatenate([wall([-8.0, 1.01], [8.0, 1.01]), wall([-8.0, -0.98], [8.0, -0.98])])


@pytest.mark.parametrize("truth", [Pose(0.213, -0.117, 0.2), Pose(-0.25, 0.25, -0.3), Pose(3.0, -7.0, 2.5)])
def test_a_known_motion_is_recovered_between_the_cells(truth):
    source = Cloud(truth.inverse().transform(l_room()))
    guess = truth @ Pose(0.2, -0.15, 0.25)
    match = CorrelativeMatcher(window_m=0.5, thin_m=0.0).register(Cloud(l_room()), source, guess)
    off = match.target_from_source.transform(source.points) - l_room()
    assert match.converged
    assert np.hypot(*off.T).max() < 0.01  # a fifth of a cell, at the farthest corner
    assert match.inliers == len(source)


@pytest.mark.parametrize("along", [0.0, 0.17, -0.2])
def test_a_corridor_leaves_the_position_along_it_to_the_guess(along):
    target = corridor()
    seen = target[np.abs(target[:, 0]) < 3.0]
    truth = Pose(0.0, 0.06, 0.05)
    guess = Pose(along, 0.0, 0.0)
    match = CorrelativeMatcher().register(Cloud(target), Cloud(truth.inverse().transform(seen)), guess)
    answer = match.target_from_source
    assert (answer.y, answer.theta) == pytest.approx((truth.y, truth.theta), abs=0.005)
    assert answer.x == pytest.approx(along, abs=0.026)  # half a cell: beyond, the prior decides


def test_of_two_equal_places_the_nearer_to_the_guess_is_the_answer():
    posts = [Pose(x, 0.0, 0.0).transform(0.1 * corner()) for x in (-0.4, 0.4)]
    match = CorrelativeMatcher(window_m=1.0, window_deg=5.0).register(
        Cloud(np.concatenate(posts)), Cloud(0.1 * corner()), Pose(0.1, 0.0, 0.0)
    )
    assert match.target_from_source.x == pytest.approx(0.4, abs=0.01)


def test_between_two_equal_maxima_the_fitted_peak_lies_in_the_middle():
    # the wall lies on the border of two rows of cells: the score is the same half a cell above and below
    grid = ScoreGrid.from_points(wall([-3.0, 1.0], [3.0, 1.0]), cell_m=0.1, sigma_m=0.1, depth=2)
    seen = wall([-2.0, 0.0], [2.0, 0.0])
    for start in (0.96, 1.04, 1.0):
        assert fit_peak(grid, seen, Pose(0.0, start, 0.0)).y == pytest.approx(1.0, abs=0.01)


def test_the_peak_of_a_quadratic_score_is_found_exactly():
    # a Gaussian of 10 m: within a few centimetres its 8 bits are all full, and what is left is the weight
    grid = ScoreGrid.from_points(np.array([[0.0, 0.0]]), cell_m=0.5, sigma_m=10.0, depth=1)
    points = np.array([[0.1, 0.0], [-0.1, 0.0]])
    peak = Pose(0.03, -0.06, 0.2)

    def weigh(motions):
        return 1.0 - ((motions - peak.row) ** 2 * [0.4, 0.9, 0.1]).sum(axis=1)

    found = fit_peak(grid, points, Pose(), min_curvature=1e-6, weigh=weigh)
    assert found.row == pytest.approx(peak.row, abs=0.01)


def test_scores_are_interpolated_between_the_centres_of_cells():
    grid = ScoreGrid.from_points(np.array([[0.5, 0.5]]), cell_m=1.0, sigma_m=1.0, depth=1)
    beside = round(255 * math.exp(-0.5)) / 255
    points = np.array([[0.5, 0.5], [1.5, 0.5], [1.0, 0.5], [0.5, 1.25], [100.0, 0.5], [-1e9, -1e9]])
    assert grid.score(points) == pytest.approx(
        [1.0, beside, (1 + beside) / 2, 0.25 + 0.75 * beside, 0.0, 0.0], abs=1e-12
    )


def test_points_beyond_the_reach_do_not_change_the_answer_or_the_memory():
    source, guess = Cloud(corner()), Pose(0.1, 0.05, 0.02)
    near = CorrelativeMatcher().register(Cloud(corner()), source, guess)
    far = np.concatenate([corner(), [[1e8, 1e8], [-1e8, 0.0]]])
    outliers = Cloud(np.concatenate([corner(), [[5e7, 0.0]]]))
    assert CorrelativeMatcher().register(Cloud(far), outliers, guess).target_from_source == near.target_from_source


def test_without_a_score_the_answer_is_the_guess_not_converged():
    guess, none = Pose(0.1, 0.2, 0.3), Cloud(np.empty((0, 2)))
    for target, source in ((none, none), (none, Cloud(corner())), (Cloud(corner()), none)):
        match = CorrelativeMatcher().register(target, source, guess)
        assert (match.target_from_source, match.converged, match.inliers) == (guess, False, 0)
    away = Cloud(corner() + 15.0)
    match = CorrelativeMatcher().register(Cloud(corner()), away, guess)
    assert (match.target_from_source, match.converged) == (guess, False)


def test_parameters_out_of_bounds_are_refused():
    with pytest.raises(BadParameter, match="window_m"):
        CorrelativeMatcher(window_m=-1.0)


def test_karto_finds_the_same_motion():
    karto = pytest.importorskip("karto_scanmatcher", reason="not installed: karto-scanmatcher; .ci/oracles installs it")
    simulated = drive(16, sweeping=False)
    first, *later = simulated.frames
    angles = first.scan.angles
    sensor = karto.LaserScanConfig(
        float(angles[0]), float(angles[-1]), float(angles[1] - angles[0]), 0.05, 30.0, 12.0, ""
    )

    def scan(frame, number, pose):
        at = karto.Pose2(*pose.row)
        return karto.LocalizedRangeScan(sensor, frame.scan.ranges.tolist(), at, at, number, 0.0)

    wrapper = karto.Wrapper(karto.ScanMatcherConfig())
    target = Cloud(first.scan.points())
    for number, (frame, truth) in enumerate(zip(later[2::4], simulated.truth[3::4], strict=True), 1):
        guess = Pose.of(truth) @ Pose(0.05, -0.04, 0.03)
        theirs = wrapper.match_scan(scan(frame, number, guess), [scan(first, 0, Pose())], False, True).best_pose
        ours = CorrelativeMatcher().register(target, Cloud(frame.scan.points()), guess).target_from_source
        left = Pose(theirs.x, theirs.y, theirs.yaw).inverse() @ ours
        assert math.hypot(left.x, left.y) < 0.015  # Karto answers in steps of 1 cm and 0.2 deg
        assert abs(left.theta) < 0.006
        ours_m, theirs_m = (math.hypot(*(one.row - truth)[:2]) for one in (ours, Pose(theirs.x, theirs.y, theirs.yaw)))
        assert ours_m < max(theirs_m, 0.01)
