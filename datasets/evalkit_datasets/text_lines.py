"""The lines of a text file, plain or gzip (told by content), one at a time."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

from evalkit.core.errors import BadData
from evalkit.io.input_files import BLOCK, blocks_of

MAGIC = b"\x1f\x8b"

LONGEST_LINE = 4 * 2**20
"""Bytes; a scan of ten thousand beams takes a fiftieth of it."""


def lines_of(path: Path, what: str) -> Iterator[bytes]:
    """The lines without their ends. ``what``: what the file should be, for the errors of a file that is not.

    BadData for damaged gzip, and for a line no text has.
    """
    begun = b""
    number = 1
    for block in _plain(path, what):
        *whole, begun = (begun + block).split(b"\n")
        number += len(whole)
        yield from whole
        if len(begun) > LONGEST_LINE:
            raise BadData(str(path), f"line {number}", f"longer than {LONGEST_LINE // 2**20} MiB", f"give {what}")
    yield begun


def _plain(path: Path, what: str) -> Iterator[bytes]:
    blocks = blocks_of(path, what)
    first = next(blocks)
    if first.startswith(MAGIC):
        yield from _unpacked(first, blocks, path)
        return
    yield first
    yield from blocks


def _unpacked(rest: bytes, blocks: Iterator[bytes], path: Path) -> Iterator[bytes]:
    """The content of gzip files joined end to end; what follows them and is none is left alone."""
    while rest.startswith(MAGIC):
        unpacker = zlib.decompressobj(wbits=31)
        try:
            while rest:
                yield unpacker.decompress(rest, BLOCK)  # never more at once, however far the rest unpacks
                rest = unpacker.unconsumed_tail or (b"" if unpacker.eof else next(blocks, b""))
            yield unpacker.flush()
        except zlib.error as error:
            raise BadData(str(path), "", f"damaged gzip ({error})", "fetch or copy the file again") from None
        if not unpacker.eof:
            raise BadData(str(path), "", "the gzip file is cut short", "fetch or copy the file again")
        rest = unpacker.unused_data
        if len(rest) < len(MAGIC):
            rest += next(blocks, b"")
