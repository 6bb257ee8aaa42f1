"""Read all scans, odometry and stamps of a CARMEN log, the digits of its stamps and the logger's clock."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.scan import Scan
from evalkit.io.timestamps import parse_stamp_ns
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit_datasets.commands.inspect.other_files import describe_other_file
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, RecordingStreams, ScanSample, Topic
from evalkit_datasets.parsing import carmen_parser
from evalkit_datasets.parsing.buffers import PoseBuffer
from evalkit_datasets.parsing.carmen_parser import Layout, Log, Reading
from evalkit_datasets.readers.columns import Columns
from evalkit_datasets.readers.reader_common import DAMAGED_LINES

COLUMNS, COLUMNS_KIND = "columns", "log in columns"
MAX_FRAMES = 100_000
OF_SCANS = "scans"
"""How the names of defects of whole scans begin; odometry and ranges are inspected themselves."""

NOTHING: Mapping[str, Value] = {}

LASER_LINES = b"FLASER", b"ROBOTLASER1"
OLD_LASERS = "LASER3", "LASER4", "LASER5"
"""Lines with a scan of CARMEN's old format that state neither pose nor angles."""

MAX_REMARKS = 5
MAX_KINDS = 1000  # kinds of lines that are counted
SCAN_POSES = "robot pose of each scan"


@dataclass(eq=False)
class _LogScans:
    """The scans of a log: the first one, a sample of the ranges, and the robot poses of all."""

    first: Reading | None = None
    scans: ScanSample = field(default_factory=ScanSample)
    robot: PoseBuffer = field(default_factory=PoseBuffer)

    def take(self, reading: Reading) -> None:
        """Add the next scan."""
        self.first = self.first or reading
        self.scans.append(reading.ranges)
        self.robot.append(reading.stamp_ns, reading.robot)


@dataclass(eq=False)
class _OtherLines:
    """What the lines of a log hold besides: number of each kind, comments, and the stamps of the logger's clock.

    ``lasers``: the kinds of lines with scans. ``logger_ns``: of the scans, None after one that cannot be read.
    ``digits``: the most of an ipc stamp.
    """

    lasers: tuple[bytes, ...] = LASER_LINES
    kinds: Counter[str] = field(default_factory=Counter)
    remarks: list[str] = field(default_factory=list)
    logger_ns: array[int] | None = field(default_factory=lambda: array("q"))
    digits: int = 0

    def take(self, line: bytes) -> None:
        """Add the next line."""
        words = line.split()
        if not words:
            return
        if words[0].startswith(b"#"):
            remark = line.decode("latin-1").lstrip("# ").strip()
            if " " in remark and len(self.remarks) < MAX_REMARKS:
                self.remarks.append(remark)
            return
        kind = words[0].decode("latin-1")
        if kind in self.kinds or len(self.kinds) < MAX_KINDS:
            self.kinds[kind] += 1
        if words[0] in self.lasers and len(words) > 3:
            self.digits = max(self.digits, _count_digits(words[-3]))
            self._take_logger_stamp(words[-1])

    def _take_logger_stamp(self, word: bytes) -> None:
        if self.logger_ns is not None:
            try:
                self.logger_ns.append(parse_stamp_ns(word.decode("latin-1")))
            except ValueError:
                self.logger_ns = None


def read_log_streams(path: Path, layout: Layout = carmen_parser.DEFAULT_LAYOUT) -> RecordingStreams:
    """Return the streams of a log; raises BadData if the file is not a log or is damaged gzip.

    ``layout``: the angles of lines that do not state them.
    """
    log, scans = Log(layout), _LogScans()
    for _, reading in carmen_parser.iter_readings(path, log):
        scans.take(reading)
    if not (len(scans.scans) or len(log.odometry) or log.damaged):
        raise BadData(str(path), "", *describe_other_file(path))
    others = _OtherLines((log.raw.encode(),) if log.raw else LASER_LINES)
    for line in carmen_parser.iter_log_lines(path):
        others.take(line)
    stamps = scans.robot.stamps_ns
    seconds = float(stamps.max() - stamps.min()) * 1e-9 if len(stamps) else 0.0
    rate = 1.0 / seconds if seconds > 0.0 else float("nan")
    topics = [Topic(kind, _describe_line(kind), count, count * rate) for kind, count in others.kinds.most_common(12)]
    return RecordingStreams(
        path, "CARMEN log", "carmen", topics, _make_laser_streams(log, scans, others.logger_ns),
        _make_odometry_streams(log, scans.robot), poses_from=log.poses_from,
        digits=others.digits, damaged=log.damaged, remarks=others.remarks,
        first_damage=f"line {log.damage[0]}: {log.damage[1]}" if log.damaged else "",
    )  # fmt: skip


