"""Charts of error against CPU time: every point of one back end, and the Pareto fronts of all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.commands.tune.objective import ScoredCandidate, mark_pareto_front
from evalkit.commands.tune.search_loop import MethodSearch
from evalkit.core.se2 import Floats
from evalkit.design.responses import Response
from evalkit.report.formatting import label_with_unit
from evalkit.report.html import charts
from evalkit.report.html.blocks import Figure
from evalkit.report.html.charts import Axis, Points

GREY, INK, WHITE, ORANGE, GREEN = "#9aa3ad", "#1c2128", "#ffffff", "#d55e00", "#009e73"
FINE = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)
MIN_TICKS = 3
MIN_MS = 1e-3
"""The smallest time drawn, because a logarithmic axis has no zero."""


def draw_pareto_fronts(results: Sequence[MethodSearch], objective: Response) -> Figure:
    """The Pareto fronts of all back ends, with default and tuned points."""
    x, y = _make_axes([_collect_places(one.tried) for one in results], objective)
    layers: list[Points] = []
    for number, one in enumerate(results):
        colour = charts.stroke(number).colour
        best = _collect_places([each for each, on in zip(one.tried, mark_pareto_front(one.tried), strict=True) if on])
        label = one.tunable.label
        layers += [Points(label, _compute_stairs(best), colour, 1.4, joined=True), Points("", best, colour, 5.0)]
    for number, one in enumerate(results):
        colour = charts.stroke(number).colour
        marks = [(one.default, INK), *([(one.chosen, WHITE)] if one.tuned else [])]
        for each, core in marks:
            layers += [
                Points("", _collect_places([each]), colour, 11.0),
                Points("", _collect_places([each]), core, 5.0),
            ]
    caption = (
        "Each line is the Pareto front of one back end's tried points. Black core: the default; white core: tuned. "
        "Lower and further left is better."
    )
    return Figure(charts.scatter(layers, x, y, equal=False), "Accuracy against compute, all back ends", caption)


def draw_points(one: MethodSearch, objective: Response) -> Figure:
    """Every point of one back end."""
    x, y = _make_axes([_collect_places(one.tried)], objective)
    on_front = mark_pareto_front(one.tried)
    plain = [each for each in one.tried if not each.losses]
    losing = [each for each in one.tried if each.losses]
    best = _collect_places([each for each, chosen in zip(one.tried, on_front, strict=True) if chosen])
    layers = [
        Points("tried", _collect_places(plain), GREY, 6.0),
        *([Points("loses runs", _collect_places(losing), ORANGE, 6.0)] if losing else []),
        Points("Pareto front", _compute_stairs(best), "#0072b2", 1.4, joined=True),
        Points("", best, "#0072b2", 6.0),
        Points("default", _collect_places([one.default]), INK, 11.0),
        *([Points("tuned", _collect_places([one.chosen]), GREEN, 11.0)] if one.tuned else []),
    ]
    caption = f"{len(one.tried)} points, {int(on_front.sum())} on the Pareto front" + (
        "" if one.tuned else "; default kept"
    )
    return Figure(charts.scatter(layers, x, y, equal=False), one.tunable.label, f"{caption}.")


def _collect_places(tried: Sequence[ScoredCandidate]) -> Floats:
    """CPU time in ms and error (N, 2) of the points with finite values."""
    both = np.array([[max(one.cpu_ms, MIN_MS), one.error] for one in tried]).reshape(-1, 2)
    return np.asarray(both[np.isfinite(both).all(axis=1)])


def _compute_stairs(places: Floats) -> Floats:
    """The border of the dominated region: right to the next point's time, then down to its error."""
    ordered = places[np.lexsort((places[:, 1], places[:, 0]))]
    corners = np.column_stack([ordered[1:, 0], ordered[:-1, 1]]) if len(ordered) > 1 else np.zeros((0, 2))
    stairs = np.zeros((2 * len(ordered) - 1 if len(ordered) else 0, 2))
    stairs[0::2], stairs[1::2] = ordered, corners
    return stairs


def _make_axes(places: Sequence[Floats], objective: Response) -> tuple[Axis, Axis]:
    every = np.concatenate(places)
    if not len(every):
        every = np.ones((1, 2))
    return (
        _log_axis("CPU time a scan, median [ms]", every[:, 0]),
        _log_axis(label_with_unit(f"{objective.metric.label} in training", objective.metric.unit), every[:, 1]),
    )


def _log_axis(label: str, values: Floats) -> Axis:
    """A logarithmic axis with ticks at 1, 2 and 5 of every decade, or at more values if those are too few."""
    low, high = float(values.min()) / 1.25, float(values.max()) * 1.25
    ticks = charts.compute_log_ticks(low, high)
    return Axis(
        label, "log", low, high, ticks if len(ticks) >= MIN_TICKS else charts.compute_log_ticks(low, high, FINE)
    )
