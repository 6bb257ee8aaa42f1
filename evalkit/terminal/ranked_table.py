"""The answer of a comparison on a terminal: the title, and a table of the methods by rank."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from rich.console import Console
from rich.text import Text

from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.contests import compare, select_counted
from evalkit.report.analysis.map_agreement import decided_by_maps
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import find_cost
from evalkit.report.analysis.statements.warnings import list_remarks
from evalkit.report.formatting import format_amount, format_milliseconds
from evalkit.terminal.console import table_width
from evalkit.terminal.map_fit import describe_map_fit
from evalkit.terminal.method_names import cut_middle, shorten_names

MAX_LINES = 10
"""Lines of the table, a head of one line included."""

LEAST_NAME = 12
"""Columns to which a name may be cut."""

BARS = (18, 8)
"""Widest and narrowest bar, in columns; a table without room for the narrowest has none."""

CPU, CORRECTED = "CPU/scan", "corrected"
"""Headings of columns."""

_METHOD, _ERROR, _AGAINST, _CORRECTED, _COST, _NOTE = range(6)
"""Places of the columns in a line; the bar is drawn behind the error."""

DROPPED = (_AGAINST, _CORRECTED, _COST)
"""Columns that a narrow table leaves out, in this order."""

LINEAR_RATIO = 8.0
"""Bars are on a logarithmic scale if the largest value exceeds the smallest more than this."""

NOT_THE_PLACE = " (maps alone: not the place in the known map)"
"""What follows the head of a table in a known map that only the consistency of the maps drawn can rank."""

OF_BEAMS = ("beams", "invalid ranges")
"""How notes on single beams begin."""

STYLES = {
    "best": "bold green",
    "best map": "bold green",
    "tied": "green",
    "lost": "red",
    "broken": "red",
    "worse than the baseline": "yellow",
}
"""Style of a line by the beginning of its note."""


@dataclass(frozen=True)
class RankedRow:
    """One line of the table; ``value``, ``low`` and ``high`` for the bar, the last two None without bounds.

    ``corrected``: the error of the corrected poses of a SLAM, "" of other methods.
    """

    method: str
    error: str
    against: str
    cost: str
    note: str
    value: float
    low: float | None = None
    high: float | None = None
    corrected: str = ""


def print_answer(console: Console, analysis: Analysis) -> None:
    """Print the title, what it costs, the ranked table, and what limits the answer."""
    answer = analysis.answer
    _print(console, answer.title, "bold")
    if answer.subtitle:
        _print(console, answer.subtitle)
    names, width = shorten_names(analysis.comparison), table_width(console)
    head, rows = build_rows(analysis)
    if rows:
        console.print()
        for line in format_rows(head, [replace(row, method=names[row.method]) for row in rows], width):
            console.print(line)
        console.print()
    for text in describe_map_fit(analysis, names, width):
        _print(console, text)
    for text in describe_notes(analysis):
        _print(console, text, "yellow")
    for sequence in analysis.sequences:
        for text in list_remarks(sequence):
            _print(console, f"{sequence.label}: {text}", "yellow")
    for pill in answer.pills:
        if pill.tone == "warn":
            _print(console, pill.text, "yellow")


def describe_notes(analysis: Analysis) -> Iterator[str]:
    """Yield for each sequence what its reader noted; what it counts in single beams is on the page only."""
    for sequence in analysis.sequences:
        notes = {name: count for run in sequence.all_runs for name, count in run.result.notes.items() if count}
        shown = [f"{name}: {count:,}" for name, count in notes.items() if not name.startswith(OF_BEAMS)]
        if shown:
            yield f"{sequence.label} as read: {'; '.join(shown)}"


def _print(console: Console, text: str, style: str = "") -> None:
    console.print(text.replace("\u00a0", " "), style=style)


def build_rows(analysis: Analysis) -> tuple[str, list[RankedRow]]:
    """Return what the errors are, and the rows: over the data sets that count if there are several, else of one."""
    counted = [one.sequence for one in analysis.answer.contests]
    valued = [sequence for sequence in analysis.sequences if sequence.deciding is not None]
    if len(counted) > 1 or not valued:
        return _rows_of_answer(analysis)
    best = max(valued, key=lambda sequence: (sequence.label in counted, not sequence.card.degenerate))
    return _rows_of_sequence(analysis, best)


def _rows_of_sequence(analysis: Analysis, sequence: SequenceAnalysis) -> tuple[str, list[RankedRow]]:
    """Return a row for each ranked method of a sequence, then for those that have a value but no rank."""
    ranking = sequence.deciding
    if ranking is None:
        return "", []
    baselines = analysis.comparison.methods_with_role("baseline")
    base = next((score.median for label in baselines if (score := ranking.of(label)) and score.median), None)
    rows = []
    for score in (*ranking.ranked, *(one for one in ranking.scores if one not in ranking.ranked and one.values)):
        value, bounds = score.median or 0.0, score.spread
        note = "worse than the baseline" if sequence.is_behind(score.method) else _note(analysis, ranking, score.method)
        rows.append(
            RankedRow(
                score.method, format_amount(ranking.metric, value), _against(value, base, score.method in baselines),
                _cost([sequence], score.method), note, value, bounds.low if bounds else None,
                bounds.high if bounds else None, _format_corrected(sequence, score.method),
            )
        )  # fmt: skip
    in_map = decided_by_maps(ranking) and any(run.result.start is not None for run in sequence.all_runs)
    return f"{ranking.metric.label}, {sequence.label}{NOT_THE_PLACE if in_map else ''}", rows


def _rows_of_answer(analysis: Analysis) -> tuple[str, list[RankedRow]]:
    """Return a row for each method that takes part: its mean error by a common one's, and how often it leads."""
    answer, baselines = analysis.answer, analysis.comparison.methods_with_role("baseline")
    counted = select_counted(analysis.sequences, answer.contests)
    part = [(one, one.relative.error) for one in answer.standings if one.counted and one.relative.error is not None]
    base = next((one.method for one, _ in part if one.method in baselines), "")
    rows = []
    for one, ratio in part:
        note = f"best or tied {one.led}/{one.counted}" if one.led else ""
        note += (", cheapest" if note else "cheapest") if answer.cheapest is one else ""
        by_base = compare(answer.contests, one.method, base).error
        against = "baseline" if one.method in baselines else _format_ratio(by_base) if by_base is not None else ""
        rows.append(RankedRow(one.method, _format_ratio(ratio), against, _cost(counted, one.method), note, ratio))
    by = " and ".join(dict.fromkeys(filter(None, (answer.common, base))))
    return f"error by that of {by}, mean over shared data", rows