def read_sequence_streams(path: Path, reader: str, given: Mapping[str, Value] = NOTHING) -> RecordingStreams:
    """Return the streams of a recording as a reader of any plug-in yields them; raises as that reader.

    ``given``: parameters of the reader. At most ``MAX_FRAMES`` frames are taken.
    """
    spec = registry.dataset(reader)
    sequence = spec.make(**{**given, "path": str(path)})
    scans, times, poses = ScanSample(), array("q"), PoseBuffer()
    first: Scan | None = None
    for frame in islice(sequence.frames(), MAX_FRAMES):
        first = first or frame.scan
        scans.append(frame.scan.ranges)
        times.append(frame.scan.stamp_ns)
        if frame.odom_from_base is not None:
            poses.append(frame.scan.stamp_ns, frame.odom_from_base.row)
    if first is None:
        raise BadData(str(path), "", f"reader '{reader}' finds no scan in it", "give another file, or --reader NAME")
    stamps = np.asarray(times)
    laser = LaserStream(
        reader, reader, "laser", stamps, None, scans, first.angles,
        first.range_min_m, first.range_max_m, first.time_increment_ns,
    )  # fmt: skip
    recorded = sequence.recorded_odometry if isinstance(sequence, Columns) else (poses.stamps_ns, poses.poses)
    wheels = [OdometryStream(reader, "odom", "base", *recorded)] if len(poses) else []
    seconds = float(stamps[-1] - stamps[0]) * 1e-9
    rate = (len(stamps) - 1) / seconds if seconds > 0.0 else float("nan")
    kind = COLUMNS_KIND if reader == COLUMNS else f"recording read by '{reader}'"
    notes = sequence.notes()
    defects = {name: count for name, count in notes.items() if name.startswith(OF_SCANS)}
    damaged = notes.get(DAMAGED_LINES, 0)
    return RecordingStreams(
        path, kind, reader, [Topic("scans", "a scan each", len(stamps), rate)], [laser], wheels,
        damaged=damaged, defects=defects,
        first_damage=sequence.first_damage if isinstance(sequence, Columns) else "",
    )  # fmt: skip


def _make_laser_streams(log: Log, scans: _LogScans, logger_ns: array[int] | None) -> list[LaserStream]:
    """Return the lidar of a log; the logger's times are left out if they do not correspond to the scans."""
    if scans.first is None:
        return []
    recorded = np.asarray(logger_ns) if logger_ns is not None and len(logger_ns) == len(scans.scans) else None
    lines = log.raw or "FLASER / ROBOTLASER1"
    return [
        LaserStream(lines, "laser lines", "laser", scans.robot.stamps_ns, recorded, scans.scans,
                    scans.first.angles, float("nan"), float("nan"))
    ]  # fmt: skip


def _make_odometry_streams(log: Log, robot: PoseBuffer) -> list[OdometryStream]:
    streams = []
    if len(log.odometry):
        streams.append(OdometryStream("ODOM lines", "odom", "base", log.odometry.stamps_ns, log.odometry.poses))
    if len(robot) and (robot.poses != robot.poses[0]).any():
        streams.append(OdometryStream(SCAN_POSES, "odom", "base", robot.stamps_ns, robot.poses))
    return streams


def _count_digits(word: bytes) -> int:
    mantissa = word.lower().split(b"e")[0]
    return len(mantissa.replace(b".", b"").replace(b"-", b"").lstrip(b"0"))


def _describe_line(kind: str) -> str:
    return {
        "FLASER": "front laser with two poses", "ROBOTLASER1": "laser with geometry", "ODOM": "wheel odometry or poses",
        "RAWLASER1": "laser without poses, read if no other line has scans",
        **dict.fromkeys(OLD_LASERS, "another laser without poses, read if no other line has scans"),
        "RLASER": "rear laser, ignored", "PARAM": "robot parameter", "NEFF": "written by GMapping",
        "VERTEX2": "pose of an optimised graph", "VERTEX_SE2": "pose of an optimised graph",
    }.get(kind, "ignored")  # fmt: skip
