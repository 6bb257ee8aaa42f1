"""A match is accepted near the guess of the wheels only; without wheels always."""

import math

import numpy as np
import pytest

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.slam.odometry_gate import MIN_POINTS, NARROW, WIDE, Gated, OdometryGate

GUESS = Pose(1.0, -2.0, 0.5)


class Answers:
    """A registration that answers a fixed motion from its guess, with a fixed error."""

    def __init__(self, gap, error_m=0.1, paired=1.0):
        self.gap, self.error_m, self.paired = gap, error_m, paired

    def register(self, target, source, guess):
        return Match(guess @ self.gap, True, 3, self.error_m, round(self.paired * len(source)))


@pytest.mark.parametrize("usual_gap", [None, (1.0, 1.0), (0.0, 0.0)])
@pytest.mark.parametrize(
    ("share", "points", "is_accepted"),
    [
        ((0.99, 0.0, 0.99), MIN_POINTS, (True, True)),
        ((0.0, -1.01, 0.0), MIN_POINTS, (False, False)),
        ((0.0, 0.0, 1.01), MIN_POINTS, (False, False)),
        ((0.1, 0.0, 0.0), MIN_POINTS - 1, (True, False)),
    ],
)
def test_far_answers_and_beside_good_odometry_those_of_few_points_are_the_guess_without_pairs(
    share, points, is_accepted, usual_gap
):
    good = usual_gap == (0.0, 0.0)
    most_m, most_rad = NARROW if good else WIDE
    gap, is_accepted = Pose(share[0] * most_m, share[1] * most_m, share[2] * most_rad), is_accepted[good]
    gated = Gated(Answers(gap), OdometryGate())
    cloud = Cloud(np.ones((points, 2)))
    assert gated.register(cloud, cloud, GUESS).inliers == points  # the guess is none of wheels
    gated.gate.begin_scan(Pose(0.0, 0.0, 0.0), usual_gap)
    match = gated.register(cloud, cloud, GUESS)
    if is_accepted:
        assert match.target_from_source == GUESS @ gap
        assert match.inliers == points
    else:
        assert match.target_from_source == GUESS
        assert match.inliers == 0


@pytest.mark.parametrize(
    ("points", "usual_points", "is_accepted"), [(20, 60.0, True), (19, 60.0, False), (39, 600.0, False)]
)
def test_of_a_lidar_with_few_beams_a_third_of_the_usual_points_is_enough(points, usual_points, is_accepted):
    gated = Gated(Answers(Pose(0.1, 0.0, 0.0)), OdometryGate())
    gated.gate.begin_scan(Pose(0.0, 0.0, 0.0), (0.0, 0.0), usual_points=usual_points)
    cloud = Cloud(np.ones((points, 2)))
    assert (gated.register(cloud, cloud, GUESS).inliers > 0) == is_accepted


@pytest.mark.parametrize("usual", [0.02, 0.0])
@pytest.mark.parametrize(
    ("gap", "is_accepted"), [((0.39, 0.0, 0.39), True), ((0.0, 0.41, 0.0), False), ((0.0, 0.0, 0.41), False)]
)
def test_answers_up_to_twenty_times_the_usual_gap_or_a_quarter_of_the_step_are_accepted(gap, is_accepted, usual):
    gated = Gated(Answers(Pose(*gap)), OdometryGate())
    step = Pose(0.0, 0.0, 0.0) if usual else Pose(0.24, -0.32, -0.2)  # with good odometry, 0.1 m and 0.05 rad more
    gated.gate.begin_scan(step, (usual, usual))
    cloud = Cloud(np.ones((MIN_POINTS, 2)))
    assert (gated.register(cloud, cloud, GUESS).inliers > 0) == is_accepted


