"""Measure the ranges of a lidar: no-return codes, invalid ranges, resolution, the robot's own body, standstill."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats
from evalkit_datasets.commands.inspect.streams import LaserStream

KNOWN_CODES: tuple[tuple[float, float, str], ...] = (
    (81.83, 0.005, "SICK LMS, centimetres, 13 bits"),
    (81.91, 0.005, "SICK LMS, centimetres, 13 bits"),
    (8.19, 0.012, "SICK LMS, millimetres, 13 bits"),
    (32.767, 0.0005, "15 bits of millimetres"),
    (65.535, 0.0005, "16 bits of millimetres"),
)
"""Ranges that sensors write for no return: value (m), tolerance (m), sensor."""

MIN_SHARE = 5e-4
"""Smallest share of all beams for a no-return code."""

MIN_COUNT = 10

MIN_BEAMS = 0.05
"""Smallest share of the beam directions for a code; a distant wall is seen in fewer directions."""

MIN_CLEARANCE_M = 0.5
"""Distance of a code from all frequent ranges below it, unless it is a spike."""

MIN_SPIKE = 20.0
"""Frequency of a code relative to the ranges around it."""

RARE = 0.01
"""Share of a cluster below which a value does not belong to it."""

STILL_CHANGES = ((0.02, 0.5), (0.06, 0.8))
"""Of a robot that stands: limits (m) of the change of a range within a second, and the least share of ranges within."""

BODY_SAME_M, BODY_SHARE, MAX_BODY_M = 0.03, 0.9, 1.5
"""Of a beam that hits the robot: limit (m) of the distance of its ranges from their median, the least share of scans
with a hit and of hits within the limit, and the longest median."""

MAX_OTHERS_SAME, MIN_OTHERS_HITS = 0.5, 0.1
"""Largest share of ranges within that limit of the other beams, as their median: else the robot may stand. Beams with a
hit in fewer scans do not count."""

MIN_BODY, MIN_BODY_BEAMS, MIN_BODY_SCANS = 0.01, 3, 20
"""Least share and number of the beams that hit the robot, and least number of scans to tell."""

MAX_BODY_GAP_DEG = 5.0
"""Beams on the robot that are at most this far apart belong to one sector."""

COLUMNS = 64
"""Beams whose ranges are copied at a time."""

STEPS_M = (0.05, 0.01, 0.005, 0.001)


@dataclass(frozen=True, slots=True)
class NoReturnCode:
    """Values within [low, high] m that probably mean no return: their share of the beams and the evidence."""

    low_m: float
    high_m: float
    share: float
    why: str


@dataclass(frozen=True, slots=True)
class BodyInView:
    """Beams that always have the same range: probably the robot's own body.

    ``share``: of all beams. ``sectors_deg``: angles of the first and the last beam of each sector, in the lidar's frame
    and as its scans state them. ``nearest_m``, ``farthest_m``: the extremes of the beams' median ranges.
    """

    share: float
    sectors_deg: tuple[tuple[float, float], ...]
    nearest_m: float
    farthest_m: float

    @property
    def range_min_m(self) -> float:
        """The least range, in whole tenths of a metre, that leaves these beams out."""
        return math.ceil(round(10.0 * (round(self.farthest_m, 2) + BODY_SAME_M), 6)) / 10.0


@dataclass(frozen=True, slots=True)
class RangeStats:
    """Shares of all beams (0 to 1), and statistics of the ranges (m) that are hits.

    ``codes``: finite values that probably mean no return. ``step_m``: resolution of the ranges, 0 if it is none of the
    usual ones. ``repeated``: number of scans equal to the previous one. ``still``: share of the scans that did not
    change within a second; nan if unknown. ``body``: what the lidar sees of the robot, None if nothing.
    ``beyond_m``: median of the ranges beyond the maximum, nan without any.
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
    body: BodyInView | None
    beyond_m: float

    @property
    def invalid(self) -> float:
        """Share of beams that are neither a hit nor a no-return."""
        return self.nan + self.zero + self.negative + self.under_minimum


