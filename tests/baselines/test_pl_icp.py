"""PL-ICP: the exact step against a numerical optimum, rejection of pairs, and known motions."""

import math

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.pl_icp import PlIcp, best_direction, fit_to_lines, line_normals


def l_room(spacing_m=0.05):
    """Return points on the walls of an L-shaped room."""
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [4.0, 2.0], [4.0, 4.5], [0.0, 4.5]]) - 1.0
    sides = np.roll(corners, -1, axis=0) - corners
    walls = zip(corners, sides, strict=True)
    return np.concatenate([at + np.arange(0, 1, spacing_m / np.hypot(*side))[:, None] * side for at, side in walls])


def cost(row, source, target, normals):
    return float((np.sum((se2.transform(row, source) - target) * normals, axis=1) ** 2).sum())


@pytest.mark.parametrize("seed", range(12))
def test_the_step_is_the_global_minimum_of_its_pairs(seed):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=(12, 2))
    target = se2.transform(rng.uniform(-3, 3, 3), source) + rng.normal(0.0, rng.uniform(0.0, 0.5), (12, 2))
    angle = rng.uniform(0, 2 * math.pi, 12)
    normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = cost(fit_to_lines(source, target, normals), source, target, normals)
    starts = [[0.0, 0.0, theta] for theta in np.linspace(-math.pi, math.pi, 9)]
    least = min(minimize(cost, start, (source, target, normals), "BFGS").fun for start in starts)
    assert found <= least + 1e-9 * (1.0 + least)


def test_exact_pairs_give_the_exact_motion_however_large():
    rng = np.random.default_rng(1)
    for theta in (0.0, 0.5, 3.1, -2.0):
        truth = Pose(4.0, -2.0, theta)
        source = rng.normal(size=(8, 2))
        angle = rng.uniform(0, 2 * math.pi, 8)
        normals = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        assert fit_to_lines(source, truth.transform(source), normals) == pytest.approx(truth.row, abs=1e-9)


def test_a_direction_without_a_preference_is_kept():
    assert best_direction(np.eye(2), np.zeros(2)) == (1.0, 0.0)
    # v' S v - 2 h' v with h = 0 is least along the smaller eigenvalue, with either sign
    assert np.abs(best_direction(np.diag([2.0, 1.0]), np.zeros(2))) == pytest.approx([0.0, 1.0])
    # h across the smaller eigenvalue, less than the gap: both signs of the rest are equally good
    assert np.abs(best_direction(np.diag([1.0, 3.0]), np.array([0.0, 1.0]))) == pytest.approx([math.sqrt(0.75), 0.5])


def test_a_single_wall_moves_nothing_along_it_and_a_circle_turns_nothing():
    along = np.linspace(-2, 2, 40)
    wall = np.stack([along, np.zeros(40)], axis=1)
    up = np.tile([0.0, 1.0], (40, 1))
    assert fit_to_lines(wall - [0.0, 0.2], wall, up) == pytest.approx([0.0, 0.2, 0.0], abs=1e-9)
    turns = np.linspace(0, 2 * math.pi, 40, endpoint=False)
    circle = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    assert fit_to_lines(circle - [0.1, 0.0], circle, circle) == pytest.approx([0.1, 0.0, 0.0], abs=1e-6)


def test_a_line_is_defined_by_a_neighbour_at_the_given_distance():
    # a wall along x seen twice, the second time 1 mm beside it
    along = np.arange(0.0, 2.0, 0.1)
    twice = np.concatenate([np.stack([along, 0 * along], axis=1), np.stack([along, 0 * along + 0.001], axis=1)])
    across = np.abs(line_normals(cKDTree(twice), 0.0)[:, 0])
    assert across == pytest.approx(np.ones(40), abs=1e-9)  # the nearest point is the one beside it
    assert np.abs(line_normals(cKDTree(twice), 0.25)[:, 1]) == pytest.approx(np.ones(40), abs=1e-4)


