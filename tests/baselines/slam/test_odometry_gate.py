"""A match is believed near the guess of the wheels only; without wheels always."""

import math

import numpy as np
import pytest

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.slam.odometry_gate import MIN_POINTS, STRICT, WIDE, OdometryGate

GUESS = Pose(1.0, -2.0, 0.5)


class Answers:
    """A registration that answers a fixed motion from its guess, with a fixed error."""

    def __init__(self, gap, error_m=0.1):
        self.gap, self.error_m = gap, error_m

    def register(self, target, source, guess):
        return Match(guess @ self.gap, True, 3, self.error_m, len(source))


@pytest.mark.parametrize("strict", [False, True])
@pytest.mark.parametrize(
    ("share", "points", "is_believed"),
    [
        ((0.99, 0.0, 0.99), MIN_POINTS, (True, True)),
        ((0.0, -1.01, 0.0), MIN_POINTS, (False, False)),
        ((0.0, 0.0, 1.01), MIN_POINTS, (False, False)),
        ((0.1, 0.0, 0.0), MIN_POINTS - 1, (True, False)),
    ],
)
def test_far_answers_and_strictly_those_of_few_points_are_the_guess_without_pairs(share, points, is_believed, strict):
    most_m, most_rad = STRICT if strict else WIDE
    gap, is_believed = Pose(share[0] * most_m, share[1] * most_m, share[2] * most_rad), is_believed[strict]
    gate = OdometryGate(Answers(gap), strict)
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
