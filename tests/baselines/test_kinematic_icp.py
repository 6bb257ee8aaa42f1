"""Kinematic ICP: the step against a numerical optimum, arcs only, and recordings without wheel odometry."""

import itertools
import math

import numpy as np
import pytest
from scipy.optimize import minimize

from evalkit.core import se2
from evalkit.core.errors import BadParameter, DataMissing
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit_baselines import kinematic_icp
from evalkit_baselines.kinematic_icp import KinematicRegistration, KinematicSettings, arc, solve_step

ANGLES = np.linspace(-math.pi, math.pi, 360, endpoint=False)


def walls():
    """Return points on two walls that meet at a right angle, so far apart that nearest points are right."""
    along = np.arange(0.0, 3.0, 0.3)
    return np.concatenate(
        [np.stack([along, 0 * along + 1.5], axis=1), np.stack([0 * along + 3.0, along - 1.5], axis=1)]
    )


def registration(**settings):
    chosen = KinematicSettings(**settings)
    return KinematicRegistration(chosen, kinematic_icp._Limit(chosen.cell_m, chosen.max_range_m))


@pytest.mark.parametrize("beta", [0.0, 0.7])
def test_the_step_minimises_the_linearised_cost(beta):
    rng = np.random.default_rng(2)
    source, gaps, heading = rng.normal(size=(20, 2)), rng.normal(0.0, 0.1, (20, 2)), 0.8

    def cost(step):
        length, turn = step
        aside = np.stack([-source[:, 1], source[:, 0]], axis=1)
        motion = se2.transform([0.0, 0.0, heading], np.array([[length, 0.0]]) + turn * aside)
        return float(((gaps - motion) ** 2).sum(axis=1).mean() + beta * length**2)

    best = minimize(cost, [0.0, 0.0], method="BFGS", tol=1e-12)
    assert solve_step(source, gaps, heading, beta) == pytest.approx(best.x, abs=1e-6)


def test_an_arc_has_its_length_and_its_turn():
    assert arc(2.0, 0.0) == pytest.approx([2.0, 0.0, 0.0])
    assert arc(math.pi, math.pi) == pytest.approx([0.0, 2.0, math.pi])  # half a circle of radius 1
    assert arc(-0.5 * math.pi, -0.5 * math.pi) == pytest.approx([-1.0, 1.0, -0.5 * math.pi])


@pytest.mark.parametrize("heading", [0.0, 1.2, -2.5])
def test_an_error_along_an_arc_is_corrected_and_one_to_the_side_stays(heading):
    truth = Pose(0.5, -0.3, heading)
    target = Cloud(truth.transform(walls()))
    wrong = truth @ Pose.of(arc(-0.02, 0.01))
    match = registration(trust_m=0.0, max_iterations=100, epsilon=1e-9).register(target, Cloud(walls()), wrong)
    left = truth.inverse() @ match.target_from_source
    assert left.row == pytest.approx([0.0, 0.0, 0.0], abs=1e-4)
    aside = registration(trust_m=0.0, max_iterations=1).register(target, Cloud(walls()), truth @ Pose(0.0, 0.02, 0.0))
    step = (truth @ Pose(0.0, 0.02, 0.0)).inverse() @ aside.target_from_source
    assert step.row == pytest.approx(arc(*_length_and_turn(step)), abs=1e-12)


def test_it_stops_after_the_first_step_below_a_tenth_of_a_millimetre():
    wrong = Pose.of(arc(-0.01, 0.005))
    match = registration(trust_m=0.0).register(Cloud(walls()), Cloud(walls()), wrong)
    poses = [wrong, *(one.target_from_source for one in match.history)]
    steps = [_length_and_turn(one.inverse() @ other) for one, other in itertools.pairwise(poses)]
    small = [math.hypot(*step) < 1e-4 for step in steps]
    assert len(small) > 1
    assert small == [False] * (len(small) - 1) + [True]
    assert (match.converged, match.iterations) == (True, len(small))


def _length_and_turn(step):
    chord = math.copysign(math.hypot(step.x, step.y), step.x)
    return chord / np.sinc(0.5 * step.theta / math.pi), step.theta


@pytest.mark.parametrize(("trust_m", "share"), [(0.0, 1.0), (0.02, 0.5), (1.0, 1.0 / 2501.0)])
def test_trust_in_the_odometry_reduces_the_length_by_its_share(trust_m, share):
    # a shift of d along the heading: beta is (trust / d)^2, and about the base the length is d / (1 + beta)
    shift = 0.02
    points = np.array([[2.0, 1.0], [2.0, -1.0], [-2.0, 1.0], [-2.0, -1.0]])
    target = Cloud(points + np.array([shift, 0.0]))
    match = registration(trust_m=trust_m, max_iterations=1).register(target, Cloud(points), Pose())
    assert match.target_from_source.row == pytest.approx([share * shift, 0.0, 0.0], abs=1e-12)


def test_the_largest_distance_of_a_pair_grows_with_the_errors_of_the_odometry():
    limit = kinematic_icp._Limit(0.1, 10.0)
    assert limit.metres == pytest.approx(0.3)
    limit.add(Pose(0.03, 0.04, 0.0))
    assert limit.metres == pytest.approx(3 * (0.1 + 0.05))
    limit.add(Pose(0.0, 0.0, 0.02))
    assert limit.metres == pytest.approx(3 * (0.1 + math.sqrt((0.05**2 + (20 * math.sin(0.01)) ** 2) / 2)))


def frame(index, odom):
    ranges = 2.0 / np.maximum(np.abs(np.cos(ANGLES)), np.abs(np.sin(ANGLES)))  # a square room
    return Frame(Scan(index * 100_000_000, ranges, ANGLES, 0.1, 12.0), odom_from_base=odom)


def test_a_recording_without_wheel_odometry_is_refused_with_the_reason():
    with pytest.raises(DataMissing, match=r"no wheel odometry at its first scan.*start = N.*leave this method out"):
        kinematic_icp.make().update(frame(0, None))


def test_a_gap_in_the_odometry_is_bridged():
    odometry = kinematic_icp.make()
    for index, odom in enumerate([Pose(), Pose(), None, Pose()]):
        answer = odometry.update(frame(index, odom)).pose
        assert answer.row == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_parameters_are_those_of_the_method_and_of_the_front_end_without_the_prior():
    names = [each.name for each in kinematic_icp.SPEC.parameters]
    assert {"trust_m", "local_map", "scan_to_scan"} <= set(names)
    assert "prior" not in names
    assert len(names) == len(set(names))
    with pytest.raises(BadParameter, match="trust_m"):
        kinematic_icp.make(trust_m=-1.0)


def test_too_few_points_return_the_guess_as_not_converged():
    guess = Pose(0.1, 0.2, 0.3)
    for target, source in ((np.eye(2), np.eye(2)), (walls(), np.empty((0, 2))), (walls(), walls() + 50.0)):
        match = registration().register(Cloud(target), Cloud(source), guess)
        assert (match.target_from_source, match.converged) == (guess, False)
