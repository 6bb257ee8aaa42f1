"""Wheel odometry alone: what every other back end has to beat.

The adapter changes nothing but the frame, the first pose becomes the identity, and bridges gaps in the odometry by
standing still until the wheels are heard again.
"""

from __future__ import annotations

from evalkit.core.errors import DataMissing
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.plugins.specs import OdometrySpec


class WheelOdometry:
    """Answers what the wheels say; never looks at a scan."""

    def __init__(self) -> None:
        self._odom_from_start: Pose | None = None
        self._start_from_base = Pose()

    def update(self, frame: Frame) -> OdometryEstimate:
        """``start_from_base`` when the first beam was fired; the last answer again in a gap of the odometry.

        DataMissing where the recording begins without odometry.
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
                "there is no bar to beat here",
            )
        return OdometryEstimate(self._start_from_base)


SPEC = OdometrySpec(
    make=WheelOdometry,
    summary="wheel odometry alone, no scan is looked at",
    citation="none: the recording's own odometry",
    licence="MIT",
    guess="none: it is the guess",
    role="baseline",
)