def measure_ranges(laser: LaserStream) -> RangeStats:
    """Return the range statistics of a lidar with at least one scan."""
    ranges_m = np.concatenate(laser.ranges)
    beams = len(ranges_m)
    low = laser.range_min_m if np.isfinite(laser.range_min_m) else 0.0
    high = laser.range_max_m if np.isfinite(laser.range_max_m) else np.inf
    finite = np.isfinite(ranges_m)
    positive = ranges_m[finite & (ranges_m > 0.0)]
    codes = find_no_return_codes(laser.ranges, high)
    plain = positive[(positive >= low) & (positive < high)]
    for code in codes:
        plain = plain[(plain < code.low_m) | (plain > code.high_m)]
    hits = np.percentile(plain, [0, 50, 99, 100]) if len(plain) else np.full(4, np.nan)
    return RangeStats(
        beams=tuple(sorted(laser.scans.beams)),
        hits=len(plain) / beams,
        infinite=_mean(np.isposinf(ranges_m)),
        nan=_mean(np.isnan(ranges_m)),
        zero=_mean(ranges_m == 0.0),
        negative=_mean(ranges_m < 0.0),
        under_minimum=_mean(finite & (ranges_m > 0.0) & (ranges_m < low)),
        at_maximum=_mean(ranges_m == high) if np.isfinite(high) else 0.0,
        beyond_maximum=_mean(finite & (ranges_m > high)),
        codes=codes,
        shortest_m=float(hits[0]),
        median_m=float(hits[1]),
        p99_m=float(hits[2]),
        longest_m=float(hits[3]),
        step_m=_find_step_m(plain),
        repeated=laser.scans.repeated,
        still=_measure_still(laser),
        body=find_body(laser, codes),
        beyond_m=float(np.median(ranges_m[finite & (ranges_m > high)])) if (ranges_m[finite] > high).any() else np.nan,
    )


def find_no_return_codes(ranges: Sequence[Floats], range_max_m: float = np.inf) -> tuple[NoReturnCode, ...]:
    """Return the finite values below a declared maximum that probably mean no return, in decreasing order.

    A code is frequent and occurs in many directions. Either no frequent range lies within 0.5 m below it, or it is
    20 times as frequent as the ranges around it.
    """
    ranges_m = np.concatenate(ranges)
    columns = np.concatenate([np.arange(len(row)) for row in ranges])
    usable = np.isfinite(ranges_m) & (ranges_m > 0.0) & (ranges_m < range_max_m)
    values, counts = np.unique(ranges_m[usable], return_counts=True)
    counts = np.asarray(counts, dtype=np.int64)
    if not len(values):
        return ()
    codes = []
    widest = max(map(len, ranges))
    for first, last in _find_clusters(values, counts, max(MIN_SHARE * len(ranges_m), MIN_COUNT)):
        if not (evidence := _find_evidence(values, counts, first, last)):
            continue
        within = usable & (ranges_m >= values[first]) & (ranges_m <= values[last])
        if len(np.unique(columns[within])) >= MIN_BEAMS * widest:
            low, high = float(values[first]), float(values[last])
            codes.append(NoReturnCode(low, high, float(within.mean()), evidence))
    return tuple(reversed(codes))


def find_body(laser: LaserStream, codes: Sequence[NoReturnCode] = ()) -> BodyInView | None:
    """Return the beams that always have the same short range while the others change, None if there are none.

    Only scans with as many beams as the first are looked at. ``codes``: ranges that mean no return.
    """
    rows = [row for row in laser.ranges if len(row) == len(laser.angles)]
    if len(rows) < MIN_BODY_SCANS:
        return None
    parts = [_measure_beams(block, laser, codes) for block in _iter_blocks(rows)]
    hits, medians_m, same = (np.concatenate(part) for part in zip(*parts, strict=True))
    fixed = (hits >= BODY_SHARE) & (same >= BODY_SHARE) & (medians_m <= MAX_BODY_M)
    others = same[~fixed & (hits >= MIN_OTHERS_HITS)]
    beams = np.flatnonzero(fixed)
    few = len(beams) < max(MIN_BODY * len(fixed), MIN_BODY_BEAMS)
    if few or not len(others) or np.median(others) > MAX_OTHERS_SAME:
        return None
    nearest, farthest = float(medians_m[beams].min()), float(medians_m[beams].max())
    return BodyInView(_mean(fixed), _find_sectors_deg(np.degrees(laser.angles[beams])), nearest, farthest)


def _iter_blocks(rows: Sequence[Floats]) -> Iterator[Floats]:
    """Yield the ranges (K, at most ``COLUMNS``) of scans (B,), some beams at a time to save memory."""
    for first in range(0, len(rows[0]), COLUMNS):
        yield np.array([row[first : first + COLUMNS] for row in rows])


