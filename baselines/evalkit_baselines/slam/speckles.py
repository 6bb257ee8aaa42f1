"""Leave out single beams of a dirty lidar whose range has nothing to do with those of their neighbours: speckles.

Dust, sunlight, and glass give single beams any range. In the map such points look like walls: in a bare corridor they
fix the position along it, and hold the robot back. Where few are alone, many are real, and farther away than their
neighbours: a wall seen through a gap. A long corridor lost loops without them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats

NEAR_M = 0.2
"""Hits whose ranges differ by no more than this, and ``STEEPEST`` times the distance between their beams, may lie on
one wall."""

STEEPEST = 5.0
"""On a wall the range changes by so many times the distance between beams where they meet it at 11 deg."""

DIRTY = 0.015
"""From this mean share of speckles among the hits of a scan on, a lidar is dirty. Recordings and worlds have 0.012 at
most, but intel, whose robot stands beside people for 123 scans: 0.041."""

CLEAN, MEMORY = 50, 200
"""Scans of that mean: as if so many clean ones had gone before the first, and at most."""

_NEIGHBOURS = (-2, -1, 1, 2)


@dataclass
class Speckles:
    """Counts the speckles of a lidar, and leaves them out while it is dirty."""

    share: float = 0.0
    scans: int = CLEAN

    @property
    def is_dirty(self) -> bool:
        """Whether speckles are left out."""
        return self.share >= DIRTY

    def drop(self, scan: Scan) -> Scan:
        """Return the scan with nan for the ranges of speckles; the same scan if the lidar is clean."""
        hits = np.flatnonzero(scan.hits)
        if not len(hits):
            return scan
        speckles = hits[find_speckles(scan.ranges[hits], scan.angles[hits])]
        self.scans = min(self.scans + 1, MEMORY)
        self.share += (len(speckles) / len(hits) - self.share) / self.scans
        if not self.is_dirty or not len(speckles):
            return scan
        cleaned = scan.ranges.copy()
        cleaned[speckles] = np.nan
        return replace(scan, ranges=cleaned)


def find_speckles(ranges: Floats, angles: Floats) -> Bools:
    """Return which hits (K,), ranges in m and angles in rad, are speckles; after the last comes the first.

    A hit is a speckle if, of the two hits before and the two after it, none may lie on a wall with it, and three or
    all are nearer, or farther: along a corridor one wall is ever farther away, and there two are on either side.
    """
    if len(ranges) <= len(_NEIGHBOURS):
        return np.zeros(len(ranges), dtype=np.bool_)
    beyond = np.stack([np.roll(ranges, step) for step in _NEIGHBOURS]) - ranges
    turn = np.abs(se2.wrap(np.stack([np.roll(angles, step) for step in _NEIGHBOURS]) - angles))
    alone = (np.abs(beyond) > NEAR_M + STEEPEST * ranges * turn).all(axis=0)
    return np.asarray(alone & ((beyond > 0.0).sum(axis=0) != len(_NEIGHBOURS) // 2))
