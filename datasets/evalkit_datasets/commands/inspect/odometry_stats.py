"""Measure the quality of odometry: path, jumps, wheel-like motion, and agreement with the speeds of its messages."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.commands.inspect.odometry_unit import LengthComparison, LengthUnit
from evalkit_datasets.commands.inspect.streams import OdometryStream
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
    ``fastest_m_s``, ``fastest_deg_s``: 99th percentile of the speeds and of the yaw rates.
    ``driving_m_s``: median speed while it moves, 0 if it never does. ``unit``: of its lengths if they are not metres.
    ``median_step_m``, ``largest_turn_deg``: between consecutive stamps. ``taken_out``: how many of the ``jump_count``
    jumps the reader takes out; ``jumps``: some of them, first those that it does not, the longest first.
    ``clock_shift_s``: to add to the stamps of the scans where they are of another clock by the times of recording.
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
    fastest_deg_s: float = 0.0
    driving_m_s: float = 0.0
    unit: LengthUnit | None = None
    lengths: LengthComparison | None = None
    clock_shift_s: float = 0.0

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
    driving = np.abs(speeds)[np.abs(speeds) > STANDING[0]]
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
        math.degrees(float(np.percentile(np.abs(rates), 99))) if len(rates) else 0.0,
        float(np.median(driving)) if len(driving) else 0.0,
    )


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
