"""Wheel odometry alone: what every other back end has to beat.

The adapter changes nothing but the frame: the first pose becomes the identity.
"""

from __future__ import annotations

from evalkit.errors import BadData
from evalkit.protocols import BackendSpec
from evalkit.types import Frame, Pose


class WheelOdometry:
    """Answers what the wheels say; never looks at a scan."""

    def __init__(self) -> None:
        self._odom_from_start: Pose | None = None

    def update(self, frame: Frame) -> Pose:
        """``start_from_base`` when the first beam was fired; BadData where the recording has no odometry for it."""
        if frame.odom_from_base is None:
            raise BadData(
                "wheel-odometry",
                f"scan at {frame.scan.stamp_ns} ns",
                "the recording has no wheel odometry here",
                "leave wheel-odometry out for this sequence",
            )
        if self._odom_from_start is None:
            self._odom_from_start = frame.odom_from_base
            return Pose()
        return self._odom_from_start.inverse() @ frame.odom_from_base


SPEC = BackendSpec(
    make=WheelOdometry,
    kind="odometry",
    summary="wheel odometry alone, no scan is looked at",
    citation="none: the recording's own odometry",
    licence="MIT",
    guess="none: it is the guess",
    role="bar",
)
