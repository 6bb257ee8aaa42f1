"""The page of a validation of the metrics: rank agreement with the true error, and detection of injected faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.commands.metric_validation.fault_injection import JITTER_M, MAX_FACTOR, MIN_FACTOR
from evalkit.commands.metric_validation.rank_agreement import MapScores
from evalkit.commands.metric_validation.validation import PILOT
from evalkit.metrics import METRICS
from evalkit.metrics.metric import Metric
from evalkit.report.formatting import label_with_unit
from evalkit.report.html import charts
from evalkit.report.html.blocks import Bullets, Cell, Column, Command, Document, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Points
from evalkit.report.html.method_colours import HUES

BY_NAME = {metric.name: metric for metric in METRICS}

GOOD, BAD = 0.8, 0.3
"""Correlations from GOOD on, and below BAD, are coloured."""


def build_document(content: Mapping[str, Any], maps: Sequence[MapScores]) -> Document:
    """Return the page of a summary and of the scores of all maps."""
    facts = (
        ("Maps", str(content["map_count"])),
        ("Worlds", ", ".join(content["worlds"])),
        ("Mapper", f"{content['mapper']}, {content['scans']} scans"),
        ("Created", content["created"]),
    )
    lead = (
        "Some metrics judge a map without ground truth. This page shows how well they follow the true error: known "
        "trajectories are perturbed in known ways, their maps are rebuilt, and each metric is correlated with the true "
        "error."
    )
    sections = (
        _build_agreement(content),
        _build_scatter(content, maps),
        _build_faults(content),
        _build_method(content),
    )
    return Document("Validation of the metrics", "Rank agreement and fault detection", lead, sections, facts)


def _build_agreement(content: Mapping[str, Any]) -> Section:
    perturbations = list(content["perturbations"])
    columns = [
        Column("Metric"), Column("All perturbations", "Spearman", number=True), Column("95 %", number=True),
        *(Column(name, number=True, tip=content["perturbations"][name]["what"]) for name in perturbations),
        *(Column(world, "all perturbations", number=True) for world in content["worlds"]),
        Column("Pilot", number=True, tip="an earlier measurement with other code: one office, 64 trajectories"),
    ]  # fmt: skip
    rows = [_make_agreement_row(row, perturbations) for row in content["agreement"]]
    known = [row for row in content["agreement"] if row["overall"] is not None]
    chart = charts.bars(
        [BY_NAME[row["metric"]].label for row in known], _collect_overall(known, "value"),
        Axis("Spearman correlation with the true error", low=-1.0, high=1.0),
        _collect_overall(known, "low"), _collect_overall(known, "high"),
    )  # fmt: skip
    note = (
        "1: the metric orders maps exactly as their aligned trajectory error; 0: no relation; below 0: reverse order. "
        "If higher is better, the sign is changed; if neither direction is better, a larger value counts as worse. The "
        "correlation is computed within each world and averaged, because maps of different worlds are not comparable. "
        "Intervals: 1,000 bootstrap draws of maps within their worlds; a single perturbation has few maps."
    )
    figure = Figure(chart, "Spearman correlation, all perturbations", "Lines: 95 % intervals.")
    return Section(
        "Rank agreement with the true error", (Table(columns, rows), Text(note, "note"), figure), "agreement"
    )


def _make_agreement_row(row: Mapping[str, Any], perturbations: Sequence[str]) -> list[Cell | str]:
    overall, pilot = row["overall"], PILOT.get(row["metric"])
    bounds = "-" if overall is None else f"{overall['low']:.2f} to {overall['high']:.2f}"
    return [
        Cell(BY_NAME[row["metric"]].label, tip=row["metric"]),
        _make_correlation_cell(overall),
        Cell(bounds, sort=-2.0 if overall is None else overall["low"]),
        *(_make_correlation_cell(row["by_perturbation"][name]) for name in perturbations),
        *(_make_correlation_cell(one) for one in row["by_world"].values()),
        Cell("-", sort=-2.0) if pilot is None else Cell(f"{pilot:.2f}", sort=pilot),
    ]


def _make_correlation_cell(interval: Mapping[str, float] | None) -> Cell:
    if interval is None:
        return Cell("-", sort=-2.0, tip="undefined: constant values")
    value = interval["value"]
    tip = f"95 %: {interval['low']:.2f} to {interval['high']:.2f}, {interval['support']} maps"
    return Cell(f"{value:.2f}", sort=value, tone="good" if value >= GOOD else "bad" if value < BAD else "", tip=tip)


def _collect_overall(rows: Sequence[Mapping[str, Any]], name: str) -> Any:
    return np.array([row["overall"][name] for row in rows])


def _build_scatter(content: Mapping[str, Any], maps: Sequence[MapScores]) -> Section:
    world = content["worlds"][0]
    own = [row for row in maps if row.world == world]
    known = [BY_NAME[row["metric"]] for row in content["agreement"] if row["overall"] is not None]
    figures = [_draw_scatter(own, list(content["perturbations"]), metric) for metric in known]
    text = f"Every map of the world '{world}': true error against the metric, one colour per perturbation."
    return Section("Map by map", (Text(text), Figures(figures, small=True)), "maps")


def _draw_scatter(maps: Sequence[MapScores], perturbations: Sequence[str], metric: Metric) -> Figure:
    layers = []
    for hue, name in zip(HUES, perturbations, strict=False):
        points = [
            (row.error_m, row.scores[metric.name])
            for row in maps
            if row.perturbation == name and row.scores[metric.name] is not None
        ]
        layers.append(Points(name, np.array(points).reshape(-1, 2), hue, 5.0))
    drawing = charts.scatter(
        layers, Axis("true error (ATE) [m]", "log"), Axis(label_with_unit(metric.label, metric.unit)), equal=False
    )
    return Figure(drawing, metric.label)


def _build_faults(content: Mapping[str, Any]) -> Section:
    rows = [
        [
            row["fault"], row["what"],
            Cell("yes" if row["metric_count"] else "no", tone="good" if row["metric_count"] else "bad"),
            str(row["metric_count"]), format_detections(row["strongest"]),
        ]
        for row in content["faults"]
    ]  # fmt: skip
    text = (
        f"A good run (true poses with {100 * JITTER_M:g} cm of jitter) over '{content['fault_world']}' is scored with "
        "one fault injected between the sequence and its scores. A fault is detected if a metric gets at least "
        f"{MIN_FACTOR:g} times worse."
    )
    columns: list[Column | str] = [
        "Fault", "What it is", "Detected", Column("Metrics", number=True), "Largest factors",
    ]  # fmt: skip
    return Section("Detection of injected faults", (Text(text), Table(columns, rows)), "faults")


def format_detections(strongest: Sequence[Mapping[str, Any]]) -> str:
    """Return the metrics that detect a fault, with their factors."""
    return "; ".join(f"{BY_NAME[one['metric']].label} {format_factor(one['factor'])}" for one in strongest) or "nothing"


def format_factor(factor: float) -> str:
    """Return a factor with three digits, limited to the largest factor."""
    if factor >= MAX_FACTOR:
        return f"over {MAX_FACTOR:,.0f}"
    return f"{factor:.0f}" if factor >= 100.0 else f"{factor:.3g}"


def _build_method(content: Mapping[str, Any]) -> Section:
    perturbations = [
        (name, one["what"], ", ".join(f"{size:g}" for size in one["sizes"]), one["unit"])
        for name, one in content["perturbations"].items()
    ]
    items = (
        "True poses are perturbed; maps and maps of both halves are built by the mapper as in any report, aligned to "
        "the ground truth.",
        "The true error is the root mean square of the position errors after alignment (ATE).",
        "Versions: " + ", ".join(f"{name} {version}" for name, version in content["versions"].items()) + ".",
    )
    table = Table(["Perturbation", "What it does", "Sizes", "Unit"], perturbations, sortable=False)
    return Section("Method", (Bullets(items), table, Command(content["command"])), "method")
