"""The CARMEN reader, from the bytes of a log to the last frame."""

from __future__ import annotations

import gzip
from pathlib import Path

from bounds import check_file_reader

from evalkit_datasets.readers.carmen import Carmen


def seeds() -> list[bytes]:
    """Return logs with every type of line, plain and gzip."""
    beams = " ".join(["2.0"] * 180)
    flaser = "".join(f"FLASER 180 {beams} {k} 0 0 {k} 0 0 {k}.25 host {k}.25\n" for k in range(3))
    robot = "".join(
        f"ROBOTLASER1 0 -1.5 3.0 1.5 30 0.01 0 3 1.0 2.0 81.91 0 {k} 0 0.1 {k} 0 0.1 0 0 1 1 0 {k}.5 host {k}.5\n"
        for k in range(3)
    )
    raw = "".join(f"RAWLASER1 0 -1.5 3.0 1.5 30 0.01 0 3 1.0 2.0 81.91 0 {k}.5 host {k}.5\n" for k in range(3))
    old = "".join(f"LASER3 180 {beams} {k}.5 host {k}.5\n" for k in range(3))
    odometry = "".join(f"ODOM {k} 0 0 0 0 0 {k}.0 host {k}.0\n" for k in range(5))
    gmapping = f"LASER_READING 180 {beams} 0 0 0 1.0\nLASER_READING 180 {beams} 0 0 0 2.0\nNEFF 3\n"
    logs = [
        flaser,
        robot,
        raw,
        old,
        odometry + robot,
        gmapping,
        "PARAM robot_frontlaser_offset 0.1\nVERTEX2 1 0 0 0\n" + robot,
    ]
    return [log.encode() for log in logs] + [gzip.compress((odometry + robot).encode())]


def swollen() -> list[bytes]:
    """Return inputs of 100 kB and more whose cost could grow faster than their size."""
    return [
        b"FLASER 1000000000 " + b"1 " * 100_000,
        b"FLASER 50000 " + b"1 " * 50_000 + b"0 0 0 0 0 0 1 h 1\n",
        b"FLASER " + b"9" * 200_000,
        b"ODOM 0 0 0 0 0 0 1 h 1\n" * 10_000,
        b"ROBOTLASER1 0 -1.5 3.0 1.5 30 0.01 0 2 1.0 2.0 0 0 0 0.1 0 0 0.1 0 0 1 1 0 1 host 1\n" * 2_000,
        gzip.compress(b"\0" * 60_000_000),
        gzip.compress(b"FLASER 2 1 1 0 0 0 0 0 0 1 h 1\n") * 5_000,
    ]


def read_input(data: bytes) -> None:
    """Read a log and all of its frames."""
    check_file_reader(_read, data, "fuzz.log")


def _read(path: Path) -> None:
    sequence = Carmen(str(path))
    for _ in sequence.frames():
        pass
    sequence.truth(), sequence.notes()
