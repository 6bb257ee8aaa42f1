"""The exported part of a results folder: its tables, its runs, and the sequences with ground truth and scans."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

from evalkit.core.errors import DataMissing, EvalkitError, StoreError, UnknownName
from evalkit.core.ground_truth import Truth
from evalkit.plugins import registry
from evalkit.plugins.parameters import NUISANCE
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.report.analysis.scores import DECIDING, Spread, choose_spread
from evalkit.report.html.method_colours import Stroke, assign_strokes
from evalkit.results.reader import (
    REMEDY,
    as_incomplete,
    find_working_folder,
    load_results_json,
    load_run,
    load_table,
)
from evalkit.results.run_record import RunRecord

IN_PAPERS = ("drift_percent", "cpu_median_ms")
"""Columns of a table beside the metric that decides the sequence."""


@dataclass(frozen=True, slots=True)
class SummaryRow:
    """One metric of one method over one sequence, in the metric's unit; None without a value.

    ``runs``: complete runs with a value. ``spread``: the bounds beside the median, as on the page. ``best``: the best,
    or without a clear difference from it. ``rank``: 1 for the best, None without a rank. ``reason``: why there is no
    value.
    """

    sequence: str
    method: str
    metric: str
    median: float | None
    runs: int
    spread: Spread | None
    best: bool
    rank: int | None
    reason: str


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

    ``columns``: the chosen metrics of the tables, () for those of a paper. ``runs``: every run that answered a scan,
    with its ground truth. ``opened``: the sequences by label and seed. ``remarks``: what is missing (a sequence without
    files, an incomplete run).
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
        valued = {(row.sequence, row.metric) for row in self.rows if row.median is not None}
        return tuple(
            label for label in self.sequences if any((label, c.name) in valued for c in self.columns_of(label))
        )

    def is_tuned(self, method: str, sequence: str) -> bool:
        """Return whether settings of a method were chosen on the data set of a sequence."""
        data_sets = {run["dataset"] for run in self.content["runs"] if run["sequence"] == sequence}
        return not data_sets.isdisjoint(self.content["methods"][method]["tuned_on"])

    def column(self, metric: str) -> MetricColumn | None:
        """Return a metric as a column, None for an unknown one."""
        card = next((one for one in self.content["metrics"] if one["name"] == metric), None)
        return None if card is None else make_column(card)

    def deciding(self, sequence: str) -> str:
        """Return the metric that decides a sequence: the one compared, else the first headline metric with a value."""
        compared = [one["metric"] for one in self.content["differences"] if one["sequence"] == sequence]
        valued = {row.metric for row in self.rows if row.sequence == sequence and row.median is not None}
        groups = {group: place for place, group in enumerate(DECIDING)}
        cards = [one for one in self.content["metrics"] if one["headline"] and one["name"] in valued]
        ordered = sorted(cards, key=lambda one: groups.get(one["group"], len(groups)))
        return str(compared[0]) if compared else str(ordered[0]["name"]) if ordered else ""

    def columns_of(self, sequence: str) -> tuple[MetricColumn, ...]:
        """Return the columns of a sequence's table: the chosen ones, or error, drift and CPU time.

        Of a SLAM also the error of its corrected poses.
        """
        if self.columns:
            return self.columns
        deciding = self.deciding(sequence)
        corrected = [one["name"] for one in self.content["metrics"] if deciding and one["counterpart"] == deciding]
        names = dict.fromkeys((deciding, *corrected, *IN_PAPERS))
        return tuple(column for name in names if (column := self.column(name)) is not None)

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

    ``metrics``: the columns in this order; empty: error, drift and CPU time. ``scans``: open the sequences, for
    ground truth and scans. Raises StoreError if the folder holds no report, or if no method has a value of one of
    ``metrics``, UnknownName for an unknown label.
    """
    with as_incomplete(folder / "results.json"):
        return _select(folder, load_results_json(folder), sequences, methods, metrics, scans)


def _check_parts(content: dict[str, Any]) -> None:
    """Raise KeyError, TypeError or AttributeError where a part that a format reads is missing or of another type."""
    itemgetter("title", "description", "command")(content)
    for verdict in content["verdicts"]:
        tuple(itemgetter("sequence", "sentences")(verdict)[1])
    for name in ("runs", "intervals", "differences"):
        for one in content.get(name, ()):
            hash(itemgetter("sequence", "method")(one))
    for name in ("sequences", "methods"):
        content[name].items()


