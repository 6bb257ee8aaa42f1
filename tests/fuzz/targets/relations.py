"""The reader of Kuemmerle relations."""

from __future__ import annotations

from bounds import check_file_reader

from evalkit_datasets.parsing.truth_files import read_relations


def seeds() -> list[bytes]:
    """Return relations forwards, backwards and with a comment."""
    return [b"1.5 2.5 0.1 0 0 0 0 0.05\n2.5 1.5 -0.1 0 0 0 0 -0.05\n", b"# measured\n1,2,0.5,0,0,0,0,3.1\n"]


def swollen() -> list[bytes]:
    """Return long lines, and many lines."""
    return [
        b"1 " * 100_000,
        b"9" * 300_000 + b" 2 0 0 0 0 0 0\n",
        b"1 2 0 0 0 0 0 0\n" * 10_000,
        b"1 2 \x1b[2J 0 0 0 0 0",
    ]


def read_input(data: bytes) -> None:
    """Read relations."""
    check_file_reader(read_relations, data, "fuzz.relations")
