"""The exported part of a results folder: its tables, its runs, and the sequences with ground truth and scans."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evalkit.core.errors import EvalkitError, StoreError, UnknownName
from evalkit.core.ground_truth import Truth
from evalkit.plugins import registry
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.report.html.palette import Stroke, assign_strokes
from evalkit.results.reader import REMEDY, load_results_json, load_run, load_table
from evalkit.results.run_record import RunRecord


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One metric of one method over one sequence, in the metric's unit; None without a value.

    ``best``: the best, or without a clear difference from it. ``complete`` of ``expected`` runs completed.
    """

    sequence: str
    method: str
    metric: str
    median: float | None
    low: float | None
    high: float | None
    best: bool
    complete: int
    expected: int


@dataclass(frozen=True, slots=True)
class MetricColumn:
    """A metric as a column of a table: ``better`` is "lower", "higher" or ""."""

    name: str
    label: str
    unit: str
    better: str
    digits: int


@dataclass(frozen=True, eq=False)
class ExportSelection:
    """What is exported of a report.

    ``columns``: the metrics of the tables. ``runs``: every run that answered a scan, with its ground truth. ``opened``:
    the sequences by label and seed. ``remarks``: what is missing (a sequence without files, an incomplete run).
    """

    folder: Path
    content: Mapping[str, Any]
    columns: tuple[MetricColumn, ...]
    rows: tuple[SummaryRow, ...]
    runs: tuple[RunRecord, ...]
    opened: Mapping[tuple[str, int | None], SensorSequence]
    remarks: tuple[str, ...] = field(default=())

    @property
    def strokes(self) -> Mapping[str, Stroke]:
        """The stroke of every method, as in the report."""
        cards: Mapping[str, Any] = self.content["methods"]
        present = {run["method"] for run in self.content["runs"]}
        known = [label for label in cards if label in present]
        return assign_strokes(known, [label for label in known if cards[label]["role"] == "baseline"])

    @property
    def sequences(self) -> tuple[str, ...]:
        """The labels of the sequences, in the report's order."""
        return tuple(dict.fromkeys(row.sequence for row in self.rows))

    @property
    def scored_sequences(self) -> tuple[str, ...]:
        """The labels of the sequences with a value in any column."""
        shown = {column.name for column in self.columns}
        valued = {row.sequence for row in self.rows if row.median is not None and row.metric in shown}
        return tuple(label for label in self.sequences if label in valued)

    def first_runs(self, sequence: str) -> tuple[RunRecord, ...]:
        """Return the runs of a sequence's lowest seed, which figures show."""
        own = [run for run in self.runs if run.sequence == sequence]
        lowest = min((run.seed or 0 for run in own), default=0)
        return tuple(run for run in own if (run.seed or 0) == lowest)


def load_selection(
    folder: Path, sequences: Sequence[str] = (), methods: Sequence[str] = (), metrics: Sequence[str] = (),
    scans: bool = True,
) -> ExportSelection:  # fmt: skip
    """Load a results folder, or the part of it with these labels.

    ``metrics``: the columns in this order; empty: the headline metrics. ``scans``: open the sequences, for ground truth
    and scans. Raises StoreError if the folder holds no report, UnknownName for an unknown label.
    """
    content = load_results_json(folder)
    known = {one["name"]: one for one in content["metrics"]}
    for kind, wanted, names in (
        ("sequence", sequences, content["sequences"]), ("method", methods, content["methods"]),
        ("metric", metrics, known),
    ):  # fmt: skip
        for name in wanted:
            if name not in names:
                raise UnknownName(kind, name, names)
    entries = [
        one for one in content["runs"]
        if (not sequences or one["sequence"] in sequences) and (not methods or one["method"] in methods)
    ]  # fmt: skip
    opened, remarks = _open_sequences(entries) if scans else ({}, [])
    runs = []
    for entry in (one for one in entries if one["scans_answered"]):
        sequence = opened.get((entry["sequence"], entry["seed"]))
        try:
            runs.append(load_run(folder, entry, sequence.truth() if sequence is not None else Truth("not available")))
        except StoreError as error:
            remarks.append(f"{entry['method']} over {entry['sequence']} is left out: {error}")
    shown = {(one["sequence"], one["method"]) for one in entries}
    rows = tuple(row for row in _load_summary(folder / "summary.csv") if (row.sequence, row.method) in shown)
    valued = {row.metric for row in rows if row.median is not None}
    chosen = metrics or [name for name, one in known.items() if one["headline"]]
    columns = tuple(
        MetricColumn(name, *(known[name][key] for key in ("label", "unit", "better", "digits")))
        for name in chosen if name in valued
    )  # fmt: skip
    return ExportSelection(folder, content, columns, rows, tuple(runs), opened, tuple(remarks))


def _load_summary(path: Path) -> list[SummaryRow]:
    try:
        return [_summary_row(row) for row in load_table(path)[1]]
    except (KeyError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read ({error})", REMEDY) from error


def _summary_row(row: Mapping[str, str]) -> SummaryRow:
    median, low, high = (float(row[name]) if row[name] else None for name in ("median", "low_95", "high_95"))
    counts = int(row["runs_complete"]), int(row["runs_expected"])
    names = row["sequence"], row["method"], row["metric"]
    return SummaryRow(*names, median, low, high, row["mark"] in ("best", "tied"), *counts)


def _open_sequences(
    entries: Sequence[Mapping[str, Any]],
) -> tuple[dict[tuple[str, int | None], SensorSequence], list[str]]:
    """Open the sequences, by label and seed; return also why some cannot be opened."""
    opened: dict[tuple[str, int | None], SensorSequence] = {}
    remarks: dict[str, None] = {}
    for one in entries:
        name = one["sequence"], one["seed"]
        if name in opened or not one["scans_answered"]:
            continue
        try:
            opened[name] = registry.dataset(one["dataset"]).open(one["dataset_parameters"])
        except (EvalkitError, TypeError) as error:  # TypeError: a stored parameter that the reader does not have
            remarks[f"{one['sequence']}: without scans and ground truth ({error})"] = None
    return opened, list(remarks)
