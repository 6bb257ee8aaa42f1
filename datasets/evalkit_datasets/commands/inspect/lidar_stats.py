"""Statistics of one lidar of a recording."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit_datasets.commands.inspect.range_stats import RangeStats
from evalkit_datasets.commands.inspect.timing import ClockOffset, StreamTiming

MIN_SWEEP_S, MAX_SWEEP_S = 0.04, 0.5
"""Periods (s) of scans within which a robot moves visibly, and that are a revolution: longer ones leave scans out."""

MAX_SWEEP_PERIODS = 1.5
"""A sweep of more periods of the scans is stated wrongly."""


@dataclass(frozen=True, slots=True)
class LidarStats:
    """Statistics of one lidar. ``field_of_view_deg``: from the first beam to the last; limits are None if unknown."""

    topic: str
    kind: str
    frame: str
    beams: int
    field_of_view_deg: float
    first_angle_deg: float
    step_deg: float
    range_min_m: float | None
    range_max_m: float | None
    sweep_s: float
    timing: StreamTiming
    clock: ClockOffset | None
    returns: RangeStats
    damaged: int
    unstamped: int

    @property
    def revolution_s(self) -> float:
        """The time from the first beam to the last (s) if the lidar turns once a scan."""
        return self.timing.period_s * self.field_of_view_deg / 360.0

    @property
    def may_be_swept(self) -> bool:
        """Whether its messages state no time between beams, and its scans may each be a revolution."""
        stated = self.sweep_s != 0.0 or not self.kind.endswith("LaserScan")
        return not stated and MIN_SWEEP_S <= self.timing.period_s <= MAX_SWEEP_S

    @property
    def is_sweep_too_long(self) -> bool:
        """Whether its scans would end after the next ones have begun, by the time between beams in its messages."""
        return self.timing.period_s > 0.0 and self.sweep_s > MAX_SWEEP_PERIODS * self.timing.period_s

    @property
    def limits(self) -> str:
        """The range limits in words."""
        low, high = self.range_min_m, self.range_max_m
        if low is None or high is None:
            least = "" if low is None else f"from {low:g} m"
            return least or ("no range limits stated" if high is None else f"up to {high:g} m")
        return f"{low:g} to {high:g} m"
