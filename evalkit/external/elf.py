"""Target machine and section sizes of a compiled file, read from its ELF header."""

from __future__ import annotations

import re
import struct
import sys
from dataclasses import dataclass
from pathlib import Path

MACHINES = {
    0x02: "SPARC", 0x03: "x86", 0x08: "MIPS", 0x14: "PowerPC", 0x15: "PowerPC 64", 0x16: "S390", 0x28: "ARM",
    0x3E: "x86-64", 0x5E: "Xtensa", 0xB7: "AArch64", 0xF3: "RISC-V", 0x102: "LoongArch",
}  # fmt: skip

WRITTEN, ALLOCATED, NO_BITS = 1, 2, 8
"""ELF section flags SHF_WRITE and SHF_ALLOC, and section type SHT_NOBITS."""

SHARED = 3
"""The file type of a shared library (and of a position-independent program)."""


def read_machine(header: bytes) -> str:
    """Return the machine of a header (at least 20 bytes), e.g. "64-bit AArch64"; "" for another format than ELF."""
    if len(header) < 20 or header[:4] != b"\x7fELF":
        return ""
    (number,) = struct.unpack_from(_order(header) + "H", header, 18)
    bits = {1: "32-bit", 2: "64-bit"}.get(header[4], "")
    return f"{bits} {MACHINES.get(number, f'machine {number:#x}')}".strip()


def find_unusable_reason(path: Path, *, library: bool) -> str:
    """Return why this process cannot use a compiled file, or "".

    A program may be anything that the system can start (a script); a library must be an ELF library, where this system
    uses ELF.
    """
    mine, theirs = _header(Path(sys.executable)), _header(path)
    here, there = read_machine(mine), read_machine(theirs)
    if not here:  # a system with another format: its loader reports errors
        return ""
    if not there:
        return f"is not a shared library (it begins with {theirs[:8]!r})" if library else ""
    if here != there:
        return f"is built for {there}, and this machine is {here}"
    if library and struct.unpack_from(_order(theirs) + "H", theirs, 16)[0] != SHARED:
        return "is not a shared library but an object file or a program"
    return ""


@dataclass(frozen=True, slots=True)
class Sizes:
    """Memory of a compiled file before it runs (bytes), as counted by ``size``.

    ``text``: code and constants; ``data``: initialised variables; ``bss``: variables that start as zero.
    """

    text: int
    data: int
    bss: int


def read_sizes(path: Path) -> Sizes | None:
    """Return the sizes of an ELF file by its section headers (System V ABI, chapter 4).

    None for another format or a damaged file.
    """
    content = path.read_bytes()
    if not read_machine(content):
        return None
    order, wide = _order(content), content[4] == 2
    header = order + ("16x2HI3QI6H" if wide else "16x2HI3II6H")
    section = order + ("2I4Q2I2Q" if wide else "10I")
    try:
        fields = struct.unpack_from(header, content)
        at, step, count = fields[5], fields[10], fields[11]
        rows = [struct.unpack_from(section, content, at + step * number) for number in range(count)]
    except struct.error:
        return None
    kept = [(kind, flags, size) for _, kind, flags, _, _, size, *_ in rows if flags & ALLOCATED]
    return Sizes(
        text=sum(size for _, flags, size in kept if not flags & WRITTEN),
        data=sum(size for kind, flags, size in kept if flags & WRITTEN and kind != NO_BITS),
        bss=sum(size for kind, flags, size in kept if flags & WRITTEN and kind == NO_BITS),
    )


def read_compiler(content: bytes) -> str:
    """Return the compilers that a compiled file names, and their options where they were recorded; "" without any."""
    found = re.findall(rb"(?:GCC: \(|clang version |rustc version |GNU C\d+ )[\x20-\x7e]{1,300}", content)
    return ", ".join(dict.fromkeys(one.decode() for one in found))[:600]


def _header(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(20)


def _order(header: bytes) -> str:
    return ">" if header[5] == 2 else "<"
