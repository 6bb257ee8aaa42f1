"""Wheel odometry alone: the poses of the recording, relative to the first one."""

import numpy as np
import pytest

from evalkit.core.errors import DataMissing
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit_baselines.wheel_odometry import SPEC


def frame(stamp_ns, odom_from_base):
    scan = Scan(stamp_ns, np.array([1.0]), np.array([0.0]), 0.1, 10.0)
    return Frame(scan, odom_from_base=odom_from_base)


def test_poses_are_relative_to_the_first_one():
    wheels = SPEC.make()
    answers = [
        wheels.update(frame(k, pose)).pose
        for k, pose in enumerate([Pose(5.0, 1.0, np.pi / 2), Pose(5.0, 2.0, np.pi / 2), Pose(4.0, 2.0, np.pi)])
    ]
    assert answers[0] == Pose()
    assert np.allclose(answers[1].row, [1.0, 0.0, 0.0], atol=1e-12)
    assert np.allclose(answers[2].row, [1.0, 1.0, np.pi / 2], atol=1e-12)


def test_a_gap_is_bridged_with_zero_motion():
    wheels = SPEC.make()
    poses = [Pose(1.0, 0.0, 0.0), Pose(2.0, 0.0, 0.0), None, None, Pose(5.0, 0.0, 0.0)]
    assert [wheels.update(frame(k, pose)).pose.x for k, pose in enumerate(poses)] == [0.0, 1.0, 1.0, 1.0, 4.0]


def test_a_recording_without_odometry_raises_data_missing():
    with pytest.raises(DataMissing, match="no wheel odometry at its first scan"):
        SPEC.make().update(frame(0, None))
