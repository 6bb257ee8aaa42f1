"""Read text files line by line, plain or gzip, and rows of numbers, with errors that name file and line."""

from __future__ import annotations

import zlib
from codecs import BOM_UTF8
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.io.input_files import BLOCK_BYTES, iter_blocks, read_text

GZIP_MAGIC = b"\x1f\x8b"

MAX_LINE_BYTES = 4 * 2**20
"""Limit of one line; a scan of 10,000 beams has 2 % of it."""

FREE_BYTES = 64 * 2**20
MAX_RATIO = 50
"""A gzip file may unpack to ``FREE_BYTES`` plus this many times its size; logs of scans unpack to 3 to 10 times."""


def iter_lines(path: Path, expected: str) -> Iterator[bytes]:
    """Yield the lines of a file, plain or gzip (detected by content), without their ends and in bounded memory.

    A mark of UTF-8 at the beginning, as spreadsheets write it, is left out.

    ``expected``: what the file should be, for errors. Raises as ``read_bytes``, and BadData for damaged gzip, for gzip
    that unpacks to too much, and for a line longer than ``MAX_LINE_BYTES``.
    """
    rest = b""
    number = 1
    blocks = iter_plain_blocks(path, expected)
    for block in chain([next(blocks).removeprefix(BOM_UTF8)], blocks):
        *complete, rest = (rest + block).split(b"\n")
        number += len(complete)
        yield from complete
        if len(rest) > MAX_LINE_BYTES:
            found = f"longer than {MAX_LINE_BYTES // 2**20} MiB"
            raise BadData(str(path), f"line {number}", found, f"give {expected}")
    yield rest


def iter_rows(path: Path, layout: str, expected: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and words of each line that is neither blank nor a comment (#); a comma counts as a blank.

    ``layout`` names the columns ("t x y"). Raises as ``read_text``, and BadData for another number of columns.
    """
    wanted = len(layout.split())
    for number, line in enumerate(read_text(path, expected).splitlines(), start=1):
        words = line.split("#", 1)[0].replace(",", " ").split()
        if not words:
            continue
        if len(words) != wanted:
            found = f"{len(words)} columns: '{_shorten(' '.join(words))}'"
            raise BadData(str(path), f"line {number}", found, f"expected {wanted}: '{layout}'")
        yield number, words


def parse_numbers(path: Path, line: int, words: list[str], layout: str) -> list[float]:
    """Return words as numbers; raises BadData that names file, line and the first word that is not a number."""
    values = []
    for column, word in enumerate(words, start=1):
        try:
            values.append(float(word))
        except ValueError:
            found = f"'{_shorten(word)}' in column {column} is not a number"
            raise BadData(str(path), f"line {line}", found, f"expected '{layout}'") from None
    return values


def parse_columns(words: list[bytes], first: int, end: int) -> Floats:
    """Return the numbers in columns ``first`` to ``end`` of a line (counted from 0, without the end).

    Raises ValueError with the first that is not a number, and its column counted from 1.
    """
    chosen = words[first:end]
    try:
        return np.fromiter(map(float, chosen), np.float64, len(chosen))
    except ValueError:
        column = next(at for at, word in enumerate(chosen) if not is_number(word))
        text = _shorten(chosen[column].decode("latin-1"))
        raise ValueError(f"'{text}' in column {first + column + 1} is not a number") from None


def is_number(word: bytes) -> bool:
    """Return whether a word is a number; nan and inf are."""
    try:
        float(word)
    except ValueError:
        return False
    return True


def iter_plain_blocks(path: Path, expected: str) -> Iterator[bytes]:
    """Yield the content of a file, plain or gzip (detected by content), in blocks; raises as ``iter_lines``."""
    blocks = iter_blocks(path, expected)
    first = next(blocks)
    if first.startswith(GZIP_MAGIC):
        yield from _decompress(first, blocks, path)
        return
    yield first
    yield from blocks


def _decompress(rest: bytes, blocks: Iterator[bytes], path: Path) -> Iterator[bytes]:
    """Yield the content of concatenated gzip members; bytes after them that are not gzip are ignored."""
    left = FREE_BYTES + MAX_RATIO * path.stat().st_size
    while rest.startswith(GZIP_MAGIC):
        member = zlib.decompressobj(wbits=31)
        try:
            while rest:
                block = member.decompress(rest, BLOCK_BYTES)  # bounds the output, however much the input expands
                left -= len(block)
                if left < 0:
                    found = (
                        f"the gzip file unpacks to more than {MAX_RATIO} times its size and {FREE_BYTES // 2**20} MiB"
                    )
                    raise BadData(str(path), "", found, "unpack it yourself if you trust its origin")
                yield block
                rest = member.unconsumed_tail or (b"" if member.eof else next(blocks, b""))
            yield member.flush()
        except zlib.error as error:
            raise BadData(str(path), "", f"damaged gzip ({error})", "fetch or copy the file again") from None
        if not member.eof:
            raise BadData(str(path), "", "the gzip file is cut short", "fetch or copy the file again")
        rest = member.unused_data
        if len(rest) < len(GZIP_MAGIC):
            rest += next(blocks, b"")


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
