"""One lidar scan, its points, and the frame an odometry receives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints, freeze
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution or sweep of a planar lidar, in the sensor's frame.

    ``stamp_ns``: time of the first beam. ``ranges`` (B,) in metres: finite within the limits, ``inf`` for no return,
    ``nan`` for invalid. ``angles`` (B,) in radians, counter-clockwise from the sensor's x axis, in the order the beams
    were fired. ``time_increment_ns``: time between two beams (0: all at once).
    """

    stamp_ns: int
    ranges: Floats
    angles: Floats
    range_min_m: float
    range_max_m: float
    time_increment_ns: int = 0

    def __post_init__(self) -> None:
        freeze(self, "ranges", self.ranges, (None,))
        freeze(self, "angles", self.angles, (len(self.ranges),))
        if not np.isfinite(self.angles).all():
            raise ValueError("angles: not finite")
        if not 0.0 <= self.range_min_m < self.range_max_m:
            raise ValueError(f"range limits: expected 0 <= min < max, got {self.range_min_m} and {self.range_max_m} m")
        if self.time_increment_ns < 0:
            raise ValueError(f"time_increment_ns: negative: {self.time_increment_ns}")
        finite = np.isfinite(self.ranges)
        outside = finite & ((self.ranges < self.range_min_m) | (self.ranges > self.range_max_m))
        if outside.any() or np.isneginf(self.ranges).any():
            beam = int(np.argmax(outside | np.isneginf(self.ranges)))
            raise ValueError(
                f"ranges: {self.ranges[beam]} m at beam {beam} lies outside "
                f"[{self.range_min_m}, {self.range_max_m}] m; mark no return as inf and invalid as nan"
            )

    @classmethod
    def of_checked(
        cls, stamp_ns: int, ranges: Floats, angles: Floats, range_min_m: float, range_max_m: float,
        time_increment_ns: int,
    ) -> Scan:  # fmt: skip
        """Return the scan of values that were those of a scan before: read-only arrays, neither copied nor checked."""
        scan = object.__new__(cls)
        scan.__dict__.update(
            stamp_ns=stamp_ns, ranges=ranges, angles=angles, range_min_m=range_min_m, range_max_m=range_max_m,
            time_increment_ns=time_increment_ns,
        )  # fmt: skip
        return scan

    @property
    def hits(self) -> Bools:
        """Mask (B,) of beams with a valid range."""
        return np.isfinite(self.ranges)

    @property
    def no_returns(self) -> Bools:
        """Mask (B,) of beams without a return."""
        return np.isposinf(self.ranges)

    @property
    def duration_ns(self) -> int:
        """Time from the first beam to the last in ns."""
        return self.time_increment_ns * max(len(self.ranges) - 1, 0)

    def points(self) -> Floats:
        """Return the hits (N, 2) in the sensor frame, in firing order."""
        hits = self.hits
        return _polar(self.ranges[hits], self.angles[hits])

    def deskewed(self, base_from_sensor: Pose, start_from_end: Pose | None, at: float = 0.0) -> Scan:
        """Return the scan as if all beams had been fired at ``stamp_ns``, for a base at constant velocity.

        ``at``: where ``stamp_ns`` lies in the sweep, 0: at the first beam, 1: at the last one.

        ``start_from_end`` is the motion of the *base* from the first beam to the last; None: unknown, the scan is
        returned unchanged. Hits are moved, no-returns are rotated, and the range limits are widened for moved hits.
        """
        if start_from_end is None or len(self.ranges) < 2 or self.time_increment_ns == 0:
            return self
        share = np.arange(len(self.ranges)) / (len(self.ranges) - 1) - at
        start_from_beam = se2.fraction(start_from_end.row, share)
        sensor_from_moved = se2.compose(
            base_from_sensor.inverse().row, se2.compose(start_from_beam, base_from_sensor.row)
        )
        hits = self.hits
        moved = se2.transform_each(sensor_from_moved[hits], self.points())
        ranges, angles = self.ranges.copy(), self.angles + sensor_from_moved[:, 2]
        ranges[hits] = np.hypot(moved[:, 0], moved[:, 1])
        angles[hits] = np.arctan2(moved[:, 1], moved[:, 0])
        low = min(self.range_min_m, float(ranges[hits].min(initial=self.range_min_m)))
        high = max(self.range_max_m, float(ranges[hits].max(initial=self.range_max_m)))
        return Scan(self.stamp_ns, ranges, angles, low, high, 0)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (N, 2) in metres in a named frame; never nan or inf; may be empty.

    ``support`` (N,): of how many measured points each is the mean, 1 or more, as in a map of voxels; None: of one
    each, or unknown. ``seen_from`` (N, 2): the mean of the unit vectors from these to where they were seen from; None:
    unknown. ``origin`` (2,): where the points of a scan were seen from (m); None: unknown. ``noisy``: the noise of
    single points is the largest error, so that a mean of n points is better than one point.
    """

    points: Floats
    frame: str = "base"
    support: Ints | None = None
    seen_from: Floats | None = None
    origin: Floats | None = None
    noisy: bool = False

    def __post_init__(self) -> None:
        freeze(self, "points", np.reshape(self.points, (0, 2)) if np.size(self.points) == 0 else self.points, (None, 2))
        if not np.isfinite(self.points).all():
            row = int(np.argmax(~np.isfinite(self.points).all(axis=1)))
            raise ValueError(f"points: not finite at row {row}: {self.points[row].tolist()}")
        if self.support is not None:
            given = np.asarray(self.support)
            freeze(self, "support", given, (len(self.points),), np.int64)
            if (self.support < 1).any() or (self.support != given).any():
                raise ValueError(f"support: expected whole numbers from 1 on, got {given.min()} to {given.max()}")
        for name, vectors, shape in (("seen_from", self.seen_from, (len(self), 2)), ("origin", self.origin, (2,))):
            if vectors is not None:
                freeze(self, name, vectors, shape)
                if not np.isfinite(vectors).all():
                    raise ValueError(f"{name}: not finite")

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One scan and all other input of a back end.

    ``base_from_sensor``: pose of the lidar on the base. ``odom_from_base``: pose of the base by wheel odometry at the
    first beam, None if the recording has none. ``start_from_end``: motion of the base from the first beam to the last
    by wheel odometry, None if unknown.
    """

    scan: Scan
    base_from_sensor: Pose = field(default_factory=Pose)
    odom_from_base: Pose | None = None
    start_from_end: Pose | None = None

    def points_in_base(self, start_from_end: Pose | None) -> Floats:
        """Return the hits (N, 2) in the base frame at the first beam (m), in firing order.

        ``start_from_end``: motion within the scan to undo (see ``Scan.deskewed``); None: the scan is not deskewed.
        """
        scan = self.scan.deskewed(self.base_from_sensor, start_from_end)
        return self.base_from_sensor.transform(scan.points())


def _polar(ranges: Floats, angles: Floats) -> Floats:
    """Return the points (N, 2) of ranges (N,) and angles (N,): equation 1 of the paper, x forward."""
    points = np.empty((len(ranges), 2))
    np.multiply(ranges, np.cos(angles), out=points[:, 0])
    np.multiply(ranges, np.sin(angles), out=points[:, 1])
    return points
