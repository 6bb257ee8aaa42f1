"""The table of methods that correct earlier poses: errors before and after, and their loop closures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from urllib.parse import quote

import numpy as np

from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_length
from evalkit.report.html.blocks import Block, Cell, Column, Fold, Heading, Table, Text
from evalkit.report.html.corrected_runs import SUFFIX
from evalkit.report.html.report_tables import (
    DASH,
    Strokes,
    by_rank,
    method_cell,
    metric_column,
    runs_anchor,
    score_cell,
)
from evalkit.results.run_record import RunRecord

CLOSURES = (
    "closure_candidates", "closures_accepted", "closures_rejected", "closure_precision_percent",
    "closure_recall_percent", "corrections", "correction_max_ms",
)  # fmt: skip
"""Metrics of the table, in order; those without a value are left out."""

NOTE = (
    "Answers are what a robot had at the time; they are ranked with those of all methods. Corrected poses are those at "
    "the end, after all corrections; maps are drawn from them. Precision: accepted closures that are right. Recall: "
    "revisits of the true path that a right closure joins."
)


def build_corrected(
    analysis: Analysis, sequence: SequenceAnalysis, number: int, strokes: Strokes, anchor: str
) -> list[Block]:
    """Return heading, note and table of the methods with corrected poses, best corrected first; [] without any."""
    final, deciding = sequence.final, sequence.deciding
    if final is None or deciding is None:
        return []
    counts = [found for name in CLOSURES if (found := sequence.rankings.get(name)) is not None and found.has_values]
    places = {label: place for place, label in enumerate(analysis.comparison.methods, start=1)}
    corrected = {score.method: score for score in final.scores if score.values}
    ranked = [score.method for score in final.ranked]
    labels = dict.fromkeys([*ranked, *(label for label in by_rank(sequence) if label in corrected)])
    rows = []
    for label in labels:
        link = f"#{runs_anchor(number, places[label])}"
        cells = [score_cell(one, one.of(label), link) for one in (deciding, final, *counts)]
        rows.append([method_cell(analysis.comparison, strokes, label, link), *cells])
    columns = [Column("Method"), *(metric_column(one.metric) for one in (deciding, final, *counts))]
    title = "Corrected poses and loop closures"
    table = Table(columns, rows, label=f"{title} on {sequence.label}")
    first = [own[0] for own in sequence.runs.values()]
    return [Heading(title, f"{anchor}-corrected"), table, Text(NOTE, "note"), *list_closures(first, anchor)]


MAX_LISTED = 30
"""More loop closures of a run are counted, not listed."""


def list_closures(records: Sequence[RunRecord], anchor: str) -> list[Block]:
    """Return a closed list of the loop closures of each run, in order of time; a time opens the player there.

    The player places the scan by the answer and by the corrected pose: before and after.
    """
    answered = [record.result.steps["stamp_ns"] for record in records if len(record.result.steps)]
    stamps = np.unique(np.concatenate(answered)) if answered else np.zeros(0, dtype=np.int64)
    folds: list[Block] = []
    for record in records:
        found = sorted(record.result.loop_closures, key=lambda one: one.stamp_ns)
        if not found:
            continue
        errors = closure_errors_m(found, record.truth.trajectory)
        start = int(record.result.steps["stamp_ns"][0])
        rows = []
        for one, error in zip(found[:MAX_LISTED], errors, strict=False):
            scan = int(np.searchsorted(stamps, one.stamp_ns)) + 1
            words = {"by": record.method, "and": f"{record.method}{SUFFIX}", "on": "own", "scan": str(scan)}
            link = f"#{anchor}-player?{'&'.join(f'{key}={quote(value)}' for key, value in words.items())}"
            apart = DASH if math.isnan(error) else Cell(format_length(error), error)
            seconds = (one.stamp_ns - start) * 1e-9, (one.other_stamp_ns - start) * 1e-9
            rows.append([
                Cell(f"{seconds[0]:.1f}", seconds[0], link=link), Cell(f"{seconds[1]:.1f}", seconds[1]),
                "accepted" if one.accepted else "rejected", one.reason, apart,
            ])  # fmt: skip
        columns = [
            Column("At", "s", True), Column("Back to", "s", True), Column("Decision"), Column("Reason"),
            Column("From the true motion", "", True),
        ]  # fmt: skip
        more = f"; the first {MAX_LISTED}" if len(found) > MAX_LISTED else ""
        title = f"Loop closures of {record.method}: {len(found)} candidates{more}"
        table = Table(columns, rows, label=title)
        folds.append(Fold(title, [table], f"{anchor}-closures-{len(folds) + 1}"))
    return folds


def closure_errors_m(closures: Sequence[LoopClosure], truth: Trajectory | None) -> Floats:
    """Return the distance (K,) in m of each measured motion from the true one; nan where the truth is not known."""
    errors = np.full(len(closures), np.nan)
    if truth is None or len(truth) < 2 or not closures:
        return errors
    stamps = np.array([[one.other_stamp_ns, one.stamp_ns] for one in closures], dtype=np.int64)
    known = can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S).all(axis=1)
    earlier, later = stamps[known].T
    measured = np.array([one.other_from_base.row for one in closures])[known]
    true = se2.between(truth.at(earlier), truth.at(later))
    errors[known] = np.hypot(*(measured - true)[:, :2].T)
    return errors
