"""Running an odometry over frames: order, poses, and scans without an answer."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.errors import BadData
from evalkit.core.odometry_estimate import OdometryEstimate, StageEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.timing import Cost
from evalkit.odometry.run_odometry import answer_frame, check_estimate, estimate_poses, run_odometry
from evalkit.plugins.protocols import NoAnswer

FRAMES = [Frame(Scan(stamp, np.array([1.0]), np.array([0.0]), 0.1, 9.0)) for stamp in (10, 20, 30)]


class ScriptedOdometry:
    """Odometry that returns or raises the items of a list in order."""

    def __init__(self, *answers):
        self.answers = list(answers)

    def update(self, frame):
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


class UncheckedPose(Pose):
    def __post_init__(self):
        pass


def test_every_frame_gives_a_step_with_its_estimate_and_the_time_of_the_call():
    estimates = [OdometryEstimate(Pose(x), cost=Cost(device_ns=5)) for x in (0.0, 1.0, 2.0)]
    steps = list(run_odometry(ScriptedOdometry(*estimates), FRAMES))
    assert [step.estimate for step in steps] == estimates
    assert [step.frame for step in steps] == FRAMES
    assert all(step.timing.wall_ns > 0 and step.timing.device_ns == 5 for step in steps)


def test_a_scan_without_an_answer_is_a_step_with_the_reason():
    odometry = ScriptedOdometry(OdometryEstimate(Pose()), NoAnswer("too dark"), OdometryEstimate(Pose(1.0)))
    steps = list(run_odometry(odometry, FRAMES))
    assert [step.estimate is None for step in steps] == [False, True, False]
    assert [step.reason for step in steps] == ["", "too dark", ""]


def test_poses_are_nan_for_unanswered_scans():
    odometry = ScriptedOdometry(OdometryEstimate(Pose()), NoAnswer("too dark"), OdometryEstimate(Pose(1.0)))
    np.testing.assert_array_equal(estimate_poses(odometry, FRAMES), [[0.0] * 3, [np.nan] * 3, [1.0, 0.0, 0.0]])
    assert estimate_poses(ScriptedOdometry(), []).shape == (0, 3)


def test_one_frame_gives_what_update_returns_or_the_reason_for_no_answer():
    reason = NoAnswer("too dark")
    odometry = ScriptedOdometry("not an estimate", reason, KeyError("lost"))
    assert [answer_frame(odometry, frame) for frame in FRAMES[:2]] == ["not an estimate", reason]
    with pytest.raises(KeyError, match="lost"):
        answer_frame(odometry, FRAMES[2])


def test_stamps_that_do_not_increase_are_bad_data():
    frames = [*FRAMES, replace(FRAMES[0], scan=replace(FRAMES[0].scan, stamp_ns=30))]
    odometry = ScriptedOdometry(*[OdometryEstimate(Pose())] * 4)
    with pytest.raises(BadData, match="log: scan 4: stamp 30 ns is not later than the one before, 30 ns"):
        list(run_odometry(odometry, frames, "log"))
    assert len(odometry.answers) == 1  # the odometry does not receive the frame


def test_other_exceptions_propagate():
    with pytest.raises(RuntimeError, match="lost the plot"):
        list(run_odometry(ScriptedOdometry(RuntimeError("lost the plot")), FRAMES))


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (Pose(), TypeError, "returned a Pose, expected an evalkit.OdometryEstimate"),
        (None, TypeError, "returned a NoneType"),
        (OdometryEstimate(np.eye(3)), TypeError, "returned a pose of type ndarray, expected an evalkit.Pose"),
        (
            OdometryEstimate(Pose(), {"s2s": {}}),
            TypeError,
            "stages with 's2s': a dict, expected an evalkit.StageEstimate",
        ),
        (OdometryEstimate(Pose(), {"icp": StageEstimate(True, True, 1, 0.0, 9)}), TypeError, "'icp': a StageEstimate"),
        (OdometryEstimate(UncheckedPose(math.nan)), ValueError, r"not finite: \(nan, 0.0, 0.0\)"),
        (OdometryEstimate(Pose(0.0, -1e308)), ValueError, r"farther away than 10,000,000 m: \(0.0, -1e\+308\)"),
    ],
)
def test_a_result_of_another_type_raises(answer, error, message):
    with pytest.raises(error, match=message):
        check_estimate(answer)
