"""Calibrate the scale of the wheel odometry while driving, where the walls fix the position along the path.

Along a bare corridor only the odometry knows the distance, and a worn wheel is off by a percent: 0.3 m in 30 m.
"""

from __future__ import annotations

import math
from dataclasses import replace

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame

MEMORY_M = 50.0
"""Path over which the scale is averaged."""

PRIOR_M = 1.0
"""Path at scale 1 that is assumed to have been driven before."""

MAX_ERROR = 0.1
"""A motion whose length differs by a larger share is slip or a wrong match: it does not count."""

MIN_STEP_M = 0.1
"""Motions shorter than this do not count."""


class OdometryScale:
    """Multiplies the lengths of odometry motions by matched length over odometry length."""

    def __init__(self) -> None:
        self._matched_m = self._odometry_m = PRIOR_M
        self._last: Pose | None = None
        self._corrected = Pose()

    @property
    def scale(self) -> float:
        """Matched length over odometry length."""
        return self._matched_m / self._odometry_m

    def correct(self, frame: Frame) -> Frame:
        """Return the frame with scaled odometry: each motion since the last frame is scaled once, as known now."""
        if frame.odom_from_base is None:
            self._last = None
            return frame
        if self._last is None:
            self._corrected = frame.odom_from_base
        else:
            self._corrected = self._corrected @ _scaled(self._last.inverse() @ frame.odom_from_base, self.scale)
        self._last = frame.odom_from_base
        within = None if frame.start_from_end is None else _scaled(frame.start_from_end, self.scale)
        return replace(frame, odom_from_base=self._corrected, start_from_end=within)

    def observe(self, matched: Pose, odometry: Pose) -> None:
        """Add the same motion as matched and as the raw odometry has it."""
        driven = math.hypot(odometry.x, odometry.y)
        if driven < MIN_STEP_M:
            return
        along = (matched.x * odometry.x + matched.y * odometry.y) / driven
        if abs(along - driven) > MAX_ERROR * driven:
            return
        self._matched_m, self._odometry_m = self._matched_m + along, self._odometry_m + driven
        if self._odometry_m > MEMORY_M:
            share = MEMORY_M / self._odometry_m
            self._matched_m, self._odometry_m = share * self._matched_m, MEMORY_M


def _scaled(motion: Pose, scale: float) -> Pose:
    return Pose(scale * motion.x, scale * motion.y, motion.theta)
