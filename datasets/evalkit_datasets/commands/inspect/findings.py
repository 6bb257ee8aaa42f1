"""Findings of the inspection: defects and notable properties of a recording, and what to do about them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from evalkit_datasets.commands.inspect.frame_tree import FrameTree
from evalkit_datasets.commands.inspect.log_streams import SCAN_POSES
from evalkit_datasets.commands.inspect.odometry_stats import OdometryStats, TurnComparison
from evalkit_datasets.commands.inspect.range_stats import RangeStats
from evalkit_datasets.commands.inspect.streams import RecordingStreams
from evalkit_datasets.commands.inspect.timing import ClockOffset, StreamTiming
from evalkit_datasets.parsing.rosbag_parser import BagDamage
from evalkit_datasets.readers import carmen

Level = Literal["problem", "warning", "note"]

MAX_OFFSET_S = 0.02
"""A larger clock offset moves a scan by a visible distance."""

MAX_DRIFT_PPM = 500.0
MAX_OFFSET_RANGE_S = 0.05
MAX_SCAN_STEP_M = 0.4
HANDLED = "handled by the reader"
DIRECTION = "direction of the angles"
STAMPS = "stamps of the scans"
SET_BACK = "clock set back"
LOG_LINES = "laser lines"


@dataclass(frozen=True, slots=True)
class InspectionFinding:
    """A defect or notable property: severity, stream, observation, and what to do ("" if nothing)."""

    level: Level
    about: str
    what: str
    advice: str = ""


_problem = partial(InspectionFinding, "problem")
_warning = partial(InspectionFinding, "warning")
_note = partial(InspectionFinding, "note")


@dataclass(frozen=True, slots=True)
class LidarStats:
    """Statistics of one lidar. ``field_of_view_deg``: from the first beam to the last; limits are None if unknown."""

    topic: str
    kind: str
    frame: str
    beams: int
    field_of_view_deg: float
    first_angle_deg: float
    step_deg: float
    range_min_m: float | None
    range_max_m: float | None
    sweep_s: float
    timing: StreamTiming
    clock: ClockOffset | None
    returns: RangeStats
    damaged: int
    unstamped: int

    @property
    def revolution_s(self) -> float:
        """The time from the first beam to the last (s) if the lidar turns once a scan."""
        return self.timing.period_s * self.field_of_view_deg / 360.0

    @property
    def limits(self) -> str:
        """The range limits in words."""
        low, high = self.range_min_m, self.range_max_m
        if low is None or high is None:
            least = "" if low is None else f"from {low:g} m"
            return least or ("no range limits stated" if high is None else f"up to {high:g} m")
        return f"{low:g} to {high:g} m"


MAX_MEDIAN_M, MIN_MEDIAN_M = 200.0, 0.02
"""Median range of a scan beyond which the unit is doubted."""

MAX_VIEW_DEG = 400.0
"""A wider field of view is doubted: revolutions may overlap a little."""

MAX_VIEW_ERROR_DEG = 30.0
"""Error of a field of view that follows from turns of the odometry."""

MAX_BEYOND = 0.5
"""Share of finite ranges beyond the declared maximum from which the unit is doubted."""

FIELDS = "fields=ranges=ranges first=angle_min step=angle_increment"
"""The parameter of the bag reader that names the fields of a LaserScan, to add a unit or a direction to them."""

MIN_RATE_HZ, MAX_RATE_HZ, MIN_RATED = 0.02, 500.0, 10
"""Scans per second beyond which the unit of time is doubted, of at least so many scans."""

MIN_SWEEP_S, MAX_SWEEP_S = 0.04, 0.5
"""Periods (s) of scans within which a robot moves visibly, and that are a revolution: longer ones leave scans out."""

DIRECTION_REMEDIES = {
    "rosbag": f"give --set '{FIELDS} clockwise'",
    "columns": "write clockwise = true in [scan] of the layout",
}
"""How the direction of the angles is stated, by reader; other formats define it."""

MAX_SECTORS = 3
"""Sectors of the robot's own body that are listed."""

