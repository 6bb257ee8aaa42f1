"""Smooth the ranges of a noisy lidar with fine beams before its points are matched.

A point of a narrow face, displaced by noise along its beam, has its nearest map point on the wall beside that face,
and is lost for the face. What remains is biased to one side: with noise of 5 cm all matchers make corridors with door
niches up to 1 % too long. The median of neighbouring beams has less noise and keeps steps; where beams are wide it
would remove what is narrow, and where the noise is small nothing is to be gained.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats

MAX_BEAMS = 5
"""Beams in a median; with 9 and more a corridor of door niches becomes 0.3 % too short."""

MAX_SPAN_RAD = math.radians(1.201)
"""Largest angle between the first and the last beam of a median: 1.2 deg, so that beams 0.3 or 0.6 deg apart are fine
whatever is rounded."""

MIN_NOISE_M = 0.02
"""Ranges with less noise are not changed."""

MEMORY = 200
"""Scans at most of the mean that says whether a lidar is noisy."""

_SIGMA_OF_SECOND_DIFFERENCE = 0.6745 * math.sqrt(6.0)
"""Median of the absolute second difference of three ranges, for normal noise of 1 sigma."""


@dataclass
class RangeNoise:
    """Smooths scans, and tells whether a lidar is noisy: whether most of its scans were smoothed."""

    share: float = 0.0
    scans: int = 0

    @property
    def is_noisy(self) -> bool:
        """Whether most of the last scans were smoothed."""
        return self.share > 0.5

    def smooth(self, scan: Scan) -> Scan:
        """Return ``smooth_ranges`` of a scan, and count it."""
        smoothed = smooth_ranges(scan)
        self.scans = min(self.scans + 1, MEMORY)
        self.share += (float(smoothed is not scan) - self.share) / self.scans
        return smoothed


def smooth_ranges(scan: Scan) -> Scan:
    """Return the scan with the median of neighbouring ranges; the same scan where beams are wide or noise is small.

    A beam whose window has a beam without a valid return, or reaches beyond the ends of the scan, keeps its range.
    """
    beams = count_beams(scan.angles)
    if beams < 3 or len(scan.ranges) < beams or not is_noisy(scan.ranges):
        return scan
    half = beams // 2
    windows = np.lib.stride_tricks.sliding_window_view(scan.ranges, beams)
    ranges = scan.ranges.copy()
    valid = np.isfinite(windows).all(axis=1)
    ranges[half : len(ranges) - half][valid] = np.partition(windows[valid], half, axis=1)[:, half]
    return replace(scan, ranges=ranges)


def count_beams(angles: Floats) -> int:
    """Return the number of neighbouring beams in a median, odd: 1 where most angles (B,) in rad are too far apart."""
    steps = np.abs(np.diff(angles))
    fitting = (beams for beams in (MAX_BEAMS, 3) if _is_most(steps * (beams - 1) <= MAX_SPAN_RAD))
    return next(fitting, 1)


def is_noisy(ranges: Floats) -> bool:
    """Return whether most valid ranges (B,) in m bend by more than those of a wall with noise of ``MIN_NOISE_M``."""
    known = np.where(np.isfinite(ranges), ranges, np.nan)
    bend = np.abs(known[:-2] + known[2:] - 2.0 * known[1:-1])
    return _is_most(bend[~np.isnan(bend)] > MIN_NOISE_M * _SIGMA_OF_SECOND_DIFFERENCE)


def _is_most(flags: Bools) -> bool:
    return 2 * int(np.count_nonzero(flags)) > len(flags)
