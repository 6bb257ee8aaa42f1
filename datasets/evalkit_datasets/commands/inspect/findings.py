"""All findings of the inspection of a recording: on its file, its lidars, its odometries and its frames."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from evalkit_datasets.commands.inspect.finding import InspectionFinding, Level, format_count, note, problem, warning
from evalkit_datasets.commands.inspect.frame_tree import FrameTree, list_frames
from evalkit_datasets.commands.inspect.lidar_findings import check_lidars
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.log_streams import OLD_LASERS
from evalkit_datasets.commands.inspect.odometry_findings import (
    check_clocks,
    check_direction,
    check_full_turn,
    check_odometry,
    check_scan_steps,
    check_shift,
    check_standing,
)
from evalkit_datasets.commands.inspect.odometry_stats import OdometryStats
from evalkit_datasets.commands.inspect.streams import RecordingStreams
from evalkit_datasets.commands.inspect.turn_comparison import TurnComparison
from evalkit_datasets.readers.reader_common import REPEATED_STAMPS

AGAIN = "fetch or record it again if that is needed"


def collect_findings(
    streams: RecordingStreams, inside: str, lidars: Sequence[LidarStats], odometries: Sequence[OdometryStats],
    turns: Mapping[str, TurnComparison], turned: str, tree: FrameTree,
) -> tuple[InspectionFinding, ...]:  # fmt: skip
    """Return all findings, most severe first; ``inside``: the ground truth in the recording, "" if none.

    ``turns``: how the odometries turn against the lidar ``turned``, "" if none does.
    """
    rank: dict[Level, int] = {"problem": 0, "warning": 1, "note": 2}
    found = [
        *_check_file(streams, inside),
        *check_lidars(lidars, streams.reader),
        *check_scan_steps(odometries, streams),
        *check_odometry(odometries, turns, streams),
        *check_standing(lidars, odometries),
        *check_full_turn(lidars, turns, streams),
        *check_shift(lidars, odometries, turns, turned, streams),
        *check_clocks(lidars, odometries),
        *check_direction(streams, turned, tree),
        *_check_frames(tree, streams),
    ]
    return tuple(sorted(found, key=lambda finding: rank[finding.level]))


def _check_file(streams: RecordingStreams, inside: str) -> Iterator[InspectionFinding]:
    if not streams.lasers and streams.damaged:
        yield problem("file", f"no scan in it can be read: {_describe_dropped(streams)}", "give another copy")
    elif not streams.lasers:
        known = ", ".join(f"{topic.name} ({topic.kind})" for topic in streams.topics) or "none"
        yield problem("file", f"it contains no laser scans, but: {known}", "give a recording with a 2D lidar")
    yield from _check_remarks(streams)
    if streams.left_out:
        what = f"by the namespaces of its topics, it is of several robots, and {streams.lasers[0].topic} of one of them"
        advice = "choose another robot by the topic of its lidar, or an odometry by its topic"
        yield note("file", f"{what}; left out: {', '.join(streams.left_out)}", advice)
    without_angles = [name for name in ("FLASER", *OLD_LASERS) if any(topic.name == name for topic in streams.topics)]
    if without_angles and streams.lasers:
        angles = streams.lasers[0].angles
        first = f"{len(angles)} beams are assumed to begin at {math.degrees(angles[0]):.6g} deg"
        what = f"{without_angles[0]} lines do not contain angles: {first}"
        yield note("lidar", what, "half a beam rotates all scans alike; parameters start_deg, step_deg")
    if any(topic.name == "RLASER" for topic in streams.topics):
        yield note("lidar", "the log also contains a rear laser (RLASER), which is ignored")
    if streams.lasers and 0 < streams.digits <= 6:
        what = f"stamps are written with {streams.digits} significant digits: times are coarse"
        yield warning("file", what, "do not evaluate timing; use the original log if available")
    if streams.poses_from:
        what = f"its poses are not odometry but {inside}: scans and ODOM lines contain corrected poses"
        yield warning("odometry", what, "they are used as ground truth, without odometry")
    elif not inside:
        yield note("truth", "none inside the file", "relations or a true trajectory may lie beside it, or be given")


def _check_remarks(streams: RecordingStreams) -> Iterator[InspectionFinding]:
    if streams.damage is not None:
        yield warning("file", streams.damage.describe(), AGAIN)
    if streams.missing:
        what = f"{format_count(streams.missing, 'message')} that its index lists cannot be found in it"
        yield warning("file", what, AGAIN)
    yield from _check_defects(streams)
    if streams.damaged and streams.lasers:
        yield warning("file", _describe_dropped(streams))
    for remark in streams.remarks:
        if "derived" in remark.lower() or "pseudo" in remark.lower():
            yield warning("file", f"comment in the file: {remark}")


def _check_defects(streams: RecordingStreams) -> Iterator[InspectionFinding]:
    """Report what a reader of another format has handled; a problem where it drops most scans for their times."""
    for name, count in streams.defects.items():
        if name == REPEATED_STAMPS and count >= streams.topics[0].count:
            what = f"{count} of {count + streams.topics[0].count} scans have the time of another scan, and are dropped"
            yield problem("file", what, "write times with all their digits (not 1.70000E+09), or check their column")
        else:
            yield note("file", f"{name}: {count}")


def _describe_dropped(streams: RecordingStreams) -> str:
    kind, which = ("message", "first that cannot be decoded") if streams.kind.endswith("bag") else ("line", "first")
    first = f"; the {which} is {streams.first_damage}" if streams.first_damage else ""
    return f"{format_count(streams.damaged, f'damaged {kind}')}, dropped{first}"


def _check_frames(tree: FrameTree, streams: RecordingStreams) -> Iterator[InspectionFinding]:
    if not streams.kind.endswith("bag"):
        return
    if not tree.names and streams.lasers:
        yield warning("tf", "no transforms in it: the lidar's pose on the base is unknown",
                      "give base_from_sensor = 'x y theta' (m, m, rad)")  # fmt: skip
    yield from _check_frames_of_lidars(tree, streams)
    for child, parents in tree.contested.items():
        yield warning("tf", f"frame '{child}' has several parents: {', '.join(parents)}")
    siblings = [child for parent, child in streams.tree.moving if parent == "odom"]
    if len(siblings) > 1:
        yield note("tf", f"'odom' is the parent of {' and '.join(sorted(siblings))}", "select one with base_frame")
    for mounting in tree.mountings:
        if mounting.problem:
            yield warning(f"lidar frame {mounting.sensor}", mounting.problem)
        elif mounting.mirrored:
            yield note(f"lidar frame {mounting.sensor}", "mounted upside down; the reader mirrors its angles")
        elif abs(mounting.theta_deg) > 1.0:
            what = f"rotated by {mounting.theta_deg:.0f} deg on '{mounting.base}'"
            yield note(f"lidar frame {mounting.sensor}", what)


def _check_frames_of_lidars(tree: FrameTree, streams: RecordingStreams) -> Iterator[InspectionFinding]:
    for frame in dict.fromkeys(laser.frame for laser in streams.lasers if tree.names):
        if frame not in tree.names:
            what = f"no transform leads to it; those in the recording have the frames {list_frames(tree)}"
            advice = "if it is one of them, give its pose: base_from_sensor = 'x y theta' (m, m, rad)"
            yield warning(f"lidar frame {frame}", what, advice)