MIN_STANDING, MAX_STILL_OF_MOVING = 0.99, 0.5
"""An odometry that stands for a larger share of the time contradicts scans of which a smaller share does not change."""


def collect_findings(
    streams: RecordingStreams, inside: str, lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats],
    turns: Mapping[str, TurnComparison], turned: str, tree: FrameTree,
) -> tuple[InspectionFinding, ...]:  # fmt: skip
    """Return all findings, most severe first; ``inside``: the ground truth in the recording, "" if none.

    ``turns``: how the odometries turn against the lidar ``turned``, "" if none does.
    """
    rank: dict[Level, int] = {"problem": 0, "warning": 1, "note": 2}
    found = [*_check_file(streams, inside), *_check_lidars(lidars), *_check_scan_steps(odometries, streams),
             *_check_odometry(odometries, turns, streams), *_check_standing(lidars, odometries),
             *_check_full_turn(lidars, turns, streams), *_check_shift(lidars, turns, turned, streams),
             *_check_clocks(lidars, odometries),
             *_check_direction(streams, turned, tree), *_check_frames(tree, streams)]  # fmt: skip
    return tuple(sorted(found, key=lambda finding: rank[finding.level]))


def format_count(count: int, noun: str) -> str:
    """Return a count with its noun: "1 gap", "3 gaps"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _check_file(streams: RecordingStreams, inside: str) -> Iterator[InspectionFinding]:
    if not streams.lasers and streams.damaged:
        yield _problem("file", f"no scan in it can be read: {_describe_dropped(streams)}", "give another copy")
    elif not streams.lasers:
        known = ", ".join(f"{topic.name} ({topic.kind})" for topic in streams.topics) or "none"
        yield _problem("file", f"it contains no laser scans, but: {known}", "give a recording with a 2D lidar")
    yield from _check_remarks(streams)
    if streams.left_out:
        what = f"by the namespaces of its topics, it is of several robots, and {streams.lasers[0].topic} of one of them"
        advice = "choose another robot by the topic of its lidar, or an odometry by its topic"
        yield _note("file", f"{what}; left out: {', '.join(streams.left_out)}", advice)
    if any(topic.name == "FLASER" for topic in streams.topics) and streams.lasers:
        angles = streams.lasers[0].angles
        first = f"{len(angles)} beams are assumed to begin at {math.degrees(angles[0]):.6g} deg"
        what = f"FLASER lines do not contain angles: {first}"
        yield _note("lidar", what, "half a beam rotates all scans alike; parameters start_deg, step_deg")
    if any(topic.name == "RLASER" for topic in streams.topics):
        yield _note("lidar", "the log also contains a rear laser (RLASER), which is ignored")
    if streams.lasers and 0 < streams.digits <= 6:
        what = f"stamps are written with {streams.digits} significant digits: times are coarse"
        yield _warning("file", what, "do not evaluate timing; use the original log if available")
    if streams.poses_from:
        what = f"its poses are not odometry but {inside}: scans and ODOM lines contain corrected poses"
        yield _warning("odometry", what, "they are used as ground truth, without odometry")
    elif not inside:
        yield _note("truth", "none inside the file", "relations or a true trajectory may lie beside it, or be given")


def _check_remarks(streams: RecordingStreams) -> Iterator[InspectionFinding]:
    if streams.damage is not None:
        yield _warning("file", _describe_damage(streams.damage), "fetch or record it again if that is needed")
    if streams.damaged and streams.lasers:
        yield _warning("file", _describe_dropped(streams))
    for remark in streams.remarks:
        if "derived" in remark.lower() or "pseudo" in remark.lower():
            yield _warning("file", f"comment in the file: {remark}")


def _describe_dropped(streams: RecordingStreams) -> str:
    first = f"; the first is {streams.first_damage}" if streams.first_damage else ""
    kind = "message" if streams.kind.endswith("bag") else "line"
    return f"{format_count(streams.damaged, f'damaged {kind}')}, dropped{first}"


def _describe_damage(damage: BagDamage) -> str:
    beyond = "" if damage.is_size_stated else "; how much was cut off, the file does not state"
    if not damage.lost_bytes:
        return f"its index is damaged or missing: all records in it were read{beyond}"
    lost = f"{damage.lost_bytes / 1e6:.2f} of {damage.whole_bytes / 1e6:.2f} MB ({damage.lost_percent} %)"
    return f"it is cut short or damaged: {lost} are lost{beyond}"


def _check_lidars(lidars: Sequence[LidarStats]) -> Iterator[InspectionFinding]:
    for lidar in lidars:
        yield from _check_units(lidar)
        yield from _check_times(lidar)
        yield from _check_ranges(lidar)
        yield from check_body(lidar)
    if len(lidars) > 1:
        names = ", ".join(lidar.topic for lidar in lidars)
        yield _note("lidars", f"{len(lidars)} lidars: {names}; a run uses one of them", "select one with topic")


def _check_times(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.timing, lidar.topic
    if not found.usable:
        advice = "the reader places the scans one second apart in the order of the file: times and speeds are unknown"
        yield _problem(about, f"{found.repeated} of {found.count} scans have the stamp of another scan", advice)
    elif found.repeated or found.backwards:
        what = f"stamps decrease {found.backwards} times, {found.repeated} are repeated"
        yield _warning(about, what, "the reader sorts the scans and keeps the first of equal stamps")
    if lidar.clock is not None and lidar.kind != LOG_LINES:
        yield from _check_steps_back(found, about)
    if found.gap_count:
        longest = found.gaps[0]
        what = f"{format_count(found.gap_count, 'gap')}, the longest {longest.length_s:.2f} s at {longest.at_s:.1f} s"
        yield InspectionFinding("warning" if longest.length_s > 1.0 else "note", about, what)
    if found.period_s and found.jitter_s > 0.2 * found.period_s:
        yield _note(about, f"the period of {found.period_s:.3f} s has a jitter of {found.jitter_s:.3f} s")
    if lidar.kind.endswith("LaserScan") and lidar.sweep_s == 0.0 and MIN_SWEEP_S <= found.period_s <= MAX_SWEEP_S:
        what = (
            f"time_increment is 0 or less: the motion within the scans, {found.period_s:.2g} s apart, is not corrected"
        )
        mend = f"set sweep_s = {lidar.revolution_s:.2g} of the reader, and mend its driver"
        yield _warning(about, what, f"if the lidar turns once a scan, {mend}")
    if lidar.unstamped:
        yield _warning(about, f"{lidar.unstamped} scans have no stamp; the time of recording is used")
    if lidar.clock is not None:
        yield from _check_clock(lidar.clock, about, lidar.kind == LOG_LINES)


def _check_steps_back(found: StreamTiming, about: str) -> Iterator[InspectionFinding]:
    """Report a clock that was set back while the recorder's went on: the times of two parts overlap."""
    step = found.step_back
    if step is None or not found.usable:
        return
    count = "once" if found.steps_back == 1 else f"{found.steps_back} times"
    where = f"{step.length_s:.2f} s at {step.at_s:.1f} s ({count})"
    back = f"the stamps of {about} go back by {where} while the recording goes on"
    before = [f"--set limit={step.before}"] if step.before > 0 else []
    behind = [f"--set start={step.behind}"] if step.behind < found.count - found.repeated else []
    part = f"take the part before it or behind it: {' or '.join([*before, *behind])}"
    advice = part if found.steps_back == 1 and [*before, *behind] else "mend the clock, and record again"
    yield _problem(SET_BACK, f"{back}: in the order of their stamps, scans of different places mix", advice)