@pytest.mark.parametrize(
    ("x_m", "error_m", "paired", "is_accepted"),
    [
        (0.24, 0.09, 0.79, True),
        (0.26, 0.09, 0.79, False),
        (0.49, 0.07, 0.79, True),
        (0.49, 0.09, 0.8, True),
        (0.51, 0.07, 0.79, False),
    ],
)
def test_an_answer_that_fits_poorly_must_be_half_as_far(x_m, error_m, paired, is_accepted):
    gated = Gated(Answers(Pose(x_m, 0.0, 0.0), error_m, paired), OdometryGate())
    gated.gate.begin_scan(Pose(0.0, 0.0, 0.0), None, 0.02)  # four times this
    cloud = Cloud(np.ones((100, 2)))
    assert (gated.register(cloud, cloud, GUESS).inliers > 0) == is_accepted


@pytest.mark.parametrize(
    ("y_before_m", "error_before_m", "x_m", "error_m", "paired", "usual_gap", "is_accepted"),
    [
        (0.029, 0.03, 0.029, 0.045, 1.0, (0.0, 0.0), True),
        (0.029, 0.03, 0.031, 0.045, 1.0, (0.0, 0.0), False),
        (0.029, 0.03, 0.031, 0.039, 0.8, (0.0, 0.0), True),
        (0.029, 0.03, 0.031, 0.039, 0.79, (0.0, 0.0), False),
        (0.029, 0.041, 0.031, 0.045, 1.0, (0.0, 0.0), True),
        (0.031, 0.03, 0.031, 0.045, 1.0, (0.0, 0.0), True),
        (0.029, 0.03, 0.031, 0.045, 1.0, None, True),
    ],
)
def test_a_doubted_answer_stays_where_good_odometry_and_the_match_before_agree(
    y_before_m, error_before_m, x_m, error_m, paired, usual_gap, is_accepted
):
    """The usual error is 0.02 m: 0.041 m are doubted, and may leave the guess by 3 cm."""
    before, now = Answers(Pose(0.0, y_before_m, 0.0), error_before_m), Answers(Pose(x_m, 0.0, 0.0), error_m, paired)
    gate, cloud = OdometryGate(), Cloud(np.ones((100, 2)))
    gate.begin_scan(Pose(0.0, 0.0, 0.0), usual_gap, 0.02)
    assert Gated(before, gate).register(cloud, cloud, GUESS).inliers == 100
    assert (Gated(now, gate).register(cloud, cloud, GUESS).inliers > 0) == is_accepted


@pytest.mark.parametrize(
    ("gap_m", "error_m", "paired", "usual_gap", "is_sure"),
    [
        (0.119, 0.039, 0.8, (0.0, 0.0), True),  # odometry is thought to be no better than 0.04 m after a step of 0.6 m
        (0.121, 0.02, 1.0, (0.0, 0.0), False),
        (0.0, 0.041, 1.0, (0.0, 0.0), False),
        (0.0, 0.02, 0.79, (0.0, 0.0), False),
        (0.0, 0.02, 1.0, None, False),
    ],
)
def test_an_answer_is_sure_where_nothing_about_it_is_doubted_and_none_before_the_first(
    gap_m, error_m, paired, usual_gap, is_sure
):
    gate, cloud = OdometryGate(), Cloud(np.ones((100, 2)))
    for _ in range(2):
        gate.begin_scan(Pose(0.6, 0.0, 1.0), usual_gap, 0.02)
        assert not gate.is_sure
        Gated(Answers(Pose(gap_m, 0.0, 0.3), error_m, paired), gate).register(cloud, cloud, GUESS)
        assert gate.is_sure == is_sure


def test_a_far_answer_that_fits_well_is_accepted():
    gated = Gated(Answers(Pose(1.0, 0.0, 0.0), 0.02), OdometryGate())
    gated.gate.begin_scan(Pose(0.0, 0.0, 0.0), None)
    cloud = Cloud(np.ones((MIN_POINTS, 2)))
    assert gated.register(cloud, cloud, GUESS).target_from_source == GUESS @ Pose(1.0, 0.0, 0.0)


def test_a_jump_of_half_a_turn_is_far():
    gated = Gated(Answers(Pose(0.0, 0.0, math.pi)), OdometryGate())
    gated.gate.begin_scan(Pose(0.0, 0.0, 0.0), None)
    cloud = Cloud(np.ones((MIN_POINTS, 2)))
    assert gated.register(cloud, cloud, GUESS).target_from_source == GUESS
