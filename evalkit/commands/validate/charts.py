"""Charts of an acceptance report: distances between answers, trajectories, maps and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.commands.validate.acceptance import AcceptanceLevel
from evalkit.commands.validate.equivalence.map_cells import GridPair
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.known_motion import answer_errors
from evalkit.commands.validate.level_answers import format_stage
from evalkit.commands.validate.level_costs import REGISTRATION, milliseconds
from evalkit.commands.validate.level_maps import CELL_MARGIN
from evalkit.commands.validate.run_paths import path_distances
from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.report.html import charts
from evalkit.report.html.blocks import Figure
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.report.html.method_colours import TRUTH, assign_strokes
from evalkit.results.run_record import RunRecord

MIN_M = 1e-17
"""The left end of logarithmic distance axes: smaller distances are drawn here."""

SHARE = Axis("share of the pairs [%]", low=0.0, high=100.0)
FREE, WALL, UNOBSERVED = 1.0, 0.0, 0.8


def pair_figures(level: AcceptanceLevel, own: str, reference: str) -> Iterator[Figure]:
    """Level 1: distances to the answers of other methods and to the known motion."""
    results: Mapping[str, Any] = level.results["results"]
    if not results:
        return
    pairs = sum(len(result["truth"]) for result in results.values())
    apart = {f"to {reference}": _distances(results, {place: result["a"] for place, result in results.items()})}
    wrong = {own: answer_errors(results, "b")[:, 0], reference: answer_errors(results, "a")[:, 0]}
    for name, answers in level.results["peers"].items():
        rows = {place: result["rows"] for place, result in answers.items() if ENDED not in result and place in results}
        here = {place: results[place] for place in rows}
        if here:
            apart[f"to {name}"] = _distances(here, rows)
            wrong[name] = answer_errors({place: {**here[place], "b": rows[place]} for place in here}, "b")[:, 0]
    yield Figure(
        charts.lines(_shares(apart, pairs), Axis("distance of two answers to one question [m]", "log"), SHARE),
        "Distance of its answers to those of other methods",
        f"Each curve: the share of pairs on which the answers of {own} and of the other are at most this far apart. "
        "Rounding in double precision causes about 1e-15 m; answers of other methods differ by millimetres.",
    )
    known = sum(int(np.isfinite(result["truth"][:, 0]).sum()) for result in results.values())
    if known:
        yield Figure(
            charts.lines(_shares(wrong, known), Axis("error of an answer to a known motion [m]", "log"), SHARE),
            "Distance of its answers to the truth",
            "Simulated pairs, half of them with a disturbed guess; equal implementations coincide.",
        )


def scan_figures(level: AcceptanceLevel, own: str, reference: str, margin: str) -> Iterator[Figure]:
    """Level 2: differences over the scans of the first seed of each sequence."""
    note = "only ties may lie above the line" if margin == FLOAT32 else "points above the line fail"
    for place, result in _first(level.results["results"]).items():
        curves = []
        for stage in dict.fromkeys(result["stage"]):
            among = np.array([one == stage for one in result["stage"]])
            curves.append(Curve(format_stage(stage), result["scan"][among], np.maximum(result["metres"][among], MIN_M)))
        limit = result[margin]["margin"]["metres"]
        body = charts.lines(curves, Axis("scan"), Axis(f"distance to {reference} [m]", "log"), levels={"margin": limit})
        yield Figure(body, place, f"Distance of the answers of {own} and {reference} to the same question; {note}.")


def path_figures(level: AcceptanceLevel, own: str, reference: str) -> Iterator[Figure]:
    """Level 3: the trajectories, and the distance between them over time."""
    paths: dict[str, list[Curve]] = {}
    for place, runs in level.results["records"].items():
        if own in runs and reference in runs and len(runs[own].result.steps) and len(runs[reference].result.steps):
            seconds, apart = path_distances(runs[own], runs[reference])
            sequence, _, seed = place.partition(", ")
            paths.setdefault(sequence, []).append(Curve(seed or sequence, seconds[1:], np.maximum(apart[1:], MIN_M)))
    for place, runs in _first(level.results["records"]).items():
        layers = list(_paths(runs, own, reference))
        if layers:
            yield Figure(
                charts.scatter(layers, Axis("x [m]"), Axis("y [m]")),
                f"{place}: paths",
                "Each is aligned to the truth as for its error; where two coincide, the later one covers the other.",
            )
    for sequence, curves in paths.items():
        axis = Axis(f"{own} from {reference} [m]", "log")
        yield Figure(charts.lines(curves, Axis("time [s]"), axis), f"{sequence}: distance between both paths", "")


def map_figures(level: AcceptanceLevel, own: str, reference: str) -> Iterator[Figure]:
    """Level 4: both maps on the same cells, and their differences."""
    for place, runs in _first(level.results["records"]).items():
        grids = [runs[name].scores.grid for name in (own, reference) if name in runs]
        if len(grids) == 2 and grids[0] is not None and grids[1] is not None:
            layers = GridPair.of(grids[1], grids[0])
            yield _map_figure(layers, layers.b, layers.observed_b, f"{place}: {own}", grids[0])
            yield _map_figure(layers, layers.a, layers.observed_a, f"{place}: {reference}", grids[0])
            yield _difference_figure(layers, f"{place}: differences to the map of {reference}", grids[0])


def time_figures(level: AcceptanceLevel) -> Iterator[Figure]:
    """Level 5: median and 95th percentile of every method."""
    for kind, labels, what in (
        ("scan_times", level.results["labels"], "a whole scan"),
        ("pair_times", level.results["registrations"], REGISTRATION),
    ):
        for place, result in level.results[kind].items():
            if ENDED in result:
                continue
            times = [milliseconds(result, row)[0] for row in range(len(labels))]
            values, high = (np.array([np.quantile(one, q) for one in times]) for q in (0.5, 0.95))
            body = charts.bars(labels, values, Axis("time [ms]", low=0.0), low=values, high=high)
            yield Figure(body, f"{place}: {what}", "Bar: median; line: up to 95 %. Measured in one process, in turns.")


def _distances(results: Mapping[str, Any], rows: Mapping[str, Floats]) -> Floats:
    apart = np.concatenate([se2.between(rows[place], result["b"]) for place, result in results.items()])
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))


def _shares(series: Mapping[str, Floats], total: int) -> list[Curve]:
    """The cumulative distribution of each series as a share of ``total`` questions."""
    curves = []
    for label, values in series.items():
        known = np.sort(values[np.isfinite(values)])
        if len(known):
            share = 100.0 * np.arange(1, len(known) + 1) / total
            curves.append(Curve(label, np.maximum(known, MIN_M), share))
    return curves


def _paths(runs: Mapping[str, RunRecord], own: str, reference: str) -> Iterator[Points]:
    truth = next(iter(runs.values())).truth.trajectory
    if truth is not None:
        yield Points("truth", truth.poses[:, :2], TRUTH, 2.2, joined=True, alpha=0.35)
    strokes = assign_strokes([own, reference, *sorted(name for name in runs if name not in (own, reference))])
    order = [name for name in runs if name not in (own, reference)] + [
        name for name in (reference, own) if name in runs
    ]
    for name in order:
        run = runs[name].result
        if len(run.steps):
            path = run.estimate.moved(runs[name].scores.world_from_start).poses[:, :2]
            yield Points(name, path, strokes[name].colour, 1.2, joined=True)


def _map_figure(layers: GridPair, values: Floats, seen: Any, title: str, grid: OccupancyGrid) -> Figure:
    greys = np.where(seen, np.where(values > 0.0, WALL, FREE), UNOBSERVED)
    return Figure(charts.picture(greys[::-1], _extent(layers, grid)), title, "Black: more likely occupied than free.")


def _difference_figure(layers: GridPair, title: str, grid: OccupancyGrid) -> Figure:
    grey = np.where(layers.observed_a, np.where(layers.a > 0.0, 0.55, FREE), UNOBSERVED)
    colours = np.stack([grey] * 3, axis=-1)
    differing = layers.differing(CELL_MARGIN)
    turned = differing & ((layers.a > 0.0) != (layers.b > 0.0))
    colours[differing], colours[turned] = (0.98, 0.8, 0.5), (0.7, 0.14, 0.09)
    caption = (
        f"Red: {int(turned.sum())} cells are a wall in one map only. Yellow and red: {int(differing.sum())} differ."
    )
    return Figure(charts.picture(colours[::-1], _extent(layers, grid)), title, caption)


def _extent(layers: GridPair, grid: OccupancyGrid) -> tuple[float, float, float, float]:
    rows, columns = layers.a.shape
    left, low = (layers.low * grid.resolution_m).tolist()
    return left, left + columns * grid.resolution_m, low, low + rows * grid.resolution_m


def _first(results: Mapping[str, Any]) -> dict[str, Any]:
    """The first seed of every sequence."""
    chosen: dict[str, Any] = {}
    for place, one in results.items():
        if place.partition(",")[0] not in {name.partition(",")[0] for name in chosen}:
            chosen[place] = one
    return chosen


def figures(level: AcceptanceLevel, own: str, reference: str, margin: str) -> Sequence[Figure]:
    """All charts of a level."""
    makers = {
        1: lambda: pair_figures(level, own, reference),
        2: lambda: scan_figures(level, own, reference, margin),
        3: lambda: path_figures(level, own, reference),
        4: lambda: map_figures(level, own, reference),
        5: lambda: time_figures(level),
    }
    return list(makers[level.number]()) if level.number in makers and level.results else []