def _check_clock(found: ClockOffset, about: str, log: bool) -> Iterator[InspectionFinding]:
    if log:
        if found.max_s - found.min_s > MAX_OFFSET_RANGE_S:
            what = (
                f"ipc and logger stamps differ by {found.min_s:.2f} to {found.max_s:.2f} s: the offset is not constant"
            )
            yield _note(about, what, "ground truth must use the ipc stamp, as the reader does")
        return
    if abs(found.median_s) > MAX_OFFSET_S:
        side = "ahead of" if found.median_s > 0 else "behind"
        what = f"header stamps are {abs(found.median_s):.3f} s {side} the time of recording"
        advice = "two clocks" if found.median_s > 0 else "latency, or two clocks"
        yield InspectionFinding(
            "warning" if found.median_s > 0 else "note",
            about,
            what,
            f"{advice}; do not combine with stamps of another clock",
        )
    if found.step_s:
        what = f"its clock steps by {found.step_s:+.2f} s against the recorder's at {found.step_at_s:.1f} s"
        yield _warning(about, what, "a clock that was set, or a recorder that was held up")
    elif abs(found.drift_ppm) > MAX_DRIFT_PPM:
        yield _warning(about, f"its clock drifts from the recorder's by {found.drift_ppm:.0f} ppm")


