"""The fenced code blocks of a Markdown page, and the commands in its console blocks."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

FENCE = re.compile(
    r"(?:^<!-- (long) -->\n)?^( *)```(\w+)(?: title=\"([^\"]+)\")?[^\n]*\n(.*?)^\2```$", re.DOTALL | re.MULTILINE
)
CONSOLE = "console"


@dataclass(frozen=True)
class CodeBlock:
    """A block of code.

    ``title``: the name of the file to save it as, or "". ``long``: it takes many seconds (marked ``<!-- long -->``).
    """

    language: str
    title: str
    content: str
    long: bool


def find_blocks(page: str) -> list[CodeBlock]:
    """Return the fenced blocks of a Markdown page, in order."""
    return [CodeBlock(match[3], match[4] or "", match[5], match[1] is not None) for match in FENCE.finditer(page)]


def find_commands(console: str) -> Iterator[tuple[str, str]]:
    """Yield each command of a console block with the output shown below it; continued lines are joined."""
    for part in re.split(r"^\$ ", console, flags=re.MULTILINE)[1:]:
        command, _, output = part.partition("\n")
        while command.endswith("\\"):
            more, _, output = output.partition("\n")
            command = f"{command[:-1]}{more.strip()}"
        yield command, output.strip("\n")
