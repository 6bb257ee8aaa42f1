"""Find an odometry whose lengths are not in metres: it drives too fast, and the scans show a fraction of its motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evalkit_datasets.commands.inspect.mounting_angle import (
    MAX_SPREAD,
    MIN_PAIRS,
    estimate_mounting_angle,
    measure_heading,
    measure_visible_share,
    pair_motions,
)
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream
from evalkit_datasets.parsing.columns_layout import LENGTH_UNITS

FAST_M_S = 10.0
"""An odometry that drives more slowly (median) is taken to be in metres."""

BEYOND_VEHICLES_M_S = 60.0
"""No vehicle with a 2D lidar drives faster (median)."""

MIN_SCALE = 0.75
"""Motions between two scans are seen up to a tenth too short."""

MIN_VISIBLE = 0.4
"""Motions of which the ranges show less, along the walls of a corridor, are seen too short."""


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


@dataclass(frozen=True, slots=True)
class LengthComparison:
    """How far the scans move, divided by how far an odometry does, on ``pairs`` straight drives: the quartiles."""

    pairs: int
    low: float
    scale: float
    high: float

    @property
    def differs(self) -> bool:
        """Whether three of four drives are shorter or longer than those of any working odometry."""
        return self.high < MIN_SCALE or self.low > 1.0 / MIN_SCALE


def compare_lengths(wheels: OdometryStream, laser: LaserStream) -> LengthComparison | None:
    """Return how far the scans move on straight drives; None if few of these are visible, or directions disagree.

    Along the walls of a corridor the scans show a part of the motion: such drives are left out.
    """
    moved, seen, scans = pair_motions(wheels, laser)
    if len(moved) < MIN_PAIRS:
        return None
    heading, spread = measure_heading(moved, seen)
    if spread > MAX_SPREAD:
        return None
    ways = np.arctan2(moved[:, 1], moved[:, 0]) - heading
    ratios = [
        float(np.hypot(*own[:2]) / np.hypot(*base[:2]))
        for base, own, (one, other), way in zip(moved, seen, scans.tolist(), ways, strict=True)
        if measure_visible_share(laser.ranges[one], laser.ranges[other], laser.angles, float(way)) > MIN_VISIBLE
    ]
    if len(ratios) < MIN_PAIRS:
        return None
    return LengthComparison(len(ratios), *map(float, np.percentile(ratios, [25, 50, 75])))


def scale_lengths(wheels: OdometryStream, unit: str) -> OdometryStream:
    """Return an odometry in metres whose positions are in a unit; the speeds in its messages stay as they are."""
    return replace(wheels, poses=wheels.poses * np.array([LENGTH_UNITS[unit]] * 2 + [1.0]))
