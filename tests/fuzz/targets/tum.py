"""The reader of trajectories in TUM format."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit.io.tum import format_tum, read_tum


def seeds() -> list[bytes]:
    """Return trajectories with comments, commas and unordered times."""
    return [
        b"# t x y z qx qy qz qw\n1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0.38268343 0.92387953\n",
        b"3,0,0,0,0,0,0,1\n1,0,0,0,0,0,1,0\n1,5,0,0,0,0,0,1\n",
    ]


def swollen() -> list[bytes]:
    """Return long lines, and many lines."""
    return [b"1 0 0 0 0 0 0 1\n" * 10_000, b"1e" + b"9" * 200_000 + b" 0 0 0 0 0 0 1\n", b"1 0 0 0 0 0 0 1e200\n"]


def read_input(data: bytes) -> None:
    """Read a trajectory and format it again."""
    check_file_reader(lambda path: format_tum(read_tum(path).trajectory), data, "fuzz.tum")
