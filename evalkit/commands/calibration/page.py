"""The calibration as a page, and as the Markdown table of the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evalkit.commands.calibration.coverage import DIFFERENCES, RUNS
from evalkit.report.html.blocks import Column, Command, Document, Section, Table, Text

HEADINGS = (
    "runs", "holds the median: blocks", "runs", "holds another run: blocks", "runs",
    "equal methods get a verdict: blocks", "runs", *(f"{100 * size:.0f} % worse is found" for size in DIFFERENCES),
)  # fmt: skip

Row = Mapping[str, Any]


def build_document(content: Mapping[str, Any]) -> Document:
    """Return the page of a calibration."""
    lead = (
        "Every seed is run once; random subsets of the runs are then treated as a whole experiment. A 95 % interval "
        "should hold the median over all seeds in 95 % of the subsets; equal methods should get a verdict in at most "
        "5 %."
    )
    columns = [Column(name, number=True) for name in HEADINGS]
    summary = Section("Summary", (Table(columns, _summarize(content)), Text(_explain(content), "note")), "summary")
    sections = (
        summary,
        Section("Intervals", (Table(list(content["coverage"][0]), _rows(content["coverage"])),), "intervals"),
        Section("Verdicts", (Table(list(content["verdicts"][0]), _rows(content["verdicts"])),), "verdicts"),
        Section("Method", (Command(content["command"]),), "method"),
    )
    facts = (("Seeds", str(content["seeds"])), ("Subsets", str(content["subsets"])), ("Created", content["created"]))
    return Document("Calibration", "Intervals and verdicts", lead, sections, facts)


def format_markdown(content: Mapping[str, Any]) -> str:
    """Return the summary as a Markdown table with its explanation."""
    lines = [f"| {' | '.join(HEADINGS)} |", f"|{'--:|' * len(HEADINGS)}"]
    lines += [f"| {' | '.join(row)} |" for row in _summarize(content)]
    return "\n".join([*lines, "", _explain(content), ""])


def _summarize(content: Mapping[str, Any]) -> list[list[str]]:
    rows = []
    for runs in RUNS:
        coverage = [row for row in content["coverage"] if row["runs"] == runs]
        verdicts = [row for row in content["verdicts"] if row["runs"] == runs]
        held = ("within_median", "over_median", "within_another", "over_another")
        found = [[row["power_over"][index] for row in verdicts] for index in range(len(DIFFERENCES))]
        shares = [
            *([row[name] for row in coverage] for name in held),
            *([row[name] for row in verdicts] for name in ("false_within", "false_over")),
            *found,
        ]
        rows.append([str(runs), *map(_format_range, shares)])
    return rows


def _format_range(shares: Sequence[float | None]) -> str:
    """Return the mean with the smallest and largest share in percent: "95 (93-97)"."""
    known = [100.0 * one for one in shares if one is not None]
    if not known:
        return "-"
    return f"{sum(known) / len(known):.0f} ({min(known):.0f}-{max(known):.0f})"


def _explain(content: Mapping[str, Any]) -> str:
    worlds = dict.fromkeys(row["world"] for row in content["coverage"])
    methods = dict.fromkeys(row["method"] for row in content["coverage"])
    metrics = dict.fromkeys(row["metric"] for row in content["coverage"])
    return (
        f"Percent, mean and range over {len(worlds)} worlds ({', '.join(worlds)}), {len(methods)} methods "
        f"({', '.join(methods)}) and {len(metrics)} metrics ({', '.join(metrics)}); {content['seeds']} seeds, "
        f"{content['subsets']} subsets. Blocks: the bootstrap over stretches of up to 10 s of the same runs. Runs: "
        "Student's t over the runs. Equal methods: the labels of two methods are exchanged at random in each seed."
    )


def _rows(rows: Sequence[Row]) -> list[list[str]]:
    return [[_format_cell(value) for value in row.values()] for row in rows]


def _format_cell(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_format_cell(one) for one in value)
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