def _check_units(lidar: LidarStats) -> Iterator[InspectionFinding]:
    """Check whether ranges and times have the order of magnitude of a lidar's."""
    middle, rate, beyond = lidar.returns.median_m, lidar.timing.rate_hz, lidar.returns.beyond_maximum
    if middle > MAX_MEDIAN_M or beyond > MAX_BEYOND:
        far = f"{100 * beyond:.0f} % of the ranges lie beyond the maximum of {lidar.range_max_m or 0.0:g} m"
        what = f"the median range is {middle:.0f} m" if beyond <= MAX_BEYOND else far
        advice = f"a bag: --set '{FIELDS} range_unit=mm'; a text log: unit = \"mm\" in [scan]"
        yield _problem(lidar.topic, f"{what}: millimetres or centimetres taken for metres?", advice)
    elif 0.0 < middle < MIN_MEDIAN_M:
        what = f"the median range is {1e3 * middle:.1f} mm: metres taken for millimetres?"
        yield _problem(lidar.topic, what, 'a bag: record metres; a text log: unit = "m" in [scan]')
    if abs(lidar.step_deg) * (lidar.beams - 1) > MAX_VIEW_DEG:
        what = f"{lidar.beams} beams {abs(lidar.step_deg):.3g} deg apart are more than a full turn"
        yield _problem(lidar.topic, f"{what}: degrees taken for radians?", f"a bag: --set '{FIELDS} angle_unit=deg'")
    if lidar.timing.usable and lidar.timing.count > MIN_RATED and not MIN_RATE_HZ <= rate <= MAX_RATE_HZ:
        what = f"{rate:.3g} scans per second: stamps in another unit than they are read in?"
        yield _problem(
            lidar.topic, what, "a bag: use the time of recording; a text log: unit in [time] (s, ms, us, ns)"
        )


