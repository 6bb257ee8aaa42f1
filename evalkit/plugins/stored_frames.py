"""The frames of a sequence in one file: processes that need the same data read them there, not from the recording."""

from __future__ import annotations

import hashlib
import json
import math
import os
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.io.output_files import write_bytes
from evalkit.plugins.kept_sequence import MAX_BYTES
from evalkit.plugins.protocols import Sequence

_FRAME = struct.Struct("<4q11d")
"""Everything of a frame but its ranges: stamp, beams, number of its array of angles, time increment; range limits,
``base_from_sensor``, ``odom_from_base`` and ``start_from_end``, where nan is no pose."""

_NO_POSE = (math.nan,) * 3


@dataclass(frozen=True)
class FramesFile:
    """A file of ``write_frames`` and its SHA-256; the sequence holds one in ``every`` scans of the sensor."""

    path: str
    sha256: str
    every: int = 1


def write_frames(sequence: Sequence, path: Path, root: Path, max_bytes: int = MAX_BYTES) -> str | None:
    """Write the frames and notes of a sequence to a file; return its SHA-256.

    None, and no file, where the ranges and angles have more than ``max_bytes``, or where a frame, scan or pose is of a
    class of its own, of which the file cannot hold all. ``root``: see ``write_bytes``; raises as this and the sequence.
    """
    rows, ranges, size = [], list[bytes](), 0
    numbers: dict[bytes, int] = {}
    for frame in sequence.frames():
        scan, poses = frame.scan, (frame.base_from_sensor, frame.odom_from_base, frame.start_from_end)
        if type(frame) is not Frame or type(scan) is not Scan or not all(type(p) in (Pose, type(None)) for p in poses):
            return None
        angles, own = scan.angles.tobytes(), scan.ranges.tobytes()
        size += len(own) + (0 if angles in numbers else len(angles))
        if size > max_bytes:
            return None
        ranges.append(own)
        rows.append((
            scan.stamp_ns, len(scan.ranges), numbers.setdefault(angles, len(numbers)), scan.time_increment_ns,
            scan.range_min_m, scan.range_max_m,
            *(value for pose in poses for value in (_NO_POSE if pose is None else (pose.x, pose.y, pose.theta))),
        ))  # fmt: skip
    counts = {"expected": len(sequence), "frames": len(rows), "angles": list(map(len, numbers))}
    header = {**counts, "notes": dict(sequence.notes())}
    parts = (json.dumps(header).encode() + b"\n", b"".join(_FRAME.pack(*row) for row in rows), *numbers, *ranges)
    content = b"".join(parts)
    write_bytes(path, content, root)
    return hashlib.sha256(content).hexdigest()


class StoredFrames:
    """The frames and notes of a sequence from a file of ``write_frames``; one scan is in memory at a time.

    Raises BadData where the file has changed, before anything in it is used.
    """

    def __init__(self, file: FramesFile) -> None:
        self._file: BinaryIO = open(file.path, "rb")  # noqa: SIM115, PTH123 - read as long as this object lives
        digest = hashlib.file_digest(self._file, "sha256").hexdigest()
        if digest != file.sha256:
            self._file.close()
            raise BadData(file.path, "", f"sha256 {digest[:12]}... instead of {file.sha256[:12]}...", "run it again")
        self._file.seek(0)
        header = json.loads(self._file.readline())
        self._expected, self._notes = int(header["expected"]), dict(header["notes"])
        self._rows = self._file.read(_FRAME.size * header["frames"])
        self._angles = [np.frombuffer(self._file.read(size)) for size in header["angles"]]
        self._begin = self._file.tell()

    def __len__(self) -> int:
        return self._expected

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; equal to the bit to those of the sequence."""
        at, file = self._begin, self._file.fileno()
        for stamp_ns, beams, angles, time_increment_ns, low_m, high_m, *poses in _FRAME.iter_unpack(self._rows):
            content = os.pread(file, 8 * beams, at)
            if len(content) != 8 * beams:
                raise BadData(self._file.name, f"byte {at + len(content)}", "it ends there", "run it again")
            ranges, at = np.frombuffer(content), at + len(content)
            scan = Scan.of_checked(stamp_ns, ranges, self._angles[angles], low_m, high_m, time_increment_ns)
            yield Frame(
                scan, _pose_or_none(*poses[:3]) or Pose(), _pose_or_none(*poses[3:6]), _pose_or_none(*poses[6:])
            )

    def notes(self) -> Mapping[str, int]:
        """Return the notes of the sequence."""
        return self._notes


def _pose_or_none(x: float, y: float, theta: float) -> Pose | None:
    return None if math.isnan(x) else Pose.of_checked(x, y, theta)
