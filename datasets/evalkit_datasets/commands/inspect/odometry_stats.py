"""Measure the quality of odometry: path, jumps, wheel-like motion, and agreement with twists and scans."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.commands.inspect.mounting_angle import estimate_motion
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, interpolate_odometry
from evalkit_datasets.commands.inspect.timing import (
    ClockOffset,
    StreamTiming,
    measure_clock_offset,
    measure_timing,
    seconds_since_first,
)
from evalkit_datasets.readers.reader_common import are_jumps, are_large_jumps

STANDING = (0.005, 0.005)
"""Speeds (m/s, rad/s) below this are standing."""

MAX_SPEED = (3.0, 2.0 * math.pi)
"""Larger speeds (m/s, rad/s) are implausible indoors: such a step is a jump."""

MIN_JUMP = (0.3, math.radians(20.0))
"""Smaller steps (m, rad) are not jumps, however short the time between two stamps."""

BIN_NS = 500_000_000
"""Interval over which speeds are measured: consecutive stamps may differ by a fraction of a millisecond."""

MAX_SIDEWAYS = 0.02
"""Wheels slip sideways by less than this share of a step; poses of filters and scan matchers by more."""

MIN_STILL = 0.002
"""Share of exactly equal poses expected of wheels that stand at times; noisy poses are never equal."""

MIN_STEP_M = 0.005

MAX_ARC_M = 0.3
"""A robot driven by wheels may change its curvature within longer steps, so that they do not lie on an arc."""

MAX_LISTED_JUMPS = 10


@dataclass(frozen=True, slots=True)
class Jump:
    """An implausible step: time after the first stamp (s), distance (m) and rotation (deg).

    ``taken_out``: so large that the reader takes it out.
    """

    at_s: float
    step_m: float
    turn_deg: float
    taken_out: bool


@dataclass(frozen=True, slots=True)
class TwistComparison:
    """The speeds in odometry messages compared with the motion of the poses.

    ``constant``: the speeds never change. ``scale`` and ``turn_scale``: speed of the poses divided by the speed in the
    messages (1: they agree), nan without motion.
    """

    constant: bool
    scale: float
    turn_scale: float


@dataclass(frozen=True, slots=True)
class OdometryStats:
    """Statistics of one odometry. ``first``: its first pose; ``net``: the last pose relative to it (m, m, deg).

    ``standing``: share of the time below 5 mm/s and 0.3 deg/s. ``exactly_still``: share of steps between equal poses.
    ``sideways``: median slip perpendicular to the arc of a step, divided by the median step, nan without motion.
    ``median_step_m``, ``largest_turn_deg``: between consecutive stamps. ``taken_out``: how many of the ``jump_count``
    jumps the reader takes out; ``jumps``: some of them, first those that it does not, the longest first.
    """

    topic: str
    parent: str
    child: str
    timing: StreamTiming
    clock: ClockOffset | None
    path_m: float
    turned_deg: float
    first: tuple[float, float, float]
    net: tuple[float, float, float]
    standing: float
    exactly_still: float
    fastest_m_s: float
    sideways: float
    median_step_m: float
    largest_turn_deg: float
    jump_count: int
    taken_out: int
    jumps: tuple[Jump, ...]
    twist: TwistComparison | None

    @property
    def like_wheels(self) -> bool:
        """Whether the motion is that of a differential drive: along arcs, with exact standstills."""
        return not (self.sideways > MAX_SIDEWAYS and self.exactly_still < MIN_STILL)


def measure_odometry(wheels: OdometryStream) -> OdometryStats:
    """Return the statistics of an odometry with at least one pose."""
    timing = measure_timing(wheels.stamps_ns)
    # poses with equal stamps are all on the path; where most stamps are equal, only the order of the file is usable
    order = np.argsort(wheels.stamps_ns, kind="stable") if timing.usable else np.arange(len(wheels.stamps_ns))
    poses = wheels.poses[order]
    steps = se2.between(poses[:-1], poses[1:])
    metres, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    jumps = _find_jumps(wheels.stamps_ns[order], metres, turns) if timing.usable else []
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    _, speeds, rates = _measure_speeds(stamps, wheels.poses[first])
    net = se2.between(poses[0], poses[-1])
    return OdometryStats(
        wheels.topic,
        wheels.parent,
        wheels.child,
        timing,
        None if wheels.recorded_ns is None else measure_clock_offset(wheels.stamps_ns, wheels.recorded_ns),
        float(metres.sum()),
        math.degrees(float(turns.sum())),
        _pose_in_degrees(poses[0]),
        _pose_in_degrees(net),
        _mean_or_zero((np.abs(speeds) < STANDING[0]) & (np.abs(rates) < STANDING[1])),
        _mean_or_zero((steps == 0.0).all(axis=1)),
        float(np.percentile(np.abs(speeds), 99)) if len(speeds) else 0.0,
        _measure_sideways(steps),
        float(np.median(metres)) if len(metres) else 0.0,
        math.degrees(float(turns.max(initial=0.0))),
        len(jumps),
        sum(jump.taken_out for jump in jumps),
        tuple(sorted(jumps, key=lambda jump: (jump.taken_out, -jump.step_m))[:MAX_LISTED_JUMPS]),
        _compare_twist(wheels),
    )


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

    @property
    def differs(self) -> bool:
        """Whether the scans rotate more than 15 % more or less than the odometry, or against it, beyond chance."""
        low, high = self.interval
        return high < 0.0 if self.driving else high < 1.0 - SAME_SCALE or low > 1.0 + SAME_SCALE


MIN_SHIFT_S = 0.08
"""A smaller difference of times is that of half a sweep, or no visible distance."""

SHIFTS_S = np.arange(-1.0, 1.005, 0.01)
RESAMPLES = 200
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

    It is that of the smallest median difference, nan beyond 1 s; the interval is that of resampled pairs, from 2.5 to
    97.5 %.
    """
    known = {pair: turn for pair, turn in turns.items() if turn is not None}
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    heading = np.unwrap(wheels.poses[first, 2])
    ones, others = ((times[list(at)] - stamps[0]) * 1e-9 for at in zip(*known, strict=True))
    late = SHIFTS_S[:, None]
    at, begin, end = (stamps - stamps[0]) * 1e-9, ones + late, others + late
    turned = np.interp(end, at, heading) - np.interp(begin, at, heading)
    apart = np.abs(turned - np.array(list(known.values())))
    picks = np.random.default_rng(0).integers(0, apart.shape[1], (RESAMPLES, apart.shape[1]))
    drawn = [SHIFTS_S[int(np.median(apart[:, pick], axis=1).argmin())] for pick in picks]
    best = SHIFTS_S[int(np.median(apart, axis=1).argmin())]
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


