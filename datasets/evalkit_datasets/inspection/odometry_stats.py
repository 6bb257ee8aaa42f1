"""What an odometry is worth: how far it goes, where it jumps, whether it moves as wheels do, and as the scans do."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.inspection.streams import LaserStream, OdometryStream
from evalkit_datasets.inspection.timing import ClockOffset, StreamTiming, measure_clock_offset, measure_timing

STILL = (0.005, 0.005)
"""Slower than this (m/s, rad/s) is standing."""

FASTEST = (3.0, 2.0 * math.pi)
"""No robot that carries a 2D lidar indoors is faster (m/s, rad/s): a step that needs more is a jump."""

MIN_JUMP = (0.3, math.radians(20.0))
"""Smaller steps are no jumps, however short the time between two stamps."""

BIN_NS = 500_000_000
"""Speeds are taken over so long: neighbouring stamps may be a fraction of a millisecond apart."""

SIDEWAYS = 0.02
"""OdometryStream do not slip sideways by more than this share of a step; poses of filters and matchers do."""

NEVER_STILL = 0.002
"""Odometry of wheels that stand does not change in any digit; noise always does."""

MIN_STEP_M = 0.005
LISTED_JUMPS = 10


@dataclass(frozen=True, slots=True)
class Jump:
    """A step no robot makes: after the first stamp (s), how far (m) and how much turned (deg)."""

    at_s: float
    step_m: float
    turn_deg: float


@dataclass(frozen=True, slots=True)
class TwistComparison:
    """How the speeds in the messages go with the motion of the poses. ``constant``: they never change at all.

    ``scale`` and ``turn_scale``: speed of the poses by the speed told (1: they agree), nan where nothing moves.
    """

    constant: bool
    scale: float
    turn_scale: float


@dataclass(frozen=True, slots=True)
class OdometryStats:
    """One odometry. ``first`` and ``net``: where it begins, and its last pose as seen from there (m, m, deg).

    ``standing``: share of the time at less than 5 mm/s and 0.3 deg/s. ``exactly_still``: share of the steps in which
    not one digit changes. ``sideways``: median slip across the arc of a step by the median step, nan where nothing
    moves. ``median_step_m``, ``largest_turn_deg``: between neighbouring stamps.
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
    jumps: tuple[Jump, ...]
    twist: TwistComparison | None

    @property
    def like_wheels(self) -> bool:
        """Whether it moves as the wheels of a differential drive do: along arcs, and now and then not at all."""
        return not (self.sideways > SIDEWAYS and self.exactly_still < NEVER_STILL)


def measure_odometry(wheels: OdometryStream) -> OdometryStats:
    """The quality of an odometry with at least one pose."""
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    poses = wheels.poses[first]
    steps = se2.between(poses[:-1], poses[1:])
    metres, turns = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    seconds = np.diff(stamps) * 1e-9
    jumps = _jumps(stamps, metres, turns, seconds)
    _, speeds, rates = _speeds(stamps, poses)
    net = se2.between(poses[0], poses[-1])
    return OdometryStats(
        wheels.topic,
        wheels.parent,
        wheels.child,
        measure_timing(wheels.stamps_ns),
        None if wheels.recorded_ns is None else measure_clock_offset(wheels.stamps_ns, wheels.recorded_ns),
        float(metres.sum()),
        math.degrees(float(turns.sum())),
        _degrees(poses[0]),
        _degrees(net),
        _mean((np.abs(speeds) < STILL[0]) & (np.abs(rates) < STILL[1])),
        _mean((steps == 0.0).all(axis=1)),
        float(np.percentile(np.abs(speeds), 99)) if len(speeds) else 0.0,
        _sideways(steps),
        float(np.median(metres)) if len(metres) else 0.0,
        math.degrees(float(turns.max(initial=0.0))),
        len(jumps),
        tuple(sorted(jumps, key=lambda jump: -jump.step_m)[:LISTED_JUMPS]),
        _twist(wheels),
    )


@dataclass(frozen=True, slots=True)
class TurnComparison:
    """The turns of an odometry against those the scans see by themselves, over ``pairs`` pairs of scans.

    ``scale``: turn of the scans by turn of the odometry (1: they agree, -1: it turns the wrong way);
    ``spread_deg``: half of what lies between the 16th and 84th percentile of the difference.
    """

    pairs: int
    scale: float
    spread_deg: float


LONGEST_S = 3.0
MAX_SHIFT = 0.25
"""Walls move by distance over range in a scan: pairs are taken where that is less than this share of the turn."""

MIN_TURN = math.radians(3.0)
MAX_TURN = math.radians(35.0)
MAX_PAIRS = 200
MIN_PAIRS = 8
CLIP_M = 10.0


def compare_turns(wheels: OdometryStream, laser: LaserStream) -> TurnComparison | None:
    """How the turns of both compare; None where fewer than eight pairs of scans turn on the spot.

    Turning on the spot shifts a scan along its angles: the shift with the least median difference of ranges is the
    turn, to a fraction of a beam.
    """
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    times, order = np.unique(laser.stamps_ns, return_index=True)
    inside = (times >= stamps[0]) & (times <= stamps[-1])
    times, order = times[inside], order[inside]
    if len(times) < MIN_PAIRS or len(stamps) < 2:
        return None
    poses = se2.interpolate(stamps, wheels.poses[first], times)
    middle_m = float(np.median([_middle(laser.ranges[at]) for at in order]))
    pairs = _pairs(times, poses, middle_m)
    step = float(np.median(np.diff(laser.angles)))
    said, seen = [], []
    for one, other in pairs:
        turn = _shift(laser.ranges[order[one]], laser.ranges[order[other]], step)
        if turn is not None:
            said.append(float(se2.wrap(poses[other, 2] - poses[one, 2])))
            seen.append(turn)
    if len(said) < MIN_PAIRS:
        return None
    odometry, scans = np.array(said), np.array(seen)
    low, high = np.degrees(np.percentile(scans - odometry, [16, 84]))
    return TurnComparison(len(said), float(np.median(scans / odometry)), 0.5 * float(high - low))


