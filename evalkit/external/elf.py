"""What machine a compiled file is for, read from its header, so that nobody meets "wrong ELF class" unexplained."""

from __future__ import annotations

import struct
import sys
from pathlib import Path

MACHINES = {
    0x02: "SPARC", 0x03: "x86", 0x08: "MIPS", 0x14: "PowerPC", 0x15: "PowerPC 64", 0x16: "S390", 0x28: "ARM",
    0x3E: "x86-64", 0x5E: "Xtensa", 0xB7: "AArch64", 0xF3: "RISC-V", 0x102: "LoongArch",
}  # fmt: skip

SHARED = 3
"""The file type of a shared library (and of a position-independent program)."""


def machine(header: bytes) -> str:
    """The machine a header (at least 20 bytes) is for, e.g. "64-bit AArch64"; "" where it is no ELF header."""
    if len(header) < 20 or header[:4] != b"\x7fELF":
        return ""
    (number,) = struct.unpack_from(_order(header) + "H", header, 18)
    bits = {1: "32-bit", 2: "64-bit"}.get(header[4], "")
    return f"{bits} {MACHINES.get(number, f'machine {number:#x}')}".strip()


def unfit(path: Path, *, library: bool) -> str:
    """Why this process cannot use a compiled file, or "" where nothing speaks against it.

    A program may be anything the system starts (a script); a library must be one, where this system uses ELF.
    """
    mine, theirs = _header(Path(sys.executable)), _header(path)
    here, there = machine(mine), machine(theirs)
    if not here:  # a system with another format: its own loader must tell
        return ""
    if not there:
        return f"is not a shared library (it begins with {theirs[:8]!r})" if library else ""
    if here != there:
        return f"is built for {there}, and this machine is {here}"
    if library and struct.unpack_from(_order(theirs) + "H", theirs, 16)[0] != SHARED:
        return "is not a shared library but an object file or a program"
    return ""


def _header(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(20)


def _order(header: bytes) -> str:
    return ">" if header[5] == 2 else "<"
