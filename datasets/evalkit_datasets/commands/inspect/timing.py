"""Measure the stamps of a stream: rate, jitter, gaps, and offset and drift against the recorder's clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats, Stamps

GAP_PERIODS = 3.0
"""A longer time between two messages, in typical periods, is a gap: at least two scans are missing."""

MAX_LISTED_GAPS = 10


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap: its start after the first stamp (s) and its length (s)."""

    at_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """Rate and regularity of a stream, in order of time.

    ``period_s``: median period; ``jitter_s``: half the range from the 16th to the 84th percentile of the periods, which
    is one standard deviation of normal periods. ``gaps``: the longest of ``gap_count``, longest first. ``backwards``
    and ``repeated``: decreasing and repeated stamps in file order.
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
        """Whether at most half of the stamps are repeated."""
        return self.repeated <= 0.5 * self.count


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Stamp minus time of recording (s): median, 5th and 95th percentile, extremes, drift."""

    median_s: float
    low_s: float
    high_s: float
    min_s: float
    max_s: float
    drift_ppm: float


def seconds_since_first(stamps_ns: Stamps) -> Floats:
    """Return the seconds (N,) since the first of stamps (N,)."""
    return np.asarray((stamps_ns - stamps_ns[:1]) * 1e-9, dtype=np.float64)


def measure_timing(stamps_ns: Stamps) -> StreamTiming:
    """Return the timing of stamps (N,) in file order, N >= 1."""
    distinct = np.unique(stamps_ns)
    seconds = seconds_since_first(distinct)
    periods = np.diff(seconds)
    period = float(np.median(periods)) if len(periods) else 0.0
    low, high = np.percentile(periods, [16, 84]) if len(periods) else (0.0, 0.0)
    typical = max(period, float(periods.mean())) if len(periods) else 0.0  # messages may come in bunches
    gap_indices = np.flatnonzero(periods > GAP_PERIODS * typical)
    longest = gap_indices[np.argsort(-periods[gap_indices], kind="stable")][:MAX_LISTED_GAPS]
    return StreamTiming(
        len(stamps_ns),
        int(distinct[0]),
        int(distinct[-1]),
        float(seconds[-1]),
        period,
        1.0 / period if period > 0.0 else 0.0,
        0.5 * float(high - low),
        len(gap_indices),
        tuple(Gap(float(seconds[at]), float(periods[at])) for at in longest),
        int(np.count_nonzero(stamps_ns[1:] < stamps_ns[:-1])),
        len(stamps_ns) - len(distinct),
    )


def measure_clock_offset(stamps_ns: Stamps, recorded_ns: Stamps) -> ClockOffset:
    """Return the offset of stamps (N,) from the times of recording (N,), N >= 1."""
    offsets = (stamps_ns - recorded_ns) * 1e-9
    low, middle, high = np.percentile(offsets, [5, 50, 95])
    seconds = seconds_since_first(recorded_ns)
    spread = float(seconds.std())
    slope = float(np.polyfit(seconds, offsets - middle, 1)[0]) if spread > 1.0 else 0.0
    return ClockOffset(float(middle), float(low), float(high), float(offsets.min()), float(offsets.max()), 1e6 * slope)
