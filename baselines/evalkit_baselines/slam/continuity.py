"""Whether a scan continues the one before it, or the track was lost: a kidnapped robot, a long gap, a wrong match."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import voxel_means

NEAR_M = 0.25
"""A point within this distance of the scan before lies on it."""

MIN_SHARE = 0.7
"""Below this share of points on the scan before or the map, of those the scan before could see, the track is lost.

Smallest shares measured on parts of recordings: 0.77 on sparse scans of intel, 0.91 on the dirty log rplidar-slambot. A
robot carried between corridors of the same width has 0.65 to 0.85, so that it is not always noticed."""

MIN_POINTS = 20
"""Scans of fewer points, after thinning, are not compared."""

SOON_NS = 1_000_000_000
"""For so long the motion goes on about as before. Without odometry, quick turns bend scans so that they do not lie on
each other; but they lie on the map."""

_VOXEL_M = 0.1
_SAMPLES = 200
"""Points that are compared: every n-th, so that so many are left, and less than twice as many."""

_GAP_RAD = np.radians(5.0)
"""A direction farther than this from every point of a scan was not seen."""

_BEHIND_M = 0.5
"""What lies so far behind a point was hidden by it."""


class _Scan(NamedTuple):
    """Points (N, 2) of a scan in the base frame, and the poses of the base and of the sensor on it."""

    points: Floats
    odom_from_base: Pose
    base_from_sensor: Pose


class Continuity:
    """Compares a scan with the one before; where that has too few points, with the last that was compared so."""

    def __init__(self) -> None:
        self._last: _Scan | None = None
        self._is_outdated = False  # _before is older than the scan before
        self._before: Floats | None = None
        self._sensor = Pose()

    def is_lost(self, points: Floats, odom_from_base: Pose, is_predicted: bool, local_map: Floats) -> bool:
        """Return whether points (N, 2) of the base frame lie neither on the scan before nor on the map (M, 2).

        ``is_predicted``: by wheel odometry, or the scan before is not older than ``SOON_NS``. Then the scan before
        alone may be the wrong one, and the map counts, too; otherwise it does not help: after a gap an equal place is
        near enough for a match. Points that the scan before could not see do not count. With too few others, a
        prediction is accepted; without one the track is lost.
        """
        from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

        self._take_last()
        moved = odom_from_base.transform(voxel_means(points, _VOXEL_M))
        before, sensor = self._before, self._sensor
        if len(moved) < MIN_POINTS or before is None:
            return False
        every = max(len(moved) // _SAMPLES, 1)
        asked = moved[::every]
        seen = asked[could_see(sensor.inverse().transform(before), sensor.inverse().transform(asked), _BEHIND_M)]
        if len(seen) * every < MIN_POINTS:
            return not is_predicted
        distance, _ = cKDTree(before).query(seen, distance_upper_bound=NEAR_M)
        on_before = np.isfinite(np.asarray(distance))
        if not is_predicted or on_before.mean() >= MIN_SHARE:
            return bool(on_before.mean() < MIN_SHARE)
        distance, _ = cKDTree(local_map).query(seen, distance_upper_bound=NEAR_M)
        return float((on_before | np.isfinite(np.asarray(distance))).mean()) < MIN_SHARE

    def keep(self, points: Floats, odom_from_base: Pose, base_from_sensor: Pose) -> None:
        """Compare the next scans with this one, points (N, 2) of the base frame.

        If the one before was never compared, and this one has too few points, there is none to compare with.
        """
        self._is_outdated = self._last is not None
        self._last = _Scan(points, odom_from_base, base_from_sensor)

    def _take_last(self) -> None:
        """Prepare the scan that was kept last, if it has enough points; many are replaced before they are needed."""
        if self._last is None:
            return
        if self._is_outdated:
            self._before = None
        moved = self._last.odom_from_base.transform(voxel_means(self._last.points, _VOXEL_M))
        if len(moved) >= MIN_POINTS:
            self._before, self._sensor = moved, self._last.odom_from_base @ self._last.base_from_sensor
        self._last = None


def could_see(before: Floats, now: Floats, behind_m: float) -> Bools:
    """Return which points (N, 2) a sensor that saw others (M, 2) could have seen, both in its frame.

    What lies more than ``behind_m`` behind what it saw was hidden.
    """
    if len(before) == 0:
        return np.zeros(len(now), dtype=np.bool_)
    bearing, ahead = (np.arctan2(each[:, 1], each[:, 0]) for each in (before, now))
    order = np.argsort(bearing, kind="stable")
    around = np.r_[bearing[order][-1] - 2.0 * np.pi, bearing[order], bearing[order][0] + 2.0 * np.pi]
    reach = np.hypot(before[:, 0], before[:, 1])[np.r_[order[-1], order, order[0]]]
    right = np.clip(np.searchsorted(around, ahead), 1, len(around) - 1)
    nearest = np.where(ahead - around[right - 1] < around[right] - ahead, right - 1, right)
    close = np.abs(around[nearest] - ahead) <= _GAP_RAD
    return np.asarray(close & (np.hypot(now[:, 0], now[:, 1]) <= reach[nearest] + behind_m))
