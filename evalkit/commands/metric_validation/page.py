"""The page of ``make metric-validation``: how metrics follow the true error, and where planted mistakes show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.commands.metric_validation.fault_injection import CAUGHT, GOOD_M, MOST
from evalkit.commands.metric_validation.measured import PILOT
from evalkit.metrics import METRICS
from evalkit.metrics.table import Metric
from evalkit.report.html import charts
from evalkit.report.html.blocks import Bullets, Cell, Column, Command, Document, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Points
from evalkit.report.html.palette import HUES

KNOWN = {metric.name: metric for metric in METRICS}
SHOWN = 5
"""Metrics told for each planted mistake."""

GOOD, BAD = 0.8, 0.3
"""Correlations above and below these are coloured: a metric to rely on, and one that says little."""


def document(content: Mapping[str, Any]) -> Document:
    """The whole page, of the JSON form."""
    facts = (
        ("Maps", str(len(content["rows"]))),
        ("Worlds", ", ".join(content["worlds"])),
        ("Mapper", f"{content['mapper']}, {content['scans']} scans"),
        ("Made", content["made"]),
    )
    lead = (
        "A map can be judged without a truth, but does the verdict follow the true error? Known trajectories are "
        "spoiled in known ways, their maps drawn again, and every metric is held against the true error."
    )
    sections = (_trust(content), _scatter(content), _planted(content), _how(content))
    return Document("Validation of the metrics", "Numbers a person trusts", lead, sections, facts)


def _trust(content: Mapping[str, Any]) -> Section:
    ways = list(content["ways"])
    columns = [
        Column("Metric"), Column("All ways", "Spearman", number=True), Column("95 %", number=True),
        *(Column(way, number=True, tip=content["ways"][way]["what"]) for way in ways),
        *(Column(world, "all ways", number=True) for world in content["worlds"]),
        Column("Pilot", number=True, tip="an earlier measurement by other code: one office, 64 trajectories"),
    ]  # fmt: skip
    rows = [_line(row, ways) for row in content["trust"]]
    told = [row for row in content["trust"] if row["overall"] is not None]
    chart = charts.bars(
        [KNOWN[row["metric"]].label for row in told], _column(told, "value"),
        Axis("Spearman correlation with the true error", low=-1.0, high=1.0),
        _column(told, "low"), _column(told, "high"),
    )  # fmt: skip
    note = (
        "1: maps are ranked exactly as their aligned trajectory error ranks them; 0: no relation; below 0: the wrong "
        "way round. Where higher is better the sign is changed; where neither is, a larger value counts as worse. The "
        "mean over worlds of the correlation within each: maps of different worlds cannot be compared. Intervals: "
        "1,000 bootstrap draws of maps within their worlds; a way alone has few maps."
    )
    figure = Figure(chart, "Spearman correlation, all ways", "Lines: 95 % intervals.")
    return Section("Do they follow the true error?", (Table(columns, rows), Text(note, "note"), figure), "trust")


def _line(row: Mapping[str, Any], ways: Sequence[str]) -> list[Cell | str]:
    overall, pilot = row["overall"], PILOT.get(row["metric"])
    extent = "-" if overall is None else f"{overall['low']:.2f} to {overall['high']:.2f}"
    return [
        Cell(KNOWN[row["metric"]].label, tip=row["metric"]),
        _correlation(overall),
        Cell(extent, sort=-2.0 if overall is None else overall["low"]),
        *(_correlation(row["by_way"][way]) for way in ways),
        *(_correlation(one) for one in row["by_world"].values()),
        Cell("-", sort=-2.0) if pilot is None else Cell(f"{pilot:.2f}", sort=pilot),
    ]


def _correlation(found: Mapping[str, float] | None) -> Cell:
    if found is None:
        return Cell("-", sort=-2.0, tip="never two different values")
    value = found["value"]
    tip = f"95 %: {found['low']:.2f} to {found['high']:.2f}, {found['support']} maps"
    return Cell(f"{value:.2f}", sort=value, tone="good" if value >= GOOD else "bad" if value < BAD else "", tip=tip)


def _column(rows: Sequence[Mapping[str, Any]], name: str) -> Any:
    return np.array([row["overall"][name] for row in rows])


def _scatter(content: Mapping[str, Any]) -> Section:
    world = content["worlds"][0]
    figures = [_cloud(content, world, KNOWN[row["metric"]]) for row in content["trust"] if row["overall"] is not None]
    told = f"Every map of the world '{world}': true error against the metric, one colour a way to go wrong."
    return Section("Map by map", (Text(told), Figures(figures, small=True)), "maps")


def _cloud(content: Mapping[str, Any], world: str, metric: Metric) -> Figure:
    layers = []
    for hue, way in zip(HUES, content["ways"], strict=False):
        points = [
            (row["error_m"], row["scores"][metric.name])
            for row in content["rows"]
            if row["world"] == world and row["way"] == way and row["scores"][metric.name] is not None
        ]
        layers.append(Points(way, np.array(points).reshape(-1, 2), hue, 5.0))
    unit = f" [{metric.unit}]" if metric.unit else ""
    drawing = charts.scatter(layers, Axis("true error (ATE) [m]", "log"), Axis(metric.label + unit), equal=False)
    return Figure(drawing, metric.label)


def _planted(content: Mapping[str, Any]) -> Section:
    rows = [
        [
            row["plant"], row["what"],
            Cell("yes" if row["caught"] else "no", tone="good" if row["caught"] else "bad"),
            str(len(row["seen"])), _sightings(row["seen"]),
        ]
        for row in content["planted"]
    ]  # fmt: skip
    told = (
        f"A good run (true poses with {100 * GOOD_M:g} cm of jitter) over '{content['plants_in']}' is scored with one "
        "mistake planted between the sequence and its scores. A mistake is caught where a metric gets at least "
        f"{CAUGHT:g} times as bad."
    )
    columns: list[Column | str] = [
        "Mistake", "What it is", "Caught", Column("Metrics", number=True), "Plainest, times as bad",
    ]  # fmt: skip
    return Section("Would a mistake of the harness show?", (Text(told), Table(columns, rows)), "planted")


def _sightings(seen: Sequence[Mapping[str, Any]]) -> str:
    return "; ".join(f"{KNOWN[each['metric']].label} {times(each['factor'])}" for each in seen[:SHOWN]) or "nothing"


def times(factor: float) -> str:
    """A factor for a table: three digits, and no more than can be told."""
    return f"over {MOST:,.0f}" if factor >= MOST else f"{factor:.0f}" if factor >= 100.0 else f"{factor:.3g}"


def _how(content: Mapping[str, Any]) -> Section:
    ways = [
        (name, way["what"], ", ".join(f"{size:g}" for size in way["sizes"]), way["unit"])
        for name, way in content["ways"].items()
    ]
    items = (
        "True poses are spoiled, maps and their halves drawn by the mapper as in any report, aligned to the truth.",
        "The true error is the root mean square of the position errors after alignment (ATE).",
        "Versions: " + ", ".join(f"{name} {version}" for name, version in content["versions"].items()) + ".",
    )
    table = Table(["Way to go wrong", "What it does", "Sizes", "Unit"], ways, sortable=False)
    return Section("How", (Bullets(items), table, Command(content["command"])), "how")
