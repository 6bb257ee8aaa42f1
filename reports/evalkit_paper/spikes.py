"""What a spike of a residual is, when it is over, and what it is laid to."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats

ROBUST = 1.4826
"""Of a normal distribution: standard deviation over median absolute deviation."""

SPIKE_SIGMAS = 5.0
STEADY_SIGMAS = 2.0
SETTLES_S = 1.0
"""A spike that begins this soon after an event is laid to it."""


@dataclass(frozen=True, slots=True)
class Band:
    """Where a residual is when nothing happens: its median and robust standard deviation."""

    median: float
    sigma: float

    @property
    def spike(self) -> float:
        """What a spike exceeds."""
        return self.median + SPIKE_SIGMAS * self.sigma

    @property
    def steady(self) -> float:
        """Under what a spike is over."""
        return self.median + STEADY_SIGMAS * self.sigma


@dataclass(frozen=True, slots=True)
class Spike:
    """Scans [first, last] above the steady band, of which at least one is above the spike's limit.

    ``peak``: the highest one's index; ``height``: its value; ``over``: whether the residual came back into the band.
    """

    first: int
    last: int
    peak: int
    height: float
    over: bool


def band(values: Floats, calm: Bools) -> Band:
    """The band of the calm ones among values (N,), nan left out; ValueError if there is none."""
    chosen = values[calm & np.isfinite(values)]
    if not len(chosen):
        raise ValueError("calm: no scan of the drive is calm")
    median = float(np.median(chosen))
    return Band(median, ROBUST * float(np.median(np.abs(chosen - median))))


def spikes(values: Floats, steady: Band) -> tuple[Spike, ...]:
    """The spikes of values (N,) in their order; nan is no spike."""
    found = []
    for first, last in stretches(values > steady.steady):
        peak = first + int(np.argmax(values[first : last + 1]))
        if values[peak] > steady.spike:
            found.append(Spike(first, last, peak, float(values[peak]), last + 1 < len(values)))
    return tuple(found)


def within(spike: Spike, times_s: Floats, event: tuple[float, float]) -> bool:
    """Whether a spike is laid to an event [begin, end] (s): it peaks from the scan before until ``SETTLES_S`` after."""
    period = float(np.median(np.diff(times_s)))
    return bool(event[0] - period <= times_s[spike.peak] <= event[1] + SETTLES_S)


def lasted_s(spike: Spike, times_s: Floats) -> float:
    """How long until the residual is back in the steady band (s), to the end of the drive where it never is."""
    return float(times_s[min(spike.last + 1, len(times_s) - 1)] - times_s[spike.first])


def stretches(marked: Bools) -> Iterator[tuple[int, int]]:
    """First and last index of every run of marks in (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    yield from zip(edges[0::2].tolist(), (edges[1::2] - 1).tolist(), strict=True)


def events(times_s: Floats, marked: Bools) -> list[tuple[float, float]]:
    """When every run of marks begins and ends (s)."""
    return [(float(times_s[first]), float(times_s[last])) for first, last in stretches(marked)]
