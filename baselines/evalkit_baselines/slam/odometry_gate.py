"""An ICP whose answer is kept only where it agrees with the wheels: dirty scans match wrongly far from them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

GATE_M, GATE_RAD = 0.3, math.radians(20.0)
"""A match farther than one of these from a guess by wheel odometry is not believed. Wheels slip less between two scans;
a robot that was carried away is found by the loop closures."""

CLEAR_M, CLEAR_SHARE = 0.04, 0.9
"""Unless it has converged to a smaller error with this share of the points paired."""

MIN_POINTS = 40
"""A match of a scan with fewer points is not believed either."""


@dataclass
class OdometryGate:
    """A Registration; ``is_measured``: whether the guess comes from wheel odometry, set before each scan.

    A match that is not believed is the guess, without inliers.
    """

    icp: Registration
    is_measured: bool = False

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        match = self.icp.register(target, source, guess)
        if not self.is_measured:
            return match
        gap = guess.inverse() @ match.target_from_source
        far = math.hypot(gap.x, gap.y) > GATE_M or abs(gap.theta) > GATE_RAD
        clear = match.converged and match.error < CLEAR_M and match.inliers >= CLEAR_SHARE * len(source)
        believed = len(source) >= MIN_POINTS and (clear or not far)
        return match if believed else replace(match, target_from_source=guess, inliers=0)