def _format_corrected(sequence: SequenceAnalysis, method: str) -> str:
    score = sequence.final.of(method) if sequence.final else None
    value = None if score is None else score.median
    return "" if sequence.final is None or value is None else format_amount(sequence.final.metric, value)


def _note(analysis: Analysis, ranking: Ranking, method: str) -> str:
    answer, place = analysis.answer, str(mark(ranking, method))
    if answer.by_maps:  # several metrics together decide
        place = "best map" if method in answer.winners else ""
    cheapest = answer.cheapest is not None and answer.cheapest.method == method
    return ", ".join([*([place] if place in STYLES else []), *(["cheapest"] if cheapest else [])])


def _against(value: float, baseline: float | None, is_baseline: bool) -> str:
    return "baseline" if is_baseline else _format_ratio(value / baseline) if baseline else ""


def _format_ratio(ratio: float) -> str:
    """Return "0.25 x"; a ratio that would be 0.00 has one digit that is not 0."""
    return f"{ratio:.2f} x" if ratio == 0.0 or ratio >= 0.005 else f"{ratio:.1g} x"


def _cost(sequences: Sequence[SequenceAnalysis], method: str) -> str:
    """Return the CPU time of a scan on the sequences whose errors the table shows."""
    cpu_ms = find_cost(sequences, method)
    return "" if cpu_ms is None else format_milliseconds(cpu_ms)


def format_rows(head: str, rows: Sequence[RankedRow], width: int, cost: str = CPU) -> Iterator[Text]:
    """Yield the lines of the table, at most ``MAX_LINES``, each of at most ``width`` columns.

    Columns: method, error, its interval as a bar, error by the baseline's, error of corrected poses, CPU time a scan,
    note. ``cost``: heading of the column of the CPU time, "" without one. What is too wide goes in this order: the
    bar, the middle of the names, unless two become equal, the columns ``DROPPED``, what a note says after the
    place, and the end of the line.
    """
    for line in _format_lines(head, rows, width, cost):
        line.truncate(width, overflow="ellipsis")
        yield line


