"""What the ranges of a lidar tell: which values mean no return, what is invalid, and whether the robot stood still."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.inspection.streams import LaserStream

KNOWN_CODES: tuple[tuple[float, float, str], ...] = (
    (81.83, 0.005, "SICK LMS, centimetres, 13 bits"),
    (81.91, 0.005, "SICK LMS, centimetres, 13 bits"),
    (8.19, 0.012, "SICK LMS, millimetres, 13 bits"),
    (32.767, 0.0005, "15 bits of millimetres"),
    (65.535, 0.0005, "16 bits of millimetres"),
)
"""Ranges that sensors write for no return: value, tolerance (m), who."""

MIN_SHARE = 5e-4
"""A code is written for more of the beams than this."""

MIN_COUNT = 10

MIN_BEAMS = 0.05
"""A code comes from more of the scan's directions than this; a wall far away from fewer."""

EMPTY_M = 0.5
"""Ranges that mean no return lie so far above all others, or so many times above what is usual beside them."""

SPIKE = 20.0
RARE = 0.01

STILL_M = (0.02, 0.06)
"""Of a robot that stands, half the beams change by less than the one within a second, four in five by less than the
other."""

STEPS_M = (0.05, 0.01, 0.005, 0.001)


@dataclass(frozen=True, slots=True)
class NoReturnCode:
    """Values within [low, high] m that seem to mean no return: their share of the beams, and what speaks for it."""

    low_m: float
    high_m: float
    share: float
    why: str


@dataclass(frozen=True, slots=True)
class RangeStats:
    """Shares of all beams (0 to 1), and ranges (m) of those that are plain hits.

    ``codes``: finite values that seem to mean no return, whether the format says so or not. ``step_m``: the finest
    step ranges are written in, 0 where none of the usual ones. ``repeated``: scans equal to the one before.
    ``still``: share of the scans whose median beam is where it was a second before; nan where nobody can tell.
    """

    beams: tuple[int, ...]
    hits: float
    infinite: float
    nan: float
    zero: float
    negative: float
    under_minimum: float
    at_maximum: float
    beyond_maximum: float
    codes: tuple[NoReturnCode, ...]
    shortest_m: float
    median_m: float
    p99_m: float
    longest_m: float
    step_m: float
    repeated: int
    still: float

    @property
    def invalid(self) -> float:
        """Share of beams that are neither a hit nor a no-return."""
        return self.nan + self.zero + self.negative + self.under_minimum


def measure_ranges(laser: LaserStream) -> RangeStats:
    """The returns of a lidar with at least one scan."""
    everything = np.concatenate(laser.ranges)
    beams = len(everything)
    low = laser.range_min_m if np.isfinite(laser.range_min_m) else 0.0
    high = laser.range_max_m if np.isfinite(laser.range_max_m) else np.inf
    finite = np.isfinite(everything)
    positive = everything[finite & (everything > 0.0)]
    codes = find_no_return_codes(laser.ranges, high)
    plain = positive[(positive >= low) & (positive < high)]
    for code in codes:
        plain = plain[(plain < code.low_m) | (plain > code.high_m)]
    hits = np.percentile(plain, [0, 50, 99, 100]) if len(plain) else np.full(4, np.nan)
    return RangeStats(
        beams=tuple(sorted({len(row) for row in laser.ranges})),
        hits=len(plain) / beams,
        infinite=_share(np.isposinf(everything)),
        nan=_share(np.isnan(everything)),
        zero=_share(everything == 0.0),
        negative=_share(everything < 0.0),
        under_minimum=_share(finite & (everything > 0.0) & (everything < low)),
        at_maximum=_share(everything == high) if np.isfinite(high) else 0.0,
        beyond_maximum=_share(finite & (everything > high)),
        codes=codes,
        shortest_m=float(hits[0]),
        median_m=float(hits[1]),
        p99_m=float(hits[2]),
        longest_m=float(hits[3]),
        step_m=_step_m(plain),
        repeated=sum(_same(one, other) for one, other in zip(laser.ranges, laser.ranges[1:], strict=False)),
        still=_still(laser.ranges, laser.stamps_ns),
    )


