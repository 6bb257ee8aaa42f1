"""Write a sequence as a scan log for ``evalkit-run`` and for boards (format: include/ek/scanlog.h).

``python -m evalkit_baselines.embedded.scanlog fr079 fr079.eksl --every 2``
"""

from __future__ import annotations

import argparse
import struct
import sys
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

from evalkit.core.errors import EvalkitError
from evalkit.core.scan import Frame
from evalkit.plugins import registry

MAGIC, VERSION = b"EKSL", 1
HAS_ODOMETRY, HAS_MOTION = 1, 2
MAX_BEAMS_AT = 8
"""Byte of the header where the number of beams of the largest scan is."""


def encode_record(frame: Frame) -> bytes:
    """Encode one scan; ranges and angles as 32-bit floats."""
    scan, odometry, motion = frame.scan, frame.odom_from_base, frame.start_from_end
    flags = HAS_ODOMETRY * (odometry is not None) + HAS_MOTION * (motion is not None)
    head = struct.pack("<2q2I", scan.stamp_ns, scan.time_increment_ns, len(scan.ranges), flags)
    poses = b"".join(pose.row.astype("<f8").tobytes() for pose in (odometry, motion) if pose is not None)
    return head + poses + scan.ranges.astype("<f4").tobytes() + scan.angles.astype("<f4").tobytes()


def write_scan_log(path: Path, frames: Iterable[Frame]) -> int:
    """Write frames, all with the first one's mount and limits of range; returns their number."""
    count = most = 0
    with path.open("wb") as file:
        for frame in frames:
            if not count:
                limits = struct.pack("<2I2d", VERSION, 0, frame.scan.range_min_m, frame.scan.range_max_m)
                file.write(MAGIC + limits + frame.base_from_sensor.row.astype("<f8").tobytes())
            file.write(encode_record(frame))
            count, most = count + 1, max(most, len(frame.scan.ranges))
        file.seek(MAX_BEAMS_AT)
        file.write(struct.pack("<I", most))
    return count


def parse_count(text: str) -> int:
    """Return a number from 1 on; anything else is a usage error."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found '{text}', expected a whole number from 1 on")
    return int(text)


def main() -> None:
    """Write a data set with its default parameters; a data set or a path that cannot be used is a usage error."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("dataset")
    parser.add_argument("path", type=Path)
    parser.add_argument("--every", type=parse_count, default=1, help="write every n-th scan (default: 1)")
    parser.add_argument("--limit", type=parse_count, help="write at most so many scans")
    arguments = parser.parse_args()
    try:
        spec = registry.dataset(arguments.dataset)
        if absent := spec.missing():
            parser.error(f"{arguments.dataset}: {absent}")
        sequence = spec.make(**{parameter.name: parameter.default for parameter in spec.parameters})
        frames = islice(sequence.frames(), 0, None, arguments.every)
        count = write_scan_log(arguments.path, islice(frames, arguments.limit))
    except EvalkitError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename or arguments.path}: cannot be written: {error.strerror}")
    sys.stdout.write(f"{arguments.path}: {count} scans, {arguments.path.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
