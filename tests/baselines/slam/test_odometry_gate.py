"""A match is believed near the guess of the wheels only; without wheels always."""

import math

import numpy as np
import pytest

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.slam.odometry_gate import GATE_M, GATE_RAD, MIN_POINTS, OdometryGate

GUESS = Pose(1.0, -2.0, 0.5)


class Answers:
    """A registration that answers a fixed motion from its guess, with a fixed error."""

    def __init__(self, gap, error_m=0.1):
        self.gap, self.error_m = gap, error_m

    def register(self, target, source, guess):
        return Match(guess @ self.gap, True, 3, self.error_m, len(source))


@pytest.mark.parametrize(
    ("gap", "points", "is_believed"),
    [
        (Pose(0.99 * GATE_M, 0.0, 0.99 * GATE_RAD), MIN_POINTS, True),
        (Pose(0.0, -1.01 * GATE_M, 0.0), MIN_POINTS, False),
        (Pose(0.0, 0.0, 1.01 * GATE_RAD), MIN_POINTS, False),
        (Pose(0.1, 0.0, 0.0), MIN_POINTS - 1, False),
    ],
)
def test_far_answers_and_those_of_few_points_are_the_guess_without_pairs(gap, points, is_believed):
    gate = OdometryGate(Answers(gap))
    cloud = Cloud(np.ones((points, 2)))
    assert gate.register(cloud, cloud, GUESS).inliers == points  # the guess is none of wheels
    gate.is_measured = True
    match = gate.register(cloud, cloud, GUESS)
    if is_believed:
        assert match.target_from_source == GUESS @ gap
        assert match.inliers == points
    else:
        assert match.target_from_source == GUESS
        assert match.inliers == 0


def test_a_far_answer_that_fits_well_is_believed():
    gate = OdometryGate(Answers(Pose(1.0, 0.0, 0.0), 0.02), is_measured=True)
    cloud = Cloud(np.ones((MIN_POINTS, 2)))
    assert gate.register(cloud, cloud, GUESS).target_from_source == GUESS @ Pose(1.0, 0.0, 0.0)


def test_a_jump_of_half_a_turn_is_far():
    gate = OdometryGate(Answers(Pose(0.0, 0.0, math.pi)), is_measured=True)
    cloud = Cloud(np.ones((MIN_POINTS, 2)))
    assert gate.register(cloud, cloud, GUESS).target_from_source == GUESS