def _check_ranges(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.returns, lidar.topic
    for code in found.codes:
        value = f"{code.high_m:g}" if code.low_m == code.high_m else f"{code.low_m:g} to {code.high_m:g}"
        what = f"{value} m means no return: {100 * code.share:.1f} % of the beams ({code.why})"
        advice = advise_on_code(code.low_m, lidar.range_max_m)
        yield InspectionFinding("note" if advice == HANDLED else "warning", about, what, advice)
    if found.zero > 0.005:
        yield _note(about, f"{100 * found.zero:.1f} % of the ranges are 0", "the reader marks them as invalid")
    if found.nan + found.negative > 0.005:
        yield _note(about, f"{100 * (found.nan + found.negative):.1f} % of the ranges are nan or negative")
    if found.at_maximum > 0.001:
        what = f"{100 * found.at_maximum:.1f} % of the ranges are the maximum itself, {lidar.range_max_m:g} m"
        yield _note(about, what, "the reader marks them as no return")
    if found.beyond_maximum > 0.001:
        what = f"{100 * found.beyond_maximum:.1f} % of the ranges lie beyond the maximum of {lidar.range_max_m:g} m"
        yield _note(about, what, "the reader marks them as no return")
    if len(found.beams) > 1:
        yield _warning(about, f"the number of beams changes: {', '.join(map(str, found.beams[:6]))}")
    if found.hits < 0.5:
        advice = (
            "a point cloud: its band of heights may miss the walls, or its unit is not m" if found.nan > 0.5 else ""
        )
        yield _warning(about, f"only {100 * found.hits:.0f} % of the beams are hits", advice)
    if found.repeated > 0:
        yield _warning(about, f"{found.repeated} scans are identical to the previous one")
    if found.still > 0.95:
        yield _note(
            about, "the robot stands still: scans do not change within a second", "suitable for noise, not for drift"
        )


def check_body(lidar: LidarStats) -> Iterator[InspectionFinding]:
    """Warn of beams that hit the robot itself."""
    body = lidar.returns.body
    if body is None:
        return
    listed = [f"{first:.0f} to {last:.0f}" for first, last in body.sectors_deg[:MAX_SECTORS]]
    sectors = ", ".join([*listed, *(["..."] if len(body.sectors_deg) > MAX_SECTORS else [])])
    ranges = " to ".join(dict.fromkeys([f"{body.nearest_m:.2f}", f"{body.farthest_m:.2f}"]))
    beams = f"{100 * body.share:.0f} % of the beams ({sectors} deg)"
    what = f"{beams} always have the same range, {ranges} m: the robot's own body?"
    mend = f"set range_min_m = {body.range_min_m:g} (m; of a text log in [scan] of its layout)"
    yield _warning(lidar.topic, what, f"{mend}: all methods then leave them out, with all else that is nearer")


def is_default_code(low_m: float) -> bool:
    """Return whether the CARMEN reader treats this value as no return by default."""
    return bool(np.isclose(low_m, (*carmen.CODES_M, *carmen.MILLIMETRE_CODES_M), atol=1e-6).any())


def advise_on_code(low_m: float, range_max_m: float | None) -> str:
    """Return what to do about a no-return code."""
    if range_max_m is not None:
        return "the driver should send inf; the reader treats it as a hit"
    return (
        HANDLED
        if low_m >= 50.0 or is_default_code(low_m)
        else f"set range_max_m = {math.floor(low_m * 100) / 100:g} (m)"
    )


def _check_scan_steps(odometries: Sequence[OdometryStats], streams: RecordingStreams) -> Iterator[InspectionFinding]:
    """Check the motion between scans by the poses in a log."""
    for one in odometries:
        if one.topic == SCAN_POSES and one.median_step_m > MAX_SCAN_STEP_M:
            what = f"{one.median_step_m:.2f} m apart (median), rotated by up to {one.largest_turn_deg:.0f} deg"
            yield _warning("scans", what, "large for a registration without a prior")
        elif streams.poses_from and one.timing.backwards:
            yield _note(one.topic, f"stamps decrease {one.timing.backwards} times")


def _check_odometry(
    odometries: Sequence[OdometryStats], turns: Mapping[str, TurnComparison], streams: RecordingStreams
) -> Iterator[InspectionFinding]:
    if not odometries and streams.lasers:
        yield _warning(
            "odometry", "no wheel odometry in it, or one that stands still", "the initial guess is constant velocity"
        )
    for one in () if streams.poses_from else odometries:
        about = f"odometry {one.topic}" + (f" ({one.child})" if one.topic == "tf" else "")
        yield from _check_motion(one, about)
        yield from _check_twist(one, about)
        yield from _check_turning(turns.get(f"{one.topic} {one.child}"), about)


def _check_standing(lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats]) -> Iterator[InspectionFinding]:
    """Warn of an odometry that stands still while the scans of a lidar change."""
    still = min((lidar.returns.still for lidar in lidars if math.isfinite(lidar.returns.still)), default=1.0)
    if still > MAX_STILL_OF_MOVING:
        return
    for one in odometries:
        if one.standing > MIN_STANDING:
            what = f"stands still, but {100 * (1 - still):.0f} % of the scans change within a second: the robot moves"
            yield _warning(f"odometry {one.topic}", what, "use odometry = 'none', or the topic of the real odometry")


def is_apart(lidar: LidarStats, odometry: OdometryStats) -> bool:
    """Return whether no scan lies within the times of an odometry."""
    scans, poses = lidar.timing, odometry.timing
    return scans.usable and (poses.last_ns < scans.first_ns or scans.last_ns < poses.first_ns)


