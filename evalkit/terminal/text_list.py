"""Lists of names with a text each, without cut words at any width."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from rich.console import Console
from rich.text import Text

INDENT = 2


def print_list(console: Console, title: str, rows: Iterable[tuple[str, str]]) -> None:
    """Print a title and lines of name and text; on a terminal wrapped beside the names, one line a row elsewhere."""
    pairs = list(rows)
    column = max((len(name) for name, _ in pairs), default=0) + 2 * INDENT
    width = console.width if console.is_terminal else 0
    console.print(Text(title, style="bold"))
    for name, text in pairs:
        console.print(Text(format_row(name, text, column, width)), soft_wrap=True)


def print_hanging(console: Console, text: str, style: str = "") -> None:
    """Print a text; on a terminal its further lines are indented."""
    wrapped = textwrap.fill(
        text, console.width, subsequent_indent=" " * 2 * INDENT, break_long_words=False, break_on_hyphens=False
    )
    console.print(Text(wrapped if console.is_terminal else text, style=style), soft_wrap=True)


def format_row(name: str, text: str, column: int, width: int) -> str:
    """Return a name and a text that begins at a column; lines of at most ``width``, 0: a single one.

    A word that is longer than the space keeps its line to itself, which begins further left.
    """
    head = f"{' ' * INDENT}{name}".ljust(column)
    if not width:
        return f"{head}{text}".rstrip()
    space = max(width - column, 20)
    first, *others = textwrap.wrap(text, space, break_long_words=False, break_on_hyphens=False) or [""]
    if len(first) > space:
        first, others = "", [first, *others]
    indents = (" " * max(min(column, width - len(line)), 2 * INDENT) for line in others)
    return "\n".join(
        [f"{head}{first}".rstrip(), *(f"{indent}{line}" for indent, line in zip(indents, others, strict=True))]
    )
