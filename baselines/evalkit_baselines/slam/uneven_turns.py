"""Find scans within which the robot begins or ends to turn: deskewing at constant velocity bends them.

Their matches are wrong by some degrees, and they would bend the map. Wheel odometry knows such a turn better, unless
its clock is late or early. Whether it is shows over the turn: from the scan before to the scan after, which are not
bent.
"""

from __future__ import annotations

import math

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import wrap

UNEVEN_RAD = math.radians(1.0)
"""A turn within a sweep that differs by more from that at the rate since the last scan is uneven."""

RIGHT_SHARE = 0.25
"""Over the turn, odometry and matches may differ by this share of that difference."""

TURNS_RIGHT = 2
"""After so many turns over which the odometry was right, without one over which it was wrong, it is right."""


class UnevenTurns:
    """Judges one scan after the other; of two scans in a row only the first is uneven."""

    def __init__(self) -> None:
        self._by_rad = 0.0
        self._beyond_rad = 0.0  # how far the scan before the last one had turned beyond the odometry
        self._odom_from_last: Pose | None = None
        self._right = 0

    @property
    def is_odometry_right(self) -> bool:
        """Whether the odometry was right over the last uneven turns."""
        return self._right == TURNS_RIGHT

    def measure(self, frame: Frame, step: Pose | None, elapsed_ns: int) -> float:
        """Return by how much (rad) the turn within a scan differs from that at the rate since the last one.

        0.0 where it is even, or unknown, or the last scan was uneven. ``step``: motion since the last scan,
        ``elapsed_ns`` ago, by wheel odometry, if measured.
        """
        sweep_ns = frame.scan.duration_ns
        if step is None or frame.start_from_end is None or sweep_ns == 0 or self._by_rad > 0.0:
            return 0.0
        by = abs(frame.start_from_end.theta - step.theta * sweep_ns / elapsed_ns)
        return by if by > UNEVEN_RAD else 0.0

    def note(self, by_rad: float, odom_from_base: Pose | None, last: Pose | None, matched: Pose | None) -> None:
        """Note what ``measure`` returned; after an uneven scan, note whether the odometry was right over its turn.

        ``odom_from_base``: wheel odometry of this scan, if any; ``last``: the answer of the last scan; ``matched``:
        where this one matched, None if it did not.
        """
        if self._by_rad > 0.0 and odom_from_base is not None and matched is not None:
            beyond = matched.theta - odom_from_base.theta
            right = abs(float(wrap(beyond - self._beyond_rad))) <= RIGHT_SHARE * self._by_rad
            self._right = min(self._right + 1, TURNS_RIGHT) if right else 0
        if last is not None and self._odom_from_last is not None:
            self._beyond_rad = last.theta - self._odom_from_last.theta
        self._by_rad, self._odom_from_last = by_rad, odom_from_base
