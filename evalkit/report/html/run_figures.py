"""Figures of runs: trajectories, errors, run times and residuals, as SVG for the page and as PDF for papers."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.metrics.runtime import period_ns
from evalkit.report.html.chart_style import LIMIT, Draw, format_log_axis, line_style, render_figure
from evalkit.report.html.palette import TRUTH, Stroke
from evalkit.results.run_record import RunRecord

POINTS = 600  # of a line: more are not visible at this size
STRETCHES = 150  # of a noisy line: more cannot be distinguished
SIZE = (6.6, 4.7)  # inches
PLAN_RATIO = 1.5  # width to height of the view from above
OF = "of:"
"""Prefix of the identifier of everything drawn of a method, by which the page hides it."""

Strokes = Mapping[str, Stroke]


@dataclass(frozen=True, slots=True)
class RunFigure:
    """An SVG file and what its caption must admit ("" if nothing). ``pdf()``: the same drawn again for a paper."""

    svg: bytes
    remark: str = ""
    pdf: Callable[[], bytes] = bytes


def draw_trajectories(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the paths from above, aligned to the ground truth (black) if there is one; None without answers."""
    paths = {record.method: world_path(record) for record in records if len(record.result.steps)}
    if not paths:
        return None
    true = next((t.truth.trajectory.poses[:, :2] for t in records if t.truth.trajectory is not None), None)
    low, high = _frame([true] if true is not None else list(paths.values()))
    outside = [label for label, path in paths.items() if ((path < low) | (path > high)).any()]

    def draw(axes: Axes) -> None:
        if true is not None:
            axes.plot(*_thinned(true).T, color=TRUTH, linewidth=2.2, label="truth", zorder=1.5)
        for label, path in paths.items():
            axes.plot(*_thinned(path).T, **_line(strokes, label))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="box")

    return _run_figure([draw], f"{', '.join(outside)} leaves the frame." if outside else "")


