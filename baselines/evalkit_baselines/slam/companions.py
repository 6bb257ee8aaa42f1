"""Leave out what moves along with the robot: its own body in view, or somebody who walks behind or ahead of it.

In a bare corridor such points alone fix the position along it, always the same one: the robot stands still in the map,
although its wheels are right. In each scan and in one from some way before, the nearest hit of each sector is looked
at: that of a companion is as far away as it was, and there the other scan, by the wheels, saw nothing up to a place
behind it. The walls of a corridor keep their range, too, but stand where they stood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats

NEAR_M = 3.0
"""Hits farther away than this stay: a companion is near, and where far walls move along, too, the wheels slip."""

MOVED_M, TURNED_RAD = 0.5, math.radians(20.0)
"""A scan is compared with an earlier one at least so far away, or turned by so much, by wheel odometry."""

SAME_M = 0.1
"""A companion keeps its range up to this."""

FREE_M = 0.25
"""A place so far before the nearest hit is free. Hits up to so far behind that of a companion are its own, too."""

MOST = 0.3
"""If a larger share of the hits would be left out, all stay."""

LEAST, OFTEN, MEMORY = 0.02, 0.7, 10
"""Companions are left out while at least ``LEAST`` of the hits moved along in at least ``OFTEN`` of the last scans: a
mean of so many. In the worlds walls seem to move along in up to 0.55 of them, at 5 and 10 scans a second."""

SECTORS = 120
_SHIFT = 0.29
"""Of the borders of sectors, in sectors: many lidars have a beam at each quarter of a degree, where rounding would
decide."""

_MIDDLES = (np.arange(SECTORS) + (0.5 - _SHIFT)) * (2.0 * math.pi / SECTORS)
_RAYS = np.column_stack([np.cos(_MIDDLES), np.sin(_MIDDLES)])


@dataclass(frozen=True, eq=False)
class _View:
    """The nearest range (SECTORS,) in each sector of a scan (m), and the pose of the sensor by wheel odometry."""

    nearest_m: Floats
    odom_from_sensor: Pose

    def is_away(self, later: _View) -> bool:
        """Return whether a later view is far enough away to be compared with this one."""
        moved = self.odom_from_sensor.inverse() @ later.odom_from_sensor
        return math.hypot(moved.x, moved.y) >= MOVED_M or abs(moved.theta) >= TURNED_RAD

    def is_free(self, points: Floats) -> Bools:
        """Return whether points (K, 2), seen from the sensor, lie before all in their sector and the two beside it."""
        sectors = _find_sectors(np.arctan2(points[:, 1], points[:, 0]))
        seen_m = np.min([self.nearest_m[(sectors + step) % SECTORS] for step in (-1, 0, 1)], axis=0)
        far_m = np.sqrt(points[:, 0] * points[:, 0] + points[:, 1] * points[:, 1])
        return np.asarray(np.isfinite(seen_m) & (far_m < seen_m - FREE_M))


class Companions:
    """Compares each scan with one from some way before, and leaves out what moves along."""

    def __init__(self) -> None:
        self._older: _View | None = None
        self._newer: _View | None = None
        self._often = 0.0
        self._scans = 0

    def drop(self, scan: Scan, odom_from_sensor: Pose | None) -> Scan:
        """Return the scan with nan for the ranges of companions; the same scan if there are none.

        ``odom_from_sensor``: pose of the sensor by wheel odometry; None: not known, nothing is left out.
        """
        if odom_from_sensor is None:
            self._older = self._newer = None
            return scan
        hits = np.flatnonzero(scan.hits)
        sectors = _find_sectors(scan.angles[hits])
        nearest_m = np.full(SECTORS, math.inf)
        np.minimum.at(nearest_m, sectors, scan.ranges[hits])
        view = _View(nearest_m, odom_from_sensor)
        earlier = self._choose(view)
        if earlier is None or not len(hits):
            return scan
        behind_m = scan.ranges[hits] - nearest_m[sectors]
        own = hits[_find_companions(view, earlier)[sectors] & (behind_m <= FREE_M)]
        share = len(own) / len(hits)
        self._scans = min(self._scans + 1, MEMORY)
        self._often += ((LEAST <= share <= MOST) - self._often) / self._scans
        if self._often < OFTEN or share > MOST or not len(own):
            return scan
        ranges = scan.ranges.copy()
        ranges[own] = np.nan
        return replace(scan, ranges=ranges)

    def _choose(self, view: _View) -> _View | None:
        """Return the view that the new one is compared with, None if there is none far enough away."""
        if self._older is None:
            self._older = view
        elif self._newer is None and self._older.is_away(view):
            self._newer = view
        elif self._newer is not None and self._newer.is_away(view):
            self._older, self._newer = self._newer, view
        return self._older if self._older.is_away(view) else None


def _find_companions(now: _View, earlier: _View) -> Bools:
    """Return in which sectors (SECTORS,) something moved along."""
    companions = now.nearest_m <= NEAR_M
    companions[companions] = np.abs(earlier.nearest_m[companions] - now.nearest_m[companions]) <= SAME_M
    rays = _RAYS[companions]
    earlier_from_now = earlier.odom_from_sensor.inverse() @ now.odom_from_sensor
    came = earlier.is_free(earlier_from_now.transform(now.nearest_m[companions, None] * rays))
    went = now.is_free(earlier_from_now.inverse().transform(earlier.nearest_m[companions, None] * rays))
    companions[companions] = came | went
    return companions


def _find_sectors(angles: Floats) -> Ints:
    """Return the sectors (K,) of angles (K,) in rad."""
    return np.floor(se2.wrap(angles) * (SECTORS / (2.0 * math.pi)) + _SHIFT).astype(np.int64) % SECTORS
