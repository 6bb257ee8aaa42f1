"""An ICP that tries again where its answer fits poorly: with near pairs, and from headings around the guess.

Pairs far apart lead ICP to a wrong place. A guess by odometry is off by 20 deg and more where the robot turns quickly
and the clocks of lidar and wheels do not agree, which is farther than ICP finds back.

Without odometry, something near that covers a part of a scan leads ICP away from a prediction that may be right. Where
the match with the scan before fits poorly, that with the map begins from the prediction too. A scan drawn at a wrong
heading holds the next ones there, at two or three times the usual error: a doubted match with the map is tried again.
Where a search finds the scan clearly (``wide_search``), that is the try; the headings are tried where it does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration
from evalkit_baselines.slam.wide_search import WideSearch

POOR_M = 0.1
"""A mean distance above this is doubted. Good matches have 0.02 m, with range noise of 5 cm 0.04 m."""

UNUSUAL = 4.0
"""And one of more than so many times the usual one: with little noise a wrong match may have 0.06 m."""

DOUBTED = 2.0
"""A match with more than this many times the usual error is doubted, with twice that wholly."""

MIN_SHARE = 0.8
"""A smaller share of points in pairs is doubted too: the pairs that are left may fit well in a wrong place."""

NEAR_M = 0.15
"""Of several answers, the one with most points within this distance of the target is taken."""

CLOSE_M = 0.1
"""On the map without odometry, the one whose points lie most closely on it: only those within this distance count, each
in proportion to how much nearer it is. A wrong pose has many points near the map and few on it."""

FINE_CORRESPONDENCE_M = 0.3
"""Of near pairs, points are at most so far apart."""

COARSE_POINTS, FINE_ITERATIONS = 200, 5
"""A scan of twice as many points or more is matched first with every n-th of them, and with the map then with all, in
few iterations and with near pairs: a point beyond the end of the map would be paired with that end, and pull the scan
back. Where odometry is good, every scan is matched with the map in this way first."""

DIRECT_EPSILON_M = 1e-4
"""Of the stop rule there."""

TRIED_POINTS = 100
"""The same for the further tries: the best of them is matched to the end."""

MIN_PAIRS = 10
"""A part with fewer pairs than the front end asks of a scan is not counted as all points."""

PART_ITERATIONS = 20
"""Largest number of iterations with a part of a scan."""

TURNS_RAD = tuple(math.radians(turn) for turn in (0.0, -12.0, 12.0, -24.0, 24.0))
"""Headings of the further tries, from the guess."""

MAX_M, MAX_RAD = 0.5, math.radians(36.0)
"""A further try that ends farther than one of these from the guess does not count: it has left its place."""


@dataclass(frozen=True)
class Coarse:
    """A Registration: ``whole``, or ``coarse`` with a part of a large scan, whose inliers count for all points."""

    whole: Registration
    coarse: Registration

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        if not is_large(source):
            return self.whole.register(target, source, guess)
        part = take_part(source, COARSE_POINTS)
        match = self.coarse.register(target, part, guess)
        if match.inliers < MIN_PAIRS:
            return match
        return replace(match, inliers=match.inliers * len(source) // len(part))


@dataclass(frozen=True)
class CoarseToFine:
    """A Registration: ``coarse``, then, of a large scan, ``fine`` with all its points."""

    coarse: Registration
    fine: Registration

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        match = self.coarse.register(target, source, guess)
        return self.fine.register(target, source, match.target_from_source) if is_large(source) else match


@dataclass
class SecondTry:
    """A Registration: ``wide``, and where that fits poorly the better of it and ``narrow``.

    ``narrow`` starts from the best of several headings by ``brief``, with a part of a large scan. Only the first poor
    answer of a scan is tried again, whichever stage it is of: ``begin_scan``. Without odometry both stages of a scan
    may be: the second one, with the map, already where its answer is doubted. ``scan_to_scan``: what the first stage
    has instead of ``wide`` and ``narrow``, since its answer is only where the second one begins. ``search``: for a scan
    without odometry on the map.
    """

    wide: Registration
    narrow: Registration
    brief: Registration
    scan_to_scan: tuple[Registration, Registration] | None = None
    search: WideSearch | None = None
    _usual_m: float = field(default=0.0, init=False)
    _tried: bool = field(default=False, init=False)
    _predicted: Pose | None = field(default=None, init=False)
    _stage: int = field(default=0, init=False)

    def begin_scan(self, usual_m: float, predicted: Pose | None = None) -> None:
        """Begin a scan; ``usual_m``: usual error of matches, 0: unknown.

        ``predicted``: the pose in the map at constant velocity; None: with odometry.
        """
        self._usual_m, self._predicted = usual_m, predicted
        self._tried, self._stage = False, 0

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        if self._predicted is not None:  # the guess may be off by more than a wall is thick
            source = replace(source, origin=None)
        wide, narrow = (self._stage == 0 and self.scan_to_scan) or (self.wide, self.narrow)
        first = wide.register(target, source, guess)
        self._stage += 1
        predicted = self._predicted if self._stage > 1 else None
        poor_m = min(POOR_M, UNUSUAL * self._usual_m) if self._usual_m > 0.0 else POOR_M
        closely = predicted is not None
        if closely and (self._tried or self._usual_m > 0.0):
            poor_m = min(poor_m, DOUBTED * self._usual_m)
        fits = not first.error > poor_m and first.inliers >= MIN_SHARE * len(source)
        if fits or not len(target) or (self._tried and not closely):
            return first
        found = self._search_map(target, source, predicted) if predicted is not None else None
        if found is not None:
            return _better(target, source, first, found, closely)
        centre, also = (predicted, [guess]) if predicted is not None and self._tried else (guess, [])
        self._tried = True
        starts = [*(centre @ Pose(0.0, 0.0, turn) for turn in TURNS_RAD), *also]
        best = self._best_answer(target, take_part(source, TRIED_POINTS), starts, closely)
        second = narrow.register(target, source, best)
        return (
            _better(target, source, first, second, closely) if _is_close(centre, second.target_from_source) else first
        )

    def _search_map(self, target: Cloud, source: Cloud, predicted: Pose) -> Match | None:
        """Return the match from where the search finds a scan on the map.

        None where it is not clear: another heading scores nearly as well, and the match does not fit as usual.
        """
        place = self.search and self.search.find(target, take_part(source, TRIED_POINTS).points, predicted)
        if not place:
            return None
        match = self.narrow.register(target, source, place.pose)
        fits = match.inliers >= MIN_SHARE * len(source) and match.error <= DOUBTED * self._usual_m
        return match if place.alone or fits else None

    def _best_answer(self, target: Cloud, part: Cloud, starts: Sequence[Pose], closely: bool) -> Pose:
        """Return the answer near the first of the starts that lies best on the target; that start if there is none."""
        best, most = starts[0], 0.0
        for start in starts:
            answer = self.brief.register(target, part, start).target_from_source
            rate = _rate(target, part, answer, closely)
            if rate > most and _is_close(starts[0], answer):
                best, most = answer, rate
        return best


def is_large(cloud: Cloud) -> bool:
    """Return whether a scan is matched with a part of its points first."""
    return len(cloud) >= 2 * COARSE_POINTS


def take_part(cloud: Cloud, enough: int) -> Cloud:
    """Return every n-th point, so that ``enough`` are left, and less than twice as many; all of a small cloud."""
    every = len(cloud) // enough
    return Cloud(cloud.points[::every], cloud.frame, origin=cloud.origin) if every > 1 else cloud


def _is_close(guess: Pose, answer: Pose) -> bool:
    gap = guess.inverse() @ answer
    return gap.x**2 + gap.y**2 <= MAX_M**2 and abs(gap.theta) <= MAX_RAD


def _better(target: Cloud, source: Cloud, first: Match, second: Match, closely: bool) -> Match:
    """Return the match that lies better on a target, the first one where both lie alike."""
    rates = [_rate(target, source, match.target_from_source, closely) for match in (first, second)]
    return second if rates[1] > rates[0] else first


def _rate(target: Cloud, source: Cloud, target_from_source: Pose, closely: bool) -> float:
    """Return how well a scan lies on a target, 0 to 1; ``closely``: as ``CLOSE_M`` says, else as ``NEAR_M``."""
    from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

    moved = target_from_source.transform(source.points)
    distance, _ = cKDTree(target.points).query(moved, distance_upper_bound=CLOSE_M if closely else NEAR_M)
    distances = np.asarray(distance)
    return float(np.maximum(1.0 - distances / CLOSE_M, 0.0).mean() if closely else np.isfinite(distances).mean())
