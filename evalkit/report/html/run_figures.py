"""Figures of runs: trajectories, errors, run times and residuals, as SVG for the page and as PDF for papers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from evalkit.core.se2 import Floats
from evalkit.metrics.runtime import is_measured, period_ns
from evalkit.report.html.chart_style import LIMIT, Draw, format_log_axis, line_style, render_figure
from evalkit.report.html.method_colours import TRUTH, Strokes
from evalkit.report.html.run_lines import POINTS, STRETCHES, bin_series, find_frame, seconds_of, thin_points, world_path
from evalkit.results.run_record import RunRecord

SIZE = (6.6, 4.7)  # inches


@dataclass(frozen=True, slots=True)
class RunFigure:
    """An SVG file and what its caption must admit ("" if nothing). ``draw(form, paper)``: the same for a paper."""

    svg: bytes
    remark: str
    draw: Callable[..., bytes]


def draw_trajectories(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the paths from above, aligned to the ground truth (black) if there is one; None without answers."""
    paths = {record.method: world_path(record) for record in records if len(record.result.steps)}
    if not paths:
        return None
    true = next((t.truth.trajectory.poses[:, :2] for t in records if t.truth.trajectory is not None), None)
    low, high = find_frame([true] if true is not None else list(paths.values()))
    outside = [label for label, path in paths.items() if ((path < low) | (path > high)).any()]

    def draw(axes: Axes) -> None:
        if true is not None:
            axes.plot(*thin_points(true).T, color=TRUTH, linewidth=2.2, label="truth", zorder=1.5)
        for label, path in paths.items():
            axes.plot(*thin_points(path).T, **_line(strokes, label))
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="box")

    return _run_figure([draw], f"{', '.join(outside)} leaves the frame." if outside else "")


def draw_errors(records: Sequence[RunRecord], strokes: Strokes) -> RunFigure | None:
    """Draw the distance to the ground truth over time, the maximum of each stretch; None without a true trajectory."""
    lines = {}
    for record in records:
        if record.scores.errors_m is not None and np.isfinite(record.scores.errors_m).any():
            lines[record.method] = bin_series(seconds_of(record), record.scores.errors_m, np.max, POINTS)
    if not lines:
        return None
    finals = [float(np.median(values)) for _, values in lines.values()]
    wide = max(finals) > 20.0 * max(min(finals), 1e-3)

    def draw(axes: Axes) -> None:
        for label, (seconds, values) in lines.items():
            axes.plot(seconds, np.maximum(values, 1e-4) if wide else values, **_line(strokes, label))
        axes.set(xlabel="time [s]", ylabel="distance to the truth [m]")
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
        if len(steps) < 2 or not is_measured(record.result, "cpu_ns"):
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
                lines[stage][record.method] = bin_series(seconds_of(record), values, np.median, STRETCHES)
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


def _run_figure(panels: Sequence[Draw], remark: str = "", min_legend: int | None = 1) -> RunFigure:
    return RunFigure(render_figure(panels, SIZE, min_legend), remark, partial(render_figure, panels, SIZE, min_legend))


def _line(strokes: Strokes, label: str) -> dict[str, Any]:
    return line_style(strokes[label], 1.3) | {"label": label}


def _boxes(axes: Axes, boxes: Sequence[tuple[str, float, float, float, float, float, float]], strokes: Strokes) -> None:
    for height, (label, low, q1, middle, q3, high, longest) in enumerate(reversed(boxes)):
        colour = strokes[label].colour
        drawn: dict[str, Any] = {"color": colour}
        axes.hlines(height, low, high, linewidth=1.4, **drawn)
        axes.barh(height, q3 - q1, left=q1, height=0.5, alpha=0.35, edgecolor=colour, linewidth=1.2, **drawn)
        axes.vlines(middle, height - 0.25, height + 0.25, linewidth=2.4, **drawn)
        axes.plot(longest, height, ".", markersize=5, **drawn)
    axes.set_yticks(range(len(boxes)), [row[0] for row in reversed(boxes)])
    axes.grid(False, axis="y")