def _measure_beams(block: Floats, laser: LaserStream, codes: Sequence[NoReturnCode]) -> tuple[Floats, Floats, Floats]:
    """Return of each beam the share of scans with a hit, the median range, and the share of hits close to it."""
    low, high = np.fmax(laser.range_min_m, 0.0), np.fmin(laser.range_max_m, np.inf)  # nan: not stated
    valid = (block > 0.0) & (block >= low) & (block < high)
    for code in codes:
        valid &= (block < code.low_m) | (block > code.high_m)
    counts = valid.sum(axis=0)
    ordered = np.sort(np.where(valid, block, np.inf), axis=0)
    medians = ordered[np.maximum(counts - 1, 0) // 2, np.arange(len(counts))]  # inf where there is no hit
    near = np.isfinite(ordered) & (ordered >= medians - BODY_SAME_M) & (ordered <= medians + BODY_SAME_M)
    return counts / len(block), medians, near.sum(axis=0) / np.maximum(counts, 1)


def _find_sectors_deg(angles_deg: Floats) -> tuple[tuple[float, float], ...]:
    """Return first and last angle of each group of directions (K,); one through the border of a full turn goes on."""
    ordered = np.sort(angles_deg)
    cuts = np.flatnonzero(np.diff(ordered) > MAX_BODY_GAP_DEG) + 1
    groups = [(float(part[0]), float(part[-1])) for part in np.split(ordered, cuts)]
    if len(groups) > 1 and groups[0][0] + 360.0 - groups[-1][1] <= MAX_BODY_GAP_DEG:
        groups = [*groups[1:-1], (groups[-1][0], groups[0][1] + 360.0)]
    return tuple(groups)


def _find_clusters(values: Floats, counts: Ints, min_count: float) -> list[tuple[int, int]]:
    """Return first and last index of each frequent value; isolated values at the top form one cluster."""
    top = len(values) - 1
    while top > 0 and values[-1] - values[top - 1] < MIN_CLEARANCE_M:
        top -= 1
    isolated = top > 0 and values[top] - values[top - 1] > MIN_CLEARANCE_M
    while isolated and counts[top] < RARE * counts[top:].sum():  # an ordinary range of that length
        top += 1
    grouped = [(top, len(values) - 1)] if isolated and counts[top:].sum() >= min_count else []
    single = [(int(at), int(at)) for at in np.flatnonzero(counts >= min_count) if not (grouped and at >= top)]
    return single + grouped


def _find_evidence(values: Floats, counts: Ints, first: int, last: int) -> str:
    """Return the evidence that a value means no return, "" if there is none."""
    low, high = float(values[first]), float(values[last])
    known = next((name for code, by, name in KNOWN_CODES if abs(low - code) <= by and abs(high - code) <= by), "")
    above = counts[last + 1 :].sum()
    if above == 0 and first > 0:
        below_m = low - float(values[:first][counts[:first] > RARE * counts[first]].max(initial=0.0))
        if below_m > MIN_CLEARANCE_M:
            return known or f"no frequent range within {below_m:.1f} m below it"
    near = np.searchsorted(values, (low - MIN_CLEARANCE_M, low + MIN_CLEARANCE_M))
    beside = np.concatenate([counts[near[0] : first], counts[first + 1 : near[1]]])
    usual = float(np.median(beside)) if len(beside) >= 3 else 0.0
    frequent = usual > 0.0 and counts[first] > MIN_SPIKE * usual
    if frequent and (known or above < counts[first]):
        return known or f"{counts[first] / usual:.0f} times as frequent as the values around it"
    return ""


def _find_step_m(plain: Floats) -> float:
    """Return the coarsest usual step of which 99.5 % of the ranges are multiples, within single precision."""
    sample = plain[:: max(len(plain) // 20_000, 1)]
    for step in STEPS_M:
        if len(sample) and np.mean(np.abs(sample / step - np.round(sample / step)) * step < 2e-5) > 0.995:
            return step
    return 0.0


def _measure_still(laser: LaserStream) -> float:
    ranges, numbers, stamps_ns = laser.ranges, laser.scans.numbers, laser.sample_stamps_ns
    before = np.searchsorted(stamps_ns, stamps_ns - 10**9, side="right") - 1
    unchanged = []
    for now, then in enumerate(before):
        successive = 0 <= then < now and numbers[now] - numbers[then] == now - then  # no scan between is left out
        if successive and len(ranges[now]) == len(ranges[then]):
            both = np.isfinite(ranges[now]) & np.isfinite(ranges[then])
            if both.sum() >= 20:
                change = np.abs(ranges[now][both] - ranges[then][both])
                unchanged.append(all(np.mean(change < limit_m) >= share for limit_m, share in STILL_CHANGES))
    return float(np.mean(unchanged)) if unchanged else float("nan")


def _mean(mask: Bools) -> float:
    return float(np.mean(mask))