def _check_clocks(lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats]) -> Iterator[InspectionFinding]:
    """Report an odometry whose times are not those of any scan: a problem if there is no other."""
    apart = [one for one in odometries if lidars and all(is_apart(lidar, one) for lidar in lidars)]
    for one in apart:
        apart_s = (one.timing.first_ns - lidars[0].timing.first_ns) * 1e-9
        side = "after" if apart_s > 0 else "before"
        what = f"by its stamps it begins {abs(apart_s):.0f} s {side} the scans, and covers none of them: two clocks?"
        if len(apart) == len(odometries):
            yield _problem(f"odometry {one.topic}", what, "the scans have no wheel odometry; record with one clock")
        else:
            yield _warning(f"odometry {one.topic}", what, "use another odometry, or record with one clock")


def _check_motion(one: OdometryStats, about: str) -> Iterator[InspectionFinding]:
    if not one.like_wheels:
        what = (
            f"sideways slip is {100 * one.sideways:.1f} % of a step, without exact standstills: not wheels of a "
            "differential drive, but poses of a filter or scan matcher (or an omnidirectional base)"
        )
        yield _warning(about, what, "use odometry = 'none' unless it is known to be wheel odometry")
    if left := one.jump_count - one.taken_out:
        what = f"{_describe_jumps(one, left, taken_out=False)}: a guess across a jump is wrong"
        advice = "cut the recording there (start, limit), or use odometry = 'none'"
        yield InspectionFinding("problem" if one.like_wheels else "warning", about, what, advice)
    if one.taken_out:
        jumps = _describe_jumps(one, one.taken_out, taken_out=True)
        what = f"{jumps}: taken out when the recording is read, as if the robot had stood meanwhile"
        yield _warning(about, what, "cut the recording there (start, limit) if it moved")
    if one.timing.gap_count and one.timing.gaps[0].length_s > 1.0:
        what = f"{format_count(one.timing.gap_count, 'gap')}, the longest {one.timing.gaps[0].length_s:.2f} s"
        yield _note(about, f"{what}; poses in between are interpolated")
    if math.hypot(*one.first[:2]) > 0.5:
        x, y, theta = one.first
        yield _note(about, f"starts at ({x:.2f}, {y:.2f}) m, {theta:.0f} deg instead of the origin")


def _describe_jumps(one: OdometryStats, count: int, taken_out: bool) -> str:
    jump = next((jump for jump in one.jumps if jump.taken_out is taken_out), one.jumps[0])
    example = f"{jump.step_m:.2f} m and {jump.turn_deg:.0f} deg at {jump.at_s:.1f} s"
    return f"{format_count(count, 'jump')}, such as {example}"


def _check_turning(turn: TurnComparison | None, about: str) -> Iterator[InspectionFinding]:
    if turn is not None and turn.differs:
        what = f"the scans rotate {turn.scale:.2f} times as much as the odometry ({turn.pairs} turns)"
        if turn.scale < 0.0:
            mend = f"a bag: --set '{FIELDS} clockwise'; a text log: clockwise = true in [scan]"
            yield _problem(about, f"{what}: the lidar's angles are mirrored, or the odometry's heading", mend)
        else:
            yield _warning(about, what, "check wheel base and clock")
    elif turn is not None and turn.spread_deg > 1.5 and not turn.driving:
        what = f"its rotations differ from those of the scans by {turn.spread_deg:.1f} deg ({turn.pairs} turns)"
        yield _note(about, what, "a weak initial guess for registrations")


