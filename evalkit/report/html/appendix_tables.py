"""The tables of a report's appendix: tests over all runs, rank agreement, settings, runs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from urllib.parse import quote

from evalkit.metrics.metric import Metric
from evalkit.metrics.validated import MetricValidation
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison, Setting
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.significance import MethodRecord, PairedComparison
from evalkit.report.formatting import capitalise, format_bounds, format_number
from evalkit.report.html.blocks import Block, Cell, Column, Fold, Table
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.report_tables import DASH, method_cell, runs_anchor
from evalkit.results.run_record import RunRecord


def records_table(analysis: Analysis, strokes: Strokes) -> Table:
    """Return success and ranks of every method over all sequences that count."""
    columns = (
        Column("Method"), Column("Runs finished", number=True, better="higher"),
        Column("Mean rank", "", True, "1 is the best on every data set"),
        *(Column(f"A{share}", "", True, f"{share} % of all its runs have at most this deciding error")
          for share in (50, 75, 95)),
        Column("Runs of A50–A95", number=True, tip="and the number of their sequences"),
    )  # fmt: skip
    rows = [_record_row(analysis.comparison, strokes, one) for one in analysis.significance.records]
    return Table(columns, rows, label="Success and ranks")


def _record_row(comparison: Comparison, strokes: Strokes, one: MethodRecord) -> list[Cell]:
    finished = Cell("could not start", "")
    if one.share is not None:
        extent = f"95 %: {100 * one.share.low:.0f}–{100 * one.share.high:.0f} %"
        finished = Cell(f"{one.finished} of {one.runs}", one.share.value, extent=extent)
    rank = DASH if one.rank is None else Cell(f"{one.rank:.1f}", one.rank)
    errors = [
        Cell("failed", error) if error > 1e9 else Cell(_format_metres(error), error) for error in one.quantiles
    ] or [DASH] * 3  # fmt: skip
    extent = f"{one.sequences} sequence{'s' * (one.sequences != 1)}"
    over = Cell(f"{one.measured} run{'s' * (one.measured != 1)}", one.measured, extent=extent)
    return [method_cell(comparison, strokes, one.method), finished, rank, *errors, over if one.measured else DASH]


def comparisons_table(analysis: Analysis, strokes: Strokes) -> Table:
    """Return the paired tests over all runs."""
    numbers = ("Runs", "Better", "Worse", "Ratio", "Larger", "p", "Detectable")
    columns: list[Column | str] = ["Method", "Against", "Verdict", *(Column(label, number=True) for label in numbers)]
    rows = [_comparison_row(analysis.comparison, strokes, one) for one in analysis.significance.comparisons]
    return Table(columns, rows, label="Pairs over all runs")


def _comparison_row(comparison: Comparison, strokes: Strokes, one: PairedComparison) -> list[Cell | str]:
    return [
        method_cell(comparison, strokes, one.method), one.reference, one.verdict,
        *(Cell(str(count), count) for count in (one.runs, one.better, one.worse)),
        DASH if one.ratio is None else Cell(f"{one.ratio:.2f}", one.ratio),
        Cell(f"{100 * one.larger:.0f} %", one.larger), Cell(f"{one.p:.2g}", one.p),
        Cell(_format_detectable(one.detectable), one.detectable),
    ]  # fmt: skip


def _format_detectable(ratio: float) -> str:
    if math.isinf(ratio):
        return "none"
    return "over 10" if ratio > 10.0 else f"{ratio:.2f}"


def agreement_table(validation: MetricValidation, metrics: Sequence[Metric]) -> Table:
    """Return the rank correlation of map metrics with the true error."""
    columns = [Column("Metric"), Column("All perturbations", number=True)]
    columns += [Column(capitalise(name), number=True, tip=what) for name, what in validation.perturbations.items()]
    columns += [Column(capitalise(world), number=True) for world in validation.worlds]
    rows: list[list[Cell]] = []
    for metric in metrics:
        name, found = (
            Cell(capitalise(metric.label), link=f"#metric-{metric.name}"),
            validation.agreement_of(metric.name),
        )
        if found is None:
            rows.append([name, Cell("not measured", ""), *[DASH] * (len(columns) - 2)])
            continue
        overall = DASH
        if found.overall is not None:
            value = found.overall.value
            overall = Cell(format_number(value, 2), value, extent=f"95 %: {format_bounds(found.overall)}")
        each = [*found.by_perturbation.values(), *found.by_world.values()]
        rows.append(
            [name, overall, *(DASH if one is None else Cell(format_number(one.value, 2), one.value) for one in each)]
        )
    return Table(columns, rows, label="Rank correlation of map metrics with the true error")


def settings_fold(settings: Sequence[Setting], anchor: str) -> list[Block]:
    """Return the parameters of a method or a sequence, changed ones in bold; nothing without any."""
    if not settings:
        return []
    rows: list[list[Cell | str]] = [
        [
            one.name,
            Cell(str(one.value), tone="warn" if one.value != one.default else "",
                 tip=f"default: {one.default}" if one.value != one.default else ""),
            one.unit,
            one.meaning,
        ]
        for one in settings
    ]  # fmt: skip
    table = Table(("Parameter", Column("Value", number=True), "Unit", "Meaning"), rows, sortable=False)
    return [Fold(f"{len(settings)} parameter{'s' * (len(settings) != 1)}", [table], anchor)]


def runs_fold(analysis: Analysis, sequence: SequenceAnalysis, number: int, strokes: Strokes) -> Fold:
    """Return every run of a sequence with its files and the command that repeats it."""
    comparison = analysis.comparison
    places = {label: place for place, label in enumerate(comparison.methods, start=1)}
    rows, anchors = [], []
    for run in sequence.all_runs:
        anchor = runs_anchor(number, places[run.method])
        anchors.append("" if anchor in anchors else anchor)
        rows.append(_run_row(comparison, strokes, run, places[run.method]))
    which = "Perturbation" if sequence.all_runs[0].spec.sequence.perturbed else "Seed"
    columns = (
        Column("Method"), Column(which, number=True), Column("Status"), Column("Scans", number=True),
        Column("Memory", "MiB", number=True), Column("Changed"), Column("Trajectory"), Column("Map"), Column("Command"),
    )  # fmt: skip
    table = Table(columns, rows, anchors=anchors, label=f"Runs of {sequence.label}")
    count = len(rows)
    return Fold(f"{sequence.label}: {count} run{'s' * (count != 1)}", [table], f"sequence-{number}-runs")


def _run_row(comparison: Comparison, strokes: Strokes, run: RunRecord, place: int) -> list[Cell]:
    result, key = run.result, quote(run.key)
    changed = [one for one in comparison.methods[run.method].settings if one.value != one.default]
    memory = result.peak_memory_bytes / 2**20
    return [
        method_cell(comparison, strokes, run.method, f"#method-{place}"),
        Cell("–" if run.seed is None else str(run.seed)),
        Cell(STATUS_LABELS[result.status], tone="" if result.is_complete else "bad", tip=result.reason),
        Cell(f"{len(result.steps)} of {result.expected}", len(result.steps)),
        Cell(f"{memory:.0f}", memory) if memory else DASH,
        Cell(", ".join(f"{one.name} {one.value}" for one in changed)),
        Cell(run.key, link=f"trajectories/{key}.tum") if len(result.steps) else DASH,
        Cell("map", link=f"maps/{key}.yaml") if run.scores.grid is not None else DASH,
        Cell(run.command),
    ]


def _format_metres(value: float) -> str:
    return f"{1000.0 * value:.0f}\u00a0mm" if value < 1.0 else f"{value:.2f}\u00a0m"
