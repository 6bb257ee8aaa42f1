"""The consoles of the commands, the width of their tables, and JSON output."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from evalkit.core.errors import show_controls
from evalkit.io.json_values import indent_json


class WordConsole(Console):
    """A console that wraps at words on a terminal, and nowhere else.

    Text may come from untrusted files: it is no mark-up, control characters are printed escaped, and ":x:" stays ":x:".
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(emoji=False, markup=False, highlight=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render as ``Console.render``, with the control characters of texts escaped."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=show_controls(segment.text))

    def print(self, *objects: Any, **options: Any) -> None:
        """Print as ``Console.print``; in a text, a word longer than a line stays whole."""
        if self.is_terminal and "soft_wrap" not in options and all(isinstance(one, str) for one in objects):
            objects = tuple(_wrap(one, self.width) for one in objects)
            options["soft_wrap"] = True
        super().print(*objects, **{"soft_wrap": not self.is_terminal, **options})


def _wrap(text: str, width: int) -> str:
    lines = (textwrap.wrap(line, width, break_long_words=False, break_on_hyphens=False) for line in text.split("\n"))
    return "\n".join("\n".join(line) for line in lines)


out = WordConsole()
err = WordConsole(stderr=True)

MAX_TABLE = 80
"""Most columns of a table that does not wrap; less where a terminal or COLUMNS is narrower."""


def table_width(console: Console) -> int:
    """Return the width of a table: that of a terminal or COLUMNS, at most 80 columns."""
    return min(console.width, MAX_TABLE)


def print_json(content: object) -> None:
    """Write JSON to standard output, without markup or wrapping."""
    sys.stdout.write(indent_json(content))
