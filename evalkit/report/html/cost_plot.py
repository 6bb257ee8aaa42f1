"""Error against CPU time, with the front of the methods that no other beats in both."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from evalkit.metrics.runtime import period_ns
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.standings import Standing
from evalkit.report.formatting import format_milliseconds
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.svg import AxisScale, element, join, log_scale, place_labels

SCATTER = (360.0, 296.0)
PLOT = (34.0, 8.0, 350.0, 252.0)
"""Size of the scatter plot, and left, top, right and bottom of its frame."""


def draw_scatter(analysis: Analysis, strokes: Strokes) -> Markup | None:
    """Return error against CPU time, with the Pareto front and the sensor's period; None with fewer than two points."""
    points = [one for one in analysis.answer.standings if one.ratio is not None and one.cpu_ms is not None]
    if len(points) < 2:
        return None
    period = _find_period_ms(analysis)
    costs = [one.cpu_ms or 0.0 for one in points]
    near = period is not None and period < 300.0 * max(costs)
    x = log_scale([*costs, *([period] if period is not None and near else [])], 0.12)
    y = log_scale([1.0, *(one.ratio or 1.0 for one in points)], 0.1)
    left, top, right, bottom = PLOT
    place = {
        one.method: (
            left + (right - left) * x.share(one.cpu_ms or 0.0), top + (bottom - top) * y.share(one.ratio or 1.0)
        )
        for one in points
    }  # fmt: skip
    parts = [element("rect", x=left, y=top, width=right - left, height=bottom - top, class_="frame"), *_grid(x, y)]
    front = _find_front(points)
    steps = " ".join(f"{place[one.method][0]:.1f},{place[one.method][1]:.1f}" for one in front)
    parts.append(element("polyline", points=steps, class_="front"))
    if period is not None and near:
        at = left + (right - left) * x.share(period)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="limit"))
        words = f"a scan every {format_milliseconds(period)}"
        parts.append(element("text", words, x=at - 4, y=bottom - 6, text_anchor="end", class_="tick"))
    labels = place_labels([(*place[one.method], one.method) for one in points], (right, bottom), 6.2, 9.0)
    for one in reversed(points):  # the best on top
        px, py = place[one.method]
        kind = f"series{' led' if one.method in analysis.answer.winners else ''}"
        label = labels.get(one.method, (px, py - 9.0, "middle"))
        hidden = "" if one.method in labels else "hinted"
        tip = f"{one.method}: {one.ratio:.1f} times the best error, {format_milliseconds(one.cpu_ms or 0.0)} a scan"
        own = (
            element("title", tip),
            element("circle", cx=px, cy=py, r=5.0, class_="dot tied"),
            element("text", one.method, x=label[0], y=label[1], text_anchor=label[2], class_=f"name {hidden}".strip()),
        )
        parts.append(element("g", join(own), class_=kind, data_of=one.method, style=f"--own:{strokes[one.method].css}"))
    parts.append(
        element("text", "CPU a scan (median)", x=(left + right) / 2, y=SCATTER[1] - 8, text_anchor="middle",
                class_="tick")
    )  # fmt: skip
    names = ", ".join(one.method for one in front)
    finding = f"Error against CPU time: no method is both cheaper and more accurate than {names}"
    size = f"0 0 {SCATTER[0]:.0f} {SCATTER[1]:.0f}"
    return element("svg", join(parts), class_="scatter", viewBox=size, role="img", aria_label=finding)


def _grid(x: AxisScale, y: AxisScale) -> list[Markup]:
    left, top, right, bottom = PLOT
    parts = []
    for tick in x.ticks(4):
        at = left + (right - left) * x.share(tick)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="grid"))
        parts.append(element("text", f"{tick:g} ms", x=at, y=bottom + 15, text_anchor="middle", class_="tick"))
    for tick in y.ticks(4):
        at = top + (bottom - top) * y.share(tick)
        parts.append(element("line", x1=left, x2=right, y1=at, y2=at, class_="grid"))
        parts.append(element("text", f"{tick:g}×", x=left - 5, y=at + 4, text_anchor="end", class_="tick"))
    return parts


def _find_front(points: Sequence[Standing]) -> list[Standing]:
    """Return the points that no other beats in both, by rising cost."""
    front: list[Standing] = []
    for one in sorted(points, key=lambda one: (one.cpu_ms or 0.0, one.ratio or 0.0)):
        if not front or (one.ratio or 0.0) < (front[-1].ratio or 0.0):
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
