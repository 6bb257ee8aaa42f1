"""Wheel odometry alone: the baseline that every other back end must beat.

The adapter only changes the frame, so that the first pose is the identity, and repeats the last pose in gaps of the
odometry.
"""

from __future__ import annotations

from evalkit.core.errors import DataMissing
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.plugins.specs import OdometrySpec


class WheelOdometry:
    """Returns the recorded wheel odometry and ignores the scans."""

    def __init__(self) -> None:
        self._odom_from_start: Pose | None = None
        self._start_from_base = Pose()

    def update(self, frame: Frame) -> OdometryEstimate:
        """Return the pose of the wheels at the first beam, the previous pose in a gap of the odometry.

        Raises DataMissing where the recording begins without odometry.
        """
        if frame.odom_from_base is not None:
            if self._odom_from_start is None:
                self._odom_from_start = frame.odom_from_base
            else:
                self._start_from_base = self._odom_from_start.inverse() @ frame.odom_from_base
        elif self._odom_from_start is None:
            raise DataMissing(
                "wheel-odometry",
                "the recording has no wheel odometry at its first scan",
                "begin at a scan that has it (start = N), or leave this method out of the comparison",
            )
        return OdometryEstimate(self._start_from_base)


SPEC = OdometrySpec(
    make=WheelOdometry,
    summary="wheel odometry alone, without the scans",
    citation="none: the recording's own odometry",
    licence="MIT",
    guess="none: it is the guess",
    role="baseline",
    default=True,
)
