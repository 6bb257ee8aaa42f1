"""Charts of the runs over one sequence: error, residuals, paths, CPU times. Each alternative text is a finding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median
from typing import TypeVar

import numpy as np
from markupsafe import Markup

from evalkit.core.se2 import Floats
from evalkit.metrics.runtime import period_ns
from evalkit.report.formatting import format_length, format_milliseconds, format_tick
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.run_lines import POINTS, STRETCHES, bin_series, find_frame, seconds_of, thin_points, world_path
from evalkit.report.html.svg import AxisScale, element, join, log_scale, polyline
from evalkit.results.run_record import RunRecord

ChartLines = Mapping[str, tuple[Floats, Floats]]
Drawn = TypeVar("Drawn")

WIDE = 1000.0
HIGH = 300.0
MAX_RATIO = 20.0
"""Above this ratio of the largest to the smallest median, errors have a logarithmic axis."""


def error_chart(records: Sequence[RunRecord], strokes: Strokes, leader: str) -> Markup | None:
    """Return the distance to the ground truth over time, the maximum of each stretch; None without a true trajectory.

    ``leader``: the method that has its colour from the start; others are grey until pointed at.
    """
    lines = {
        one.method: bin_series(seconds_of(one), one.scores.errors_m, np.max, POINTS // 2)
        for one in records
        if one.scores.errors_m is not None and np.isfinite(one.scores.errors_m).any()
    }
    if not lines:
        return None
    middles = {label: float(np.median(values)) for label, (_, values) in lines.items()}
    best, worst = min(middles, key=middles.__getitem__), max(middles, key=middles.__getitem__)
    finding = f"{best} has the smallest error over time, {format_length(middles[best])} in the median"
    if worst != best:
        finding += f"; {worst} the largest, {format_length(middles[worst])}"
    note = "Distance to the ground truth; each point is the maximum of a stretch. Point at a name to see its line."
    return _time_chart("Error over time", note, finding, lines, strokes, leader, middles)


def residual_charts(records: Sequence[RunRecord], strokes: Strokes, leader: str) -> list[Markup]:
    """Return the reported residuals over time, scan to scan and scan to map, where methods report them."""
    drawn = []
    for stage, title in (("s2s_error", "Residual, scan to scan"), ("s2m_error", "Residual, scan to map")):
        lines = {
            one.method: bin_series(seconds_of(one), values, np.median, STRETCHES)
            for one in records
            if np.isfinite(values := np.asarray(one.result.steps[stage], dtype=np.float64)).any()
        }
        if lines:
            middles = {label: float(np.median(values)) for label, (_, values) in lines.items()}
            least = min(middles, key=middles.__getitem__)
            finding = f"{least} reports the smallest, {format_length(middles[least])} in the median"
            note = "As reported by each method, by its own definition; each point is the median of a stretch."
            drawn.append(_time_chart(title, note, finding, lines, strokes, leader))
    return drawn


def path_chart(records: Sequence[RunRecord], strokes: Strokes, leader: str) -> Markup | None:
    """Return the paths from above, aligned to the ground truth (black) if there is one; None without answers."""
    paths = {one.method: world_path(one) for one in records if len(one.result.steps)}
    if not paths:
        return None
    true = next((one.truth.trajectory.poses[:, :2] for one in records if one.truth.trajectory is not None), None)
    low, high = find_frame([true] if true is not None else list(paths.values()))
    outside = [label for label, path in paths.items() if ((path < low) | (path > high)).any()]
    side = (high - low).tolist()
    scale = WIDE / side[0]

    def place(points: Floats) -> Floats:
        return np.asarray((thin_points(points) - [low[0], high[1]]) * [scale, -scale], dtype=np.float64)

    body = [_line(label, place(path), strokes, leader) for label, path in _leader_last(paths, leader)]
    if true is not None:
        body.append(polyline(place(true), class_="truth"))
    finding = f"{', '.join(outside)} {'leave' if len(outside) > 1 else 'leaves'} the frame" if outside else (
        "all paths stay within the frame"
    )  # fmt: skip
    note = f"View from above{', aligned to the ground truth (thick)' if true is not None else ''}. "
    note += f"{finding[0].upper()}{finding[1:]}." if outside else ""
    size = f"0 0 {WIDE:.0f} {WIDE * side[1] / side[0]:.0f}"
    drawing = element("svg", join(body), class_="plan", viewBox=size, role="img", aria_label=f"Paths: {finding}")
    return _figure("Paths", note, drawing)


def cost_chart(records: Sequence[RunRecord], strokes: Strokes, leader: str) -> Markup | None:
    """Return the CPU time per scan of each method, cheapest first, beside the scan period; None without times."""
    rows, periods = {}, []
    for one in records:
        if len(one.result.steps) > 1 and one.result.steps["cpu_ns"].any():
            milliseconds = np.maximum(one.result.steps["cpu_ns"], 1) * 1e-6
            rows[one.method] = [*np.percentile(milliseconds, [5, 25, 50, 75, 95]).tolist(), float(milliseconds.max())]
            periods.append(period_ns(one.result) * 1e-6)
    if not rows:
        return None
    period = median(periods)
    scale = log_scale([*(value for row in rows.values() for value in (row[0], row[-1])), period], 0.03)
    ordered = sorted(rows, key=lambda label: rows[label][2])
    body = [_cost_row(label, rows[label], scale, period, strokes, leader) for label in ordered]
    ticks = [
        element("span", format_milliseconds(tick), class_="tick", style=f"left:{100 * scale.share(tick):.1f}%")
        for tick in scale.ticks(5)
    ]
    body.append(element("div", element("span", join(ticks), class_="ticks"), class_="range"))
    slow = [label for label in ordered if rows[label][4] > period]
    finding = f"{ordered[0]} is the cheapest, {format_milliseconds(rows[ordered[0]][2])} in the median; "
    finding += f"slower than the sensor in 5 % of the scans: {', '.join(slow)}" if slow else (
        "every method is faster than the sensor in 95 % of the scans"
    )  # fmt: skip
    note = f"Box: 25 to 75 %. Line: 5 to 95 %. Dot: maximum. Dashed: the scan period, {format_milliseconds(period)}."
    chart = element("div", join(body), class_="ranges", role="img", aria_label=f"CPU time per scan: {finding}")
    return _figure("CPU time per scan", note, chart)


def _cost_row(
    label: str, row: Sequence[float], scale: AxisScale, period: float, strokes: Strokes, leader: str
) -> Markup:  # fmt: skip
    low, q1, middle, _, high, most = (f"{100 * scale.share(value):.1f}%" for value in row)
    wide = f"{100 * (scale.share(row[3]) - scale.share(row[1])):.1f}%"
    limit = f"{100 * scale.share(period):.1f}%"
    drawing = element(
        "svg",
        join((
            element("line", x1=limit, x2=limit, y1=0, y2=22, class_="limit"),
            element("line", x1=low, x2=high, y1=11, y2=11),
            element("rect", x=q1, width=wide, y=6, height=10, class_="box"),
            element("line", x1=middle, x2=middle, y1=4, y2=18, stroke_width=2.4),
            element("circle", cx=most, cy=11, r=2.4, class_="dot"),
        )),
        width="100%", height=22,
    )  # fmt: skip
    kind = f"range series{' led' if label == leader else ''}"
    name = element("span", label, class_="who")
    return element("div", join((name, drawing)), class_=kind, data_of=label, style=f"--own:{strokes[label].css}")


def _time_chart(
    title: str, note: str, finding: str, lines: ChartLines, strokes: Strokes, leader: str,
    keys: Mapping[str, float] | None = None,
) -> Markup:  # fmt: skip
    """Return lines over time; ``keys``: the value beside each name, in the list of names below the chart."""
    usual = [float(np.median(values)) for _, values in lines.values()]
    wide = max(usual) > MAX_RATIO * max(min(usual), 1e-3)
    end = max(*(float(seconds[-1]) for seconds, _ in lines.values()), 1e-3)
    top = max(float(np.max(values)) for _, values in lines.values())
    y = AxisScale(max(min(usual) / 10.0, 1e-4), 1.1 * top) if wide else AxisScale(0.0, max(1.1 * top, 1e-4), log=False)
    x = AxisScale(0.0, end, log=False)

    def place(seconds: Floats, values: Floats) -> Floats:
        heights = np.array([y.share(value) for value in values.tolist()])
        return np.stack([WIDE * seconds / end, HIGH * (1.0 - heights)], axis=-1)

    rows = [
        element("line", x1=0, x2=WIDE, y1=HIGH * (1 - y.share(tick)), y2=HIGH * (1 - y.share(tick)), class_="grid")
        for tick in y.ticks(5)
    ]
    rows += [_line(label, place(*line), strokes, leader) for label, line in _leader_last(lines, leader)]
    size = f"0 0 {WIDE:.0f} {HIGH:.0f}"
    drawing = element(
        "svg", join(rows), viewBox=size, preserveAspectRatio="none", role="img", aria_label=f"{title}: {finding}"
    )
    at_left = [
        element("span", format_tick(tick), class_="tick", style=f"bottom:{100 * y.share(tick):.1f}%")
        for tick in y.ticks(5)
    ]
    below = [
        element("span", f"{tick:g} s", class_="tick", style=f"left:{100 * x.share(tick):.1f}%") for tick in x.ticks(6)
    ]
    axes = join((
        element("div", join(at_left), class_="left"), drawing, element("div", join(below), class_="below"),
    ))  # fmt: skip
    note = f"{note} Logarithmic axis." if wide else note
    return _figure(title, note, element("div", axes, class_="plot"), _keys(keys or {}, strokes, leader))


def _keys(values: Mapping[str, float], strokes: Strokes, leader: str) -> Markup:
    """Return the names with their values, smallest first; each colours its line while pointed at."""
    items = [
        element(
            "button", join((element("b", label), Markup(" "), element("span", format_length(value)))), type="button",
            class_=f"series{' led' if label == leader else ''}", data_of=label, style=f"--own:{strokes[label].css}",
        )
        for label, value in sorted(values.items(), key=lambda item: item[1])
    ]  # fmt: skip
    return element("div", join(items), class_="keys") if items else Markup("")


def _line(label: str, points: Floats, strokes: Strokes, leader: str) -> Markup:
    kind = f"series{' led' if label == leader else ''}"
    title = element("title", label)
    return element(
        "g", join((title, polyline(points))), class_=kind, data_of=label, style=f"--own:{strokes[label].css}"
    )  # fmt: skip


def _leader_last(lines: Mapping[str, Drawn], leader: str) -> list[tuple[str, Drawn]]:
    return sorted(lines.items(), key=lambda item: item[0] == leader)


def _figure(title: str, note: str, *body: Markup) -> Markup:
    caption = element("figcaption", join((element("strong", title), Markup(" "), element("span", note))))
    return element("figure", join((caption, *body)), class_="card chart")
