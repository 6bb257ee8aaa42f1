"""The headline tables as LaTeX (booktabs) and Markdown, and the figures as PDF or SVG."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence

from evalkit.commands.export.results import Cell, Heading, Results
from evalkit.report.html import figures
from evalkit.report.html.formatting import as_markdown

WIDE = 4
"""A table with more metrics than this is shrunk to the width of the text."""

ARROWS = {"lower": r" $\downarrow$", "higher": r" $\uparrow$", "": ""}
SIGNS = {"lower": " ↓", "higher": " ↑", "": ""}
_SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}", ">": r"\textgreater{}",
    "\u00a0": "~", "°": r"\textdegree{}", "−": "$-$", "σ": r"$\sigma$", "µ": r"\textmu{}", "²": "$^2$",
}  # fmt: skip

Files = Iterator[tuple[str, bytes]]
"""Name and content of each file."""


def latex(results: Results) -> Files:
    r"""A table for each sequence and ``tables.tex``, which holds them all; needs booktabs and graphicx."""
    names = []
    for sequence in results.scored:
        names.append(f"table-{file_name(sequence)}")
        yield f"{names[-1]}.tex", _latex_table(results, sequence).encode()
    inputs = "\n".join(rf"\input{{{name}}}" for name in names)
    head = "% Needs \\usepackage{booktabs,graphicx}; in the text: \\input{tables}."
    yield "tables.tex", f"{head}\n{inputs}\n".encode()


def markdown(results: Results) -> Files:
    """``summary.md``: what the report says of each sequence, and its headline table."""
    parts = [f"# {_one_line(str(results.content['title']))}", _one_line(str(results.content["description"]))]
    said = {verdict["sequence"]: verdict["sentences"] for verdict in results.content["verdicts"]}
    for sequence in results.sequences:
        parts += [f"## {_pipes(sequence)}", "\n".join(f"- {_one_line(text)}" for text in said.get(sequence, ()))]
        if sequence in results.scored:
            parts.append(_markdown_table(results, sequence))
    parts.append("Medians over complete runs, 95 % intervals in brackets. Bold: no difference from the best is shown.")
    parts.append(f"Made by `{_one_line(str(results.content['command']))}`.")
    yield "summary.md", ("\n\n".join(part for part in parts if part) + "\n").encode()


def drawings(results: Results, form: str) -> Files:
    """Trajectories, error over time, runtimes and residuals of each sequence's lowest seed; ``form``: pdf or svg."""
    kinds = (("trajectories", figures.trajectories), ("errors", figures.errors),
             ("runtimes", figures.runtimes), ("residuals", figures.residuals))  # fmt: skip
    for sequence in results.sequences:
        for kind, draw in kinds:
            drawn = draw(results.first(sequence), results.strokes)
            if drawn is not None:
                yield f"{file_name(sequence)}-{kind}.{form}", drawn.pdf() if form == "pdf" else drawn.svg


def file_name(label: str) -> str:
    """A label as part of a file's name that LaTeX takes too."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", label).strip("-.") or "x"


def escaped(text: str) -> str:
    r"""A text as LaTeX: ``paper_map & 5 %`` becomes ``paper\_map \& 5 \%``."""
    return "".join(_SPECIAL.get(letter, letter) for letter in text)


def _latex_table(results: Results, sequence: str) -> str:
    headings, rows = _table(results, sequence)
    titles = [f"{escaped(one.label)}{_unit(one, escaped)}{ARROWS[one.better]}" for one in headings]
    body = [
        " & ".join([escaped(label), runs, *(_latex_cell(one, cell) for one, cell in zip(headings, own, strict=True))])
        for label, runs, own in rows
    ]
    wide = len(headings) > WIDE
    lines = [
        r"\begin{table}", r"  \centering",
        rf"  \caption{{{escaped(sequence)}: medians over complete runs, 95\,\% intervals in brackets. "
        r"Bold: no difference from the best is shown.}",
        rf"  \label{{tab:{file_name(sequence)}}}",
        *([r"  \resizebox{\textwidth}{!}{%"] if wide else []),
        rf"  \begin{{tabular}}{{lr{'r' * len(headings)}}}", r"    \toprule",
        rf"    & {' & '.join(['runs', *titles])} \\", r"    \midrule",
        *(rf"    {line} \\" for line in body),
        r"    \bottomrule", r"  \end{tabular}" + ("}" if wide else ""), r"\end{table}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _latex_cell(heading: Heading, cell: Cell | None) -> str:
    if cell is None or cell.median is None:
        return "--"
    value, bounds = _numbers(heading, cell)
    value = value.replace("-", "$-$")
    value = rf"\textbf{{{value}}}" if cell.best else value
    return value + (rf" {{\scriptsize [{bounds.replace('-', '$-$')}]}}" if bounds else "")


def _markdown_table(results: Results, sequence: str) -> str:
    headings, rows = _table(results, sequence)
    titles = ["", "runs", *(f"{_pipes(one.label)}{_unit(one, _pipes)}{SIGNS[one.better]}" for one in headings)]
    lines = [_row(titles), _row(["---", *["---:"] * (len(titles) - 1)])]
    for label, runs, own in rows:
        cells = [_markdown_cell(one, cell) for one, cell in zip(headings, own, strict=True)]
        lines.append(_row([_pipes(label), runs, *cells]))
    return "\n".join(lines)


def _markdown_cell(heading: Heading, cell: Cell | None) -> str:
    if cell is None or cell.median is None:
        return "–"
    value, bounds = _numbers(heading, cell)
    return (f"**{value}**" if cell.best else value) + (f" [{bounds}]" if bounds else "")


def _table(results: Results, sequence: str) -> tuple[list[Heading], list[tuple[str, str, list[Cell | None]]]]:
    """The headline metrics that mean something here, and a row for each method: label, runs, cells."""
    known = {(cell.method, cell.metric): cell for cell in results.cells if cell.sequence == sequence}
    valued = {metric for (_, metric), cell in known.items() if cell.median is not None}
    headings = [one for one in results.headings if one.name in valued]
    rows: list[tuple[str, str, list[Cell | None]]] = []
    for label in dict.fromkeys(method for method, _ in known):
        some = next(cell for (method, _), cell in known.items() if method == label)
        rows.append((label, f"{some.complete}/{some.expected}", [known.get((label, one.name)) for one in headings]))
    return headings, rows


def _numbers(heading: Heading, cell: Cell) -> tuple[str, str]:
    """Median and bounds as printed; no bounds where there is no interval."""
    value = f"{cell.median:.{heading.digits}f}"
    if cell.low is None or cell.high is None:
        return value, ""
    return value, f"{cell.low:.{heading.digits}f}, {cell.high:.{heading.digits}f}"


def _unit(heading: Heading, safe: Callable[[str], str]) -> str:
    return f" [{safe(heading.unit)}]" if heading.unit else ""


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _pipes(text: str) -> str:
    return as_markdown(_one_line(text))


def _one_line(text: str) -> str:
    return " ".join(text.split())