def find_no_return_codes(ranges: Sequence[Floats], range_max_m: float = np.inf) -> tuple[NoReturnCode, ...]:
    """The finite values below a declared maximum that seem to mean no return, from the longest down.

    A code is frequent, comes from many directions, and either nothing lies within half a metre below it or it is
    twenty times as frequent as what lies beside it.
    """
    everything = np.concatenate(ranges)
    columns = np.concatenate([np.arange(len(row)) for row in ranges])
    usable = np.isfinite(everything) & (everything > 0.0) & (everything < range_max_m)
    values, counts = np.unique(everything[usable], return_counts=True)
    counts = np.asarray(counts, dtype=np.int64)
    if not len(values):
        return ()
    found = []
    widest = max(map(len, ranges))
    for first, last in _clusters(values, counts, max(MIN_SHARE * len(everything), MIN_COUNT)):
        within = usable & (everything >= values[first]) & (everything <= values[last])
        directions = len(np.unique(columns[within])) / widest
        why = _why(values, counts, first, last)
        if why and directions >= MIN_BEAMS:
            low, high = float(values[first]), float(values[last])
            found.append(NoReturnCode(low, high, float(within.mean()), why))
    return tuple(reversed(found))


def _clusters(values: Floats, counts: Ints, least: float) -> list[tuple[int, int]]:
    """First and last index of each frequent value; values above all others that lie close together are one."""
    top = len(values) - 1
    while top > 0 and values[-1] - values[top - 1] < EMPTY_M:
        top -= 1
    isolated = top > 0 and values[top] - values[top - 1] > EMPTY_M
    while isolated and counts[top] < RARE * counts[top:].sum():  # a range that happens to be as long
        top += 1
    grouped = [(top, len(values) - 1)] if isolated and counts[top:].sum() >= least else []
    single = [(int(at), int(at)) for at in np.flatnonzero(counts >= least) if not (grouped and at >= top)]
    return single + grouped


def _why(values: Floats, counts: Ints, first: int, last: int) -> str:
    """What speaks for a no-return, "" where nothing does."""
    known = next((who for value, off, who in KNOWN_CODES if np.abs(values[[first, last]] - value).max() <= off), "")
    above = counts[last + 1 :].sum()
    below_m = float(
        values[first] - values[: max(first, 1)][counts[: max(first, 1)] > RARE * counts[first]].max(initial=0.0)
    )
    if above == 0 and first > 0 and below_m > EMPTY_M:
        return known or f"nothing as frequent lies within {below_m:.1f} m below it"
    near = (np.abs(values - values[first]) < EMPTY_M) & (np.arange(len(values)) != first)
    usual = float(np.median(counts[near])) if near.sum() >= 3 else 0.0
    frequent = usual > 0.0 and counts[first] > SPIKE * usual
    if frequent and (known or above < counts[first]):
        return known or f"{counts[first] / usual:.0f} times as frequent as the values beside it"
    return ""


def _step_m(plain: Floats) -> float:
    """The coarsest usual step nearly all ranges are multiples of (single precision leaves a few micrometres)."""
    some = plain[:: max(len(plain) // 20_000, 1)]
    for step in STEPS_M:
        if len(some) and np.mean(np.abs(some / step - np.round(some / step)) * step < 2e-5) > 0.995:
            return step
    return 0.0


def _still(ranges: Sequence[Floats], stamps_ns: Stamps) -> float:
    before = np.searchsorted(stamps_ns, stamps_ns - 10**9, side="right") - 1
    seen = []
    for now, then in enumerate(before):
        if 0 <= then < now and len(ranges[now]) == len(ranges[then]):
            both = np.isfinite(ranges[now]) & np.isfinite(ranges[then])
            if both.sum() >= 20:
                change = np.percentile(np.abs(ranges[now][both] - ranges[then][both]), [50, 80])
                seen.append(bool((change < STILL_M).all()))
    return float(np.mean(seen)) if seen else float("nan")


def _same(one: Floats, other: Floats) -> bool:
    return len(one) == len(other) and bool(np.array_equal(one, other, equal_nan=True))


def _share(mask: Bools) -> float:
    return float(np.mean(mask))
