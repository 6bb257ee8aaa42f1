"""Export a table for each sequence as LaTeX (booktabs, siunitx) and Markdown: error, drift, CPU time, rank."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from evalkit.commands.export.results import ExportSelection, MetricColumn, SummaryRow
from evalkit.core.errors import show_controls
from evalkit.report.formatting import capitalise, escape_markdown

Width = Literal["column", "text"]

ARROWS = {"lower": r" $\downarrow$", "higher": r" $\uparrow$", "": ""}
SIGNS = {"lower": " ↓", "higher": " ↑", "": ""}
SHORT = {"cpu_median_ms": "CPU", "drift_percent": "drift"}
"""Headings of columns that are short enough for one column of a page."""

BOUNDS = {
    "interval": "95 % interval", "perturbed": "lowest and highest of the repeated runs",
    "range": "lowest and highest of the runs",
}  # fmt: skip
"""What the brackets hold, by kind of spread."""

_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "\u00a0": "~", "°": r"\textdegree{}", "−": "$-$", "σ": r"$\sigma$", "µ": r"\textmu{}", "²": "$^2$",
}  # fmt: skip

Files = Iterator[tuple[str, bytes]]
"""Name and content of each file."""


@dataclass(frozen=True)
class PaperTable:
    """The table of one sequence, of which LaTeX and Markdown differ only in mark-up.

    ``rows``: label, cells (None without a value) and rank of each method, the best first. The rank is that in the
    first column: "--" without one, () if no method has one. ``intervals``: the number of columns that show bounds, from
    the first on.
    """

    columns: tuple[MetricColumn, ...]
    rows: tuple[tuple[str, tuple[SummaryRow | None, ...], tuple[str, ...]], ...]
    intervals: int

    @property
    def is_ranked(self) -> bool:
        """Whether a method has a rank."""
        return any(rank for *_, rank in self.rows)

    def has_bounds(self, column: int) -> bool:
        """Whether a method has bounds in a column."""
        return any(self.bounds(column, cells[column]) for _, cells, _ in self.rows)

    def bounds(self, column: int, cell: SummaryRow | None) -> str:
        """Return the bounds of a cell as printed, "" without any."""
        if column >= self.intervals or cell is None or cell.spread is None:
            return ""
        digits = self.columns[column].digits
        return f"{cell.spread.low:.{digits}f}, {cell.spread.high:.{digits}f}"

    def label(self, column: int) -> str:
        """Return the heading of a column without its unit."""
        label = SHORT.get(self.columns[column].name, self.columns[column].label)
        return "corrected" if column and label == f"{self.columns[0].label}, corrected poses" else label

    def caption(self) -> str:
        """Return what the values, brackets and bold numbers of this table are."""
        shown = [(at, cell) for _, cells, _ in self.rows for at, cell in enumerate(cells) if cell and cell.runs]
        single = all(cell.runs == 1 for _, cell in shown)
        parts = ["one complete run of each method" if single else "medians over complete runs"]
        if "cpu_median_ms" in (one.name for one in self.columns):
            parts.append("CPU: median time of a scan")
        bounded = [cell.spread for at, cell in shown if cell.spread and self.bounds(at, cell)]
        if bounded:
            kinds = [text for kind, text in BOUNDS.items() if kind in {one.kind for one in bounded}]
            alone = any(one.runs == 1 for one in bounded)  # its interval says nothing of other runs
            of_one = " over the scans of the run" if single else " (of a single run: over its scans)" if alone else ""
            parts.append(f"in brackets: {' or '.join(kinds)}{of_one}")
        if bold := {at for at, cell in shown if cell.best}:
            parts.append("bold: the best value, and close ones not clearly different")
            unranked = {
                label: [self.label(at) for at in sorted(bold) if (cell := cells[at]) and cell.runs and not cell.rank]
                for label, cells, _ in self.rows
            }
            listed = [f"{label} ({', '.join(names)})" for label, names in unranked.items() if names]
            parts += [f"not ranked: {', '.join(listed)}"] if listed else []
        return "; ".join(parts)


def build_table(results: ExportSelection, sequence: str) -> PaperTable:
    """Return the table of a sequence: methods by rank in its first column, then those without a rank.

    Methods with equal medians share a rank.
    """
    known = {(cell.method, cell.metric): cell for cell in results.rows if cell.sequence == sequence}
    valued = {metric for (_, metric), cell in known.items() if cell.median is not None}
    columns = tuple(one for one in results.columns_of(sequence) if one.name in valued)
    first = [cell for cell in known.values() if cell.metric == columns[0].name and cell.rank is not None]
    best = {cell.median: cell.rank for cell in sorted(first, key=lambda one: -(one.rank or 0))}
    ranks = {cell.method: best[cell.median] for cell in first}
    labels = dict.fromkeys(method for method, _ in known)
    methods = sorted(labels, key=lambda label: ranks.get(label) or len(known))
    shown = [[known.get((label, one.name)) for label in methods] for one in columns]
    scaled = [_with_digits(*_in_millimetres(one, cells)) for one, cells in zip(columns, shown, strict=True)]
    return PaperTable(
        tuple(column for column, _ in scaled),
        tuple(
            (label, tuple(cells[row] for _, cells in scaled), (str(ranks.get(label, "--")),) if ranks else ())
            for row, label in enumerate(methods)
        ),
        len(columns) if results.columns else 1,
    )


def _in_millimetres(
    column: MetricColumn, cells: list[SummaryRow | None]
) -> tuple[MetricColumn, list[SummaryRow | None]]:
    """Return a column of metres in millimetres if all its values are below a metre, any other column as it is."""
    values = [abs(cell.median) for cell in cells if cell is not None and cell.median is not None]
    if column.unit != "m" or max(values) >= 1.0:
        return column, cells
    digits = 1 if min(values) < 0.1 else 0
    return replace(column, unit="mm", digits=digits), [None if cell is None else _scale(cell, 1000.0) for cell in cells]


def _with_digits(column: MetricColumn, cells: list[SummaryRow | None]) -> tuple[MetricColumn, list[SummaryRow | None]]:
    """Return a column with up to two more digits, where its smallest value but 0 would be printed as 0."""
    values = [abs(cell.median) for cell in cells if cell is not None and cell.median]
    needed = -math.floor(math.log10(min(values))) if values else 0
    return replace(column, digits=min(max(column.digits, needed), column.digits + 2)), cells


def _scale(cell: SummaryRow, factor: float) -> SummaryRow:
    spread = cell.spread
    scaled = spread and replace(spread, low=factor * spread.low, high=factor * spread.high)
    return replace(cell, median=None if cell.median is None else factor * cell.median, spread=scaled)


def format_latex(results: ExportSelection, width: Width = "column") -> Files:
    r"""Yield one table per sequence, and ``tables.tex``, which inputs them all; needs booktabs and siunitx.

    ``width``: of one column, or of the text (``table*``). Nothing is scaled: the text of a table is \footnotesize.
    """
    names = []
    for sequence in results.scored_sequences:
        names.append(f"table-{file_name(sequence)}")
        yield f"{names[-1]}.tex", _latex_table(build_table(results, sequence), sequence, width).encode()
    inputs = "\n".join(rf"\input{{{name}}}" for name in names)
    head = "% Needs \\usepackage{booktabs,siunitx}; in the text: \\input{tables}."
    yield "tables.tex", f"{head}\n{inputs}\n".encode()


def format_markdown(results: ExportSelection) -> Files:
    """Yield ``summary.md``: the verdict over each sequence and its table."""
    parts = [f"# {_escape_cell(str(results.content['title']))}", _escape_cell(str(results.content["description"]))]
    sentences = {verdict["sequence"]: verdict["sentences"] for verdict in results.content["verdicts"]}
    for sequence in results.sequences:
        listed = "\n".join(f"- {_escape_cell(text)}" for text in sentences.get(sequence, ()))
        parts += [f"## {_escape_cell(sequence)}", listed]
        if sequence in results.scored_sequences:
            table = build_table(results, sequence)
            parts += [_markdown_table(table), f"{_escape_cell(capitalise(table.caption()))}."]
    command = _one_line(str(results.content["command"]))
    fence = "`" * (1 + max(map(len, re.findall("`+", command)), default=0))
    parts.append(f"Command: {fence}{show_controls(command)}{fence}.")
    yield "summary.md", ("\n\n".join(part for part in parts if part) + "\n").encode()


def file_name(label: str) -> str:
    """Return a label as part of a file name that LaTeX accepts."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", label).strip("-.") or "x"


