import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit_baselines.slam.odometry_scale import MEMORY_M, PRIOR_M, OdometryScale


def make_frame(odom_from_base, start_from_end=None):
    return Frame(Scan(0, np.full(4, np.inf), np.arange(4.0), 0.0, 10.0), Pose(), odom_from_base, start_from_end)


def test_the_scale_is_the_matched_length_over_the_odometry_length_with_a_prior_of_one():
    scale = OdometryScale()
    assert scale.scale == 1.0
    for _ in range(20):
        scale.observe(Pose(1.02, 0.3, 0.0), Pose(1.0, 0.0, 0.1))  # what is across does not count
    assert scale.scale == pytest.approx((20 * 1.02 + PRIOR_M) / (20 + PRIOR_M))


def test_a_long_drive_forgets_the_prior():
    scale = OdometryScale()
    for _ in range(1000):
        scale.observe(Pose(0.97, 0.0, 0.0), Pose(1.0, 0.0, 0.0))
    assert scale.scale == pytest.approx(0.97, abs=1e-3)
    for _ in range(int(3 * MEMORY_M)):
        scale.observe(Pose(1.01, 0.0, 0.0), Pose(1.0, 0.0, 0.0))
    assert scale.scale == pytest.approx(1.01, abs=3e-3)


def test_slip_wrong_matches_and_a_robot_at_rest_do_not_count():
    scale = OdometryScale()
    for matched, odometry in ((0.5, 1.0), (1.2, 1.0), (0.0, 0.0), (0.05, 0.06)):
        scale.observe(Pose(matched, 0.0, 0.0), Pose(odometry, 0.0, 0.0))
    assert scale.scale == 1.0


def test_steps_and_the_motion_within_a_scan_are_scaled_and_the_turn_is_not():
    scale = OdometryScale()
    for _ in range(500):
        scale.observe(Pose(1.05, 0.0, 0.0), Pose(1.0, 0.0, 0.0))
    first = scale.correct(make_frame(Pose(5.0, 5.0, np.pi / 2)))
    assert first.odom_from_base == Pose(5.0, 5.0, np.pi / 2)
    second = scale.correct(make_frame(Pose(5.0, 7.0, np.pi / 2 + 0.3), Pose(0.1, 0.0, 0.02)))
    assert second.odom_from_base.row == pytest.approx([5.0, 7.1, np.pi / 2 + 0.3], abs=1e-3)
    assert second.start_from_end.row == pytest.approx([0.105, 0.0, 0.02], abs=1e-4)


def test_a_frame_without_odometry_is_not_changed():
    frame = make_frame(None)
    assert OdometryScale().correct(frame) is frame