def _select(
    folder: Path, content: dict[str, Any], sequences: Sequence[str], methods: Sequence[str], metrics: Sequence[str],
    scans: bool,
) -> ExportSelection:  # fmt: skip
    _check_parts(content)
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
    opened, remarks = _open_sequences(folder, entries) if scans else ({}, [])
    runs = []
    for entry in (one for one in entries if one["scans_answered"]):
        sequence = opened.get((entry["sequence"], entry["seed"]))
        try:
            runs.append(load_run(folder, entry, sequence.truth() if sequence is not None else Truth("not available")))
        except StoreError as error:
            remarks.append(f"{entry['method']} over {entry['sequence']} is left out: {error}")
    shown = {(one["sequence"], one["method"]) for one in entries}
    perturbed = {one["sequence"] for one in content["runs"] if NUISANCE in one["dataset_parameters"]}
    stored = _load_summary(folder / "summary.csv", perturbed)
    rows = tuple(row for row in stored if (row.sequence, row.method) in shown)
    _check_values(folder, rows, metrics)
    columns = tuple(make_column(known[name]) for name in dict.fromkeys(metrics))
    return ExportSelection(folder, content, columns, rows, tuple(runs), opened, tuple(remarks))


def _check_values(folder: Path, rows: Sequence[SummaryRow], metrics: Sequence[str]) -> None:
    """Raise StoreError, with the reason stored with the scores, for a chosen metric without any value."""
    valued = list(dict.fromkeys(row.metric for row in rows if row.median is not None))
    for name in metrics:
        if name not in valued:
            reasons = dict.fromkeys(row.reason for row in rows if row.metric == name and row.reason)
            what = f"no method has {name}: {'; '.join(reasons) or 'it was not computed'}"
            raise StoreError(str(folder), what, f"metrics with a value: {', '.join(valued) or 'none'}")


def make_column(card: Mapping[str, Any]) -> MetricColumn:
    """Return a column from the card of a metric in results.json."""
    return MetricColumn(*(card[key] for key in ("name", "label", "unit", "better", "digits")))


def _load_summary(path: Path, perturbed: Collection[str]) -> list[SummaryRow]:
    """Load the rows of summary.csv; ``perturbed``: the sequences whose runs are perturbations of a recording."""
    try:
        return [_summary_row(row, row["sequence"] in perturbed) for row in load_table(path)[1]]
    except (KeyError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read ({error})", REMEDY) from error


def _summary_row(row: Mapping[str, str], perturbed: bool) -> SummaryRow:
    median = float(row["median"]) if row["median"] else None
    interval = (float(row["low_95"]), float(row["high_95"])) if row["low_95"] else None
    extremes = (float(row["lowest"]), float(row["highest"])) if row["lowest"] else None
    runs, rank = int(row["runs_scored"]), int(row["rank"]) if row["rank"] else None
    spread = choose_spread(runs, perturbed, interval, extremes)
    names = row["sequence"], row["method"], row["metric"]
    return SummaryRow(*names, median, runs, spread, row["mark"] in ("best", "tied"), rank, row["reason"])


def _open_sequences(
    folder: Path, entries: Sequence[Mapping[str, Any]],
) -> tuple[dict[tuple[str, int | None], SensorSequence], list[str]]:  # fmt: skip
    """Open the sequences, by label and seed; return also why some cannot be opened."""
    opened: dict[tuple[str, int | None], SensorSequence] = {}
    remarks: dict[str, None] = {}
    for one in entries:
        name = one["sequence"], one["seed"]
        if name in opened or not one["scans_answered"]:
            continue
        working = find_working_folder(folder, one["key"])
        try:
            opened[name] = registry.dataset(one["dataset"]).open(_resolve_paths(one["dataset_parameters"], working))
        except (EvalkitError, TypeError) as error:  # TypeError: a stored parameter that the reader does not have
            sought = f"; relative paths were sought in {working}, where it ran" if working else ""
            why = f"{error}{sought if isinstance(error, DataMissing) else ''}"
            remarks[f"{one['sequence']}: without scans and ground truth ({why})"] = None
    return opened, list(remarks)


def _resolve_paths(parameters: Mapping[str, Any], folder: Path | None) -> dict[str, Any]:
    """Return the parameters with absolute paths of the files that they name relative to a folder, if it is known."""
    if folder is None:
        return dict(parameters)
    return {
        name: _resolve_path(value, folder) if isinstance(value, str) and value else value
        for name, value in parameters.items()
    }


def _resolve_path(value: str, folder: Path) -> str:
    """Return the absolute path of a file or an address in it (FILE?topic=/pose); any other text as it is."""
    path, mark, query = value.partition("?")
    try:
        if (folder / value).exists():  # a file may have a question mark in its name
            return str(folder / value)
        return f"{folder / path}{mark}{query}" if path and (folder / path).exists() else value
    except (OSError, ValueError):  # a text that is not the path of a file
        return value