def _check_full_turn(
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
            yield _problem("angles of FLASER lines", what, mend)
            return


def _check_shift(
    lidars: Sequence[LidarStats], turns: Mapping[str, TurnComparison], turned: str, streams: RecordingStreams
) -> Iterator[InspectionFinding]:
    """Warn of scans whose stamps are not the times at which the odometry rotates as they do."""
    named = ((name.split()[0], turn) for name, turn in turns.items() if turn.is_shifted)
    odometry, turn = next(named, ("", None))
    if turn is None or streams.reader != "rosbag":
        return
    low, high = sorted(abs(value) for value in turn.shift_interval)
    side = "later" if turn.shift_s > 0.0 else "earlier"
    what = (
        f"by the turns of {odometry}, the scans were taken {abs(turn.shift_s):.2f} s {side} than their stamps say "
        f"({low:.2f} to {high:.2f} s, {turn.pairs} turns)"
    )
    if agreeing := [name.split()[0] for name, other in turns.items() if other.agrees_in_time]:
        yield _warning(STAMPS, f"{what}, but {agreeing[0]} agrees with them", f"use --set odometry={agreeing[0]}")
        return
    lidar = next(one for one in lidars if one.topic == turned)
    if lidar.sweep_s == 0.0 and 0.0 < turn.shift_s < 0.5 * lidar.revolution_s + MAX_OFFSET_S:
        sweep = f"if the lidar turns once a scan: --set sweep_s={lidar.revolution_s:.2g}"
        yield _warning(STAMPS, f"{what}: the middle of a revolution, whose time_increment is 0 or less", sweep)
        return
    mend = f"--set stamp_shift_s={turn.shift_s:.2f}"
    yield _warning(STAMPS, what, f"if the stamps of the scans are wrong, not those of the odometry: {mend}")


def _check_direction(streams: RecordingStreams, turned: str, tree: FrameTree) -> Iterator[InspectionFinding]:
    """Warn where neither a mounting nor a turn tells whether the angles of a lidar are mirrored.

    ``turned``: the lidar that was compared with an odometry, "" if none.
    """
    stated = {mounting.sensor for mounting in tree.mountings if not mounting.problem}
    unknown = [laser.topic for laser in streams.lasers if laser.frame not in stated and laser.topic != turned]
    if not unknown or streams.reader not in DIRECTION_REMEDIES:
        return
    compared = "only one lidar is compared with the odometry" if turned else "the odometry does not turn measurably"
    why = compared if streams.wheels else "there is no odometry"
    what = f"{', '.join(unknown)}: whether the angles are mirrored (a lidar upside down) could not be checked: {why}"
    yield _warning(DIRECTION, what, f"where a map is a mirror image, {DIRECTION_REMEDIES[streams.reader]}")


def _check_twist(one: OdometryStats, about: str) -> Iterator[InspectionFinding]:
    if one.twist is None:
        return
    if one.twist.constant:
        yield _note(about, "the speeds in its messages are constant: only its poses are usable")
        return
    for name, ratio in (("speed", one.twist.scale), ("yaw rate", one.twist.turn_scale)):
        if math.isfinite(ratio) and not 0.8 <= ratio <= 1.25:
            yield _warning(about, f"its poses have {ratio:.2f} times the {name} of its messages")


def _check_frames(tree: FrameTree, streams: RecordingStreams) -> Iterator[InspectionFinding]:
    if not streams.kind.endswith("bag"):
        return
    if not tree.names and streams.lasers:
        yield _warning("tf", "no transforms in it: the lidar's pose on the base is unknown",
                      "give base_from_sensor = 'x y theta' (m, m, rad)")  # fmt: skip
    for child, parents in tree.contested.items():
        yield _warning("tf", f"frame '{child}' has several parents: {', '.join(parents)}")
    siblings = [child for parent, child in streams.tree.moving if parent == "odom"]
    if len(siblings) > 1:
        yield _note("tf", f"'odom' is the parent of {' and '.join(sorted(siblings))}", "select one with base_frame")
    for mounting in tree.mountings:
        if mounting.problem:
            yield _warning(f"lidar frame {mounting.sensor}", mounting.problem)
        elif mounting.mirrored:
            yield _note(f"lidar frame {mounting.sensor}", "mounted upside down; the reader mirrors its angles")
        elif abs(mounting.theta_deg) > 1.0:
            what = f"rotated by {mounting.theta_deg:.0f} deg on '{mounting.base}'"
            yield _note(f"lidar frame {mounting.sensor}", what)
