"""Values as HTML and Markdown that says them to the letter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

ROOM = "\n\n"


def text(value: str) -> str:
    """A text on one line, to stand in HTML: nothing in it is markup."""
    return escape(" ".join(value.split()), quote=False)


def code(value: str) -> str:
    """A text as code."""
    return f"<code>{text(value)}</code>" if value else ""


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """A list of names and what is said of each (HTML); what is empty is left out."""
    lines = [f"<dt>{text(name)}</dt> <dd> {told} </dd>" for name, told in rows if told]
    return "\n".join(('<dl class="facts">', *lines, "</dl>"))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are HTML."""
    heading = "".join(f"<th>{text(cell)}</th>" for cell in head)
    body = [f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows]
    return "\n".join(("<table>", f"<thead><tr>{heading}</tr></thead>", "<tbody>", *body, "</tbody>", "</table>"))


def fold(summary: str, content: str) -> str:
    """What is shown when asked for (HTML)."""
    return f"<details>\n<summary>{text(summary)}</summary>\n{content}\n</details>"


def heading(level: int, title: str, anchor: str) -> str:
    """A heading (Markdown) with an anchor of its own."""
    return f"{'#' * level} `{title}` {{ #{anchor} }}"


def page(*parts: str) -> str:
    """Parts of a page, apart."""
    return ROOM.join(part for part in parts if part) + "\n"
