"""Error against CPU time, with the front of the methods that no other beats in both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from evalkit.metrics.runtime import period_ns
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.contests import find_mean_cpu_ms
from evalkit.report.formatting import format_milliseconds
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.svg import AxisScale, element, join, log_scale, place_labels

SCATTER = (360.0, 296.0)
PLOT = (34.0, 8.0, 350.0, 252.0)
"""Size of the scatter plot, and left, top, right and bottom of its frame."""

LETTER, TICK_LETTER, LETTER_HEIGHT = 6.2, 5.6, 9.0
"""Mean width of a letter of a name and of a tick, and the height of both."""


@dataclass(frozen=True, slots=True)
class _Point:
    """A method by its error and CPU time, divided by those of the method that all are compared with."""

    method: str
    error: float
    cpu: float
    shared: str


def draw_scatter(analysis: Analysis, strokes: Strokes) -> Markup | None:
    """Return error against CPU time, with the Pareto front and the sensor's period; None with fewer than two points.

    Both are divided by those of one method, each over the data sets on which both have a value.
    """
    points, common = _find_points(analysis), analysis.answer.common
    if len(points) < 2:
        return None
    period, every = _find_period_ms(analysis), find_mean_cpu_ms(analysis.answer.contests, common)
    limit = period / every if period is not None and every is not None else math.inf
    costs = [one.cpu for one in points]
    near = limit < 300.0 * max(costs)
    x = log_scale([*costs, *([limit] if near else [])], 0.12)
    y = log_scale([1.0, *(one.error for one in points)], 0.1)
    left, top, right, bottom = PLOT
    place = {
        one.method: (
            left + (right - left) * x.share(one.cpu), top + (bottom - top) * y.share(one.error)
        )
        for one in points
    }  # fmt: skip
    parts = [element("rect", x=left, y=top, width=right - left, height=bottom - top, class_="frame"), *_grid(x, y)]
    front = _find_front(points)
    steps = " ".join(f"{place[one.method][0]:.1f},{place[one.method][1]:.1f}" for one in front)
    parts.append(element("polyline", points=steps, class_="front"))
    free = []
    if period is not None and near:
        at = left + (right - left) * x.share(limit)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="limit"))
        words = f"a scan every {format_milliseconds(period)}"
        parts.append(element("text", words, x=at - 4, y=bottom - 6, text_anchor="end", class_="tick"))
        free.append((at - 4 - TICK_LETTER * len(words), bottom - 6 - LETTER_HEIGHT, at, bottom))
    names = {one.method: f"{one.method} ({one.shared})" if one.shared else one.method for one in points}
    wanted = [(*place[one.method], names[one.method]) for one in points]
    labels = place_labels(wanted, (right, bottom), LETTER, LETTER_HEIGHT, free)
    for one in reversed(points):  # the best on top
        kind = f"series{' led' if one.method in analysis.answer.ahead else ''}"
        own = _draw_point(one, place[one.method], names[one.method], labels.get(names[one.method]), common)
        parts.append(element("g", own, class_=kind, data_of=one.method, style=f"--own:{strokes[one.method].css}"))
    parts.append(
        element("text", f"CPU time, times that of {common}", x=(left + right) / 2, y=SCATTER[1] - 8,
                text_anchor="middle", class_="tick")
    )  # fmt: skip
    best = ", ".join(one.method for one in front)
    finding = f"Error against CPU time: no method is both cheaper and more accurate than {best}"
    size = f"0 0 {SCATTER[0]:.0f} {SCATTER[1]:.0f}"
    return element("svg", join(parts), class_="scatter", viewBox=size, role="img", aria_label=finding)


def _draw_point(
    one: _Point, at: tuple[float, float], name: str, label: tuple[float, float, str] | None, common: str
) -> Markup:
    """Return a point with its tip and its name; without a place for the name (``label``), it appears on demand."""
    x, y, anchor = label or (at[0], at[1] - 9.0, "middle")
    where = f", on {one.shared} data sets" if one.shared else ""
    tip = f"{one.method}: {one.error:.2f} times the error and {one.cpu:.2g} times the CPU time of {common}{where}"
    kinds = " ".join(filter(None, ("name", "part" if one.shared else "", "" if label else "hinted")))
    return join(
        (
            element("title", tip),
            element("circle", cx=at[0], cy=at[1], r=5.0, class_="dot tied"),
            element("text", name, x=x, y=y, text_anchor=anchor, class_=kinds),
        )
    )


def _grid(x: AxisScale, y: AxisScale) -> list[Markup]:
    left, top, right, bottom = PLOT
    parts = []
    for tick in x.ticks(4):
        at = left + (right - left) * x.share(tick)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="grid"))
        parts.append(element("text", f"{tick:g}×", x=at, y=bottom + 15, text_anchor="middle", class_="tick"))
    for tick in y.ticks(4):
        at = top + (bottom - top) * y.share(tick)
        parts.append(element("line", x1=left, x2=right, y1=at, y2=at, class_="grid"))
        parts.append(element("text", f"{tick:g}×", x=left - 5, y=at + 4, text_anchor="end", class_="tick"))
    return parts


def _find_points(analysis: Analysis) -> list[_Point]:
    """Return the methods with an error and a time, best first; ``shared``: "2 of 3" where not all data sets count."""
    every, points = len(analysis.answer.contests), []
    for one in analysis.answer.standings:
        relative = one.relative
        if relative.error is not None and relative.cpu is not None:
            shared = "" if relative.shared == every else f"{relative.shared} of {every}"
            points.append(_Point(one.method, relative.error, relative.cpu, shared))
    return points


def _find_front(points: Sequence[_Point]) -> list[_Point]:
    """Return the points that no other beats in both, by rising cost."""
    front: list[_Point] = []
    for one in sorted(points, key=lambda one: (one.cpu, one.error)):
        if not front or one.error < front[-1].error:
            front.append(one)
    return front


def _find_period_ms(analysis: Analysis) -> float | None:
    """Return the shortest period of the sensors of the data sets that count."""
    counted = {one.sequence for one in analysis.answer.contests}
    periods = [
        period_ns(run.result) * 1e-6
        for run in analysis.comparison.records
        if run.sequence in counted and len(run.result.steps) > 1
    ]
    return float(np.min(periods)) if periods else None
