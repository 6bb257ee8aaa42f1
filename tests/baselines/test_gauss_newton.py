"""The descent that the field matchers share, on costs whose minimum and Hessian are known by hand."""

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.gauss_newton import MAX_STEP_M, Normal, StopRule, Terms, descend, solve, sum_points, turn_about

POINTS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [2.0, 1.0]])
STOP = StopRule(max_iterations=30, step_m=1e-9, weak=1e-6)


def to_fixed(truth, normals=None):
    """A sum of squared distances to the points' own places under ``truth``, or along ``normals`` (N, 2)."""
    places = truth.transform(POINTS)
    bent = (
        np.broadcast_to(np.eye(2), (len(POINTS), 2, 2)) if normals is None else normals[:, :, None] * normals[:, None]
    )

    def evaluate(moved):
        pull = np.einsum("nij,nj->ni", bent, moved - places)
        cost = 0.5 * float(np.sum(pull * (moved - places)))
        curvature = bent.reshape(-1, 4).T[[0, 1, 3]]
        return Terms(cost, pull.T, curvature, len(moved), float(np.linalg.norm(pull, axis=1).mean()), len(moved))

    return evaluate


def test_a_quadratic_cost_is_minimised_to_rounding():
    truth = Pose(0.3, -0.2, 0.4)
    match = descend(to_fixed(truth), Cloud(POINTS), Pose(), STOP)
    assert match.converged
    assert match.target_from_source.row == pytest.approx(truth.row, abs=1e-9)
    assert match.error == pytest.approx(0.0, abs=1e-9)
    assert match.inliers == len(POINTS)


@pytest.mark.parametrize(("limit", "converged"), [(30, True), (3, False), (1, False)])
def test_every_evaluation_is_an_iteration_up_to_the_limit(limit, converged):
    evaluate, calls = to_fixed(Pose(0.3, -0.2, 0.4)), []

    def counted(moved):
        calls.append(moved)
        return evaluate(moved)

    match = descend(counted, Cloud(POINTS), Pose(), StopRule(max_iterations=limit, step_m=1e-9, weak=1e-6))
    assert (match.iterations, match.converged) == (len(calls), converged)
    assert len(calls) == limit if not converged else 3 < len(calls) < limit


def test_a_direction_that_no_point_observes_stays_at_the_guess():
    across = np.tile([0.0, 1.0], (len(POINTS), 1))  # every point sees a wall along x
    guess = Pose(0.7, 0.1, 0.05)
    match = descend(to_fixed(Pose(), across), Cloud(POINTS), guess, STOP)
    at_mean = match.target_from_source.transform([POINTS.mean(axis=0)])[0]
    assert at_mean[0] == pytest.approx(guess.transform([POINTS.mean(axis=0)])[0, 0], abs=2e-3)  # of 0.7 m
    assert match.target_from_source.theta == pytest.approx(0.0, abs=1e-6)
    assert match.target_from_source.y == pytest.approx(0.0, abs=1e-6)


def test_the_hessian_of_point_distances_is_the_count_and_the_squared_arms():
    normal = sum_points(POINTS, to_fixed(Pose())(POINTS))
    assert normal.centre == pytest.approx([0.4, 0.2])
    assert normal.radius**2 == pytest.approx(np.mean(np.sum((POINTS - [0.4, 0.2]) ** 2, axis=1)))
    assert normal.hessian == pytest.approx(5.0 * np.eye(3), abs=1e-12)  # the turn is scaled by the radius of gyration
    assert normal.slope == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_negative_curvature_still_gives_a_downhill_step():
    slope = np.array([1.0, -2.0, 0.5])
    step = solve(Normal(slope, np.diag([-100.0, 100.0, -50.0]), 1.0, np.zeros(2), 1.0), weak=0.0)
    assert step == pytest.approx([-0.01, 0.02, -0.01])


def test_a_step_is_shortened_to_its_limit_in_its_direction():
    step = solve(Normal(np.array([-30.0, -40.0, 0.0]), np.eye(3), 1.0, np.zeros(2), 1.0), weak=0.0)
    assert step == pytest.approx([0.6 * MAX_STEP_M, 0.8 * MAX_STEP_M, 0.0])


def test_a_turn_keeps_its_centre_and_a_shift_moves_it():
    centre = np.array([3.0, -1.0])
    moved = turn_about(centre, 2.0, np.array([0.1, 0.2, 0.5]))
    assert moved.theta == pytest.approx(0.25)
    assert moved.transform([centre])[0] == pytest.approx([3.1, -0.8])


def test_a_cost_that_cannot_be_lowered_returns_the_guess_as_converged():
    guess = Pose(0.2, 0.1, 0.0)
    rising = iter(range(100))

    def evaluate(moved):
        return Terms(float(next(rising)), np.ones((2, len(moved))), np.ones((3, len(moved))), len(moved), 0.1, 5.0)

    match = descend(evaluate, Cloud(POINTS), guess, STOP)
    assert match.converged
    assert match.target_from_source == guess


def test_too_few_points_near_anything_is_no_answer():
    def evaluate(moved):
        return Terms(0.0, np.zeros((2, len(moved))), np.zeros((3, len(moved))), 2, 0.0, 2.0)

    match = descend(evaluate, Cloud(POINTS), Pose(1.0, 2.0, 3.0), STOP)
    assert not match.converged
    assert match.target_from_source == Pose(1.0, 2.0, 3.0)
    assert np.isnan(match.error)
