"""The reader of Kuemmerle relations."""

from __future__ import annotations

from bounds import held_file

from evalkit_datasets.truth_files import read_relations


def seeds() -> list[bytes]:
    """Relations forwards, backwards and with a comment."""
    return [b"1.5 2.5 0.1 0 0 0 0 0.05\n2.5 1.5 -0.1 0 0 0 0 -0.05\n", b"# measured\n1,2,0.5,0,0,0,0,3.1\n"]


def swollen() -> list[bytes]:
    """Long lines, and many."""
    return [
        b"1 " * 100_000,
        b"9" * 300_000 + b" 2 0 0 0 0 0 0\n",
        b"1 2 0 0 0 0 0 0\n" * 10_000,
        b"1 2 \x1b[2J 0 0 0 0 0",
    ]


def one(data: bytes) -> None:
    """Reads relations."""
    held_file(read_relations, data, "fuzz.relations")
