"""An ICP whose answer is kept only where it agrees with wheel odometry: wrong matches of bad scans are far from it.

How far is too far depends on the wheels: on some robots they agree with the scans to a centimetre, on others their
clocks do not agree. A match is not accepted where it is many times farther from the odometry than matches usually are.

A wall that comes into sight, and is not on the map yet, pulls a match away by less. Where good odometry and the match
with the scan before agree, a match with the map that fits poorly must not leave their pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration
from evalkit_baselines.slam.match_doubt import APART, expect_gap
from evalkit_baselines.slam.second_try import DOUBTED, MIN_SHARE, UNUSUAL

UNLIKELY = 20.0
"""Times the usual gap between match and odometry (m, rad): a match that is farther from its guess is not accepted."""

NARROW, STEP_SHARE = (0.3, math.radians(20.0)), 0.25
"""Nearer than this (m, rad), and this share of the step, it is accepted; with good odometry this is the limit."""

WIDE = 0.5, math.radians(36.0)
"""A match farther than one of these is not accepted in any case, nor before it is known what is usual. Between two
scans wheels slip less, and clocks that do not agree turn less; the loop closures find a robot that was carried away."""

CLEAR_M, CLEAR_SHARE = 0.04, 0.9
"""Unless it has converged to a smaller error with this share of the points paired."""

POOR_SHARE = 0.5
"""Both limits are multiplied by this where a match has ``UNUSUAL`` times the usual error and pairs for less than
``MIN_SHARE`` of the points."""

MIN_POINTS, TIMES_FEWER = 40, 3.0
"""Where the odometry is good enough for a limit below ``WIDE``, a match of a scan with fewer points is not accepted; of
a lidar with few beams, of one with so many times fewer than usual."""


@dataclass
class OdometryGate:
    """Judges the matches of one scan after the other."""

    _is_measured: bool = False
    _limit: tuple[float, float] = WIDE
    _usual_m: float = math.inf
    _near_m: float = math.inf
    _fewest: float = MIN_POINTS
    is_sure: bool = False
    """The last match of this scan was accepted, agrees with good odometry, and is not doubted."""

    def begin_scan(
        self,
        step: Pose | None,
        usual_gap: tuple[float, float] | None,
        usual_m: float = 0.0,
        usual_points: float = math.inf,
    ) -> None:
        """Give the motion since the last scan by wheel odometry, if measured, and what is usual.

        ``usual_gap``: of matches to the odometry (m, rad), None: unknown; ``usual_m``: error of matches, 0: unknown;
        ``usual_points``: of a scan; infinite: many.
        """
        self._is_measured = step is not None
        self._fewest = min(MIN_POINTS, usual_points / TIMES_FEWER)
        self._usual_m = usual_m if usual_m > 0.0 else math.inf
        self._limit, self.is_sure = WIDE, False
        if step is not None and usual_gap is not None:
            moved = math.hypot(step.x, step.y), abs(step.theta)
            metres, turn = (
                min(max(UNLIKELY * usual, narrow + STEP_SHARE * far), wide)
                for usual, narrow, far, wide in zip(usual_gap, NARROW, moved, WIDE, strict=True)
            )
            self._limit, self._near_m = (metres, turn), APART * expect_gap(usual_gap[0], step)

    @property
    def is_good(self) -> bool:
        """Whether the odometry has been so good that no match far from it is accepted."""
        return self._is_measured and self._limit[0] < WIDE[0]

    def judge(self, match: Match, points: int, guess: Pose) -> Match:
        """Return a match of a scan of so many points; one that is not accepted becomes the guess, without inliers."""
        if not self._is_measured:
            return match
        gap, (most_m, most_rad) = guess.inverse() @ match.target_from_source, self._limit
        gap_m, few_pairs = math.hypot(gap.x, gap.y), match.inliers < MIN_SHARE * points
        share = POOR_SHARE if few_pairs and match.error > UNUSUAL * self._usual_m else 1.0
        far = gap_m > share * most_m or abs(gap.theta) > share * most_rad
        doubted = few_pairs or match.error > DOUBTED * self._usual_m
        apart = gap_m > self._near_m
        clear = match.converged and match.error < CLEAR_M and match.inliers >= CLEAR_SHARE * points
        few = self.is_good and points < self._fewest
        accepted = not few and (clear or not (far or (self.is_sure and doubted and apart)))
        self.is_sure = self.is_good and accepted and not doubted and not apart
        return match if accepted else replace(match, target_from_source=guess, inliers=0)


@dataclass(frozen=True)
class Gated:
    """A Registration whose matches the gate judges."""

    icp: Registration
    gate: OdometryGate

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        return self.gate.judge(self.icp.register(target, source, guess), len(source), guess)
