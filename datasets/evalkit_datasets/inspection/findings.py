"""What was measured said in sentences: what is wrong with a recording, or worth knowing, and what to do about it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from evalkit_datasets import carmen
from evalkit_datasets.inspection.frame_tree import FrameTree
from evalkit_datasets.inspection.log_streams import BESIDE
from evalkit_datasets.inspection.odometry_stats import OdometryStats, TurnComparison
from evalkit_datasets.inspection.range_stats import RangeStats
from evalkit_datasets.inspection.streams import RecordingStreams
from evalkit_datasets.inspection.timing import ClockOffset, StreamTiming

Level = Literal["problem", "warning", "note"]

LATE_S = 0.02
"""A clock that is off by more than this moves a scan by a visible distance."""

DRIFT_PPM = 500.0
WANDER_S = 0.05
SPARSE_M = 0.4
KNOWN = "the reader knows it"


@dataclass(frozen=True, slots=True)
class InspectionFinding:
    """Something worth knowing: how bad, about which stream, what was seen, and what to do ("" if nothing)."""

    level: Level
    about: str
    what: str
    advice: str = ""


@dataclass(frozen=True, slots=True)
class LidarStats:
    """One lidar, measured. ``field_of_view_deg`` counts a beam's width; limits are None where the format is silent."""

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


def of(
    streams: RecordingStreams, inside: str, lidars: Sequence[LidarStats], drivings: Sequence[OdometryStats],
    turns: Mapping[str, TurnComparison], tree: FrameTree,
) -> tuple[InspectionFinding, ...]:  # fmt: skip
    """All findings, the worst first; ``inside``: the truth the recording holds."""
    rank: dict[Level, int] = {"problem": 0, "warning": 1, "note": 2}
    found = [*_of_file(streams, inside), *_of_lidars(lidars), *_of_scan_steps(drivings, streams),
             *_of_odometry(drivings, turns, streams), *_of_frames(tree, streams)]  # fmt: skip
    return tuple(sorted(found, key=lambda finding: rank[finding.level]))


