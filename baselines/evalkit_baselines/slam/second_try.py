"""An ICP that tries again where its answer fits poorly: with near pairs, and from headings around the guess.

Pairs far apart lead ICP to a wrong place. A guess by odometry is off by 20 deg and more where the robot turns quickly
and the clocks of lidar and wheels do not agree, which is farther than ICP finds back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

POOR_M = 0.1
"""A mean distance above this is doubted. Good matches have 0.02 m, with range noise of 5 cm 0.04 m."""

UNUSUAL = 4.0
"""And one of more than so many times the usual one: with little noise a wrong match may have 0.06 m."""

MIN_SHARE = 0.8
"""A smaller share of points in pairs is doubted too: the pairs that are left may fit well in a wrong place."""

NEAR_M = 0.15
"""Of several answers, the one with most points within this distance of the target is taken."""

TURNS_RAD = tuple(math.radians(turn) for turn in (0.0, -12.0, 12.0, -24.0, 24.0))
"""Headings of the further tries, from the guess."""

MAX_M, MAX_RAD = 0.5, math.radians(36.0)
"""A further try that ends farther than one of these from the guess does not count: it has left its place."""


@dataclass
class SecondTry:
    """A Registration: ``wide``, and where that fits poorly the best of it and ``narrow`` from several headings.

    ``usual_m``: usual error of matches, set before each scan; 0: unknown.
    """

    wide: Registration
    narrow: Registration
    usual_m: float = 0.0

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        first = self.wide.register(target, source, guess)
        poor_m = min(POOR_M, UNUSUAL * self.usual_m) if self.usual_m > 0.0 else POOR_M
        if not first.error > poor_m and first.inliers >= MIN_SHARE * len(source):
            return first
        starts = [guess @ Pose(0.0, 0.0, turn) for turn in TURNS_RAD]
        tries = [self.narrow.register(target, source, start) for start in starts]
        near = [first, *(match for match in tries if _is_close(guess, match.target_from_source))]
        return max(near, key=lambda match: _share_near(target, source, match.target_from_source))


def _is_close(guess: Pose, answer: Pose) -> bool:
    gap = guess.inverse() @ answer
    return gap.x**2 + gap.y**2 <= MAX_M**2 and abs(gap.theta) <= MAX_RAD


def _share_near(target: Cloud, source: Cloud, target_from_source: Pose) -> float:
    from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

    moved = target_from_source.transform(source.points)
    distance, _ = cKDTree(target.points).query(moved, distance_upper_bound=NEAR_M)
    return float(np.isfinite(np.asarray(distance)).mean())
