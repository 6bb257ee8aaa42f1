"""How far a step between two keyframes may be wrong because its matches fit poorly or contradict the wheels.

Where a scan fits the map worse than usual, the match or the map is wrong, and the truth may be anywhere between the
match and the pose that wheel odometry predicts. The same holds where the two are farther apart than usual: the wheels
slip, or the match follows somebody who walks along a corridor. A step whose error is thought to be that of the drift
alone keeps the search windows of all later loops away from the true motion. A prediction at constant velocity says
nothing about it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from evalkit.core.odometry_estimate import StageEstimate
from evalkit.core.pose import Pose
from evalkit_baselines.slam.second_try import DOUBTED, MIN_SHARE

USUAL_SCANS = 50
"""Scans over which the usual error of matches, their points, and their gap to the prediction, are averaged."""

APART = 3.0
"""The same for its gap to the prediction, in times the usual gap."""

GAP_M, GAP_SHARE, GAP_RAD = 0.01, 0.05, 0.01
"""Odometry is thought to be no better than this and this share of its step, and in heading than this."""


class Doubt(NamedTuple):
    """Variance that a step has beyond that of the drift: of each coordinate and of the heading."""

    position_m2: float = 0.0
    heading_rad2: float = 0.0


class MatchDoubt:
    """Sums up the doubt of the scans since the last keyframe."""

    def __init__(self) -> None:
        self._usual_m = 0.0
        self._usual_points = 0.0
        self._usual_gap_m = 0.0
        self._usual_gap_rad = 0.0
        self._compared = 0
        self._sum = Doubt()

    @property
    def usual_m(self) -> float:
        """Usual error of matches, a recent mean (m); 0 before the first one."""
        return self._usual_m

    @property
    def usual_points(self) -> float:
        """Usual number of points of a scan whose match is accepted, a recent mean; 0 before the first one."""
        return self._usual_points

    @property
    def usual_gap(self) -> tuple[float, float] | None:
        """Usual gap of matches to odometry (m, rad), a recent mean; None before ``USUAL_SCANS`` scans with odometry."""
        return (self._usual_gap_m, self._usual_gap_rad) if self._compared >= USUAL_SCANS else None

    def observe(self, last: Pose, predicted: Pose | None, matched: Pose, match: StageEstimate, points: int) -> bool:
        """Add a scan of so many points, by its accepted match with the map and the pose by odometry, if any.

        ``last``: pose of the scan before. Returns whether the match fits about as usual.
        """
        usual = self._usual_m if self._usual_m > 0.0 else match.residual_m
        share = _misfit(match, points, usual)
        self._usual_points += (points - self._usual_points) / (USUAL_SCANS if self._usual_points > 0.0 else 1)
        self._usual_m = usual + (min(match.residual_m, DOUBTED * usual) - usual) / USUAL_SCANS
        if predicted is None:
            return share == 0.0
        gap = predicted.inverse() @ matched
        gap_m = math.hypot(gap.x, gap.y)
        usual_m = expect_gap(self._usual_gap_m, last.inverse() @ predicted)
        usual_rad = max(self._usual_gap_rad, GAP_RAD)
        self._usual_gap_m += (min(gap_m, 2.0 * usual_m) - self._usual_gap_m) / USUAL_SCANS
        self._usual_gap_rad += (min(abs(gap.theta), 2.0 * usual_rad) - self._usual_gap_rad) / USUAL_SCANS
        self._compared += 1
        apart = max(share, _share(gap_m, APART * usual_m))
        self._sum = Doubt(self._sum.position_m2 + apart**2 * gap_m**2, self._sum.heading_rad2 + share**2 * gap.theta**2)
        return share == 0.0

    def take(self) -> Doubt:
        """Return the doubt of the step that ends now, and begin the next one."""
        taken, self._sum = self._sum, Doubt()
        return taken


def expect_gap(usual_m: float, step: Pose) -> float:
    """Return the usual gap (m) to the odometry, which is thought to be no better than its step allows."""
    return max(usual_m, GAP_M + GAP_SHARE * math.hypot(step.x, step.y))


def _misfit(match: StageEstimate, points: int, usual_m: float) -> float:
    """Return how much a match is doubted, 0 to 1, because it fits poorly."""
    return 1.0 if match.inliers < MIN_SHARE * points else _share(match.residual_m, DOUBTED * usual_m)


def _share(value: float, limit: float) -> float:
    """Return 0 up to the limit, 1 from twice the limit on, and between them in proportion."""
    return min(max(value / limit - 1.0, 0.0), 1.0) if limit > 0.0 else 0.0
