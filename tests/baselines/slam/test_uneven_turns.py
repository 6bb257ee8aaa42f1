"""Scans within which the robot begins or ends to turn, and whether wheel odometry is right over them."""

import math

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit_baselines.slam.uneven_turns import UnevenTurns


def turned(degrees):
    return Pose(0.0, 0.0, math.radians(degrees))


def make_frame(within_deg, increment_ms=10):
    scan = Scan(0, np.ones(5), np.arange(5.0), 0.0, 10.0, increment_ms * 1_000_000)
    return Frame(scan, Pose(), Pose(), None if within_deg is None else turned(within_deg))


@pytest.mark.parametrize(
    ("turned_deg", "within_deg", "increment_ms", "expected_deg"),
    [
        (8.0, 3.1, 10, 0.0),  # 40 ms of 80 ms: at 100 deg/s the sweep turns by 4 deg
        (8.0, 5.1, 10, 1.1),
        (8.0, 2.0, 10, 2.0),
        (-8.0, -6.0, 10, 2.0),
        (8.0, None, 10, 0.0),
        (8.0, 6.0, 0, 0.0),
        (None, 6.0, 10, 0.0),
    ],
)
def test_a_turn_is_uneven_where_it_is_a_degree_off_that_at_the_rate_since_the_last_scan(
    turned_deg, within_deg, increment_ms, expected_deg
):
    step = None if turned_deg is None else turned(turned_deg)
    found = UnevenTurns().measure(make_frame(within_deg, increment_ms), step, 80_000_000)
    assert math.degrees(found) == pytest.approx(expected_deg)


def pass_a_turn(turns, odometry_deg, matched_deg):
    """A scan at rest, an uneven one of 8 deg, and the scan after it; returns whether that one may be uneven."""
    turns.note(0.0, Pose(), Pose(), Pose())
    by = turns.measure(make_frame(8.0), Pose(), 80_000_000)
    turns.note(by, turned(3.0), Pose(), turned(9.0))  # where the bent one matches does not matter
    following = turns.measure(make_frame(8.0), Pose(), 80_000_000)
    turns.note(following, turned(odometry_deg), turned(9.0), None if matched_deg is None else turned(matched_deg))
    return bool(following)


def test_odometry_is_right_after_two_turns_within_a_quarter_of_the_unevenness_and_none_beyond_it():
    turns = UnevenTurns()
    for matched_deg, right in ((20.1, False), (17.9, False), (21.9, False), (None, False), (20.0, True), (22.1, False)):
        assert not pass_a_turn(turns, 20.0, matched_deg)
        assert turns.is_odometry_right is right
