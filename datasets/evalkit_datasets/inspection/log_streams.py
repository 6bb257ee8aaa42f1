"""Read all scans, odometry and stamps of a CARMEN log, the digits of its stamps and the logger's clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Stamps
from evalkit.io.timestamps import parse_stamp_ns
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit_datasets import carmen_parser
from evalkit_datasets.carmen_parser import Log, Reading
from evalkit_datasets.inspection.other_files import describe_other_file
from evalkit_datasets.inspection.streams import LaserStream, OdometryStream, RecordingStreams, Topic

COLUMNS, COLUMNS_KIND = "columns", "log in columns"
MAX_FRAMES = 100_000
NOTHING: Mapping[str, Value] = {}

LASER_LINES = (b"FLASER", b"ROBOTLASER1")
MAX_REMARKS = 5
SCAN_POSES = "robot pose of each scan"


def read_log_streams(path: Path) -> RecordingStreams:
    """Return the streams of a log; raises BadData if the file is not a log or is damaged gzip."""
    log, readings = carmen_parser.read_log(path)
    if not (readings or len(log.odometry) or log.damaged):
        raise BadData(str(path), "", *describe_other_file(path))
    kinds: Counter[str] = Counter()
    remarks: list[str] = []
    tails: list[tuple[bytes, bytes]] = []
    for line in carmen_parser.iter_log_lines(path):
        words = line.split()
        if not words:
            continue
        if words[0].startswith(b"#"):
            remarks.append(line.decode("latin-1").lstrip("# ").strip())
            continue
        kinds[words[0].decode("latin-1")] += 1
        if words[0] in LASER_LINES and len(words) > 3:
            tails.append((words[-3], words[-1]))
    lasers = [_make_laser_stream(readings, tails)] if readings else []
    seconds = (lasers[0].stamps_ns.max() - lasers[0].stamps_ns.min()) * 1e-9 if lasers else 0.0
    rate = 1.0 / seconds if seconds > 0.0 else float("nan")
    topics = [Topic(kind, _describe_line(kind), count, count * rate) for kind, count in kinds.most_common(12)]
    digits = max((_count_digits(ipc) for ipc, _ in tails), default=0)
    comments = [remark for remark in remarks if " " in remark][:MAX_REMARKS]
    return RecordingStreams(
        path, "CARMEN log", "carmen", topics, lasers, _make_odometry_streams(log, readings), poses_from=log.poses_from,
        digits=digits, damaged=log.damaged, remarks=comments,
    )  # fmt: skip


def read_sequence_streams(path: Path, reader: str, given: Mapping[str, Value] = NOTHING) -> RecordingStreams:
    """Return the streams of a recording as a reader of any plug-in yields them; raises as that reader.

    ``given``: parameters of the reader. At most ``MAX_FRAMES`` frames are taken.
    """
    spec = registry.dataset(reader)
    sequence = spec.make(**{**given, "path": str(path)})
    frames = list(islice(sequence.frames(), MAX_FRAMES))
    if not frames:
        raise BadData(str(path), "", f"reader '{reader}' finds no scan in it", "give another file, or --reader NAME")
    first = frames[0].scan
    stamps = np.array([frame.scan.stamp_ns for frame in frames], dtype=np.int64)
    laser = LaserStream(
        reader, reader, "laser", stamps, None, [frame.scan.ranges for frame in frames], first.angles,
        first.range_min_m, first.range_max_m, first.time_increment_ns,
    )  # fmt: skip
    known = [frame for frame in frames if frame.odom_from_base is not None]
    poses = [frame.odom_from_base.row for frame in known if frame.odom_from_base is not None]
    times = np.array([frame.scan.stamp_ns for frame in known], dtype=np.int64)
    wheels = [OdometryStream(reader, "odom", "base", times, np.array(poses))] if poses else []
    seconds = float(stamps[-1] - stamps[0]) * 1e-9
    rate = (len(frames) - 1) / seconds if seconds > 0.0 else float("nan")
    kind = COLUMNS_KIND if reader == COLUMNS else f"recording read by '{reader}'"
    damaged = sequence.notes().get("damaged lines dropped", 0)
    return RecordingStreams(
        path, kind, reader, [Topic("scans", "a scan each", len(frames), rate)], [laser], wheels, damaged=damaged
    )


def _make_laser_stream(readings: list[Reading], tails: list[tuple[bytes, bytes]]) -> LaserStream:
    stamps = np.array([reading.stamp_ns for reading in readings], dtype=np.int64)
    return LaserStream(
        "FLASER / ROBOTLASER1",
        "laser lines",
        "laser",
        stamps,
        _parse_logger_stamps(tails, len(stamps)),
        [reading.ranges for reading in readings],
        readings[0].angles,
        float("nan"),
        float("nan"),
    )


def _parse_logger_stamps(tails: list[tuple[bytes, bytes]], scans: int) -> Stamps | None:
    """Return the logger's times (N,), or None if they do not correspond to the scans."""
    if len(tails) != scans:
        return None
    try:
        return np.array([parse_stamp_ns(logger.decode("latin-1")) for _, logger in tails], dtype=np.int64)
    except ValueError:
        return None


def _make_odometry_streams(log: Log, readings: list[Reading]) -> list[OdometryStream]:
    streams = []
    if len(log.odometry):
        streams.append(OdometryStream("ODOM lines", "odom", "base", log.odometry.stamps_ns, log.odometry.poses))
    poses = [reading.robot for reading in readings]
    if len(set(poses)) > 1:
        stamps = np.array([reading.stamp_ns for reading in readings], dtype=np.int64)
        streams.append(OdometryStream(SCAN_POSES, "odom", "base", stamps, np.array(poses)))
    return streams


def _count_digits(word: bytes) -> int:
    mantissa = word.lower().split(b"e")[0]
    return len(mantissa.replace(b".", b"").replace(b"-", b"").lstrip(b"0"))


def _describe_line(kind: str) -> str:
    return {
        "FLASER": "front laser with two poses", "ROBOTLASER1": "laser with geometry", "ODOM": "wheel odometry or poses",
        "RLASER": "rear laser, ignored", "PARAM": "robot parameter", "NEFF": "written by GMapping",
        "VERTEX2": "pose of an optimised graph", "VERTEX_SE2": "pose of an optimised graph",
    }.get(kind, "ignored")  # fmt: skip
