"""Export the headline tables as LaTeX (booktabs) and Markdown, and the figures as PDF or SVG."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from evalkit.commands.export.results import ExportSelection, MetricColumn, SummaryRow
from evalkit.report.formatting import escape_markdown
from evalkit.report.html import run_figures

WIDE = 4
"""A table with more metrics than this is scaled to the width of the text."""

ARROWS = {"lower": r" $\downarrow$", "higher": r" $\uparrow$", "": ""}
SIGNS = {"lower": " ↓", "higher": " ↑", "": ""}
_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "\u00a0": "~", "°": r"\textdegree{}", "−": "$-$", "σ": r"$\sigma$", "µ": r"\textmu{}", "²": "$^2$",
}  # fmt: skip

Files = Iterator[tuple[str, bytes]]
"""Name and content of each file."""


def format_latex(results: ExportSelection) -> Files:
    r"""Yield one table per sequence, and ``tables.tex``, which inputs them all; needs booktabs and graphicx."""
    names = []
    for sequence in results.scored_sequences:
        names.append(f"table-{file_name(sequence)}")
        yield f"{names[-1]}.tex", _latex_table(results, sequence).encode()
    inputs = "\n".join(rf"\input{{{name}}}" for name in names)
    head = "% Needs \\usepackage{booktabs,graphicx}; in the text: \\input{tables}."
    yield "tables.tex", f"{head}\n{inputs}\n".encode()


def format_markdown(results: ExportSelection) -> Files:
    """Yield ``summary.md``: the verdict over each sequence and its headline table."""
    parts = [f"# {_one_line(str(results.content['title']))}", _one_line(str(results.content["description"]))]
    sentences = {verdict["sequence"]: verdict["sentences"] for verdict in results.content["verdicts"]}
    for sequence in results.sequences:
        parts += [f"## {_escape_cell(sequence)}", _list(sentences.get(sequence, ()))]
        if sequence in results.scored_sequences:
            parts.append(_markdown_table(results, sequence))
    parts.append("Medians over complete runs, 95 % intervals in brackets. Bold: the best, and methods tied with it.")
    parts.append(f"Command: `{_one_line(str(results.content['command']))}`.")
    yield "summary.md", ("\n\n".join(part for part in parts if part) + "\n").encode()


def draw_figures(results: ExportSelection, form: str) -> Files:
    """Yield trajectories, errors, run times and residuals of each sequence's lowest seed; ``form``: pdf or svg."""
    kinds = (("trajectories", run_figures.draw_trajectories), ("errors", run_figures.draw_errors),
             ("runtimes", run_figures.draw_runtimes), ("residuals", run_figures.draw_residuals))  # fmt: skip
    for sequence in results.sequences:
        for kind, draw in kinds:
            drawn = draw(results.first_runs(sequence), results.strokes)
            if drawn is not None:
                yield f"{file_name(sequence)}-{kind}.{form}", drawn.pdf() if form == "pdf" else drawn.svg


def file_name(label: str) -> str:
    """Return a label as part of a file name that LaTeX accepts."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", label).strip("-.") or "x"


def escape_latex(text: str) -> str:
    r"""Escape a text for LaTeX: ``paper_map & 5 %`` becomes ``paper\_map \& 5 \%``."""
    return "".join(_SPECIAL.get(letter, letter) for letter in text)


def _latex_table(results: ExportSelection, sequence: str) -> str:
    columns, rows = _select_table(results, sequence)
    titles = [f"{escape_latex(one.label)}{_format_unit(one, escape_latex)}{ARROWS[one.better]}" for one in columns]
    body = [" & ".join([escape_latex(label), runs, *map(_latex_cell, columns, own)]) for label, runs, own in rows]
    wide = len(columns) > WIDE
    lines = [
        r"\begin{table}", r"  \centering",
        rf"  \caption{{{escape_latex(sequence)}: medians over complete runs, 95\,\% intervals in brackets. "
        r"Bold: the best, and methods tied with it.}",
        rf"  \label{{tab:{file_name(sequence)}}}",
        *([r"  \resizebox{\textwidth}{!}{%"] if wide else []),
        rf"  \begin{{tabular}}{{lr{'r' * len(columns)}}}", r"    \toprule",
        rf"    & {' & '.join(['runs', *titles])} \\", r"    \midrule",
        *(rf"    {line} \\" for line in body),
        r"    \bottomrule", r"  \end{tabular}" + ("}" if wide else ""), r"\end{table}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _latex_cell(column: MetricColumn, cell: SummaryRow | None) -> str:
    if cell is None or cell.median is None:
        return "--"
    value, bounds = _format_values(column, cell)
    value = value.replace("-", "$-$")
    value = rf"\textbf{{{value}}}" if cell.best else value
    return value + (rf" {{\scriptsize [{bounds.replace('-', '$-$')}]}}" if bounds else "")


def _markdown_table(results: ExportSelection, sequence: str) -> str:
    columns, rows = _select_table(results, sequence)
    labels = (f"{_escape_cell(one.label)}{_format_unit(one, _escape_cell)}{SIGNS[one.better]}" for one in columns)
    titles = ["", "runs", *labels]
    lines = [_format_row(titles), _format_row(["---", *["---:"] * (len(titles) - 1)])]
    for label, runs, own in rows:
        cells = [_markdown_cell(one, cell) for one, cell in zip(columns, own, strict=True)]
        lines.append(_format_row([_escape_cell(label), runs, *cells]))
    return "\n".join(lines)


def _markdown_cell(column: MetricColumn, cell: SummaryRow | None) -> str:
    if cell is None or cell.median is None:
        return "–"
    value, bounds = _format_values(column, cell)
    return (f"**{value}**" if cell.best else value) + (f" [{bounds}]" if bounds else "")


def _select_table(
    results: ExportSelection, sequence: str
) -> tuple[list[MetricColumn], list[tuple[str, str, list[SummaryRow | None]]]]:
    """Return the headline metrics with a value here, and a row for each method: label, runs, cells."""
    known = {(cell.method, cell.metric): cell for cell in results.rows if cell.sequence == sequence}
    valued = {metric for (_, metric), cell in known.items() if cell.median is not None}
    columns = [one for one in results.columns if one.name in valued]
    rows: list[tuple[str, str, list[SummaryRow | None]]] = []
    for label in dict.fromkeys(method for method, _ in known):
        some = next(cell for (method, _), cell in known.items() if method == label)
        rows.append((label, f"{some.complete}/{some.expected}", [known.get((label, one.name)) for one in columns]))
    return columns, rows


def _format_values(column: MetricColumn, cell: SummaryRow) -> tuple[str, str]:
    """Return median and bounds as printed; no bounds without an interval."""
    value = f"{cell.median:.{column.digits}f}"
    if cell.low is None or cell.high is None:
        return value, ""
    return value, f"{cell.low:.{column.digits}f}, {cell.high:.{column.digits}f}"


def _format_unit(column: MetricColumn, safe: Callable[[str], str]) -> str:
    return f" [{safe(column.unit)}]" if column.unit else ""


def _format_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _escape_cell(text: str) -> str:
    return escape_markdown(_one_line(text))


def _list(sentences: Sequence[str]) -> str:
    return "\n".join(f"- {_one_line(text)}" for text in sentences)


def _one_line(text: str) -> str:
    return " ".join(text.split())
