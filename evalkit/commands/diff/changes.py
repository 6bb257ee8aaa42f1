"""What every comparison of before and after has in common: the verdict on one change, and the text of all of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

from evalkit.report.formatting import escape_markdown

ChangeVerdict = Literal[
    "regression",
    "improvement",
    "no difference shown",
    "not comparable",
    "unchanged",
    "within the limit",
    "too few samples",
]
"""The verdict on one change."""

ORDER: tuple[ChangeVerdict, ...] = get_args(ChangeVerdict)
"""The order in which changes are listed."""

MARKS: Mapping[ChangeVerdict, str] = {"regression": "❌ ", "improvement": "✅ "}
SAME = "the same to the last digit"


@dataclass(frozen=True)
class ChangeText:
    """A comparison as text: one table (rows as long as ``columns``), remarks, and the conclusion in one sentence.

    ``missing``: how many runs, metrics or series of OLD have no counterpart in NEW. ``content``: the same comparison as
    plain values for JSON.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    remarks: tuple[str, ...]
    conclusion: str
    regressions: int
    missing: int
    content: Mapping[str, Any]


def format_markdown(text: ChangeText) -> str:
    """Return the comment for a pull request: the conclusion, the table of changes, the remarks."""
    lines = [f"**{escape_markdown(text.conclusion)}**", ""]
    if text.rows:
        rule = ["---"] * len(text.columns)
        lines += [*map(_format_row, (text.columns, rule, *text.rows)), ""]
    lines += [f"- {escape_markdown(remark)}" for remark in text.remarks]
    return "\n".join(lines).rstrip() + "\n"


def format_lines(text: ChangeText) -> list[str]:
    """Return one line for each change, for a terminal that is too narrow for the table."""
    first = text.columns.index("old")
    lines = []
    for row in text.rows:
        values = [f"{what} {cell}" for what, cell in zip(text.columns[first:-1], row[first:-1], strict=True) if cell]
        lines.append(f"{', '.join(row[:first])}: {', '.join(values)}: {row[-1]}")
    return lines


def format_verdict(verdict: ChangeVerdict, reason: str) -> str:
    """Return a verdict with its mark and its reason, if there is one."""
    return f"{MARKS.get(verdict, '')}{verdict}{f': {reason}' if reason else ''}"


def describe_missing(count: int, what: str, old: str, new: str) -> str:
    """Return "2 runs of OLD have no counterpart in NEW. ", "" for 0. ``what``: "run", "metric" or "series"."""
    if not count:
        return ""
    plural = "s" if count > 1 and not what.endswith("s") else ""
    return f"{count} {what}{plural} of {old} {'have' if count > 1 else 'has'} no counterpart in {new}. "


def _format_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(escape_markdown(cell.replace('|', '/')) for cell in cells)} |"
