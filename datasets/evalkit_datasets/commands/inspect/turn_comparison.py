"""Compare the rotations of an odometry with those that the scans of a lidar show."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.commands.inspect.mounting_angle import estimate_motion
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, interpolate_odometry
from evalkit_datasets.commands.inspect.timing import seconds_since_first

MIN_SHIFT_S = 0.08
"""A smaller difference of times is that of half a sweep, or no visible distance."""

SHIFT_STEP_S = 0.01
SHIFTS_S = np.arange(-1.0, 1.005, SHIFT_STEP_S)
RESAMPLES = 200
MAX_APART = math.radians(10.0)
"""A rotation of the scans that differs by more from that of the odometry was measured wrongly."""

MAX_PAIR_S = 3.0
MAX_SHIFT = 0.25
"""Translation divided by range, as a share of the rotation: pairs that translate more are not used."""

MIN_TURN = math.radians(3.0)
MAX_TURN = math.radians(35.0)
MAX_PAIRS = 200
MIN_PAIRS = 8
MAX_FLOW_TURN, MAX_FLOW_M = math.radians(15.0), 0.4
"""Range flow is linear in the motion between two scans, which is therefore small."""

MIN_FLOW_SCALE = 0.5
"""Rotation by range flow divided by that of the odometry: less of it shows no direction."""

SAME_SCALE = 0.15
CLIP_M = 10.0
MAX_DIFFERENCES = 500_000
"""Differences of ranges in memory at a time: a scan may have very many beams."""


@dataclass(frozen=True, slots=True)
class TurnComparison:
    """The rotations of an odometry compared with those measured from ``pairs`` pairs of scans alone.

    ``scale``: median of the rotation of the scans divided by that of the odometry (1: they agree, -1: opposite
    direction); ``interval``: of that median, about 95 %, by ranks. ``spread_deg``: half the range from the 16th to the
    84th percentile of the difference. ``driving``: the robot drives between the scans, so that only the direction of
    their rotation is reliable. ``shift_s``: by how much later than its stamp a scan was taken, by the rotations of the
    odometry, and ``shift_interval``: of it, about 95 %; both from the middle of a sweep, nan if unknown.
    """

    pairs: int
    scale: float
    interval: tuple[float, float]
    spread_deg: float
    driving: bool = False
    shift_s: float = math.nan
    shift_interval: tuple[float, float] = (math.nan, math.nan)

    @property
    def is_shifted(self) -> bool:
        """Whether the times of the scans differ from those of the odometry, beyond chance."""
        low, high = self.shift_interval
        return abs(self.shift_s) >= MIN_SHIFT_S and (low > 0.5 * MIN_SHIFT_S or high < -0.5 * MIN_SHIFT_S)

    @property
    def agrees_in_time(self) -> bool:
        """Whether the times of the scans are known to be close to those of the odometry."""
        return abs(self.shift_s) < 0.5 * MIN_SHIFT_S

    def shift(self, by_s: float) -> TurnComparison:
        """Return it for scans whose stamps were ``by_s`` less."""
        low, high = self.shift_interval
        return replace(self, shift_s=self.shift_s + by_s, shift_interval=(low + by_s, high + by_s))

    @property
    def differs(self) -> bool:
        """Whether the scans rotate more than 15 % more or less than the odometry, or against it, beyond chance."""
        low, high = self.interval
        return high < 0.0 if self.driving else high < 1.0 - SAME_SCALE or low > 1.0 + SAME_SCALE


def compare_turns(wheels: OdometryStream, laser: LaserStream) -> TurnComparison | None:
    """Return the comparison of rotations, or None if fewer than eight pairs of scans rotate measurably.

    A rotation on the spot shifts a scan along its angles: the shift with the smallest median difference of ranges is
    the rotation, to a fraction of a beam. With fewer than eight of them, the range flow tells in which direction the
    scans rotate while the robot drives.
    """
    times, order, poses = interpolate_odometry(wheels, laser)
    if len(times) < MIN_PAIRS:
        return None
    middle_m = float(np.median([_median_range(laser.ranges[at]) for at in order]))
    step = float(np.median(np.diff(laser.angles)))
    pairs = _select_pairs(times, poses, MAX_TURN, lambda turn: MAX_SHIFT * middle_m * turn)
    turns = {
        (one, other): _measure_rotation(laser.ranges[order[one]], laser.ranges[order[other]], step)
        for one, other in pairs
    }
    on_spot = _compare_pairs(poses, turns)
    if on_spot is None:
        return _compare_while_driving(laser, times, order, poses)
    if on_spot.differs:
        return on_spot
    middle_s = 0.5e-9 * laser.time_increment_ns * (len(laser.angles) - 1)
    shift_s, *interval = _measure_shift(wheels, times, turns) - middle_s
    return replace(on_spot, shift_s=float(shift_s), shift_interval=(float(interval[0]), float(interval[1])))


def _measure_shift(wheels: OdometryStream, times: Stamps, turns: Mapping[tuple[int, int], float | None]) -> Floats:
    """Return the time (s) to add to those of the scans so that the odometry rotates alike, and its interval (3,).

    It is that of the smallest mean difference, nan beyond 1 s; the interval is that of resampled pairs, from 2.5 to
    97.5 %. Most pairs lie within a turn at a constant rate, and tell nothing: a median would leave out those that do.
    """
    known = {pair: turn for pair, turn in turns.items() if turn is not None}
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    heading = np.unwrap(wheels.poses[first, 2])
    ones, others = ((times[list(at)] - stamps[0]) * 1e-9 for at in zip(*known, strict=True))
    late = SHIFTS_S[:, None]
    at, begin, end = (stamps - stamps[0]) * 1e-9, ones + late, others + late
    turned = np.interp(end, at, heading) - np.interp(begin, at, heading)
    apart = np.minimum(np.abs(turned - np.array(list(known.values()))), MAX_APART)
    picks = np.random.default_rng(0).integers(0, apart.shape[1], (RESAMPLES, apart.shape[1]))
    drawn = [SHIFTS_S[int(apart[:, pick].mean(axis=1).argmin())] for pick in picks]
    best = SHIFTS_S[int(apart.mean(axis=1).argmin())]
    inside = SHIFTS_S[0] < best < SHIFTS_S[-1]
    return np.array([best if inside else math.nan, *np.percentile(drawn, [2.5, 97.5])])


def _compare_while_driving(laser: LaserStream, times: Stamps, order: Ints, poses: Floats) -> TurnComparison | None:
    """Return the comparison of rotations by range flow, None if it shows no direction beyond chance."""
    turns: dict[tuple[int, int], float | None] = {}
    for one, other in _select_pairs(times, poses, MAX_FLOW_TURN, lambda _turn: MAX_FLOW_M):
        seen = estimate_motion(laser.ranges[order[one]], laser.ranges[order[other]], laser.angles)
        turns[one, other] = None if seen is None else float(seen[2])
    found = _compare_pairs(poses, turns)
    if found is None or found.interval[0] <= 0.0 <= found.interval[1] or abs(found.scale) < MIN_FLOW_SCALE:
        return None
    return replace(found, driving=True)


def _compare_pairs(poses: Floats, turns: Mapping[tuple[int, int], float | None]) -> TurnComparison | None:
    """Return the comparison with the rotations (rad) between pairs of scans, None if fewer than eight are known."""
    known = {pair: turn for pair, turn in turns.items() if turn is not None}
    if len(known) < MIN_PAIRS:
        return None
    ones, others = np.array(list(known)).T
    odometry, scans = se2.wrap(poses[others, 2] - poses[ones, 2]), np.array(list(known.values()))
    low, high = np.degrees(np.percentile(scans - odometry, [16, 84]))
    ratios = np.sort(scans / odometry)
    rank = int(0.5 * len(ratios) - math.sqrt(len(ratios)))  # Conover 1999, section 3.2: normal approximation
    interval = float(ratios[rank]), float(ratios[-1 - rank])
    return TurnComparison(len(ratios), float(np.median(ratios)), interval, 0.5 * float(high - low))


def _select_pairs(
    times: Stamps, poses: Floats, max_turn: float, max_moved_m: Callable[[float], float]
) -> list[tuple[int, int]]:
    """Return pairs of scans within 3 s between which the odometry rotates by 3 deg to ``max_turn`` (rad).

    ``max_moved_m(turn)``: its largest translation (m) in a turn (rad). No two pairs overlap: each is a turn of its own,
    and an odometry that lags in a single turn is no wrong scale.
    """
    pairs: list[tuple[int, int]] = []
    seconds = seconds_since_first(times)
    for one in range(len(times)):
        if pairs and one < pairs[-1][1]:
            continue
        last = int(np.searchsorted(seconds, seconds[one] + MAX_PAIR_S, side="right"))
        for other in range(one + 1, min(last, one + 12)):
            turn = abs(float(se2.wrap(poses[other, 2] - poses[one, 2])))
            if turn > max_turn:
                break
            if turn >= MIN_TURN:
                moved = float(np.hypot(*(poses[other, :2] - poses[one, :2])))
                if moved <= max_moved_m(turn):
                    pairs.append((one, other))
                break
    return pairs[:: max(len(pairs) // MAX_PAIRS, 1)]


def _measure_rotation(one: Floats, other: Floats, step: float) -> float | None:
    """Return the rotation (rad) that aligns the second scan with the first, None without a distinct minimum."""
    if len(one) != len(other):
        return None
    a, b = (np.where(np.isfinite(row) & (row > 0.0), np.minimum(row, CLIP_M), np.nan) for row in (one, other))
    max_shift = min(int(MAX_TURN * 1.4 / abs(step)), len(a) // 2)
    costs = _shift_costs(a, b, max_shift)
    best = int(np.nanargmin(costs)) if np.isfinite(costs).any() else 0
    if not 0 < best < len(costs) - 1 or costs[best] > 0.5 * np.nanmedian(costs):
        return None
    left, middle, right = costs[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    fine = 0.5 * (left - right) / curvature if curvature > 0.0 else 0.0
    return float((best - max_shift + fine) * step)


def _median_range(ranges: Floats) -> float:
    plain = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    return float(np.median(plain)) if len(plain) else 0.0


def _shift_costs(one: Floats, other: Floats, max_shift: int) -> Floats:
    """Return the median range differences with beam i of the second scan compared to beam i + shift of the first.

    The shifts are all from -max_shift to max_shift; NaN for a shift with fewer than 20 common beams.
    """
    shifted = sliding_window_view(np.pad(one, max_shift, constant_values=np.nan), len(other))
    blocks = np.array_split(shifted, shifted.size // MAX_DIFFERENCES + 1)
    return np.concatenate([_median_differences(block, other) for block in blocks if len(block)])


def _median_differences(rows: Floats, other: Floats) -> Floats:
    """Return the median difference between each row and the other scan; NaN for fewer than 20 common beams."""
    apart = np.sort(np.abs(rows - other), axis=1)  # unknown differences last
    known = np.isfinite(apart).sum(axis=1)
    middle = np.stack([(known - 1) // 2, known // 2], axis=1)
    return np.where(known >= 20, np.take_along_axis(apart, middle, axis=1).mean(axis=1), np.nan)
