"""All scans, odometry and stamps of a CARMEN log, with what only its text tells: digits and the logger's clock."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.timestamps import parse_stamp_ns
from evalkit_datasets import carmen_parser
from evalkit_datasets.carmen_parser import Log, Reading
from evalkit_datasets.inspection.streams import LaserStream, OdometryStream, RecordingStreams, Topic

NO_RECORDING = {
    ".tum": "a trajectory (.tum) goes beside a recording: evalkit compare RECORDING --reference FILE",
    ".relations": "relations go beside a recording: evalkit compare RECORDING --relations FILE",
    ".toml": "an experiment is run with evalkit compare FILE, distances by tape go beside a recording: --spans FILE",
    ".yaml": "a map is compared as the method file:MAP.yaml",
    ".pgm": "a map is compared as the method file:MAP.yaml",
}
"""What to do with files that people hold a recording for, by their endings."""

LASER_LINES = (b"FLASER", b"ROBOTLASER1")
REMARKS = 5
BESIDE = "robot pose beside each scan"


def read(path: Path) -> RecordingStreams:
    """The streams of a log; BadData where it is no log or holds damaged gzip."""
    log, readings = carmen_parser.read_log(path)
    if not (readings or len(log.odometry) or log.damaged):
        what = "no line begins with FLASER, ROBOTLASER1, LASER_READING or ODOM"
        remedy = NO_RECORDING.get(path.suffix, "give a bag (.bag, .db3, .mcap, or the folder of one) or a CARMEN log")
        raise BadData(str(path), "", what, remedy)
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
    lasers = [_laser(readings, tails)] if readings else []
    seconds = (lasers[0].stamps_ns.max() - lasers[0].stamps_ns.min()) * 1e-9 if lasers else 0.0
    rate = 1.0 / seconds if seconds > 0.0 else float("nan")
    topics = [Topic(kind, _meaning(kind), count, count * rate) for kind, count in kinds.most_common(12)]
    digits = max((_digits(ipc) for ipc, _ in tails), default=0)
    told = [remark for remark in remarks if " " in remark][:REMARKS]
    return RecordingStreams(
        path, "CARMEN log", topics, lasers, _wheels(log, readings), poses_from=log.poses_from, digits=digits,
        damaged=log.damaged, remarks=told,
    )  # fmt: skip


def _laser(readings: list[Reading], tails: list[tuple[bytes, bytes]]) -> LaserStream:
    stamps = np.array([reading.stamp_ns for reading in readings], dtype=np.int64)
    return LaserStream(
        "FLASER / ROBOTLASER1",
        "laser lines",
        "laser",
        stamps,
        _logger(tails, len(stamps)),
        [reading.ranges for reading in readings],
        readings[0].angles,
        float("nan"),
        float("nan"),
    )


def _logger(tails: list[tuple[bytes, bytes]], scans: int) -> Stamps | None:
    """The logger's times (N,), None where they do not pair up with the scans."""
    if len(tails) != scans:
        return None
    try:
        return np.array([parse_stamp_ns(logger.decode("latin-1")) for _, logger in tails], dtype=np.int64)
    except ValueError:
        return None


def _wheels(log: Log, readings: list[Reading]) -> list[OdometryStream]:
    found = []
    if len(log.odometry):
        found.append(OdometryStream("ODOM lines", "odom", "base", log.odometry.stamps_ns, log.odometry.poses))
    poses = [reading.robot for reading in readings]
    if len(set(poses)) > 1:
        stamps = np.array([reading.stamp_ns for reading in readings], dtype=np.int64)
        found.append(OdometryStream(BESIDE, "odom", "base", stamps, _rows(poses)))
    return found


def _rows(rows: list[tuple[float, float, float]]) -> Floats:
    return np.array(rows, dtype=np.float64).reshape(-1, 3)


def _digits(word: bytes) -> int:
    mantissa = word.lower().split(b"e")[0]
    return len(mantissa.replace(b".", b"").replace(b"-", b"").lstrip(b"0"))


def _meaning(kind: str) -> str:
    return {
        "FLASER": "front laser, two poses", "ROBOTLASER1": "laser with its geometry", "ODOM": "wheel odometry or poses",
        "RLASER": "rear laser, not read", "PARAM": "a setting of the robot", "NEFF": "left by GMapping",
        "VERTEX2": "a pose of an optimised graph", "VERTEX_SE2": "a pose of an optimised graph",
    }.get(kind, "not read")  # fmt: skip
