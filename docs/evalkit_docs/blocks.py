"""The code blocks of a page, and the commands within those of a console."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

FENCE = re.compile(
    r"(?:^<!-- (long) -->\n)?^( *)```(\w+)(?: title=\"([^\"]+)\")?[^\n]*\n(.*?)^\2```$", re.DOTALL | re.MULTILINE
)
CONSOLE = "console"


@dataclass(frozen=True)
class Block:
    """A block of code; ``title``: the file that a reader saves it as, or "".

    ``long``: it takes many seconds (``<!-- long -->`` stands above it).
    """

    language: str
    title: str
    content: str
    long: bool


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page (Markdown), in order."""
    return [Block(found[3], found[4] or "", found[5], found[1] is not None) for found in FENCE.finditer(page)]


def commands(console: str) -> Iterator[tuple[str, str]]:
    """Every command of a console block, a line that ends in a backslash joined with the next, and the answer shown."""
    for part in re.split(r"^\$ ", console, flags=re.MULTILINE)[1:]:
        command, _, answer = part.partition("\n")
        while command.endswith("\\"):
            more, _, answer = answer.partition("\n")
            command = f"{command[:-1]}{more.strip()}"
        yield command, answer.strip("\n")