def times(count: int, thing: str) -> str:
    """A count with its thing: "1 gap", "3 gaps"."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"


def _of_file(streams: RecordingStreams, inside: str) -> Iterator[InspectionFinding]:
    if not streams.lasers:
        known = ", ".join(f"{topic.name} ({topic.kind})" for topic in streams.topics) or "none"
        yield InspectionFinding(
            "problem", "file", f"no laser scans in it; it holds: {known}", "give a recording with a 2D lidar"
        )
    if streams.damaged:
        yield InspectionFinding("warning", "file", f"damaged, and left out: {streams.damaged} of its messages or lines")
    for remark in streams.remarks:
        if "derived" in remark.lower() or "pseudo" in remark.lower():
            yield InspectionFinding("warning", "file", f"it says of itself: {remark}")
    if any(topic.name == "FLASER" for topic in streams.topics) and streams.lasers:
        beams = len(streams.lasers[0].angles)
        what = f"FLASER lines do not tell their angles: {beams} beams are taken to begin at -90 deg"
        yield InspectionFinding(
            "note", "lidar", what, "half a beam more or less turns every scan alike: start_deg, step_deg"
        )
    if any(topic.name == "RLASER" for topic in streams.topics):
        yield InspectionFinding("note", "lidar", "it holds a rear laser, too (RLASER), which is not read")
    if streams.lasers and 0 < streams.digits <= 6:
        what = f"stamps are written with {streams.digits} significant digits: times are coarse"
        yield InspectionFinding(
            "warning", "file", what, "judge nothing by its times; take the original log where there is one"
        )
    if streams.poses_from:
        what = f"the poses in it are no odometry but {inside}: scans and ODOM lines carry corrected poses"
        yield InspectionFinding("warning", "odometry", what, "they serve as reference; odometry is none")
    elif not inside:
        yield InspectionFinding(
            "note", "truth", "no ground truth inside", "relations or a true trajectory beside it serve"
        )


def _of_lidars(lidars: Sequence[LidarStats]) -> Iterator[InspectionFinding]:
    for lidar in lidars:
        yield from _of_times(lidar)
        yield from _of_ranges(lidar)
    if len(lidars) > 1:
        names = ", ".join(lidar.topic for lidar in lidars)
        yield InspectionFinding(
            "note", "lidars", f"{len(lidars)} lidars: {names}; a run takes one of them", "choose with topic"
        )


def _of_times(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.timing, lidar.topic
    if not found.usable:
        yield InspectionFinding(
            "problem", about, f"{found.repeated} of {found.count} scans share their stamp with another"
        )
    elif found.repeated or found.backwards:
        what = f"stamps go backwards {found.backwards} times, {found.repeated} repeat another"
        yield InspectionFinding("warning", about, what, "the reader sorts them and keeps the first of equal ones")
    if found.gap_count:
        longest = found.gaps[0]
        what = f"{times(found.gap_count, 'gap')}, the longest {longest.length_s:.2f} s at {longest.at_s:.1f} s"
        yield InspectionFinding("warning" if longest.length_s > 1.0 else "note", about, what)
    if found.period_s and found.jitter_s > 0.2 * found.period_s:
        yield InspectionFinding("note", about, f"the period of {found.period_s:.3f} s varies by {found.jitter_s:.3f} s")
    if lidar.unstamped:
        yield InspectionFinding("warning", about, f"{lidar.unstamped} scans carry no time; that of recording is taken")
    if lidar.clock is not None:
        yield from _of_clock(lidar.clock, about, lidar.kind == "laser lines")


def _of_clock(found: ClockOffset, about: str, log: bool) -> Iterator[InspectionFinding]:
    if log:
        if found.most_s - found.least_s > WANDER_S:
            what = f"ipc and logger stamps differ by {found.least_s:.2f} to {found.most_s:.2f} s: no constant offset"
            yield InspectionFinding("note", about, what, "truth must refer to the ipc stamp, which the reader takes")
        return
    if abs(found.median_s) > LATE_S:
        side = "ahead of" if found.median_s > 0 else "behind"
        what = f"header stamps are {abs(found.median_s):.3f} s {side} the time of recording"
        advice = "ahead: two clocks" if found.median_s > 0 else "transport, or two clocks"
        yield InspectionFinding(
            "warning" if found.median_s > 0 else "note", about, what, f"{advice}; mix with no other clock"
        )
    if abs(found.drift_ppm) > DRIFT_PPM:
        yield InspectionFinding(
            "warning", about, f"its clock runs away from the recorder's by {found.drift_ppm:.0f} ppm"
        )


def _of_ranges(lidar: LidarStats) -> Iterator[InspectionFinding]:
    found, about = lidar.returns, lidar.topic
    for code in found.codes:
        value = f"{code.high_m:g}" if code.low_m == code.high_m else f"{code.low_m:g} to {code.high_m:g}"
        what = f"{value} m is no range but a no-return: {100 * code.share:.1f} % of the beams ({code.why})"
        advice = code_advice(code.low_m, lidar.range_max_m)
        yield InspectionFinding("note" if advice == KNOWN else "warning", about, what, advice)
    if found.zero > 0.005:
        yield InspectionFinding(
            "note", about, f"{100 * found.zero:.1f} % of the ranges are 0", "invalid for the reader"
        )
    if found.nan + found.negative > 0.005:
        yield InspectionFinding(
            "note", about, f"{100 * (found.nan + found.negative):.1f} % of the ranges are nan or negative"
        )
    if found.at_maximum > 0.001:
        what = f"{100 * found.at_maximum:.1f} % of the ranges are the maximum itself, {lidar.range_max_m:g} m"
        yield InspectionFinding("note", about, what, "no returns for the reader")
    if found.beyond_maximum > 0.001:
        what = f"{100 * found.beyond_maximum:.1f} % of the ranges lie beyond the maximum of {lidar.range_max_m:g} m"
        yield InspectionFinding("note", about, what, "no returns for the reader")
    if len(found.beams) > 1:
        yield InspectionFinding(
            "warning", about, f"the number of beams changes: {', '.join(map(str, found.beams[:6]))}"
        )
    if found.hits < 0.5:
        yield InspectionFinding("warning", about, f"only {100 * found.hits:.0f} % of the beams are hits")
    if found.repeated > 0:
        yield InspectionFinding("warning", about, f"{found.repeated} scans are equal to the one before, beam by beam")
    if found.still > 0.95:
        yield InspectionFinding("note", about, "the robot stands still: scans look as they did a second before",
                      "good for noise, not for drift")  # fmt: skip


def is_known(low_m: float) -> bool:
    """Whether the reader of logs takes this value for a no-return without being told."""
    return bool(np.isclose(low_m, (*carmen.CODES_M, *carmen.MILLIMETRE_CODES_M), atol=1e-6).any())


def code_advice(low_m: float, range_max_m: float | None) -> str:
    """What to do about a no-return code, "" where the reader takes it for one already."""
    if range_max_m is not None:
        return "the driver should send inf; the reader takes it for a wall"
    return KNOWN if low_m >= 50.0 or is_known(low_m) else f"set range_max_m = {math.floor(low_m * 100) / 100:g}"


def _of_scan_steps(drivings: Sequence[OdometryStats], streams: RecordingStreams) -> Iterator[InspectionFinding]:
    """What the poses in a log tell of its scans, whoever made them."""
    for one in drivings:
        if one.topic == BESIDE and one.median_step_m > SPARSE_M:
            what = f"{one.median_step_m:.2f} m apart (median), and turned by up to {one.largest_turn_deg:.0f} deg"
            yield InspectionFinding("warning", "scans", what, "far for a registration without a prior")
        elif streams.poses_from and one.timing.backwards:
            yield InspectionFinding("note", one.topic, f"their stamps go backwards {one.timing.backwards} times")


def _of_odometry(
    drivings: Sequence[OdometryStats], turns: Mapping[str, TurnComparison], streams: RecordingStreams
) -> Iterator[InspectionFinding]:
    if not drivings and streams.lasers:
        yield InspectionFinding("warning", "odometry", "no wheel odometry in it", "runs start from constant velocity")
    for one in () if streams.poses_from else drivings:
        about = f"odometry {one.topic}" + (f" ({one.child})" if one.topic == "tf" else "")
        yield from _of_motion(one, about)
        yield from _of_twist(one, about)
        yield from _of_turning(turns.get(f"{one.topic} {one.child}"), about)


def _of_motion(one: OdometryStats, about: str) -> Iterator[InspectionFinding]:
    if not one.like_wheels:
        what = (
            f"it slips sideways by {100 * one.sideways:.1f} % of a step and never stands exactly still: no "
            "differential drive's wheels, but poses a filter or a matcher made (or an omnidirectional base)"
        )
        yield InspectionFinding("warning", about, what, "use odometry = 'none' unless you know better")
    if one.jump_count:
        first = one.jumps[0]
        example = f"{first.step_m:.2f} m and {first.turn_deg:.0f} deg at {first.at_s:.1f} s"
        yield InspectionFinding("warning", about, f"{times(one.jump_count, 'jump')}, such as {example}")
    if one.timing.gap_count and one.timing.gaps[0].length_s > 1.0:
        what = f"{times(one.timing.gap_count, 'gap')}, the longest {one.timing.gaps[0].length_s:.2f} s"
        yield InspectionFinding("note", about, f"{what}; between them it is interpolated")
    if math.hypot(*one.first[:2]) > 0.5:
        x, y, theta = one.first
        yield InspectionFinding("note", about, f"it begins at ({x:.2f}, {y:.2f}) m, {theta:.0f} deg, not at its origin")


def _of_turning(turn: TurnComparison | None, about: str) -> Iterator[InspectionFinding]:
    if turn is not None and not 0.85 <= turn.scale <= 1.15:
        what = f"the scans turn {turn.scale:.2f} times as much as it says ({turn.pairs} turns)"
        wrong = "is its heading, or the lidar, the wrong way round?"
        yield InspectionFinding(
            "warning", about, what, wrong if turn.scale < 0 else "check its wheel base and its clock"
        )
    elif turn is not None and turn.spread_deg > 1.5:
        what = f"its turns differ from those of the scans by {turn.spread_deg:.1f} deg each ({turn.pairs} turns)"
        yield InspectionFinding("note", about, what, "a weak guess: registrations must bear it")


def _of_twist(one: OdometryStats, about: str) -> Iterator[InspectionFinding]:
    if one.twist is None:
        return
    if one.twist.constant:
        yield InspectionFinding("note", about, "the speeds in its messages never change: only its poses tell of motion")
        return
    for name, ratio in (("speed", one.twist.scale), ("rate of turning", one.twist.turn_scale)):
        if math.isfinite(ratio) and not 0.8 <= ratio <= 1.25:
            yield InspectionFinding("warning", about, f"its poses show {ratio:.2f} times the {name} its messages tell")


def _of_frames(tree: FrameTree, streams: RecordingStreams) -> Iterator[InspectionFinding]:
    if streams.kind == "CARMEN log":
        return
    if not tree.names and streams.lasers:
        yield InspectionFinding("warning", "tf", "no transforms in it: the lidar's pose on the base is unknown",
                      "give base_from_sensor = 'x y theta'")  # fmt: skip
    for child, parents in tree.contested.items():
        yield InspectionFinding("warning", "tf", f"frame '{child}' has several parents: {', '.join(parents)}")
    siblings = [child for parent, child in streams.tree.moving if parent == "odom"]
    if len(siblings) > 1:
        yield InspectionFinding(
            "note", "tf", f"'odom' moves {' and '.join(sorted(siblings))}", "choose with base_frame"
        )
    for mounting in tree.mountings:
        if mounting.problem:
            yield InspectionFinding("warning", f"lidar frame {mounting.sensor}", mounting.problem)
        elif mounting.mirrored:
            yield InspectionFinding(
                "note", f"lidar frame {mounting.sensor}", "it hangs upside down; the reader mirrors its angles"
            )
        elif abs(mounting.theta_deg) > 1.0:
            what = f"it is turned by {mounting.theta_deg:.0f} deg on '{mounting.base}'"
            yield InspectionFinding("note", f"lidar frame {mounting.sensor}", what)