def escape_latex(text: str) -> str:
    r"""Escape a text for LaTeX: ``paper_map & 5 %`` becomes ``paper\_map \& 5 \%``."""
    return "".join(_SPECIAL.get(letter, letter) for letter in show_controls(_one_line(text)))


def _latex_table(table: PaperTable, sequence: str, width: Width) -> str:
    kinds, titles, units = ["l"], [""], [""]
    for at, one in enumerate(table.columns):
        bounds = table.has_bounds(at)
        kinds.append(_number_column(table, at) + (r"@{\;}l" if bounds else ""))
        for row, text in ((titles, escape_latex(table.label(at))), (units, _format_head(one))):
            row.append(rf"\multicolumn{{2}}{{c}}{{{text}}}" if bounds else f"{{{text}}}")
    if table.is_ranked:
        kinds, titles, units = [*kinds, "r"], [*titles, "Rank"], [*units, ""]
    body = [
        " & ".join([escape_latex(label), *(_latex_cell(table, at, cell) for at, cell in enumerate(cells)), *rank])
        for label, cells, rank in table.rows
    ]
    kind = "table*" if width == "text" else "table"
    lines = [
        rf"\begin{{{kind}}}", r"  \centering\footnotesize\setlength{\tabcolsep}{3pt}\sisetup{detect-weight=true}",
        rf"  \caption{{{escape_latex(f'{sequence}: {table.caption()}.')}}}",
        rf"  \label{{tab:{file_name(sequence)}}}",
        rf"  \begin{{tabular}}{{{' '.join(kinds)}}}", r"    \toprule",
        rf"    {' & '.join(titles)} \\", rf"    {' & '.join(units)} \\", r"    \midrule",
        *(rf"    {line} \\" for line in body),
        r"    \bottomrule", r"  \end{tabular}", rf"\end{{{kind}}}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _format_head(column: MetricColumn) -> str:
    """Return unit and direction of a column, its second heading: one line of both is wider than the numbers."""
    return f"{_format_unit(column, escape_latex)}{ARROWS[column.better]}".strip()


def _number_column(table: PaperTable, column: int) -> str:
    """Return the column of siunitx that aligns the values at their decimal points."""
    known = (cells[column] for _, cells, _ in table.rows)
    values = [cell.median for cell in known if cell is not None and cell.median is not None]
    digits = table.columns[column].digits
    whole = max(len(f"{abs(value):.{digits}f}".partition(".")[0]) for value in values)
    return f"S[table-format={'-' if min(values) < 0.0 else ''}{whole}.{digits}]"


def _latex_cell(table: PaperTable, column: int, cell: SummaryRow | None) -> str:
    one = table.columns[column]
    between = " & " if table.has_bounds(column) else ""
    if cell is None or cell.median is None:
        return f"{{--}}{between}"
    bounds = table.bounds(column, cell).replace("-", "$-$")
    bold = r"\bfseries " if cell.best else ""
    return f"{bold}{cell.median:.{one.digits}f}{between}{f'[{bounds}]' if bounds else ''}"


def _markdown_table(table: PaperTable) -> str:
    labels = [
        f"{_escape_cell(table.label(at))}{_format_unit(one, _escape_cell)}{SIGNS[one.better]}"
        for at, one in enumerate(table.columns)
    ]
    labels += ["rank"] if table.is_ranked else []
    lines = [_format_row(["", *labels]), _format_row(["---", *["---:"] * len(labels)])]
    for label, cells, rank in table.rows:
        texts = [_markdown_cell(table, at, cell) for at, cell in enumerate(cells)]
        lines.append(_format_row([_escape_cell(label), *texts, *rank]))
    return "\n".join(lines)


def _markdown_cell(table: PaperTable, column: int, cell: SummaryRow | None) -> str:
    if cell is None or cell.median is None:
        return "–"
    value, bounds = f"{cell.median:.{table.columns[column].digits}f}", table.bounds(column, cell)
    return (f"**{value}**" if cell.best else value) + (f" [{bounds}]" if bounds else "")


def _format_unit(column: MetricColumn, safe: Callable[[str], str]) -> str:
    return f" [{safe(column.unit)}]" if column.unit else ""


def _format_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escape_cell(text: str) -> str:
    return escape_markdown(_one_line(text))


def _one_line(text: str) -> str:
    return " ".join(text.split())
