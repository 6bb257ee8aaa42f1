"""Each mistake in reading a frame, applied to a frame of four beams, gives what its name says."""

import math

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.mistaken_frames import mistaken_frames, mistaken_trajectories, skipped_scans
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan

NAN, INF = math.nan, math.inf
MOUNTED, WITHIN = Pose(0.2, 0.1, math.pi / 2.0), Pose(0.03, 0.0, 0.01)
SCAN = Scan(7, [1.237, 4.321, INF, NAN], [-0.3, 0.0, 0.2, 0.4], 0.1, 10.1, 1000)
FRAME = Frame(SCAN, base_from_sensor=MOUNTED, odom_from_base=Pose(5.0, 6.0, 0.7), start_from_end=WITHIN)
CHANGES = dict(mistaken_frames())


@pytest.mark.parametrize(
    ("what", "angles"),
    [
        ("the angles of the beams are in the reverse order", [0.4, 0.2, 0.0, -0.3]),
        ("the angles of the beams are clockwise", [0.3, 0.0, -0.2, -0.4]),
        ("the angles of the beams are in degrees", [-54.0 / math.pi, 0.0, 36.0 / math.pi, 72.0 / math.pi]),
        ("the angles of the beams are not read: they are even from 0 rad", [0.0, 0.5, 1.0, 1.5]),
        ("the angles of the beams are not read: they are even from -3.14 rad", [-1.0, -0.5, 0.0, 0.5]),
    ],
)
def test_angles_are_read_as_the_mistake_says(what, angles):
    unit = math.pi if "not read" in what else 1.0
    scan = CHANGES[what](FRAME).scan
    assert scan.angles.tolist() == pytest.approx([unit * angle for angle in angles], abs=1e-12)
    np.testing.assert_array_equal(scan.ranges, SCAN.ranges)


@pytest.mark.parametrize(
    ("what", "ranges"),
    [
        ("no return is a point at 0.1 of the way from the smallest range to the largest", [1.237, 4.321, 1.1, NAN]),
        ("an invalid range is a point at 0.99 of the way from the smallest range to the largest",
         [1.237, 4.321, INF, 10.0]),
        ("ranges beyond 4 m are not used", [1.237, NAN, NAN, NAN]),
        ("ranges beyond 5 m are not used", [1.237, 4.321, NAN, NAN]),
        ("ranges are rounded to 0.01 m", [1.24, 4.32, INF, NAN]),
        ("ranges are cut to 0.05 m", [1.2, 4.3, INF, NAN]),
        ("only every second beam is used", [1.237, NAN, INF, NAN]),
    ],
)  # fmt: skip
def test_ranges_are_read_as_the_mistake_says(what, ranges):
    scan = CHANGES[what](FRAME).scan
    np.testing.assert_allclose(scan.ranges, ranges, atol=1e-12)
    np.testing.assert_array_equal(scan.angles, SCAN.angles)


def test_beams_after_the_first_ones_are_invalid():
    many = Scan(7, np.ones(100), np.linspace(-1.0, 1.0, 100), 0.1, 10.1, 1000)
    read = CHANGES["only the first 64 beams are used"](Frame(many))
    assert np.isfinite(read.scan.ranges).tolist() == [True] * 64 + [False] * 36


@pytest.mark.parametrize(
    ("what", "expected"),
    [
        ("the wheel odometry is not used", (None, MOUNTED, None)),
        ("the motion within a scan is not used: it is not deskewed", (FRAME.odom_from_base, MOUNTED, None)),
        ("the motion within a scan is inverted", (FRAME.odom_from_base, MOUNTED, WITHIN.inverse())),
        ("the turn within a scan has the wrong sign", (FRAME.odom_from_base, MOUNTED, Pose(0.03, 0.0, -0.01))),
        ("the mounting of the lidar is not used", (FRAME.odom_from_base, Pose(), WITHIN)),
        ("the mounting of the lidar is inverted", (FRAME.odom_from_base, Pose(-0.1, 0.2, -math.pi / 2.0), WITHIN)),
    ],
)
def test_motions_and_mounting_are_read_as_the_mistake_says(what, expected):
    read = CHANGES[what](FRAME)
    for found, wanted in zip((read.odom_from_base, read.base_from_sensor, read.start_from_end), expected, strict=True):
        assert found == wanted if wanted is None else found.row == pytest.approx(wanted.row, abs=1e-12)


def test_answers_are_late_or_those_before_as_the_mistake_says():
    rows = np.arange(12.0).reshape(4, 3)
    ((what, late),) = mistaken_trajectories(rows)
    assert (what, late.tolist()) == ("answers are one scan late", rows[[0, 0, 1, 2]].tolist())
    last = dict(skipped_scans(7))
    assert last["one scan of 3 is skipped: it has the answer before"].tolist() == [0, 1, 1, 3, 4, 4, 6]
