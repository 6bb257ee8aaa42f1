"""Wheel odometry alone: the recording's own poses, seen from the first one."""

import numpy as np
import pytest

from evalkit.errors import BadData
from evalkit.types import Frame, Pose, Scan
from evalkit_baselines.wheel_odometry import SPEC


def frame(stamp_ns, odom_from_base):
    scan = Scan(stamp_ns, np.array([1.0]), np.array([0.0]), 0.1, 10.0)
    return Frame(scan, odom_from_base=odom_from_base)


def test_poses_are_seen_from_the_first_one():
    wheels = SPEC.make()
    answers = [
        wheels.update(frame(k, pose))
        for k, pose in enumerate([Pose(5.0, 1.0, np.pi / 2), Pose(5.0, 2.0, np.pi / 2), Pose(4.0, 2.0, np.pi)])
    ]
    assert answers[0] == Pose()
    assert np.allclose(answers[1].row, [1.0, 0.0, 0.0], atol=1e-12)
    assert np.allclose(answers[2].row, [1.0, 1.0, np.pi / 2], atol=1e-12)


@pytest.mark.parametrize("absent", [0, 2])
def test_a_recording_without_odometry_is_refused_by_time_and_with_a_way_out(absent):
    wheels = SPEC.make()
    for stamp_ns in range(absent):
        wheels.update(frame(stamp_ns, Pose()))
    with pytest.raises(BadData, match=f"scan at {absent} ns: the recording has no wheel odometry here; leave"):
        wheels.update(frame(absent, None))
