"""The header of a file that should be a shared library."""

from __future__ import annotations

import sys
from pathlib import Path

from bounds import held_file

from evalkit.external import elf


def seeds() -> list[bytes]:
    """This interpreter's own header, and that of a big-endian machine."""
    return [Path(sys.executable).read_bytes()[:64], b"\x7fELF\x01\x02\x01" + bytes(9) + b"\x00\x03\x00\x28"]


def swollen() -> list[bytes]:
    """Headers cut short, and one of nothing but ones."""
    return [b"\x7fELF", b"\x7fELF\x02\x01\x01", b"\x7fELF" + b"\xff" * 100_000]


def one(data: bytes) -> None:
    """Asks why the file cannot be used."""
    held_file(
        lambda path: (elf.unusable_reason(path, library=True), elf.unusable_reason(path, library=False)),
        data,
        "fuzz.so",
    )
