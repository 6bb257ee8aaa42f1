"""A results folder read back whole: its tables, its runs as they were left, and the sequences they ran over."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.errors import EvalkitError, StoreError, UnknownName
from evalkit.core.ground_truth import Truth
from evalkit.plugins import registry
from evalkit.plugins.protocols import Sequence as Recording
from evalkit.report.html.palette import Stroke, strokes
from evalkit.report.results_json import NAME, VERSION
from evalkit.results.run_record import RunRecord
from evalkit.results.store import Store

AGAIN = "name a folder that `evalkit compare` has written, or write the report again"


@dataclass(frozen=True, slots=True)
class Cell:
    """One metric of one method over one sequence, in the metric's unit; None where there is no value.

    ``best``: no difference from the best is shown; ``complete`` of ``expected`` runs ended well.
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
class Heading:
    """A metric as a column: ``better`` is "lower", "higher" or ""."""

    name: str
    label: str
    unit: str
    better: str
    digits: int


@dataclass(frozen=True, eq=False)
class Results:
    """A comparison. ``headings``: the metrics in tables; ``records``: every run that answered a scan, with truth.

    ``remarks``: what could not be had (a sequence whose files are not here, a run cut short), a sentence each.
    """

    folder: Path
    content: Mapping[str, Any]
    headings: tuple[Heading, ...]
    cells: tuple[Cell, ...]
    records: tuple[RunRecord, ...]
    recordings: Mapping[tuple[str, int | None], Recording]
    remarks: tuple[str, ...] = field(default=())

    @property
    def strokes(self) -> Mapping[str, Stroke]:
        """The stroke of every method, as in the report."""
        cards: Mapping[str, Any] = self.content["methods"]
        present = {record["method"] for record in self.content["trials"]}
        known = [label for label in cards if label in present]
        return strokes(known, [label for label in known if cards[label]["role"] == "baseline"])

    @property
    def sequences(self) -> tuple[str, ...]:
        """Labels of the sequences, in the report's order."""
        return tuple(dict.fromkeys(cell.sequence for cell in self.cells))

    @property
    def scored(self) -> tuple[str, ...]:
        """Labels of the sequences over which a metric of the tables has a value."""
        shown = {heading.name for heading in self.headings}
        valued = {cell.sequence for cell in self.cells if cell.median is not None and cell.metric in shown}
        return tuple(label for label in self.sequences if label in valued)

    def first(self, sequence: str) -> tuple[RunRecord, ...]:
        """The runs of a sequence's lowest seed: what a figure shows."""
        own = [record for record in self.records if record.sequence == sequence]
        lowest = min((record.seed or 0 for record in own), default=0)
        return tuple(record for record in own if (record.seed or 0) == lowest)


def read(
    folder: Path, sequences: Sequence[str] = (), methods: Sequence[str] = (), metrics: Sequence[str] = (),
    scans: bool = True,
) -> Results:  # fmt: skip
    """A results folder, or the part of it with these names; StoreError where it is none, UnknownName for a name.

    ``metrics``: the headings in this order; empty: the headline ones. ``scans``: make the sequences again, for truth
    and scans; else runs have no truth.
    """
    content = _content(folder / "results.json")
    wanted = [
        one for one in content["trials"]
        if (not sequences or one["sequence"] in sequences) and (not methods or one["method"] in methods)
    ]  # fmt: skip
    _known("sequence", sequences, content["sequences"])
    _known("method", methods, content["methods"])
    recordings, remarks = _recordings(wanted) if scans else ({}, [])
    found = [_trial(folder, one, recordings) for one in wanted if one["scans_answered"]]
    records = [one for one in found if isinstance(one, RunRecord)]
    remarks += [one for one in found if isinstance(one, str)]
    shown = {(one["sequence"], one["method"]) for one in wanted}
    cells = tuple(cell for cell in _cells(folder / "summary.csv") if (cell.sequence, cell.method) in shown)
    valued = {cell.metric for cell in cells if cell.median is not None}
    known = {one["name"]: one for one in content["metrics"]}
    _known("metric", metrics, known)
    chosen = metrics or [name for name, one in known.items() if one["headline"]]
    headings = tuple(_heading(known[name]) for name in chosen if name in valued)
    return Results(folder, content, headings, cells, tuple(records), recordings, tuple(remarks))


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StoreError(str(path), "there is no such file", AGAIN) from None
    except (OSError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read, perhaps half-written ({error})", AGAIN) from error
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != {"name": NAME, "version": VERSION}:
        raise StoreError(str(path), f"it is no {NAME} of version {VERSION}", AGAIN)
    found: dict[str, Any] = content
    return found


def _heading(one: Mapping[str, Any]) -> Heading:
    return Heading(one["name"], one["label"], one["unit"], one["better"], one["digits"])


def _known(kind: str, wanted: Sequence[str], known: Mapping[str, Any]) -> None:
    for name in wanted:
        if name not in known:
            raise UnknownName(kind, name, known)


def _cells(path: Path) -> list[Cell]:
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return [_cell(row) for row in csv.DictReader(file)]
    except (OSError, KeyError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read ({error})", AGAIN) from error


def _cell(row: Mapping[str, str]) -> Cell:
    median, low, high = (float(row[name]) if row[name] else None for name in ("median", "low_95", "high_95"))
    best = row["level_with_best"] == "True" or row["place"] == "1"
    counts = int(row["runs_complete"]), int(row["runs_expected"])
    return Cell(row["sequence"], row["method"], row["metric"], median, low, high, best, *counts)


def _recordings(wanted: Sequence[Mapping[str, Any]]) -> tuple[dict[tuple[str, int | None], Recording], list[str]]:
    """The sequences made again, by label and seed, and why some could not be."""
    made: dict[tuple[str, int | None], Recording] = {}
    remarks: dict[str, None] = {}
    for one in wanted:
        place = one["sequence"], one["seed"]
        if place in made or not one["scans_answered"]:
            continue
        try:
            made[place] = registry.dataset(one["dataset"]).make(**one["dataset_parameters"])
        except EvalkitError as error:
            remarks[f"{one['sequence']}: its scans and its truth are not here ({error})"] = None
    return made, list(remarks)


def _trial(folder: Path, one: Mapping[str, Any], recordings: Mapping[Any, Recording]) -> RunRecord | str:
    """A run as it was left; or a text, where its files hold less than the report tells of it."""
    store = Store.existing(folder)
    run, scored = store.load_result(one["key"]), store.load_scores(one["key"])
    answered = 0 if run is None else len(run.steps)
    if run is None or scored is None or answered != one["scans_answered"]:
        whole = answered == one["scans_answered"]
        what = "its alignment and map are not" if whole else f"{answered} of its {one['scans_answered']} answers are"
        who = f"{one['method']} over {one['sequence']}" + ("" if one["seed"] is None else f", seed {one['seed']}")
        return f"{who}: {what} in {folder / 'runs' / one['key']}, so it is left out; make the report again"
    recording = recordings.get((one["sequence"], one["seed"]))
    method = Method(one["method"], one["backend"], one["backend_parameters"])
    parameters = {name: value for name, value in one["dataset_parameters"].items() if name != "seed"}
    sequence = SequenceSpec(one["sequence"], one["dataset"], parameters, (one["seed"],))
    spec = RunSpec(one["key"], method, sequence, one["seed"])
    truth = recording.truth() if recording is not None else Truth("not here")
    return RunRecord(spec, run, replace(scored, alignment=one["alignment"]), truth, one["command"])