def _format_lines(head: str, rows: Sequence[RankedRow], width: int, cost: str) -> Iterator[Text]:
    shown = rows if len(rows) < MAX_LINES else rows[: MAX_LINES - 2]
    cells = [[row.method, row.error, row.against, row.corrected, row.cost, row.note] for row in shown]
    sizes = [max(map(len, column)) for column in zip(*cells, strict=True)]
    headings = {_CORRECTED: CORRECTED, _COST: cost}
    for column, heading in headings.items():
        sizes[column] = max(sizes[column], len(heading)) if sizes[column] else 0
    room = _room(sizes, width)
    bar = min(room - 2, BARS[0]) if room - 2 >= BARS[1] else 0
    _fit(cells, sizes, width)
    scale = _Scale([value for row in shown for value in (row.low, row.value, row.high) if value is not None], bar)
    left = sum(size + 2 for size in (sizes[_METHOD], sizes[_ERROR], bar, sizes[_AGAINST]) if size)
    heads = [f"{heading:>{sizes[column]}}" for column, heading in headings.items() if sizes[column]]
    above = textwrap.wrap(head, max(width - 2, 1), break_on_hyphens=False) or [""]
    above += [""] if heads and len(head) + 2 > left else []
    for at, over in enumerate(above, start=1):
        columns = heads if at == len(above) else []
        yield Text("  ".join([f"{f'  {over}':<{left}}", *columns]).rstrip(), style="dim")
    for row, own in zip(shown, cells, strict=True):
        method, error, against, corrected, spent, note = (
            text.ljust(size) if at in (_METHOD, _NOTE) else text.rjust(size)
            for at, (text, size) in enumerate(zip(own, sizes, strict=True))
        )
        parts = (method, error, scale.draw(row) if bar else "", against, corrected, spent, note)
        style = next((style for word, style in STYLES.items() if row.note.startswith(word)), "")
        line = f"  {'  '.join(part for part in parts if part)}".rstrip()
        yield Text(line.replace("\u00a0", " "), style=style)
    if len(rows) > len(shown):
        yield Text(f"  and {len(rows) - len(shown)} more on the page", style="dim")


def _room(sizes: Sequence[int], width: int) -> int:
    """Return the columns of the terminal that a table leaves free; negative if it is too wide."""
    return width - sum(size + 2 for size in sizes if size)


def _fit(cells: list[list[str]], sizes: list[int], width: int) -> None:
    """Cut the names and empty columns of a table until it fits, if that is enough; ``sizes``: of its columns."""
    least = min(sizes[_METHOD], LEAST_NAME)
    if len({cut_middle(own[_METHOD], least) for own in cells}) < len({own[_METHOD] for own in cells}):
        least = sizes[_METHOD]
    for column in DROPPED:
        if _room([least, *sizes[1:]], width) < 0:
            sizes[column] = 0
            for own in cells:
                own[column] = ""
    if _room([least, *sizes[1:]], width) < 0:
        for own in cells:
            own[_NOTE] = own[_NOTE].partition(", ")[0]
        sizes[_NOTE] = max(len(own[_NOTE]) for own in cells)
    sizes[_METHOD] = min(sizes[_METHOD], max(sizes[_METHOD] + _room(sizes, width), least))
    for own in cells:
        own[_METHOD] = cut_middle(own[_METHOD], sizes[_METHOD])


class _Scale:
    """Bars of so many columns from zero to the largest value.

    Values that are far apart are on a logarithmic scale, which begins at the smallest.
    """

    def __init__(self, values: Sequence[float], columns: int) -> None:
        self._columns = columns
        low, high = min(values), max(values)
        self._log = low > 0.0 and high > LINEAR_RATIO * low
        self._low, self._high = self._place(low if self._log else min(low, 0.0)), self._place(high)

    def draw(self, row: RankedRow) -> str:
        """Return the interval of a row as a line with its value as a dot."""
        ends = [row.value if end is None else end for end in (row.low, row.high)]
        first, at, last = (self._column(value) for value in (ends[0], row.value, ends[1]))
        return "".join("●" if n == at else "─" if first <= n <= last else " " for n in range(self._columns))

    def _place(self, value: float) -> float:
        return math.log(value) if self._log else value

    def _column(self, value: float) -> int:
        span = self._high - self._low
        return round((self._place(value) - self._low) / span * (self._columns - 1)) if span > 0.0 else 0