def draw_errors(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the distance to the ground truth over time, the maximum of each stretch; None without a true trajectory."""
    lines = {}
    for record in records:
        if record.scores.errors_m is not None and np.isfinite(record.scores.errors_m).any():
            lines[record.method] = _binned(_seconds(record), record.scores.errors_m, np.max, POINTS)
    if not lines:
        return None
    finals = [float(np.median(values)) for _, values in lines.values()]
    wide = max(finals) > 20.0 * max(min(finals), 1e-3)

    def draw(axes: Axes) -> None:
        for label, (seconds, values) in lines.items():
            axes.plot(seconds, np.maximum(values, 1e-4) if wide else values, **_line(strokes, label))
        axes.set(xlabel="time [s]", ylabel="distance to the ground truth [m]")
        if wide:
            axes.set_yscale("log")
            format_log_axis(axes.yaxis)
        else:
            axes.set_ylim(bottom=0.0)

    return _run_figure([draw], "Logarithmic axis." if wide else "")


def draw_runtimes(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the CPU time per scan: box 25 to 75 %, whiskers 5 to 95 %, dot the maximum; line: the scan period."""
    boxes, periods = [], []
    for record in records:
        steps = record.result.steps
        if len(steps) < 2:
            continue
        milliseconds = np.maximum(steps["cpu_ns"], 1) * 1e-6
        low, q1, middle, q3, high = np.percentile(milliseconds, [5, 25, 50, 75, 95])
        boxes.append((record.method, low, q1, middle, q3, high, milliseconds.max()))
        periods.append(period_ns(record.result) * 1e-6)
    if not boxes:
        return None

    def draw(axes: Axes) -> None:
        _boxes(axes, boxes, strokes)
        period = float(np.median(periods))
        axes.axvline(period, **LIMIT)
        axes.annotate(
            f"scan period {period:.0f} ms ", (period, 1.0), (0, 3), xycoords=("data", "axes fraction"),
            textcoords="offset points", color=LIMIT["color"], ha="right", fontsize=9,
        )  # fmt: skip
        axes.set_xscale("log")
        axes.set_xlim(0.6 * min(row[1] for row in boxes), 1.6 * max(period, *(row[-1] for row in boxes)))
        format_log_axis(axes.xaxis)
        axes.set_xlabel("CPU time per scan [ms]")

    return _run_figure([draw], min_legend=None)


def draw_residuals(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the reported residuals over time, scan-to-scan and scan-to-map; None if no method reports them."""
    stages = (("s2s_error", "scan to scan [m]"), ("s2m_error", "scan to map [m]"))
    lines: dict[str, dict[str, tuple[Floats, Floats]]] = {stage: {} for stage, _ in stages}
    for record in records:
        for stage, _ in stages:
            values = np.asarray(record.result.steps[stage], dtype=np.float64)
            if np.isfinite(values).any():
                lines[stage][record.method] = _binned(_seconds(record), values, np.median, STRETCHES)
    panels = [
        partial(_residual_panel, lines[stage], title, strokes) for stage, title in stages if lines[stage]
    ]  # fmt: skip
    if not panels:
        return None

    def last(axes: Axes) -> None:
        panels[-1](axes)
        axes.set_xlabel("time [s]")

    return _run_figure([*panels[:-1], last])


def _residual_panel(
    lines: Mapping[str, tuple[Floats, Floats]], title: str, strokes: Strokes, axes: Axes
) -> None:  # fmt: skip
    for label, (seconds, values) in lines.items():
        axes.plot(seconds, values, **_line(strokes, label))
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(title)


def world_path(record: RunRecord) -> Floats:
    """Return the estimated positions (N, 2) in the frame of the ground truth (m); finite ones only."""
    steps = record.result.steps
    poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1).astype(np.float64)
    poses = poses[np.isfinite(poses).all(axis=1)]
    return se2.compose(record.scores.world_from_start.row, poses)[:, :2]


def _run_figure(panels: Sequence[Draw], remark: str = "", min_legend: int | None = 1) -> RunFigure:
    return RunFigure(
        render_figure(panels, SIZE, min_legend), remark, partial(render_figure, panels, SIZE, min_legend, "pdf")
    )


def _line(strokes: Strokes, label: str) -> dict[str, Any]:
    return line_style(strokes[label], 1.3) | {"label": label, "gid": OF + label}


def _boxes(axes: Axes, boxes: Sequence[tuple[str, float, float, float, float, float, float]], strokes: Strokes) -> None:
    for height, (label, low, q1, middle, q3, high, longest) in enumerate(reversed(boxes)):
        colour = strokes[label].colour
        drawn: dict[str, Any] = {"color": colour, "gid": OF + label}
        axes.hlines(height, low, high, linewidth=1.4, **drawn)
        axes.barh(height, q3 - q1, left=q1, height=0.5, alpha=0.35, edgecolor=colour, linewidth=1.2, **drawn)
        axes.vlines(middle, height - 0.25, height + 0.25, linewidth=2.4, **drawn)
        axes.plot(longest, height, ".", markersize=5, **drawn)
    for written in axes.set_yticks(range(len(boxes)), [row[0] for row in reversed(boxes)]):
        written.label1.set_gid(OF + written.label1.get_text())
    axes.grid(False, axis="y")


def _seconds(record: RunRecord) -> Floats:
    stamps = record.result.steps["stamp_ns"]
    return np.asarray((stamps - stamps[0]) * 1e-9)


def _frame(paths: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the corners of the figure: all paths with a margin, except paths above twice the median size."""
    corners = np.array([[*path.min(axis=0), *path.max(axis=0)] for path in paths if len(path)])
    sides = np.hypot(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    usual = corners[sides <= max(2.0 * float(np.median(sides)), 0.1)]
    low, high = usual[:, :2].min(axis=0), usual[:, 2:].max(axis=0)
    margin = max(0.06 * float((high - low).max()), 0.05)
    side = high - low + 2.0 * margin
    side = np.maximum(side, side[::-1] * [PLAN_RATIO, 1.0 / PLAN_RATIO])
    middle = 0.5 * (low + high)
    return middle - 0.5 * side, middle + 0.5 * side


def _thinned(points: Floats) -> Floats:
    """Return at most POINTS of the points (N, 2), evenly spaced in index, with the first and the last."""
    if len(points) <= POINTS:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, POINTS).round().astype(int)])


def _binned(seconds: Floats, values: Floats, of: Callable[[Floats], Any], most: int) -> tuple[Floats, Floats]:
    """Return at most so many stretches of a series: their mean time, and ``of`` applied to their finite values."""
    finite = np.isfinite(values)
    seconds, values = seconds[finite], values[finite]
    if len(values) <= most:
        return seconds, values
    edges = np.linspace(0, len(values), most + 1).round().astype(int)
    pieces = list(itertools.pairwise(edges))
    return (
        np.array([seconds[a:b].mean() for a, b in pieces]),
        np.array([float(of(values[a:b])) for a, b in pieces]),
    )
