"""An ICP whose answer is kept only where it agrees with wheel odometry: wrong matches of bad scans are far from it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

WIDE = 0.5, math.radians(36.0)
"""A match farther than one of these (m, rad) from a guess by wheel odometry is not believed. Between two scans wheels
slip less, and clocks that do not agree turn less; a robot that was carried away is found by the loop closures."""

STRICT = 0.3, math.radians(20.0)
"""The same for dirty scans from a lidar and wheels whose clocks agree."""

CLEAR_M, CLEAR_SHARE = 0.04, 0.9
"""Unless it has converged to a smaller error with this share of the points paired."""

MIN_POINTS = 40
"""With the strict gate, a match of a scan with fewer points is not believed either."""


@dataclass
class OdometryGate:
    """A Registration; ``is_measured``: whether the guess comes from wheel odometry, set before each scan.

    A match that is not believed is the guess, without inliers.
    """

    icp: Registration
    strict: bool = False
    is_measured: bool = False

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        match = self.icp.register(target, source, guess)
        if not self.is_measured:
            return match
        gap, (most_m, most_rad) = guess.inverse() @ match.target_from_source, STRICT if self.strict else WIDE
        far = math.hypot(gap.x, gap.y) > most_m or abs(gap.theta) > most_rad
        clear = match.converged and match.error < CLEAR_M and match.inliers >= CLEAR_SHARE * len(source)
        few = self.strict and len(source) < MIN_POINTS
        return match if not few and (clear or not far) else replace(match, target_from_source=guess, inliers=0)
