"""The header of a file that should be a shared library."""

from __future__ import annotations

import sys
from pathlib import Path

from bounds import check_file_reader

from evalkit.external import elf


def seeds() -> list[bytes]:
    """Return the header of this interpreter, and that of a big-endian machine."""
    return [Path(sys.executable).read_bytes()[:64], b"\x7fELF\x01\x02\x01" + bytes(9) + b"\x00\x03\x00\x28"]


def swollen() -> list[bytes]:
    """Return truncated headers, and one of ones only."""
    return [b"\x7fELF", b"\x7fELF\x02\x01\x01", b"\x7fELF" + b"\xff" * 100_000]


def read_input(data: bytes) -> None:
    """Check whether the file can be used."""
    check_file_reader(
        lambda path: (elf.find_unusable_reason(path, library=True), elf.find_unusable_reason(path, library=False)),
        data,
        "fuzz.so",
    )