@pytest.mark.parametrize("truth", [Pose(0.12, -0.08, 0.09), Pose(3.0, -7.0, 2.5)])
def test_a_known_motion_of_noise_free_walls_is_recovered(truth):
    source = Cloud(truth.inverse().transform(l_room()[::2]))
    match = PlIcp(thin_m=0.0, line_m=0.1, epsilon_m=1e-9, max_iterations=100).register(
        Cloud(l_room()), source, truth @ Pose(0.1, -0.06, 0.05)
    )
    left = truth.inverse() @ match.target_from_source
    assert match.converged
    assert math.hypot(left.x, left.y) < 1e-3
    assert abs(left.theta) < 1e-3


def test_a_displaced_tenth_is_trimmed():
    moved = l_room().copy()
    moved[:40] += [0.0, -0.3]  # a box in front of a wall
    match = PlIcp(thin_m=0.0, line_m=0.1, max_iterations=100).register(Cloud(l_room()), Cloud(moved), Pose())
    kept_all = PlIcp(thin_m=0.0, line_m=0.1, keep_share=1.0, quantile_factor=0.0, sharing_factor=0.0).register(
        Cloud(l_room()), Cloud(moved), Pose()
    )
    assert math.hypot(match.target_from_source.x, match.target_from_source.y) < 1e-3
    assert math.hypot(kept_all.target_from_source.x, kept_all.target_from_source.y) > 5e-3


def test_of_the_points_at_one_target_point_the_far_ones_are_dropped():
    target = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
    # three points near (2, 0): at 0.1, at 0.25 and at 0.35, more than three times the best
    source = np.array([[0.0, 0.1], [1.0, 0.1], [2.1, 0.0], [2.25, 0.0], [2.35, 0.0], [0.1, 1.0], [0.1, 2.0]])
    settings = {"thin_m": 0.0, "keep_share": 1.0, "quantile_factor": 0.0, "max_iterations": 1, "restart_error_m": 0.0}
    assert PlIcp(**settings).register(Cloud(target), Cloud(source), Pose()).inliers == 6  # type: ignore[arg-type]
    everything = PlIcp(**settings, sharing_factor=0.0).register(Cloud(target), Cloud(source), Pose())  # type: ignore[arg-type]
    assert everything.inliers == 7


def test_a_restart_leaves_a_local_minimum_and_the_least_mean_error_is_the_answer():
    # a saw of teeth 0.4 m apart and a guess half a tooth off: the descent ends turned and aside
    x = np.arange(0.0, 4.0, 0.02)
    saw = np.stack([x, np.abs((x / 0.4) % 1.0 - 0.5) * 0.8], axis=1)
    post = np.stack([np.full(25, 2.8), np.arange(-0.6, -0.1, 0.02)], axis=1)
    target, source = Cloud(np.concatenate([saw, post])), Cloud(np.concatenate([saw[40:160], post]))

    def answer(restart_error_m):
        settings = PlIcp(
            thin_m=0.0, line_m=0.05, max_correspondence_m=0.3, max_iterations=60, restart_error_m=restart_error_m,
            restart_m=0.3,
        )  # fmt: skip
        return settings.register(target, source, Pose(0.22, 0.0, 0.0))

    once, many = answer(0.0), answer(1e-3)
    assert once.error > 0.03
    assert many.target_from_source.row == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert answer(1.0).target_from_source == once.target_from_source


def test_too_few_pairs_return_the_guess_as_not_converged():
    guess, none, two = Pose(0.1, 0.2, 0.3), Cloud(np.zeros((0, 2))), Cloud(np.eye(2))
    for target, source in ((none, none), (Cloud(l_room()), none), (two, two), (Cloud(l_room()), Cloud(l_room() + 50))):
        match = PlIcp().register(target, source, guess)
        assert (match.target_from_source, match.converged) == (guess, False)
    # one point in a hundred has a partner: less than five in a hundred
    mostly_far = np.concatenate([l_room()[:4], l_room() + 50.0])
    assert not PlIcp().register(Cloud(l_room()), Cloud(mostly_far), Pose()).converged
