"""Distances measured with a tape, between positions of the robot or between walls."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SpanEnd:
    """One end of a measured distance: a point (m) relative to the robot at a time, or a wall of the map.

    With ``stamp_ns``, x and y are coordinates in the base frame at that time; (0, 0) is the robot itself. Without it,
    the end is the wall nearest to x, y in the map frame: the true world frame if known, else that of the first pose.
    """

    x: float = 0.0
    y: float = 0.0
    stamp_ns: int | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x) and math.isfinite(self.y)):
            raise ValueError(f"place: not finite: ({self.x}, {self.y})")


@dataclass(frozen=True, slots=True)
class Span:
    """A measured distance between two ends in metres, with its standard deviation."""

    name: str
    first: SpanEnd
    second: SpanEnd
    metres: float
    sigma_m: float = 0.01

    def __post_init__(self) -> None:
        if not (math.isfinite(self.metres) and self.metres > 0.0):
            raise ValueError(f"metres: expected a positive number, got {self.metres}")
        if not (math.isfinite(self.sigma_m) and self.sigma_m > 0.0):
            raise ValueError(f"sigma_m: expected a positive number, got {self.sigma_m}")
