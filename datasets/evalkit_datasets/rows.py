"""Text files of numbers in columns, with errors that name the file, the line and what was found there."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from evalkit.core.errors import BadData
from evalkit.io.input_files import bytes_of


def lines_of(path: Path, what: str) -> Iterator[tuple[int, str]]:
    """Number and text of every line that is neither blank nor a comment; commas count as blanks."""
    for number, line in enumerate(text_of(path, what).splitlines(), start=1):
        text = line.split("#", 1)[0].replace(",", " ").strip()
        if text:
            yield number, text


def text_of(path: Path, what: str) -> str:
    """The whole file as text; DataMissing where there is none, BadData where it is empty or no text."""
    content = bytes_of(path, what)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise BadData(str(path), f"byte {error.start}", "no text", f"give {what}") from None
    if "\0" in text:
        raise BadData(str(path), f"character {text.index(chr(0))}", "a zero byte, so no text", f"give {what}")
    return text


def numbers(path: Path, line: int, words: list[str], layout: str) -> list[float]:
    """The words as numbers; BadData names the first that is none. ``layout``: what the line should look like."""
    values = []
    for column, word in enumerate(words, start=1):
        try:
            values.append(float(word))
        except ValueError:
            raise BadData(
                str(path), f"line {line}", f"'{_short(word)}' in column {column} is no number", f"expected '{layout}'"
            ) from None
    return values


def columns(path: Path, line: int, text: str, layout: str) -> list[str]:
    """The words of a line, as many as the layout has; BadData otherwise."""
    words, wanted = text.split(), len(layout.split())
    if len(words) != wanted:
        raise BadData(
            str(path), f"line {line}", f"{len(words)} columns: '{_short(text)}'", f"expected {wanted}: '{layout}'"
        )
    return words


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
