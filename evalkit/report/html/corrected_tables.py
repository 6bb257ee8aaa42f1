"""The table of methods that correct earlier poses: errors before and after, and their loop closures."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from urllib.parse import quote

import numpy as np

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.se2 import Stamps
from evalkit.metrics.loop_closures import measure_errors
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_length
from evalkit.report.html.blocks import Block, Cell, Column, Fold, Heading, Table, Text
from evalkit.report.html.corrected_runs import SUFFIX
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.report_tables import (
    DASH,
    by_rank,
    method_cell,
    metric_column,
    runs_anchor,
    score_cell,
)
from evalkit.report.html.shown_corrections import attribute_closures, name_correction
from evalkit.results.run_record import RunRecord

COUNTS = (
    "closure_candidates", "closures_accepted", "closures_rejected", "closure_precision_percent",
    "closure_recall_percent", "recoveries_own", "corrections", "correction_max_ms", "cpu_p99_ms", "cpu_max_ms",
)  # fmt: skip
"""Metrics of the table, in order; those without a value are left out."""

NOTE = (
    "Answers are what a robot had at the time; they are ranked with those of all methods. Corrected poses are those at "
    "the end, after all corrections; maps are drawn from them. Precision: accepted closures that are right. Recall: "
    "returns of the true path to itself that a right closure joins, each counted once, however long."
)


def build_corrected(
    analysis: Analysis, sequence: SequenceAnalysis, number: int, strokes: Strokes, anchor: str
) -> list[Block]:
    """Return heading, note and table of the methods that correct poses, and their loop closures.

    Best corrected first. [] where no method corrects poses, or none changes an error or has a candidate.
    """
    final, first = sequence.final, [own[0] for own in sequence.runs.values()]
    correcting = [label for label, own in sequence.runs.items() if any(run.result.final is not None for run in own)]
    tried = any(run.result.loop_closures for run in sequence.all_runs)
    if not correcting or (final is None and not tried):
        return []
    answers = () if final is None or sequence.deciding is None else (sequence.deciding, final)
    counts = [found for name in COUNTS if (found := sequence.rankings.get(name)) is not None and found.has_values]
    places = {label: place for place, label in enumerate(analysis.comparison.methods, start=1)}
    ranked = [score.method for score in final.ranked] if final else []
    labels = dict.fromkeys([*ranked, *(label for label in by_rank(sequence) if label in correcting)])
    rows = []
    for label in labels:
        link = f"#{runs_anchor(number, places[label])}"
        cells = [score_cell(one, one.of(label), link) for one in (*answers, *counts)]
        rows.append([method_cell(analysis.comparison, strokes, label, link), *cells])
    columns = [Column("Method"), *(metric_column(one.metric) for one in (*answers, *counts))]
    title = "Corrected poses and loop closures"
    table = Table(columns, rows, label=f"{title} on {sequence.label}")
    return [Heading(title, f"{anchor}-corrected"), table, Text(NOTE, "note"), *list_closures(first, anchor)]


MAX_ACCEPTED = 100
"""More accepted loop closures of a run are counted, not listed."""

MAX_EXAMPLES, MAX_REASONS = 3, 20
"""Rejected candidates that are listed for each reason, and reasons, most frequent first."""


def list_closures(records: Sequence[RunRecord], anchor: str) -> list[Block]:
    """Return a closed list of the loop closures of each run: the accepted ones, then the rejected ones by reason.

    A time opens the player there: of a closure with the scan placed by the answer and by the corrected pose at the end,
    of a correction with the path before and after it.
    """
    answered = [record.result.steps["stamp_ns"] for record in records if len(record.result.steps)]
    stamps = np.unique(np.concatenate(answered)) if answered else np.zeros(0, dtype=np.int64)
    folds: list[Block] = []
    for record in records:
        found = sorted(record.result.loop_closures, key=lambda one: one.stamp_ns)
        if not found:
            continue
        errors = measure_errors(found, record.truth.trajectory)[:, 0]
        pairs = list(zip(found, errors.tolist(), strict=True))
        accepted = [pair for pair in pairs if pair[0].accepted]
        candidates = f"{len(found)} candidate{'s' if len(found) != 1 else ''}"
        title = f"Loop closures of {record.method}: {candidates}, {len(accepted)} accepted"
        tables = []
        if accepted:
            tables.append(_tabulate_accepted(record, stamps, accepted, anchor))
        if len(accepted) < len(found):
            tables.append(_tabulate_rejected(record, stamps, [one for one in pairs if not one[0].accepted], anchor))
        notes: list[Block] = []
        if np.isfinite(errors).any():
            notes.append(Text(f"Distances are from this truth: {record.truth.how.rstrip('.')}.", "note"))
        else:
            tables = [_without_last_column(table) for table in tables]
        folds.append(Fold(title, [*tables, *notes], f"{anchor}-closures-{len(folds) + 1}"))
    return folds


CORRECTED = (
    Column("Corrected at", "s", True,
           "the first correction of the path after it, before another closure was accepted; a dash where the method "
           "reported none: no earlier pose moved by more than 1 cm or 0.5 deg"),
    Column("Robot moved", "", True, "by this correction, one scan before it"),
)  # fmt: skip


def _tabulate_accepted(
    record: RunRecord, stamps: Stamps, accepted: Sequence[tuple[LoopClosure, float]], anchor: str
) -> Table:
    """Return the accepted closures in order of time, each with the distance of its motion from the true one."""
    corrections = _cells_of_corrections(record, stamps, anchor)
    unknown = (DASH, DASH) if corrections else ()
    rows: list[list[Cell | str]] = [
        [
            *_cells_of_times(record, stamps, one, anchor), one.reason, *corrections.get(one.stamp_ns, unknown),
            _cell_of_error(error),
        ]
        for one, error in accepted[:MAX_ACCEPTED]
    ]  # fmt: skip
    columns = [
        Column("Accepted at", "s", True), Column("Back to", "s", True), Column("Reason"),
        *(CORRECTED if corrections else ()),
        Column("From the true motion", "", True, "the motion that was measured, against the truth"),
    ]  # fmt: skip
    more = f"The first {MAX_ACCEPTED} of {len(accepted)} accepted closures" if len(accepted) > MAX_ACCEPTED else ""
    return Table(columns, rows, more, label=f"Accepted loop closures of {record.method}")


def _tabulate_rejected(
    record: RunRecord, stamps: Stamps, rejected: Sequence[tuple[LoopClosure, float]], anchor: str
) -> Table:
    """Return the rejected candidates by reason, most frequent first: how many, and the first of them."""
    kinds: dict[str, list[tuple[LoopClosure, float]]] = {}
    for pair in rejected:
        kinds.setdefault(_without_numbers(pair[0].reason), []).append(pair)
    rows: list[list[Cell | str]] = []
    ordered = sorted(kinds.values(), key=lambda kind: -len(kind))
    for kind in ordered[:MAX_REASONS]:
        of_all = f"{len(kind)}{_describe_values([one.reason for one, _ in kind])}"
        for place, (one, error) in enumerate(kind[:MAX_EXAMPLES]):
            count = Cell(of_all if place == 0 else "")
            rows.append([one.reason, count, *_cells_of_times(record, stamps, one, anchor), _cell_of_error(error)])
    left = sum(map(len, ordered[MAX_REASONS:]))
    columns = [
        Column("Rejected"),
        Column("Candidates", "", True,
               "rejected for this reason, whatever its numbers; in brackets the first of them, where it differs: "
               "lowest, median, highest"),
        Column("At", "s", True), Column("Back to", "s", True),
        Column("Its guess, from the true motion", "", True,
               "The motion of the candidate against the truth. A method that rejects a candidate before it measures a "
               "motion gives the one it expected: this is no error of a measurement."),
    ]  # fmt: skip
    more = f"{left} more for other reasons" if left else ""
    return Table(columns, rows, more, sortable=False, label=f"Rejected loop closures of {record.method}")


def _without_last_column(table: Table) -> Table:
    return replace(table, columns=table.columns[:-1], rows=[row[:-1] for row in table.rows])


_NUMBER = re.compile(r"(?<!\w)\d+(?:[.,]\d+)*(?:e[-+]?\d+)?")
"""A number in a reason; the 2 of "chi2" is none."""


def _without_numbers(reason: str) -> str:
    return _NUMBER.sub("#", reason)


def _describe_values(reasons: Sequence[str]) -> str:
    """Return the lowest, median and highest first number of reasons in brackets; "" where they agree or have none."""
    found = [number.group() for reason in reasons if (number := _NUMBER.search(reason))]
    if len(set(found)) < 2 or any("," in number or number.count(".") > 1 for number in found):
        return ""
    values = np.array(found, dtype=np.float64)
    return f" ({values.min():.3g}, {np.median(values):.3g}, {values.max():.3g})"


def _cells_of_corrections(record: RunRecord, stamps: Stamps, anchor: str) -> dict[int, tuple[Cell, Cell]]:
    """Return when each correction was and how far the robot moved, by the stamp of the last closure before it."""
    start = int(record.result.steps["stamp_ns"][0])
    cells = {}
    for number, (one, closures) in enumerate(attribute_closures(record.result)[0], start=1):
        if closures:
            words = {"correction": name_correction(record.method, number)}
            at, moved = (one.stamp_ns - start) * 1e-9, float(one.moved_m[-1])
            link = _link_to_player(record, stamps, one.stamp_ns, anchor, words)
            cells[closures[-1].stamp_ns] = (Cell(f"{at:.1f}", at, link=link), Cell(format_length(moved), moved))
    return cells


def _link_to_player(record: RunRecord, stamps: Stamps, stamp_ns: int, anchor: str, more: Mapping[str, str]) -> str:
    """Return a link that opens the player at a scan, placed by the answer on its own map."""
    words = {"by": record.method, **more, "on": "own", "scan": str(int(np.searchsorted(stamps, stamp_ns)) + 1)}
    return f"#{anchor}-player?{'&'.join(f'{key}={quote(value)}' for key, value in words.items())}"


def _cells_of_times(record: RunRecord, stamps: Stamps, one: LoopClosure, anchor: str) -> tuple[Cell, Cell]:
    """Return the times of both frames in s since the first answer; the later one opens the player there."""
    start = int(record.result.steps["stamp_ns"][0])
    link = _link_to_player(record, stamps, one.stamp_ns, anchor, {"and": f"{record.method}{SUFFIX}"})
    later, earlier = (one.stamp_ns - start) * 1e-9, (one.other_stamp_ns - start) * 1e-9
    return Cell(f"{later:.1f}", later, link=link), Cell(f"{earlier:.1f}", earlier)


def _cell_of_error(error_m: float) -> Cell:
    return DASH if math.isnan(error_m) else Cell(format_length(error_m), error_m)
