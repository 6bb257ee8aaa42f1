"""This report's methods among published results."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from evalkit.metrics.metric import Metric
from evalkit.plugins.specs import Published
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.html.blocks import Cell, Column, Table
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.report_tables import format_in_cell, method_cell, metric_column

COVERED, MIN_COVERED = "relations_answered_percent", 95.0
"""A metric, and the percentage from which on a result is compared with published ones, which are of all relations."""


def explain_no_published(sequence: SequenceAnalysis) -> str:
    """Return why published results are not shown beside those of a sequence; "" without any, or if they are."""
    excerpt = sequence.all_runs[0].spec.sequence.excerpt_scans
    ranking = sequence.rankings.get(COVERED)
    known = [score.median for score in ranking.scores if score.median is not None] if ranking else []
    whole = max(known) >= MIN_COVERED if known else not excerpt
    if not sequence.card.published or whole:
        return ""
    share = f" with {max(known):.{int(max(known) < 9.95)}f} % of its relations" if known else ""
    part = f"excerpts of {excerpt} scans" if excerpt else "a part of it"
    return (
        f"Not compared with published results, which are of the whole {sequence.label}: the runs are of {part}{share}."
    )


def published_table(analysis: Analysis, sequence: SequenceAnalysis, strokes: Strokes) -> Table | None:
    """Return this report's methods among published results, best first; None without publications."""
    published = sequence.card.published
    metric = _counterpart(sequence.metrics, published) if published else None
    if metric is None:
        return None
    spread = sequence.rankings.get(published[0].spread_metric)
    rows: list[tuple[float, list[Cell | str]]] = [
        (row.value, [Cell(row.label), Cell(format_in_cell(metric, row.value), row.value),
                     "–" if row.spread is None else format_in_cell(metric, row.spread), Cell(row.source)])
        for row in published
    ]  # fmt: skip
    for score in sequence.rankings[metric.name].ranked:
        beside = spread.of(score.method) if spread else None
        value = median(score.values)
        deviation = format_in_cell(metric, beside.median) if beside is not None and beside.median is not None else "–"
        name = method_cell(analysis.comparison, strokes, score.method)
        rows.append((value, [name, Cell(format_in_cell(metric, value), value), deviation, Cell("this report")]))
    columns = (Column("Method"), metric_column(metric), Column("± spread", number=True), Column("Source"))
    return Table(columns, [row for _, row in sorted(rows, key=lambda one: one[0])], label="Published results")


def _counterpart(metrics: Sequence[Metric], rows: Sequence[Published]) -> Metric | None:
    """Return the metric that published results are compared with."""
    named = rows[0].metric
    for metric in metrics:
        if metric.name == named or (not named and metric.group == "relations" and metric.unit == "m"):
            return metric
    return None
