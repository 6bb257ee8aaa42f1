"""Findings on the odometries of a recording, and on what they tell of its scans: times, turns, mirrored angles."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from evalkit_datasets.commands.inspect.finding import (
    FIELDS,
    MAX_OFFSET_S,
    InspectionFinding,
    format_count,
    note,
    problem,
    warning,
)
from evalkit_datasets.commands.inspect.frame_tree import FrameTree
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.log_streams import SCAN_POSES
from evalkit_datasets.commands.inspect.odometry_stats import OdometryStats
from evalkit_datasets.commands.inspect.odometry_unit import LengthUnit
from evalkit_datasets.commands.inspect.streams import RecordingStreams
from evalkit_datasets.commands.inspect.turn_comparison import TurnComparison
from evalkit_datasets.parsing.columns_layout import LENGTH_UNITS

MAX_SCAN_STEP_M = 0.4
DIRECTION = "direction of the angles"
STAMPS = "stamps of the scans"

MAX_VIEW_ERROR_DEG = 30.0
"""Error of a field of view that follows from turns of the odometry."""

DIRECTION_REMEDIES = {
    "rosbag": f"give --set '{FIELDS} clockwise'",
    "columns": "write clockwise = true in [scan] of the layout",
}
"""How the direction of the angles is stated, by reader; other formats define it."""

UNIT_REMEDIES = {
    "rosbag": "give --set odometry_unit={unit}",
    "columns": 'write unit = "{unit}" in [pose] of the layout, or check wheel_diameter_m in [ticks]',
}
"""How the unit of an odometry is stated, by reader; other formats define it."""

MIN_STANDING, MAX_STILL_OF_MOVING = 0.99, 0.5
"""An odometry that stands for a larger share of the time contradicts scans of which a smaller share does not change."""


def check_scan_steps(odometries: Sequence[OdometryStats], streams: RecordingStreams) -> Iterator[InspectionFinding]:
    """Check the motion between scans by the poses in a log."""
    for one in odometries:
        if one.topic == SCAN_POSES and one.median_step_m > MAX_SCAN_STEP_M:
            what = f"{one.median_step_m:.2f} m apart (median), rotated by up to {one.largest_turn_deg:.0f} deg"
            yield warning("scans", what, "large for a registration without a prior")
        elif streams.poses_from and one.timing.backwards:
            yield note(one.topic, f"stamps decrease {one.timing.backwards} times")


def check_odometry(
    odometries: Sequence[OdometryStats], turns: Mapping[str, TurnComparison], streams: RecordingStreams
) -> Iterator[InspectionFinding]:
    """Report what is wrong or notable with each odometry, and if there is none."""
    if not odometries and streams.lasers:
        yield warning(
            "odometry", "no wheel odometry in it, or one that stands still", "the initial guess is constant velocity"
        )
    for one in () if streams.poses_from else odometries:
        about = f"odometry {one.topic}" + (f" ({one.child})" if one.topic == "tf" else "")
        yield from (
            _check_motion(one, about, streams.reader)
            if one.unit is None
            else _check_unit(one.unit, about, streams.reader)
        )
        yield from _check_lengths(one, about, streams.reader)
        yield from _check_twist(one, about)
        yield from _check_turning(turns.get(f"{one.topic} {one.child}"), about, streams.reader)


def check_standing(lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats]) -> Iterator[InspectionFinding]:
    """Warn of an odometry that stands still while the scans of a lidar change."""
    still = min((lidar.returns.still for lidar in lidars if math.isfinite(lidar.returns.still)), default=1.0)
    if still > MAX_STILL_OF_MOVING:
        return
    for one in odometries:
        if one.standing > MIN_STANDING:
            what = f"stands still, but {100 * (1 - still):.0f} % of the scans change within a second: the robot moves"
            yield warning(f"odometry {one.topic}", what, "use odometry = 'none', or the topic of the real odometry")


def is_apart(lidar: LidarStats, odometry: OdometryStats) -> bool:
    """Return whether no scan lies within the times of an odometry."""
    scans, poses = lidar.timing, odometry.timing
    return scans.usable and (poses.last_ns < scans.first_ns or scans.last_ns < poses.first_ns)


def check_clocks(lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats]) -> Iterator[InspectionFinding]:
    """Report an odometry whose times are not those of the scans: a problem if there is no other."""
    apart = {at: what for at, one in enumerate(odometries) if (what := _describe_other_clock(lidars, one))}
    for at, what in apart.items():
        one = odometries[at]
        shift_s = f"{one.clock_shift_s:.2f}"
        mend = f"give --set stamp_shift_s={shift_s}, or record" if one.clock_shift_s else "record"
        if len(apart) == len(odometries):
            none = "the scans have no wheel odometry; " if _is_apart_of_all(lidars, one) else ""
            value = ("stamp_shift_s", float(shift_s)) if one.clock_shift_s else None
            yield problem(f"odometry {one.topic}", what, f"{none}{mend} with one clock", value)
        else:
            yield warning(f"odometry {one.topic}", what, f"use another odometry, or {mend} with one clock")


def _is_apart_of_all(lidars: Sequence[LidarStats], odometry: OdometryStats) -> bool:
    return bool(lidars) and all(is_apart(lidar, odometry) for lidar in lidars)


def _describe_other_clock(lidars: Sequence[LidarStats], one: OdometryStats) -> str:
    """Return how the times of an odometry differ from those of the scans, "" if they do not."""
    if _is_apart_of_all(lidars, one):
        apart_s = (one.timing.first_ns - lidars[0].timing.first_ns) * 1e-9
        side = "after" if apart_s > 0 else "before"
        return f"by its stamps it begins {abs(apart_s):.0f} s {side} the scans, and covers none of them: two clocks?"
    if not one.clock_shift_s:
        return ""
    side = "ahead of" if one.clock_shift_s > 0 else "behind"
    shift_s = abs(one.clock_shift_s)
    return f"by the times of recording, its stamps are {shift_s:.2f} s {side} those of the scans: two clocks"


def _check_motion(one: OdometryStats, about: str, reader: str) -> Iterator[InspectionFinding]:
    if not one.like_wheels:
        what = (
            f"sideways slip is {100 * one.sideways:.1f} % of a step, without exact standstills: not wheels of a "
            "differential drive, but poses of a filter or scan matcher (or an omnidirectional base)"
        )
        yield warning(about, what, "use odometry = 'none' unless it is known to be wheel odometry")
    heading = 'if its headings are in deg, write heading_unit = "deg" in [pose]; else ' if reader == "columns" else ""
    if left := one.jump_count - one.taken_out:
        what = f"{_describe_jumps(one, left, taken_out=False)}: a guess across a jump is wrong"
        advice = f"{heading}cut the recording there (start, limit), or use odometry = 'none'"
        yield InspectionFinding("problem" if one.like_wheels else "warning", about, what, advice)
    if one.taken_out:
        jumps = _describe_jumps(one, one.taken_out, taken_out=True)
        what = f"{jumps}: taken out when the recording is read, as if the robot had stood meanwhile"
        yield warning(about, what, f"{heading}cut the recording there (start, limit) if it moved")
    if one.timing.gap_count and one.timing.gaps[0].length_s > 1.0:
        what = f"{format_count(one.timing.gap_count, 'gap')}, the longest {one.timing.gaps[0].length_s:.2f} s"
        yield note(about, f"{what}; poses in between are interpolated")
    if math.hypot(*one.first[:2]) > 0.5:
        x, y, theta = one.first
        yield note(about, f"starts at ({x:.2f}, {y:.2f}) m, {theta:.0f} deg instead of the origin")


def _check_unit(found: LengthUnit, about: str, reader: str) -> Iterator[InspectionFinding]:
    """Report lengths that are not in metres; jumps, slip and gaps are not judged then."""
    if found.unit:
        share = round(1.0 / LENGTH_UNITS[found.unit])
        what = f"its lengths are in {found.unit}, not in m: the scans move {share} times less"
    else:
        what = "it drives faster than any vehicle with a 2D lidar: mm or cm taken for m?"
    advice = UNIT_REMEDIES.get(reader, "convert its poses to m, or use odometry = 'none'")
    what = f"{what} ({found.driving_m_s:.0f} m/s, median)"
    mend = ("odometry_unit", found.unit) if found.unit else None
    yield problem(about, what, advice.format(unit=found.unit or "mm"), mend)


def _check_lengths(one: OdometryStats, about: str, reader: str) -> Iterator[InspectionFinding]:
    """Report lengths in an unknown unit, or of a wrong wheel diameter."""
    if one.lengths is None or not one.lengths.differs:
        return
    seen = f"the scans move {one.lengths.scale:.2f} times as far as it does on {one.lengths.pairs} straight drives"
    advice = "check wheel_diameter_m in [ticks], or multiply its lengths" if reader == "columns" else "record it in m"
    what = f"{seen}: lengths in another unit, or a wrong wheel diameter"
    yield problem(about, what, f"{advice}, or use odometry = 'none'")


def _describe_jumps(one: OdometryStats, count: int, taken_out: bool) -> str:
    jump = next((jump for jump in one.jumps if jump.taken_out is taken_out), one.jumps[0])
    example = f"{jump.step_m:.2f} m and {jump.turn_deg:.0f} deg at {jump.at_s:.1f} s"
    return f"{format_count(count, 'jump')}, such as {example}"


def _check_turning(turn: TurnComparison | None, about: str, reader: str) -> Iterator[InspectionFinding]:
    if turn is not None and turn.differs:
        what = f"the scans rotate {turn.scale:.2f} times as much as the odometry ({turn.pairs} turns)"
        if turn.scale < 0.0:
            what = f"{what}: the lidar's angles are mirrored, or the odometry's heading"
            yield problem(about, what, DIRECTION_REMEDIES.get(reader, ""), ("fields", "clockwise"))
        else:
            yield warning(about, what, "check wheel base and clock")
    elif turn is not None and turn.spread_deg > 1.5 and not turn.driving:
        what = f"its rotations differ from those of the scans by {turn.spread_deg:.1f} deg ({turn.pairs} turns)"
        yield note(about, what, "a weak initial guess for registrations")


def check_full_turn(
    lidars: Sequence[LidarStats], turns: Mapping[str, TurnComparison], streams: RecordingStreams
) -> Iterator[InspectionFinding]:
    """Report FLASER lines, which state no angles, of a lidar that sees all around by the turns of the odometry."""
    if len(lidars) != 1 or not any(topic.name == "FLASER" for topic in streams.topics):
        return
    for turn in turns.values():
        view_deg = lidars[0].beams * lidars[0].step_deg / turn.scale if turn.scale > 0.0 else 0.0
        if turn.differs and not turn.driving and abs(view_deg - 360.0) < MAX_VIEW_ERROR_DEG:
            what = f"by {turn.pairs} turns of the odometry, {lidars[0].beams} beams see all around, not half of it"
            mend = f"--set start_deg=-180 --set step_deg={360.0 / lidars[0].beams:.6g}, or where the first beam points"
            yield problem("angles of FLASER lines", what, mend)
            return


def check_shift(
    lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats], turns: Mapping[str, TurnComparison], turned: str,
    streams: RecordingStreams,
) -> Iterator[InspectionFinding]:  # fmt: skip
    """Warn of scans whose stamps are not the times at which the odometry rotates as they do, if its clock is theirs."""
    others = {f"{one.topic} {one.child}" for one in odometries if one.clock_shift_s}
    named = ((name.split()[0], turn) for name, turn in turns.items() if turn.is_shifted and name not in others)
    odometry, turn = next(named, ("", None))
    lidar = next((one for one in lidars if one.topic == turned), None)
    if turn is None or lidar is None or lidar.is_sweep_too_long or streams.reader != "rosbag":
        return
    low, high = sorted(abs(value) for value in turn.shift_interval)
    side = "later" if turn.shift_s > 0.0 else "earlier"
    what = (
        f"by the turns of {odometry}, the scans were taken {abs(turn.shift_s):.2f} s {side} than their stamps say "
        f"({low:.2f} to {high:.2f} s, {turn.pairs} turns)"
    )
    if agreeing := [name.split()[0] for name, other in turns.items() if other.agrees_in_time]:
        yield warning(STAMPS, f"{what}, but {agreeing[0]} agrees with them", f"use --set odometry={agreeing[0]}")
        return
    if lidar.sweep_s == 0.0 and 0.0 < turn.shift_s < 0.5 * lidar.revolution_s + MAX_OFFSET_S:
        sweep = f"if the lidar turns once a scan: --set sweep_s={lidar.revolution_s:.2g}"
        yield warning(STAMPS, f"{what}: the middle of a revolution, whose time_increment is 0 or less", sweep)
        return
    mend = f"--set stamp_shift_s={turn.shift_s:.2f}"
    yield warning(STAMPS, what, f"if the stamps of the scans are wrong, not those of the odometry: {mend}")


def check_direction(streams: RecordingStreams, turned: str, tree: FrameTree) -> Iterator[InspectionFinding]:
    """Warn where neither a mounting nor a turn tells whether the angles of a lidar are mirrored.

    ``turned``: the lidar that was compared with an odometry, "" if none.
    """
    stated = {mounting.sensor for mounting in tree.mountings if not mounting.problem and not mounting.unlinked}
    unknown = [laser.topic for laser in streams.lasers if laser.frame not in stated and laser.topic != turned]
    if not unknown or streams.reader not in DIRECTION_REMEDIES:
        return
    compared = "only one lidar is compared with the odometry" if turned else "the odometry does not turn measurably"
    why = compared if streams.wheels else "there is no odometry"
    what = f"{', '.join(unknown)}: whether the angles are mirrored (a lidar upside down) could not be checked: {why}"
    yield warning(DIRECTION, what, f"where a map is a mirror image, {DIRECTION_REMEDIES[streams.reader]}")


def _check_twist(one: OdometryStats, about: str) -> Iterator[InspectionFinding]:
    if one.twist is None:
        return
    if one.twist.constant:
        yield note(about, "the speeds in its messages are constant: only its poses are usable")
        return
    for name, ratio in (("speed", one.twist.scale), ("yaw rate", one.twist.turn_scale)):
        if math.isfinite(ratio) and not 0.8 <= ratio <= 1.25:
            yield warning(about, f"its poses have {ratio:.2f} times the {name} of its messages")