def _pairs(times: Stamps, poses: Floats, middle_m: float) -> list[tuple[int, int]]:
    """Scans between which the odometry turns by 3 to 35 deg nearly on the spot, within three seconds."""
    found = []
    for one in range(len(times)):
        last = int(np.searchsorted(times, times[one] + int(LONGEST_S * 1e9), side="right"))
        for other in range(one + 1, min(last, one + 12)):
            turn = abs(float(se2.wrap(poses[other, 2] - poses[one, 2])))
            if turn > MAX_TURN:
                break
            if turn >= MIN_TURN:
                moved = float(np.hypot(*(poses[other, :2] - poses[one, :2])))
                if moved <= MAX_SHIFT * turn * middle_m:
                    found.append((one, other))
                break
    return found[:: max(len(found) // MAX_PAIRS, 1)]


def _shift(one: Floats, other: Floats, step: float) -> float | None:
    """The turn (rad) that makes the second scan look most like the first, None where no turn stands out."""
    if len(one) != len(other):
        return None
    a, b = (np.where(np.isfinite(row) & (row > 0.0), np.minimum(row, CLIP_M), np.nan) for row in (one, other))
    most = min(int(MAX_TURN * 1.4 / abs(step)), len(a) // 2)
    costs = np.array([_cost(a, b, shift) for shift in range(-most, most + 1)])
    best = int(np.nanargmin(costs)) if np.isfinite(costs).any() else 0
    if not 0 < best < len(costs) - 1 or costs[best] > 0.5 * np.nanmedian(costs):
        return None
    left, middle, right = costs[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    fine = 0.5 * (left - right) / bend if bend > 0.0 else 0.0
    return float((best - most + fine) * step)


def _middle(ranges: Floats) -> float:
    plain = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    return float(np.median(plain)) if len(plain) else 0.0


def _cost(one: Floats, other: Floats, shift: int) -> float:
    """The median difference where direction i of the second is direction i + shift of the first."""
    a = one[shift:] if shift >= 0 else one[:shift]
    b = other[: len(other) - shift] if shift >= 0 else other[-shift:]
    apart = np.abs(a - b)
    known = np.isfinite(apart)
    return float(np.median(apart[known])) if known.sum() >= 20 else float("nan")


def _jumps(stamps: Stamps, metres: Floats, turns: Floats, seconds: Floats) -> list[Jump]:
    far = (metres > MIN_JUMP[0]) & (metres > FASTEST[0] * seconds)
    round_ = (turns > MIN_JUMP[1]) & (turns > FASTEST[1] * seconds)
    return [
        Jump(float(stamps[at + 1] - stamps[0]) * 1e-9, float(metres[at]), math.degrees(float(turns[at])))
        for at in np.flatnonzero(far | round_)
    ]


def _speeds(stamps: Stamps, poses: Floats) -> tuple[Stamps, Floats, Floats]:
    """Beginnings (K,) of stretches of half a second, forward speed (m/s) and rate of turning (rad/s) over each."""
    if len(stamps) < 2 or stamps[-1] - stamps[0] < 2 * BIN_NS:
        return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    length = max(BIN_NS, int(np.median(np.diff(stamps))))
    edges = np.arange(stamps[0], stamps[-1], length)
    rows = se2.interpolate(stamps, poses, edges)
    moved = se2.between(rows[:-1], rows[1:])
    return edges[:-1], moved[:, 0] / (length * 1e-9), moved[:, 2] / (length * 1e-9)


def _sideways(steps: Floats) -> float:
    """An arc that begins along x ends at y = x tan(theta / 2): what is left beside that is slip."""
    moving = np.abs(steps[:, 0]) > MIN_STEP_M
    along, across = steps[moving, 0], steps[moving, 1] - steps[moving, 0] * np.tan(0.5 * steps[moving, 2])
    return float(np.median(np.abs(across)) / np.median(np.abs(along))) if moving.sum() >= 20 else float("nan")


def _twist(wheels: OdometryStream) -> TwistComparison | None:
    if wheels.twists is None or len(wheels.twists) != len(wheels.stamps_ns):
        return None
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    told = wheels.twists[first]
    starts, speeds, rates = _speeds(stamps, wheels.poses[first])
    if not len(starts):
        return None
    middles = starts + BIN_NS // 2
    at = np.stack([np.interp(middles, stamps, column) for column in told.T], axis=-1)
    return TwistComparison(bool((told == told[0]).all()), _ratio(speeds, at[:, 0], 0.05), _ratio(rates, at[:, 1], 0.1))


def _ratio(poses: Floats, told: Floats, least: float) -> float:
    moving = (np.abs(told) > least) & (np.abs(poses) > least)
    return float(np.median(poses[moving] / told[moving])) if moving.sum() >= 5 else float("nan")


def _degrees(pose: Floats) -> tuple[float, float, float]:
    return float(pose[0]), float(pose[1]), math.degrees(float(pose[2]))


def _mean(mask: Bools) -> float:
    return float(np.mean(mask)) if len(mask) else 0.0
