"""The bag reader on whole files: ROS 1, ROS 2 in SQLite and in MCAP, selected by the first byte."""

from __future__ import annotations

from pathlib import Path

from bags import KINDS, SUFFIXES, frames_of, made
from bounds import check_file_reader

MAGIC = {b"#ROSBAG": "ros1", b"SQLite ": "sqlite3"}


def seeds() -> list[bytes]:
    """Return a bag of every format with scans, odometry and transforms."""
    return [made(kind) for kind in KINDS]


def swollen() -> list[bytes]:
    """Return bags with wrong lengths."""
    one, sqlite, mcap = seeds()
    return [
        one[:13] + b"\xff\xff\xff\x7f" + one[17:],
        one[: len(one) // 2] + b"\xff\xff\xff\x7f" * 50_000,
        sqlite[: len(sqlite) // 2] + b"\xff" * 100_000,
        mcap[:8] + b"\x01" + b"\xff\xff\xff\xff\xff\xff\xff\x7f" + mcap[17:],
        mcap[:8] + b"\x06" + b"\x00" * 100_000,
        mcap[:-8] * 20,
    ]


def read_input(data: bytes) -> None:
    """Read a bag and all of its frames. The reader allocates any declared length, but does not fill it."""
    kind = MAGIC.get(data[:7], "mcap")
    check_file_reader(_read, data, f"fuzz{SUFFIXES[kind]}", resident=True)


def _read(path: Path) -> None:
    frames_of(path)
