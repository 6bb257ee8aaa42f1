"""An ICP that tries again where its answer fits poorly: with near pairs, and from headings around the guess.

Pairs far apart lead ICP to a wrong place. A guess by odometry is off by 20 deg and more where the robot turns quickly
and the clocks of lidar and wheels do not agree, which is farther than ICP finds back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

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

COARSE_POINTS, FINE_ITERATIONS = 200, 5
"""A scan of twice as many points or more is matched first with every n-th of them, then with all, in few iterations."""

TRIED_POINTS, TRIED_ITERATIONS = 100, 20
"""The same for the further tries, which are short: the best of them is matched to the end."""

TURNS_RAD = tuple(math.radians(turn) for turn in (0.0, -12.0, 12.0, -24.0, 24.0))
"""Headings of the further tries, from the guess."""

MAX_M, MAX_RAD = 0.5, math.radians(36.0)
"""A further try that ends farther than one of these from the guess does not count: it has left its place."""


@dataclass(frozen=True)
class CoarseToFine:
    """A Registration: ``coarse`` with a part of a large scan, then ``fine`` with all its points."""

    coarse: Registration
    fine: Registration

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        part = take_part(source, COARSE_POINTS)
        match = self.coarse.register(target, part, guess)
        return match if part is source else self.fine.register(target, source, match.target_from_source)


@dataclass
class SecondTry:
    """A Registration: ``wide``, and where that fits poorly the better of it and ``narrow``.

    ``narrow`` starts from the best of several headings by ``brief``, with a part of a large scan. Only the first poor
    answer of a scan is tried again, whichever stage it is of: ``begin_scan``.
    """

    wide: Registration
    narrow: Registration
    brief: Registration
    _usual_m: float = field(default=0.0, init=False)
    _tried: bool = field(default=False, init=False)

    def begin_scan(self, usual_m: float) -> None:
        """Begin a scan; ``usual_m``: usual error of matches, 0: unknown."""
        self._usual_m, self._tried = usual_m, False

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        first = self.wide.register(target, source, guess)
        poor_m = min(POOR_M, UNUSUAL * self._usual_m) if self._usual_m > 0.0 else POOR_M
        fits = not first.error > poor_m and first.inliers >= MIN_SHARE * len(source)
        if self._tried or fits or not len(target):
            return first
        self._tried = True
        second = self.narrow.register(target, source, self._best_start(target, take_part(source, TRIED_POINTS), guess))
        if not _is_close(guess, second.target_from_source):
            return first
        near = [_share_near(target, source, match.target_from_source) for match in (first, second)]
        return second if near[1] > near[0] else first

    def _best_start(self, target: Cloud, part: Cloud, guess: Pose) -> Pose:
        best, most = guess, 0.0
        for turn in TURNS_RAD:
            answer = self.brief.register(target, part, guess @ Pose(0.0, 0.0, turn)).target_from_source
            near = _share_near(target, part, answer)
            if near > most and _is_close(guess, answer):
                best, most = answer, near
        return best


def take_part(cloud: Cloud, enough: int) -> Cloud:
    """Return every n-th point, so that ``enough`` are left, and less than twice as many; all of a small cloud."""
    every = len(cloud) // enough
    return Cloud(cloud.points[::every], cloud.frame) if every > 1 else cloud


def _is_close(guess: Pose, answer: Pose) -> bool:
    gap = guess.inverse() @ answer
    return gap.x**2 + gap.y**2 <= MAX_M**2 and abs(gap.theta) <= MAX_RAD


def _share_near(target: Cloud, source: Cloud, target_from_source: Pose) -> float:
    from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

    moved = target_from_source.transform(source.points)
    distance, _ = cKDTree(target.points).query(moved, distance_upper_bound=NEAR_M)
    return float(np.isfinite(np.asarray(distance)).mean())
