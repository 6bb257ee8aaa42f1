"""What the stamps of a stream tell: rate, jitter, gaps, and how they go with another clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Stamps

GAP_PERIODS = 3.0
"""A silence of more than so many usual periods is a gap: two scans in a row are missing."""

LISTED_GAPS = 10


@dataclass(frozen=True, slots=True)
class Gap:
    """A silence: when it began after the first stamp (s) and how long it lasted (s)."""

    at_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """Rate and regularity of a stream, in order of time.

    ``period_s``: median; ``jitter_s``: half of what lies between the 16th and 84th percentile of the periods, one
    standard deviation where they are normal. ``gaps``: the longest, longest first, of ``gap_count``. ``backwards`` and
    ``repeated``: of the file's order.
    """

    count: int
    first_ns: int
    last_ns: int
    duration_s: float
    period_s: float
    rate_hz: float
    jitter_s: float
    gap_count: int
    gaps: tuple[Gap, ...]
    backwards: int
    repeated: int

    @property
    def usable(self) -> bool:
        """Whether the stamps tell at least every second message from the others."""
        return self.repeated <= 0.5 * self.count


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """A stamp minus the time of recording (s): median, 5th and 95th percentile, extremes, drift."""

    median_s: float
    low_s: float
    high_s: float
    least_s: float
    most_s: float
    drift_ppm: float


def measure_timing(stamps_ns: Stamps) -> StreamTiming:
    """The timing of stamps (N,) in the order of the file; N at least 1."""
    distinct = np.unique(stamps_ns)
    periods = np.diff(distinct) * 1e-9
    period = float(np.median(periods)) if len(periods) else 0.0
    low, high = np.percentile(periods, [16, 84]) if len(periods) else (0.0, 0.0)
    usual = max(period, float(periods.mean())) if len(periods) else 0.0  # messages may come in bunches
    silent = np.flatnonzero(periods > GAP_PERIODS * usual)
    longest = silent[np.argsort(-periods[silent], kind="stable")][:LISTED_GAPS]
    return StreamTiming(
        len(stamps_ns),
        int(distinct[0]),
        int(distinct[-1]),
        float(distinct[-1] - distinct[0]) * 1e-9,
        period,
        1.0 / period if period > 0.0 else 0.0,
        0.5 * float(high - low),
        len(silent),
        tuple(Gap(float(distinct[at] - distinct[0]) * 1e-9, float(periods[at])) for at in longest),
        int(np.count_nonzero(np.diff(stamps_ns) < 0)),
        len(stamps_ns) - len(distinct),
    )


def measure_clock_offset(stamps_ns: Stamps, recorded_ns: Stamps) -> ClockOffset:
    """How stamps (N,) go with the clock of the recorder (N,); N at least 1."""
    offsets = (stamps_ns - recorded_ns) * 1e-9
    low, middle, high = np.percentile(offsets, [5, 50, 95])
    seconds = (recorded_ns - recorded_ns[0]) * 1e-9
    spread = float(seconds.std())
    slope = float(np.polyfit(seconds, offsets - middle, 1)[0]) if spread > 1.0 else 0.0
    return ClockOffset(float(middle), float(low), float(high), float(offsets.min()), float(offsets.max()), 1e6 * slope)
