"""Find an odometry whose lengths are not in metres: it drives too fast, and the scans show a fraction of its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evalkit_datasets.commands.inspect.mounting_angle import estimate_mounting_angle
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream
from evalkit_datasets.parsing.columns_layout import LENGTH_UNITS

FAST_M_S = 10.0
"""An odometry that drives more slowly (median) is taken to be in metres."""

BEYOND_VEHICLES_M_S = 60.0
"""No vehicle with a 2D lidar drives faster (median)."""


@dataclass(frozen=True, slots=True)
class LengthUnit:
    """The unit of an odometry that is read as metres: "mm" or "cm" by the scans, "" if its speed alone is known."""

    unit: str
    driving_m_s: float


def find_length_unit(wheels: OdometryStream, laser: LaserStream | None, driving_m_s: float) -> LengthUnit | None:
    """Return the unit of the lengths of an odometry; None if they are metres or nothing shows another unit.

    ``driving_m_s``: its median speed while it drives. The unit is that with which the odometry has the direction, and
    within a factor of 1.6 the length, of the motions between scans on straight drives.
    """
    if driving_m_s < FAST_M_S:
        return None
    for unit in ("mm", "cm"):
        if laser is not None and estimate_mounting_angle(scale_lengths(wheels, unit), laser) is not None:
            return LengthUnit(unit, driving_m_s)
    return LengthUnit("", driving_m_s) if driving_m_s > BEYOND_VEHICLES_M_S else None


def scale_lengths(wheels: OdometryStream, unit: str) -> OdometryStream:
    """Return an odometry in metres whose positions are in a unit; the speeds in its messages stay as they are."""
    return replace(wheels, poses=wheels.poses * np.array([LENGTH_UNITS[unit]] * 2 + [1.0]))
