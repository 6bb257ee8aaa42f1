"""The drawings of a dossier: how far answers lie apart, paths, maps and times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.commands.validate.acceptance import Level
from evalkit.commands.validate.answers import errors, told_stage
from evalkit.commands.validate.costs import milliseconds
from evalkit.commands.validate.equivalence.map_cells import Layers
from evalkit.commands.validate.paths import distances
from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.report.html import charts
from evalkit.report.html.blocks import Figure
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.report.html.palette import TRUTH, assign_strokes
from evalkit.results.run_record import RunRecord

MIN_M = 1e-17
"""Nothing nearer is drawn farther to the left: there are no numbers between 0 and this that mean a difference."""

SHARE = Axis("share of the pairs [%]", low=0.0, high=100.0)
SEEN, WALL, UNSEEN = 1.0, 0.0, 0.8


def of_pairs(level: Level, mine: str, twin: str) -> Iterator[Figure]:
    """Level 1: distance to the others' answers, and to the known motion."""
    found: Mapping[str, Any] = level.shown["found"]
    if not found:
        return
    pairs = sum(len(result["truth"]) for result in found.values())
    apart = {f"to {twin}": _far(found, {place: result["a"] for place, result in found.items()})}
    wrong = {mine: errors(found, "b")[:, 0], twin: errors(found, "a")[:, 0]}
    for name, answers in level.shown["others"].items():
        rows = {place: result["rows"] for place, result in answers.items() if ENDED not in result and place in found}
        here = {place: found[place] for place in rows}
        if here:
            apart[f"to {name}"] = _far(here, rows)
            wrong[name] = errors({place: {**here[place], "b": rows[place]} for place in here}, "b")[:, 0]
    yield Figure(
        charts.lines(_shares(apart, pairs), Axis("distance between two answers to one question [m]", "log"), SHARE),
        "How far its answers lie from the others'",
        f"Each curve: the share of pairs on which {mine} and the other lie at most so far apart. Rounding in double "
        "precision leaves about 1e-15 m; other methods answer otherwise by millimetres.",
    )
    known = sum(int(np.isfinite(result["truth"][:, 0]).sum()) for result in found.values())
    if known:
        yield Figure(
            charts.lines(_shares(wrong, known), Axis("error of an answer where the motion is known [m]", "log"), SHARE),
            "How far its answers lie from the truth",
            "Simulated pairs, half with a guess far off: farther left is better; equal implementations coincide.",
        )


def of_scans(level: Level, mine: str, twin: str, margin: str) -> Iterator[Figure]:
    """Level 2: difference over the scans of each sequence's first seed."""
    above = "above the line only a tie may lie" if margin == "float32" else "above the line is too far"
    for place, result in _first(level.shown["found"]).items():
        curves = []
        for stage in dict.fromkeys(result["stage"]):
            among = np.array([one == stage for one in result["stage"]])
            curves.append(Curve(told_stage(stage), result["scan"][among], np.maximum(result["metres"][among], MIN_M)))
        held = result[margin]["margin"]["metres"]
        drawn = charts.lines(curves, Axis("scan"), Axis(f"apart from {twin} [m]", "log"), levels={"margin": held})
        yield Figure(drawn, place, f"How far {mine}'s answer lies from {twin}'s to the same question; {above}.")


def of_paths(level: Level, mine: str, twin: str) -> Iterator[Figure]:
    """Level 3: the paths, and the distance between both over time."""
    drawn: dict[str, list[Curve]] = {}
    for place, runs in level.shown["trials"].items():
        if mine in runs and twin in runs and len(runs[mine].result.steps) and len(runs[twin].result.steps):
            seconds, apart = distances(runs[mine], runs[twin])
            sequence, _, seed = place.partition(", ")
            drawn.setdefault(sequence, []).append(Curve(seed or sequence, seconds[1:], np.maximum(apart[1:], MIN_M)))
    for place, runs in _first(level.shown["trials"]).items():
        layers = list(_walked(runs, mine, twin))
        if layers:
            yield Figure(
                charts.scatter(layers, Axis("x [m]"), Axis("y [m]")),
                f"{place}: paths",
                "Each aligned to the truth as for its error; where two coincide the later one covers the other.",
            )
    for sequence, curves in drawn.items():
        axis = Axis(f"{mine} from {twin} [m]", "log")
        yield Figure(charts.lines(curves, Axis("time [s]"), axis), f"{sequence}: distance between both paths", "")


