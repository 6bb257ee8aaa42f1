"""Inspect a recording: measure every stream and collect the findings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from evalkit.config import adhoc_experiment
from evalkit.plugins.parameters import Value
from evalkit_datasets.commands.inspect import bag_streams, findings, log_streams
from evalkit_datasets.commands.inspect.finding import InspectionFinding
from evalkit_datasets.commands.inspect.frame_tree import FrameTree, build_frame_tree, mirror_if_upside_down
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.odometry_stats import OdometryStats, measure_odometry
from evalkit_datasets.commands.inspect.odometry_unit import compare_lengths, find_length_unit, scale_lengths
from evalkit_datasets.commands.inspect.range_stats import measure_ranges
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, RecordingStreams, Topic
from evalkit_datasets.commands.inspect.timing import MIN_CLOCK_STEP_S, ClockOffset, measure_clock_offset, measure_timing
from evalkit_datasets.commands.inspect.turn_comparison import TurnComparison, compare_turns
from evalkit_datasets.parsing import bag_file, carmen_parser
from evalkit_datasets.parsing.columns_layout import is_described
from evalkit_datasets.parsing.sweeps import SweepOptions, parse_fields

ROSBAG, CARMEN, COLUMNS = OWN = ("rosbag", "carmen", "columns")
"""Readers with an inspection of their own: of the file instead of the frames (columns: with a proposal)."""

TRUTH_WORDS = ("ground_truth", "groundtruth", "gt", "mocap", "vicon", "optitrack", "reference")


@dataclass(frozen=True, eq=False)
class Inspection:
    """All measurements of a recording. ``turns``: rotations against the best lidar, by odometry."""

    path: Path
    kind: str
    bytes: int
    topics: tuple[Topic, ...]
    lidars: tuple[LidarStats, ...]
    odometries: tuple[OdometryStats, ...]
    turns: Mapping[str, TurnComparison]
    frames: FrameTree
    poses_from: str
    truth_inside: str
    remarks: tuple[str, ...]
    findings: tuple[InspectionFinding, ...]
    streams: RecordingStreams


def inspect_recording(path: Path, reader: str = "", given: Mapping[str, Value] | None = None) -> Inspection:
    """Return the inspection of a recording; raises BadData or DataMissing as the readers.

    ``reader``: the data set that reads it; found by content and suffix if not given. ``given``: its parameters, which
    readers without an inspection of their own need.
    """
    reader, topic = reader or find_reader_name(path), str((given or {}).get("topic", ""))
    streams = _read_streams(path, reader, given or {})
    lidars = tuple(_measure_lidar(laser) for laser in streams.lasers)
    best = _select_lidar(lidars, topic)
    others = _find_other_robots(streams, lidars, best, given or {}) if reader == ROSBAG else frozenset()
    if others:
        streams = _read_streams(path, reader, given or {}, others)
        lidars = tuple(one for one in lidars if one.topic not in others)
        best = _select_lidar(lidars, topic)
    tree = build_frame_tree(streams.tree, streams.lasers, _list_bases(streams.wheels, given or {}))
    laser = None if best is None else mirror_if_upside_down(streams.lasers[best], tree)
    odometries, turns = [], {}
    for wheels in streams.wheels:
        stats, comparison = _measure_odometry(wheels, laser, None if best is None else lidars[best].clock)
        odometries.append(stats)
        if comparison is not None:
            turns[f"{wheels.topic} {wheels.child}"] = comparison
    inside, turned = _describe_truth_inside(streams), streams.lasers[best or 0].topic if turns else ""
    return Inspection(
        path, streams.kind, _count_bytes(path), tuple(streams.topics), lidars, tuple(odometries), turns, tree,
        streams.poses_from, inside, tuple(streams.remarks),
        findings.collect_findings(streams, inside, lidars, odometries, turns, turned, tree),
        streams,
    )  # fmt: skip


def _list_bases(wheels: Sequence[OdometryStream], given: Mapping[str, Value]) -> list[str]:
    """Return the frames that the reader may take as the base: a given one, then those of the odometries.

    First the odometry that is given, or the topic "odom"; none if no odometry is used.
    """
    base, odometry = (str(given.get(name, default)) for name, default in (("base_frame", ""), ("odometry", "auto")))
    wanted = "odom" if odometry == "auto" else odometry.lstrip("/")
    ordered = [] if odometry == "none" else sorted(wheels, key=lambda one: one.topic.lstrip("/") != wanted)
    return [*([base] if base else []), *(one.child for one in ordered)]


def _measure_odometry(
    wheels: OdometryStream, laser: LaserStream | None, clock: ClockOffset | None
) -> tuple[OdometryStats, TurnComparison | None]:
    """Return the statistics of an odometry and its turns against a lidar with its clock, None if they show nothing.

    Where the times of recording show that the lidar has another clock, the turns are compared with that mended.
    """
    found = measure_odometry(wheels)
    found = replace(found, unit=find_length_unit(wheels, laser, found.driving_m_s))
    if laser is None:
        return found, None
    found = replace(found, lengths=None if found.unit is not None else compare_lengths(wheels, laser))
    turns = compare_turns(wheels, laser)
    apart_s = 0.0 if clock is None or found.clock is None else found.clock.median_s - clock.median_s
    if abs(apart_s) < MIN_CLOCK_STEP_S or (turns is not None and turns.agrees_in_time):
        return found, turns
    turns = compare_turns(wheels, replace(laser, stamps_ns=laser.stamps_ns + round(apart_s * 1e9)))
    if turns is not None:
        turns = turns.shift(apart_s)
        apart_s = turns.shift_s if math.isfinite(turns.shift_s) else apart_s
    return replace(found, clock_shift_s=apart_s), turns


def find_reader_name(path: Path) -> str:
    """Return the name of the reader of a recording: plug-ins are asked by content first; a CARMEN log is the rest."""
    if path.is_dir() or path.suffix in bag_file.SUFFIXES:
        found = adhoc_experiment.find_reader(path)
        return found[0] if found is not None else ROSBAG
    found = adhoc_experiment.find_reader(path)
    own = found is not None and (found[1].recognises is not None or found[0] not in OWN)
    return found[0] if found is not None and own and not _lacks_layout(path, found[0]) else CARMEN


def _lacks_layout(path: Path, reader: str) -> bool:
    return reader == COLUMNS and not is_described(path)


def _select_lidar(lidars: Sequence[LidarStats], topic: str) -> int | None:
    """Return the index of the lidar of a topic, else of the one that measures most; None if there is none."""
    named = (at for at, one in enumerate(lidars) if topic and one.topic.lstrip("/") == topic.lstrip("/"))
    return next(named, max(range(len(lidars)), key=lambda at: measured_directions(lidars[at]), default=None))


def _read_streams(
    path: Path, reader: str, given: Mapping[str, Value], left_out: frozenset[str] = frozenset()
) -> RecordingStreams:
    if reader == ROSBAG:
        fields = parse_fields(str(given.get("fields", "")))
        sweep_s, shift_s = (_number(given, name, 0.0) for name in ("sweep_s", "stamp_shift_s"))
        options = SweepOptions(fields=fields, sweep_s=sweep_s, stamp_shift_s=shift_s)
        streams = bag_streams.read_bag_streams(path, left_out, options)
        unit = str(given.get("odometry_unit", "m"))
        streams = replace(streams, wheels=[scale_lengths(one, unit) for one in streams.wheels])
        return _reverse_angles(streams) if fields is not None and fields.clockwise else streams
    if reader == CARMEN:
        layout = _number(given, "start_deg", carmen_parser.DEFAULT_LAYOUT[0]), _number(given, "step_deg", 0.0)
        return log_streams.read_log_streams(path, layout)
    own = {name: value for name, value in given.items() if name not in ("start", "every", "limit")}
    return log_streams.read_sequence_streams(path, reader, own)


def _find_other_robots(
    streams: RecordingStreams, lidars: Sequence[LidarStats], best: int | None, given: Mapping[str, Value]
) -> frozenset[str]:
    if best is None:
        return frozenset()
    return bag_streams.find_other_robots(streams, lidars[best].topic, str(given.get("odometry", "")))


def _number(given: Mapping[str, Value], name: str, default: float) -> float:
    return float(str(given.get(name, default)))


def _reverse_angles(streams: RecordingStreams) -> RecordingStreams:
    """Return the streams with the angles of all scans clockwise."""
    lasers = [one if "clockwise" in one.fields.split() else replace(one, angles=-one.angles) for one in streams.lasers]
    return replace(streams, lasers=lasers)


def measured_directions(lidar: LidarStats) -> float:
    """Return the field of view with hits (deg) times the scan rate (at most 10 Hz): ranks several lidars."""
    return lidar.field_of_view_deg * lidar.returns.hits * min(lidar.timing.rate_hz, 10.0)


def field_of_view_deg(angles: Sequence[float]) -> float:
    """Return the angle (deg) from the first beam to the last; 360 where one more step is a full circle to a degree."""
    span = math.degrees(abs(angles[-1] - angles[0]))
    return 360.0 if span + span / max(len(angles) - 1, 1) > 359.0 else span


def _measure_lidar(laser: LaserStream) -> LidarStats:
    angles = laser.angles.tolist()
    return LidarStats(
        laser.topic,
        laser.kind,
        laser.frame,
        len(angles),
        field_of_view_deg(angles),
        math.degrees(angles[0]),
        math.degrees((angles[-1] - angles[0]) / (len(angles) - 1)),
        laser.range_min_m if math.isfinite(laser.range_min_m) else None,
        laser.range_max_m if math.isfinite(laser.range_max_m) else None,
        laser.time_increment_ns * 1e-9 * (len(angles) - 1),
        measure_timing(laser.stamps_ns),
        None if laser.recorded_ns is None else measure_clock_offset(laser.stamps_ns, laser.recorded_ns),
        measure_ranges(laser),
        laser.damaged,
        laser.unstamped,
    )


def _count_bytes(path: Path) -> int:
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.is_file()]
    return sum(file.stat().st_size for file in files)


def _describe_truth_inside(streams: RecordingStreams) -> str:
    if streams.poses_from:
        return {"gmapping": "GMapping's poses", "graph": "graph-optimised poses"}[streams.poses_from]
    named = [t.name for t in streams.topics if any(word in t.name.lower().split("/") for word in TRUTH_WORDS)]
    slam = [f"{parent} to {child}" for parent, child in streams.tree.moving if parent == "map"]
    topics = [f"by its name, topic {name}" for name in named]
    return "; ".join(topics + [f"tf {pair} of a localisation (not independent)" for pair in slam])
