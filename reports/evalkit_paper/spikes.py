"""Find spikes of a residual, their duration, and the event that each belongs to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats

ROBUST = 1.4826
"""Ratio of standard deviation to median absolute deviation of a normal distribution."""

SPIKE_SIGMAS = 5.0
STEADY_SIGMAS = 2.0
MAX_DELAY_S = 1.0
"""Time (s) after an event within which a spike is assigned to it."""


@dataclass(frozen=True, slots=True)
class Band:
    """Steady range of a residual: median and robust standard deviation (m)."""

    median: float
    sigma: float

    @property
    def spike(self) -> float:
        """Level that a spike exceeds."""
        return self.median + SPIKE_SIGMAS * self.sigma

    @property
    def steady(self) -> float:
        """Level below which a spike has ended."""
        return self.median + STEADY_SIGMAS * self.sigma


@dataclass(frozen=True, slots=True)
class Spike:
    """Scans [first, last] above the steady level, at least one of them above the spike level.

    ``peak``: index of the highest value; ``height``: that value; ``ended``: whether the residual returned to the band.
    """

    first: int
    last: int
    peak: int
    height: float
    ended: bool


def compute_band(values: Floats, calm: Bools) -> Band:
    """Compute the band of the calm values among (N,), ignoring nan. Raises ValueError if none is calm."""
    chosen = values[calm & np.isfinite(values)]
    if not len(chosen):
        raise ValueError("calm: no scan of the drive is calm")
    median = float(np.median(chosen))
    return Band(median, ROBUST * float(np.median(np.abs(chosen - median))))


def find_spikes(values: Floats, steady: Band) -> tuple[Spike, ...]:
    """Find the spikes of values (N,), in order; nan is not a spike."""
    found = []
    for first, last in find_runs(values > steady.steady):
        peak = first + int(np.argmax(values[first : last + 1]))
        if values[peak] > steady.spike:
            found.append(Spike(first, last, peak, float(values[peak]), last + 1 < len(values)))
    return tuple(found)


def belongs_to(spike: Spike, times_s: Floats, event: tuple[float, float]) -> bool:
    """Whether a spike belongs to an event [begin, end] (s).

    It peaks between the scan before the event and ``MAX_DELAY_S`` after it.
    """
    period = float(np.median(np.diff(times_s)))
    return bool(event[0] - period <= times_s[spike.peak] <= event[1] + MAX_DELAY_S)


def duration_s(spike: Spike, times_s: Floats) -> float:
    """Time (s) until the residual returns to the steady band, or until the end of the drive if it does not."""
    return float(times_s[min(spike.last + 1, len(times_s) - 1)] - times_s[spike.first])


def find_runs(marked: Bools) -> Iterator[tuple[int, int]]:
    """First and last index of every run of True in (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    yield from zip(edges[0::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)


def find_events(times_s: Floats, marked: Bools) -> list[tuple[float, float]]:
    """Begin and end (s) of every run of True."""
    return [(float(times_s[first]), float(times_s[last])) for first, last in find_runs(marked)]
