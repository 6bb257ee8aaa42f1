"""Build HTML and Markdown from plain values, with everything escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape


def text(value: str) -> str:
    """Return a text as HTML on one line."""
    return escape(" ".join(value.split()), quote=False)


def code(value: str) -> str:
    """Return a text as HTML code, or "" for an empty text."""
    return f"<code>{text(value)}</code>" if value else ""


def facts(rows: Iterable[tuple[str, str]]) -> str:
    """Return a definition list (HTML) of names and HTML values; rows with an empty value are omitted."""
    lines = [f"<dt>{text(name)}</dt> <dd> {value} </dd>" for name, value in rows if value]
    return "\n".join(('<dl class="facts">', *lines, "</dl>"))


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table (HTML) with a head of texts and rows of HTML cells."""
    heading = "".join(f"<th>{text(cell)}</th>" for cell in head)
    body = [f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows]
    return "\n".join(("<table>", f"<thead><tr>{heading}</tr></thead>", "<tbody>", *body, "</tbody>", "</table>"))


def fold(summary: str, content: str) -> str:
    """Return HTML content that is hidden until its summary is clicked."""
    return f"<details>\n<summary>{text(summary)}</summary>\n{content}\n</details>"


def heading(level: int, title: str, anchor: str) -> str:
    """Return a Markdown heading with an explicit anchor."""
    return f"{'#' * level} `{title}` {{ #{anchor} }}"


def page(*parts: str) -> str:
    """Join the non-empty parts of a Markdown page with blank lines."""
    return "\n\n".join(part for part in parts if part) + "\n"
