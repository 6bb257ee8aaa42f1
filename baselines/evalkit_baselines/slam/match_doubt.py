"""How far a step between two keyframes may be wrong because its matches fit poorly.

Where a scan fits the map worse than usual, the match or the map is wrong, and the truth may be anywhere between the
match and the pose that wheel odometry predicts. A step whose error is thought to be that of the drift alone keeps the
search windows of all later loops away from the true motion. A prediction at constant velocity says nothing about it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from evalkit.core.odometry_estimate import StageEstimate
from evalkit.core.pose import Pose
from evalkit_baselines.slam.second_try import MIN_SHARE

USUAL_SCANS = 50.0
"""Scans over which the usual error of matches is averaged."""

DOUBTED = 2.0
"""A match with more than this many times the usual error is doubted, with twice that wholly."""


class Doubt(NamedTuple):
    """Variance that a step has beyond that of the drift: of each coordinate and of the heading."""

    position_m2: float = 0.0
    heading_rad2: float = 0.0


class MatchDoubt:
    """Sums up the doubt of the scans since the last keyframe."""

    def __init__(self) -> None:
        self._usual_m = 0.0
        self._sum = Doubt()

    @property
    def usual_m(self) -> float:
        """Usual error of matches, a recent mean (m); 0 before the first one."""
        return self._usual_m

    def observe(self, predicted: Pose | None, matched: Pose, match: StageEstimate, points: int) -> None:
        """Add a scan of so many points, by its accepted match with the map and the pose by odometry, if any."""
        usual = self._usual_m if self._usual_m > 0.0 else match.residual_m
        over = match.residual_m / (DOUBTED * usual) - 1.0 if usual > 0.0 else 0.0
        share = 1.0 if match.inliers < MIN_SHARE * points else min(max(over, 0.0), 1.0)
        self._usual_m = usual + (min(match.residual_m, DOUBTED * usual) - usual) / USUAL_SCANS
        if predicted is None:
            return
        gap = predicted.inverse() @ matched
        self._sum = Doubt(
            self._sum.position_m2 + share**2 * math.hypot(gap.x, gap.y) ** 2,
            self._sum.heading_rad2 + share**2 * gap.theta**2,
        )

    def take(self) -> Doubt:
        """Return the doubt of the step that ends now, and begin the next one."""
        taken, self._sum = self._sum, Doubt()
        return taken