def _find_jumps(stamps: Stamps, metres: Floats, turns: Floats) -> list[Jump]:
    """Return the implausible steps between sorted times; steps without a time between them are none."""
    times = seconds_since_first(stamps)
    seconds = np.diff(times)
    moved = np.column_stack([metres, turns])
    jumps, large = are_jumps(moved, seconds, MIN_JUMP, MAX_SPEED), are_large_jumps(moved, seconds)
    return [
        Jump(float(times[at + 1]), float(metres[at]), math.degrees(float(turns[at])), bool(large[at]))
        for at in np.flatnonzero(jumps & (seconds > 0.0))
    ]


def _measure_speeds(stamps: Stamps, poses: Floats) -> tuple[Stamps, Floats, Floats]:
    """Return starts (K,) of intervals of half a second, forward speed (m/s) and yaw rate (rad/s) in each.

    Only intervals that contain a pose are used: at most as many as there are poses, however far apart their times are.
    """
    none = np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    times = seconds_since_first(stamps)
    length = max(BIN_NS * 1e-9, float(np.median(np.diff(times)))) if len(stamps) > 1 else 0.0
    if len(stamps) < 2 or times[-1] < 2.0 * length:
        return none
    begins = stamps[0] + np.unique((times / length).astype(np.int64)) * np.int64(length * 1e9)
    begins = begins[begins + np.int64(length * 1e9) < stamps[-1]]
    if not len(begins):
        return none
    ends = begins + np.int64(length * 1e9)
    moved = se2.between(se2.interpolate(stamps, poses, begins), se2.interpolate(stamps, poses, ends))
    return begins, moved[:, 0] / length, moved[:, 2] / length


def _measure_sideways(steps: Floats) -> float:
    """Return the median slip: the deviation from an arc that starts along x and ends at y = x tan(theta / 2).

    It is nan if the median step is longer than ``MAX_ARC_M``: between such poses wheels do not drive a single arc.
    """
    moving = np.abs(steps[:, 0]) > MIN_STEP_M
    if moving.any() and np.median(np.abs(steps[moving, 0])) > MAX_ARC_M:
        return float("nan")
    along, across = steps[moving, 0], steps[moving, 1] - steps[moving, 0] * np.tan(0.5 * steps[moving, 2])
    return float(np.median(np.abs(across)) / np.median(np.abs(along))) if moving.sum() >= 20 else float("nan")


def _compare_twist(wheels: OdometryStream) -> TwistComparison | None:
    if wheels.twists is None or len(wheels.twists) != len(wheels.stamps_ns):
        return None
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    twists = wheels.twists[first]
    starts, speeds, rates = _measure_speeds(stamps, wheels.poses[first])
    if not len(starts):
        return None
    middles = starts + BIN_NS // 2
    at = np.stack([np.interp(middles, stamps, column) for column in twists.T], axis=-1)
    return TwistComparison(
        bool((twists == twists[0]).all()), _median_ratio(speeds, at[:, 0], 0.05), _median_ratio(rates, at[:, 1], 0.1)
    )


def _median_ratio(of_poses: Floats, of_twists: Floats, minimum: float) -> float:
    moving = (np.abs(of_twists) > minimum) & (np.abs(of_poses) > minimum)
    return float(np.median(of_poses[moving] / of_twists[moving])) if moving.sum() >= 5 else float("nan")


def _pose_in_degrees(pose: Floats) -> tuple[float, float, float]:
    return float(pose[0]), float(pose[1]), math.degrees(float(pose[2]))


def _mean_or_zero(mask: Bools) -> float:
    return float(np.mean(mask)) if len(mask) else 0.0
