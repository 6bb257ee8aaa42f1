"""The calibration as a page, and as the Markdown table of the documentation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from evalkit.commands.calibration.coverage import DIFFERENCES, RUNS, expected_coverage, group_sequences
from evalkit.report.html.blocks import Column, Command, Document, Section, Table, Text
from evalkit.stats.runs import MIN_RUNS

HEADINGS = (
    "sequence", "runs", "holds the median: blocks", "runs", "holds another run: blocks", "runs",
    "equal methods get a verdict: blocks", "runs", *(f"{100 * size:.0f} % worse is found" for size in DIFFERENCES),
)  # fmt: skip

CalibrationRow = Mapping[str, Any]


def build_document(content: Mapping[str, Any]) -> Document:
    """Return the page of a calibration."""
    lead = (
        "Every seed of a simulated world, and every perturbation of a recording, is run once; random subsets of the "
        "runs are then treated as a whole experiment. A 95 % interval should hold the median over all runs in 95 % of "
        "the subsets; equal methods should get a verdict in at most 5 %."
    )
    columns = [Column(HEADINGS[0]), *(Column(name, number=True) for name in HEADINGS[1:])]
    notes = [Text(line, "note") for line in _explain(content)]
    summary = Section("Summary", (Table(columns, _summarize(content)), *notes), "summary")
    sections = (
        summary,
        Section("Intervals", (Table(list(content["coverage"][0]), _rows(content["coverage"])),), "intervals"),
        *(
            [Section("Verdicts", (Table(list(content["verdicts"][0]), _rows(content["verdicts"])),), "verdicts")]
            if content["verdicts"]
            else []
        ),
        Section("Method", (Command(content["command"]),), "method"),
    )
    facts = (("Seeds", str(content["seeds"])), ("Subsets", str(content["subsets"])), ("Created", content["created"]))
    return Document("Calibration", "Intervals and verdicts", lead, sections, facts)


def format_markdown(content: Mapping[str, Any]) -> str:
    """Return the summary as a Markdown table with its explanation."""
    lines = [f"| {' | '.join(HEADINGS)} |", f"|--|{'--:|' * (len(HEADINGS) - 1)}"]
    lines += [f"| {' | '.join(row)} |" for row in _summarize(content)]
    return "\n".join([*lines, "", "\n\n".join(_explain(content)), ""])


def _summarize(content: Mapping[str, Any]) -> list[list[str]]:
    groups = group_sequences([row["sequence"] for row in content["coverage"]], content["recordings"])
    return [
        [name, str(runs), *_summarize_runs(content, labels, runs)] for name, labels in groups.items() for runs in RUNS
    ]


def _summarize_runs(content: Mapping[str, Any], labels: Sequence[str], runs: int) -> list[str]:
    coverage, verdicts = (
        [row for row in content[key] if row["runs"] == runs and row["sequence"] in labels]
        for key in ("coverage", "verdicts")
    )
    held = ("within_median", "over_median", "within_another", "over_another")
    shares = [
        *([row[name] for row in coverage] for name in held),
        *([row[name] for row in verdicts] for name in ("false_within", "false_over")),
        *([row["power_over"][index] for row in verdicts] for index in range(len(DIFFERENCES))),
    ]
    return [_format_range(one) for one in shares]


def _format_range(shares: Sequence[float | None]) -> str:
    """Return the mean with the smallest and largest share in percent: "95 (93-97)"."""
    known = [100.0 * one for one in shares if one is not None]
    if not known:
        return "-"
    return f"{sum(known) / len(known):.0f} ({min(known):.0f}-{max(known):.0f})"


def _explain(content: Mapping[str, Any]) -> list[str]:
    """Return paragraphs: what the numbers and groups are, what was skipped, and what is outside the limits."""
    groups = group_sequences([row["sequence"] for row in content["coverage"]], content["recordings"])
    lines = [
        f"Percent, mean and range over methods and metrics; {content['subsets']} subsets. Blocks: the bootstrap over "
        "stretches of up to 10 s of the same runs. Runs: Student's t over the runs. Equal methods: the labels of two "
        "methods are exchanged at random in each seed or perturbation. Relations get no verdict here: the report shows "
        "no difference below their own accuracy.",
        *(_describe_group(content, name, labels) for name, labels in groups.items()),
    ]
    if content["recordings"]:
        lines.append(
            "The runs of a recording are few, and the subsets are drawn from them without replacement: an interval "
            "holds their median more often than that of all possible perturbations. They say nothing about another "
            "recording."
        )
    ends = (("Skipped", content["skipped"]), ("Outside the limits", content["failures"]))
    return [*lines, *(f"{title}: {'; '.join(found)}." for title, found in ends if found)]


def _describe_group(content: Mapping[str, Any], name: str, labels: Sequence[str]) -> str:
    rows = [row for row in content["coverage"] if row["sequence"] in labels]
    methods, metrics = (", ".join(dict.fromkeys(row[key] for row in rows)) for key in ("method", "metric"))
    population = min(row["population"] for row in rows)
    expected = ", ".join(
        f"{100 * expected_coverage(runs, population):.1f} % at {runs}" for runs in RUNS if runs >= MIN_RUNS
    )
    title = name if name in content["recordings"] else f"{name} ({', '.join(labels)})"
    kind = "perturbed runs" if name in content["recordings"] else "seeds"
    return (
        f"{title}: {methods}; {metrics}; subsets of {population} {kind}. An exact interval would hold the median of "
        f"these in {expected} runs."
    )


def _rows(rows: Sequence[CalibrationRow]) -> list[list[str]]:
    return [[_format_cell(value) for value in row.values()] for row in rows]


def _format_cell(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(_format_cell(one) for one in value)
    return "-" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)
