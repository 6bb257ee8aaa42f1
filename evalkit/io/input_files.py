"""Read a file given by the user, whole or in blocks; errors name the file and what to give instead."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evalkit.core.errors import BadData, DataMissing

BLOCK_BYTES = 2**16

_PAGE = "a web page, not the file", "fetch the file again, from the address of the file itself"
_UTF_16 = "UTF-16 text", "save it as UTF-8"
_OTHERS = {
    b"<!doctype html": _PAGE,
    b"<html": _PAGE,
    b"version https://git-lfs": ("a pointer of Git LFS, not the file", "fetch the file with 'git lfs pull'"),
    b"\xff\xfe": _UTF_16,
    b"\xfe\xff": _UTF_16,
}
"""What often lies in place of a file, by how it begins: its name, and what to do."""


def read_bytes(path: Path, expected: str) -> bytes:
    """Return the content of a file; ``expected``: what it should be, for errors ("a map in PGM format").

    Raises DataMissing if there is no such file, BadData if it is empty, cannot be read, or begins as another file.
    """
    return b"".join(iter_blocks(path, expected))


def check_beginning(path: Path, content: bytes) -> None:
    """Raise BadData if the content of a file begins as a web page, a pointer of Git LFS or UTF-16 text."""
    for beginning, (found, remedy) in _OTHERS.items():
        if content[:100].lstrip().lower().startswith(beginning):
            raise BadData(str(path), "", found, remedy)


def iter_blocks(path: Path, expected: str) -> Iterator[bytes]:
    """Yield a file in blocks of ``BLOCK_BYTES`` bytes; raises as ``read_bytes`` at the first block."""
    try:
        if not path.is_file():
            found = "it is a folder" if path.is_dir() else "no such file"
            raise DataMissing(str(path), found, f"give the path of {expected}")
        with path.open("rb") as file:
            block = file.read(BLOCK_BYTES)
            if not block:
                raise BadData(str(path), "", "the file is empty", f"give {expected}")
            check_beginning(path, block)
            while block:
                yield block
                block = file.read(BLOCK_BYTES)
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "check its permissions") from error


def read_text(path: Path, expected: str) -> str:
    """Return the content of a UTF-8 text file; raises as ``read_bytes``, and BadData if it is not text."""
    content = read_bytes(path, expected)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadData(str(path), f"byte {error.start}", "not UTF-8 text", f"give {expected}") from None
    if "\0" in text:
        raise BadData(str(path), f"character {text.index(chr(0))}", "a zero byte: not text", f"give {expected}")
    return text
