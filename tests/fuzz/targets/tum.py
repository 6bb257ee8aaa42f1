"""The reader of trajectories in TUM format, of the data sets and of the method ``file:``."""

from __future__ import annotations

from bounds import held_file

from evalkit.io.tum import format_tum, read_tum


def seeds() -> list[bytes]:
    """Trajectories with comments, commas and times out of order."""
    return [
        b"# t x y z qx qy qz qw\n1.0 0 0 0 0 0 0 1\n2.0 1 0 0 0 0 0.38268343 0.92387953\n",
        b"3,0,0,0,0,0,0,1\n1,0,0,0,0,0,1,0\n1,5,0,0,0,0,0,1\n",
    ]


def swollen() -> list[bytes]:
    """Long lines, and many."""
    return [b"1 0 0 0 0 0 0 1\n" * 10_000, b"1e" + b"9" * 200_000 + b" 0 0 0 0 0 0 1\n", b"1 0 0 0 0 0 0 1e200\n"]


def one(data: bytes) -> None:
    """Reads a trajectory, and writes it back."""
    held_file(lambda path: format_tum(read_tum(path).trajectory), data, "fuzz.tum")
