"""Read the tables of a report's page, and check the cells that show a score."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html.parser import HTMLParser

from amounts import check_amount
from facts import Facts


class Page(HTMLParser):
    """The cells with a number to sort by of every table of a page: label of the table, rows of (text, sort, tone)."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[tuple[str, list[str], list[list[tuple[str, str, str]]]]] = []
        self._label = ""
        self._cell: list[str] | None = None
        self._attributes: dict[str, str | None] = {}
        self._extent = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Open a table, a row, a cell or a part of one."""
        given = dict(attrs)
        if tag == "div" and given.get("class") == "scroll":
            self._label = given.get("aria-label") or ""
        elif tag == "table":
            self.tables.append((self._label, [], []))
        elif tag == "tr" and self.tables:
            self.tables[-1][2].append([])
        elif tag in ("td", "th"):
            self._cell, self._attributes = [], given
        elif self._cell is not None and (self._extent or "extent" in (given.get("class") or "")):
            self._extent += 1

    def handle_endtag(self, tag: str) -> None:
        """Close a cell or a part of one."""
        if tag in ("td", "th") and self._cell is not None and self.tables and self.tables[-1][2]:
            text = " ".join("".join(self._cell).split())
            _, heads, rows = self.tables[-1]
            tone = self._attributes.get("class") or ""
            sort = self._attributes.get("data-sort") or ""
            (heads.append(text) if self._attributes.get("scope") == "col" else rows[-1].append((text, sort, tone)))
            self._cell, self._extent = None, 0
        elif self._extent:
            self._extent -= 1

    def handle_data(self, data: str) -> None:
        """Collect the text of a cell, without its interval."""
        if self._cell is not None and not self._extent:
            self._cell.append(data)


TONES = {"good": "best", "tied": "tied"}


def check_cells(facts: Facts, page: str) -> Iterator[str]:
    """Check every cell that shows a score in the tables of a page."""
    reader = Page()
    reader.feed(page)
    if not reader.tables:
        yield "the page has no table"
    for label, heads, rows in reader.tables:
        for row in filter(None, rows):
            yield from _check_row(facts, label, heads, row)


def _check_row(facts: Facts, label: str, heads: list[str], row: list[tuple[str, str, str]]) -> Iterator[str]:
    named = _longest(facts.methods, row[0][0])
    if label.startswith("Results on ") and named:
        for head, cell in zip(heads[1:], row[1:], strict=True):
            if (metric := _find_metric(facts, head)) is not None:
                yield from _check_cell(facts, label.removeprefix("Results on "), metric, named, cell)
    elif label == "At a glance" and named:
        for head, cell in zip(heads[2:-1], row[2:-1], strict=True):
            where = _longest(facts.runs, head) or ""
            metric = facts.deciding(where)
            if metric:
                yield from _check_cell(facts, where, metric, named, cell)
    elif label.startswith("All metrics on "):
        where, metric = label.removeprefix("All metrics on ").rpartition(": ")[0], _find_metric(facts, row[0][0])
        for method, cell in zip(heads[1:], row[1:], strict=True):
            yield from _check_cell(facts, where, metric or "", _longest(facts.methods, method) or "", cell)


def _longest(names: Iterable[str], text: str) -> str | None:
    return max((name for name in names if text.startswith(name)), key=len, default=None)


def _find_metric(facts: Facts, head: str) -> str | None:
    label = _longest([one[:1].upper() + one[1:] for one in facts.labels], head)
    return None if label is None else facts.labels.get(label) or facts.labels.get(label[:1].lower() + label[1:])


def _check_cell(facts: Facts, where: str, metric: str, method: str, cell: tuple[str, str, str]) -> Iterator[str]:
    text, sort, tone = cell[0].replace("\u00a0", " ").replace("\u2212", "-"), cell[1], cell[2].split()
    found = facts.find(where, metric).get(method)
    what = f"cell of {method} on {where}, {metric}"
    if found is None or not found.values:
        if text not in ("–", ""):
            yield f"{what}: {text} without a value"
        return
    yield from check_amount(what, text, found.median)
    if sort and abs(float(sort) - found.median) > 1e-9 * abs(found.median):
        yield f"{what}: sorted by {sort}, recomputed {found.median}"
    for name, standing in TONES.items():
        if (name in tone) != (facts.standing(where, method, metric) == standing):
            yield f"{what}: shown as {tone}, stands as {facts.standing(where, method, metric)}"
