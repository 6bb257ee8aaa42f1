"""A file a user names, read whole or block by block, or an error that says what to do."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from evalkit.core.errors import BadData, DataMissing

BLOCK = 2**16

_LONG_KEY = re.compile(r"""(?<![\w-])(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){100}""")


def bytes_of(path: Path, what: str) -> bytes:
    """The whole file; DataMissing where there is none, BadData where it is empty or cannot be read."""
    return b"".join(blocks_of(path, what))


def blocks_of(path: Path, what: str) -> Iterator[bytes]:
    """The file in blocks of ``BLOCK`` bytes; the same errors when the first is asked for."""
    try:
        if not path.is_file():
            found = "it is a folder" if path.is_dir() else "no such file"
            raise DataMissing(str(path), found, f"give the path of {what}")
        with path.open("rb") as file:
            block = file.read(BLOCK)
            if not block:
                raise BadData(str(path), "", "the file is empty", f"give {what}")
            while block:
                yield block
                block = file.read(BLOCK)
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "check its permissions") from error


def tables_of(text: str, number: Callable[[str], Any] = float) -> dict[str, Any]:
    """The tables of a TOML text, numbers with a point made by ``number``; ValueError where it is no TOML.

    Neither is what would take far more time and memory than its size: keys of a hundred parts.
    """
    if _LONG_KEY.search(text):
        raise ValueError("a key of a hundred parts")
    try:
        content = tomllib.loads(text, parse_float=number)
    except RecursionError:
        raise ValueError("tables or lists nested too deeply") from None
    except ArithmeticError:
        raise ValueError("a number beyond all bounds") from None
    _refuse_endless_numbers(content)
    return content


def _refuse_endless_numbers(content: dict[str, Any]) -> None:
    """ValueError where a whole number has more than the 64 bits that TOML asks for: such cannot even be printed."""
    waiting: list[Any] = [content]
    while waiting:
        value = waiting.pop()
        if isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise ValueError("a whole number of more than 64 bits")
        if isinstance(value, (dict, list)):
            waiting.extend(value.values() if isinstance(value, dict) else value)
