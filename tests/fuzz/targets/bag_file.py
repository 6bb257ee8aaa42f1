"""The bag reader from the file's bytes on: ROS 1, ROS 2 in SQLite and in MCAP, told apart by their first bytes."""

from __future__ import annotations

from pathlib import Path

from bags import KINDS, SUFFIXES, frames_of, made
from bounds import held_file

MAGIC = {b"#ROSBAG": "ros1", b"SQLite ": "sqlite3"}


def seeds() -> list[bytes]:
    """A bag of every kind with scans, odometry and transforms."""
    return [made(kind) for kind in KINDS]


def swollen() -> list[bytes]:
    """Lengths that lie."""
    one, sqlite, mcap = seeds()
    return [
        one[:13] + b"\xff\xff\xff\x7f" + one[17:],
        one[: len(one) // 2] + b"\xff\xff\xff\x7f" * 50_000,
        sqlite[: len(sqlite) // 2] + b"\xff" * 100_000,
        mcap[:8] + b"\x01" + b"\xff\xff\xff\xff\xff\xff\xff\x7f" + mcap[17:],
        mcap[:8] + b"\x06" + b"\x00" * 100_000,
        mcap[:-8] * 20,
    ]


def one(data: bytes) -> None:
    """Reads a bag, and all of its frames. Whatever length it tells is asked for in one piece, though never filled."""
    kind = MAGIC.get(data[:7], "mcap")
    held_file(_read, data, f"fuzz{SUFFIXES[kind]}", resident=True)


def _read(path: Path) -> None:
    frames_of(path)
