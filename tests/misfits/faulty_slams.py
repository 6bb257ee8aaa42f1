"""SLAM back ends with one fault each, around one that is sound: wheels whose 80th scan corrects all earlier poses."""

import numpy as np

from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.trajectory import Trajectory

AT, CORRECTION = 80, np.array([-0.06, 0.03, 0.0])


class SoundSlam:
    """Spreads a known correction linearly over the path at scan ``AT``."""

    def __init__(self):
        self.stamps, self.rows, self.closures, self.first, self.correction = [], [], [], None, Pose()

    def update(self, frame):
        self.first = self.first or frame.odom_from_base
        pose = self.correction @ self.first.inverse() @ frame.odom_from_base
        self.stamps.append(frame.scan.stamp_ns)
        self.rows.append(pose.row)
        if len(self.rows) == AT:
            self.correct()
        return OdometryEstimate(Pose.of(self.rows[-1]), corrected=self.reports())

    def correct(self):
        share = np.linspace(0.0, 1.0, AT)
        self.rows = list(se2.compose(se2.fraction(CORRECTION, share), np.array(self.rows)))
        self.correction = Pose.of(CORRECTION)
        motion = Pose.of(self.rows[-1])
        self.closures = [
            LoopClosure(self.stamps[-2], self.stamps[0], motion, False, "far"),
            LoopClosure(self.stamps[-1], self.stamps[0], motion, True, "near"),
        ]

    def reports(self):
        return len(self.rows) == AT

    def trajectory(self):
        return Trajectory(np.array(self.stamps), np.array(self.rows), "start", "base")

    def loop_closures(self):
        return tuple(self.closures)


class LeavesOutFrames(SoundSlam):
    """Has a pose for every second frame: keyframes only."""

    def trajectory(self):
        return Trajectory(np.array(self.stamps[::2]), np.array(self.rows[::2]))


class MovesTheStart(SoundSlam):
    """Anchors the last pose instead of the first one."""

    def correct(self):
        super().correct()
        self.rows = list(se2.compose(se2.inverse(CORRECTION), np.array(self.rows)))


class Tears(SoundSlam):
    """Moves the second half of the path alone."""

    def correct(self):
        super().correct()
        half = np.array(self.rows[AT // 2 :])
        self.rows[AT // 2 :] = list(half + np.array([0.0, 0.15, 0.0]))


class InTheWrongFrame(SoundSlam):
    """Returns base_from_start."""

    def trajectory(self):
        return Trajectory(np.array(self.stamps), se2.inverse(np.array(self.rows)))


class RandomCorrection(SoundSlam):
    """Spreads another correction for every object."""

    made = 0

    def correct(self):
        super().correct()
        RandomCorrection.made += 1
        self.rows[5] = self.rows[5] + [1e-9 * RandomCorrection.made, 0.0, 0.0]


class RandomClosures(SoundSlam):
    """Reports one more candidate for every object."""

    made = 0

    def correct(self):
        super().correct()
        RandomClosures.made += 1
        self.closures = self.closures[:1] * RandomClosures.made + self.closures[1:]


class CorrectsWhenAsked(SoundSlam):
    """Optimises in ``trajectory``, and continues from there."""

    def trajectory(self):
        self.correction = Pose(1e-6) @ self.correction
        return super().trajectory()


class OutOfOrder(SoundSlam):
    """Reports the newest candidate first."""

    def loop_closures(self):
        return tuple(reversed(self.closures))


class OfUnknownFrames(SoundSlam):
    """Reports a closure at the end of the scan instead of its first beam."""

    def loop_closures(self):
        return tuple(
            LoopClosure(one.stamp_ns + 99, one.other_stamp_ns, one.other_from_base, True, one.reason)
            for one in self.closures
        )


class Silent(SoundSlam):
    """Reports no correction although it corrects."""

    def reports(self):
        return False


class Boasts(SoundSlam):
    """Reports a correction at every scan from the tenth on."""

    def reports(self):
        return len(self.rows) >= 10


class NotReporting(SoundSlam):
    """Does not report corrections, which is allowed."""

    def reports(self):
        return None