def of_maps(level: Level, mine: str, twin: str) -> Iterator[Figure]:
    """Level 4: both maps on the same cells, and where they differ."""
    for place, runs in _first(level.shown["trials"]).items():
        grids = [runs[name].scores.grid for name in (mine, twin) if name in runs]
        if len(grids) == 2 and grids[0] is not None and grids[1] is not None:
            layers = Layers.of(grids[1], grids[0])
            yield _map(layers, layers.b, layers.observed_b, f"{place}: {mine}", grids[0])
            yield _differing(layers, f"{place}: where {twin}'s map differs", grids[0])


def of_times(level: Level) -> Iterator[Figure]:
    """Level 5: median and 95th percentile of every method."""
    for kind, labels, what in (
        ("paced", level.shown["labels"], "a whole scan"),
        ("alone", level.shown["registrations"], "one registration of two scans"),
    ):
        for place, result in level.shown[kind].items():
            if ENDED in result:
                continue
            taken = [milliseconds(result, row)[0] for row in range(len(labels))]
            values, high = (np.array([np.quantile(one, q) for one in taken]) for q in (0.5, 0.95))
            drawn = charts.bars(labels, values, Axis("time [ms]", low=0.0), low=values, high=high)
            yield Figure(drawn, f"{place}: {what}", "Bar: median; line: up to 95 %. One process, in turns.")


def _far(found: Mapping[str, Any], rows: Mapping[str, Floats]) -> Floats:
    apart = np.concatenate([se2.between(rows[place], result["b"]) for place, result in found.items()])
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))


def _shares(series: Mapping[str, Floats], asked: int) -> list[Curve]:
    """Every series as the share of all that were asked whose values are at most so large."""
    curves = []
    for label, values in series.items():
        known = np.sort(values[np.isfinite(values)])
        if len(known):
            share = 100.0 * np.arange(1, len(known) + 1) / asked
            curves.append(Curve(label, np.maximum(known, MIN_M), share))
    return curves


def _walked(runs: Mapping[str, RunRecord], mine: str, twin: str) -> Iterator[Points]:
    truth = next(iter(runs.values())).truth.trajectory
    if truth is not None:
        yield Points("truth", truth.poses[:, :2], TRUTH, 2.2, joined=True, alpha=0.35)
    drawn = assign_strokes([mine, twin, *sorted(name for name in runs if name not in (mine, twin))])
    order = [name for name in runs if name not in (mine, twin)] + [name for name in (twin, mine) if name in runs]
    for name in order:
        run = runs[name].result
        if len(run.steps):
            path = run.estimate.moved(runs[name].scores.world_from_start).poses[:, :2]
            yield Points(name, path, drawn[name].colour, 1.2, joined=True)


def _map(layers: Layers, values: Floats, seen: Any, title: str, grid: OccupancyGrid) -> Figure:
    greys = np.where(seen, np.where(values > 0.0, WALL, SEEN), UNSEEN)
    return Figure(charts.picture(greys[::-1], _extent(layers, grid)), title, "Black: more likely a wall than not.")


def _differing(layers: Layers, title: str, grid: OccupancyGrid) -> Figure:
    grey = np.where(layers.observed_a, np.where(layers.a > 0.0, 0.55, SEEN), UNSEEN)
    colours = np.stack([grey] * 3, axis=-1)
    differing = layers.differing(1e-5)
    turned = differing & ((layers.a > 0.0) != (layers.b > 0.0))
    colours[differing], colours[turned] = (0.98, 0.8, 0.5), (0.7, 0.14, 0.09)
    caption = f"Red: {int(turned.sum())} cells are a wall in one only. Yellow and red: {int(differing.sum())} differ."
    return Figure(charts.picture(colours[::-1], _extent(layers, grid)), title, caption)


def _extent(layers: Layers, grid: OccupancyGrid) -> tuple[float, float, float, float]:
    rows, columns = layers.a.shape
    left, low = (layers.low * grid.resolution_m).tolist()
    return left, left + columns * grid.resolution_m, low, low + rows * grid.resolution_m


def _first(found: Mapping[str, Any]) -> dict[str, Any]:
    """The first place of every sequence: one seed is enough to look at."""
    chosen: dict[str, Any] = {}
    for place, one in found.items():
        if place.partition(",")[0] not in {name.partition(",")[0] for name in chosen}:
            chosen[place] = one
    return chosen


def figures(level: Level, mine: str, twin: str, margin: str) -> Sequence[Figure]:
    """All drawings of a level."""
    drawn = {
        1: lambda: of_pairs(level, mine, twin),
        2: lambda: of_scans(level, mine, twin, margin),
        3: lambda: of_paths(level, mine, twin),
        4: lambda: of_maps(level, mine, twin),
        5: lambda: of_times(level),
    }
    return list(drawn[level.number]()) if level.number in drawn and level.shown else []
