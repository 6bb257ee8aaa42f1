"""Measure the stamps of a stream: rate, jitter, gaps, and offset and drift against the recorder's clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats, Stamps

GAP_PERIODS = 3.0
"""A longer time between two messages, in typical periods, is a gap: at least two scans are missing."""

MAX_LISTED_GAPS = 10

MIN_CLOCK_STEP_S = 0.5
"""A larger change from one message to the next, against the recorder's clock, is that of a clock that was set."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A gap: its start after the first stamp (s) and its length (s)."""

    at_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class StepBack:
    """A step back of the stamps in file order: the time after the first stamp (s) where it begins, and its length (s).

    ``before``: how many different stamps lie before all that follow it, ``behind``: at or before all that precede it.
    """

    at_s: float
    length_s: float
    before: int
    behind: int


@dataclass(frozen=True, slots=True)
class StreamTiming:
    """Rate and regularity of a stream, in order of time.

    ``period_s``: median period; ``jitter_s``: half the range from the 16th to the 84th percentile of the periods, which
    is one standard deviation of normal periods. ``gaps``: the longest of ``gap_count``, longest first. ``backwards``
    and ``repeated``: decreasing and repeated stamps in file order. ``steps_back``: the number of steps
    back of more than 0.5 s; ``step_back``: the longest of them.
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
    steps_back: int = 0
    step_back: StepBack | None = None

    @property
    def usable(self) -> bool:
        """Whether at most half of the stamps are repeated."""
        return self.repeated <= 0.5 * self.count


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """Stamp minus time of recording (s): median, 5th and 95th percentile, extremes, drift.

    ``step_s``: the largest change from one message to the next, if it is larger than 0.5 s, at ``step_at_s`` after the
    first; else 0.
    """

    median_s: float
    low_s: float
    high_s: float
    min_s: float
    max_s: float
    drift_ppm: float
    step_s: float = 0.0
    step_at_s: float = 0.0


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
    back = _find_steps_back(stamps_ns)
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
        len(back),
        _measure_step_back(stamps_ns, distinct, back),
    )


def _find_steps_back(stamps_ns: Stamps) -> Ints:
    """Return the numbers of the stamps behind which a clock was set back; one message that comes late is none."""
    back = np.flatnonzero(np.diff(stamps_ns[:-1]) < -MIN_CLOCK_STEP_S * 1e9)
    return np.asarray(back[stamps_ns[back + 2] < stamps_ns[back]])


def _measure_step_back(stamps_ns: Stamps, distinct: Stamps, back: Ints) -> StepBack | None:
    """Return the longest of the steps back behind the stamps with the numbers ``back``, None if there are none."""
    if not len(back):
        return None
    at = int(back[np.argmin(np.diff(stamps_ns)[back])])
    before = int(np.searchsorted(distinct, stamps_ns[at + 1 :].min()))
    behind = int(np.searchsorted(distinct, stamps_ns[: at + 1].max(), side="right"))
    seconds = (int(stamps_ns[at]) - int(distinct[0])) * 1e-9
    return StepBack(seconds, (int(stamps_ns[at]) - int(stamps_ns[at + 1])) * 1e-9, before, behind)


def measure_clock_offset(stamps_ns: Stamps, recorded_ns: Stamps) -> ClockOffset:
    """Return the offset of stamps (N,) from the times of recording (N,), N >= 1."""
    offsets = (stamps_ns - recorded_ns) * 1e-9
    low, middle, high = np.percentile(offsets, [5, 50, 95])
    seconds = seconds_since_first(recorded_ns)
    spread = float(seconds.std())
    slope = float(np.polyfit(seconds, offsets - middle, 1)[0]) if spread > 1.0 else 0.0
    changes = np.diff(offsets)
    at = int(np.argmax(np.abs(changes))) if len(changes) else 0
    stepped = len(changes) > 0 and abs(changes[at]) > MIN_CLOCK_STEP_S
    step = (float(changes[at]), float(seconds[at + 1])) if stepped else (0.0, 0.0)
    extremes = float(offsets.min()), float(offsets.max())
    return ClockOffset(float(middle), float(low), float(high), *extremes, 1e6 * slope, *step)
