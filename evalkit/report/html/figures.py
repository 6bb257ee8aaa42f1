"""The report's drawings as SVG, on white, without pyplot; with `charts` the only module that imports matplotlib."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.metrics.runtime import period_ns
from evalkit.report.html.palette import TRUTH, Stroke
from evalkit.results.run_record import RunRecord

POINTS = 600  # of a drawn line: more cannot be seen at this size
STRETCHES = 150  # of a noisy line: more cannot be told apart
SIZE = (6.6, 4.7)  # inches
PLAN_RATIO = 1.5  # of width to height of what is seen from above
STYLE: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 10.0,
    "axes.edgecolor": "#9aa3ad",
    "axes.labelcolor": "#30363d",
    "axes.linewidth": 0.8,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#e4e8ec",
    "grid.linewidth": 0.7,
    "xtick.color": "#59636e",
    "ytick.color": "#59636e",
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "text.parse_math": False,  # labels are names, not formulae
    "svg.fonttype": "path",
    "pdf.fonttype": 42,  # TrueType as journals ask for
    "svg.hashsalt": "evalkit",  # the same report twice is the same bytes
    "path.simplify_threshold": 0.5,
}

OF = "of:"
"""What is drawn of a method has an identifier of this and its label, by which the page can leave it out."""

Strokes = Mapping[str, Stroke]


@dataclass(frozen=True, slots=True)
class Drawing:
    """An SVG file and what its caption must admit ("" if nothing). ``pdf()``: the same drawn again for a paper."""

    svg: bytes
    remark: str = ""
    pdf: Callable[[], bytes] = bytes


def trajectories(records: Sequence[RunRecord], strokes: Strokes) -> Drawing | None:
    """The paths seen from above, aligned to the truth (black) where there is one; None if nobody moved a scan."""
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

    return _drawing(draw, f"{', '.join(outside)} leaves the frame." if outside else "")


def errors(records: Sequence[RunRecord], strokes: Strokes) -> Drawing | None:
    """The distance to the truth over time, the largest of each stretch; None where there is no true trajectory."""
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
        axes.set(xlabel="time [s]", ylabel="distance to the truth [m]")
        if wide:
            axes.set_yscale("log")
            _plain_log(axes, "y")
        else:
            axes.set_ylim(bottom=0.0)

    return _drawing(draw, "Logarithmic axis." if wide else "")


def runtimes(records: Sequence[RunRecord], strokes: Strokes) -> Drawing | None:
    """CPU time per scan: box 25 to 75 %, whiskers 5 to 95 %, dot the longest; line: the scan period."""
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
        axes.axvline(period, color="#b42318", linewidth=1.2, linestyle=(0, (5, 3)))
        axes.annotate(
            f"scan period {period:.0f} ms ", (period, 1.0), (0, 3), xycoords=("data", "axes fraction"),
            textcoords="offset points", color="#b42318", ha="right", fontsize=9,
        )  # fmt: skip
        axes.set_xscale("log")
        axes.set_xlim(0.6 * min(row[1] for row in boxes), 1.6 * max(period, *(row[-1] for row in boxes)))
        _plain_log(axes, "x")
        axes.set_xlabel("CPU time per scan [ms]")

    return _drawing(draw, legend=False)


def residuals(records: Sequence[RunRecord], strokes: Strokes) -> Drawing | None:
    """What the registrations say of themselves over time, scan-to-scan and scan-to-map; None if nobody tells."""
    stages = (("s2s_error", "scan to scan [m]"), ("s2m_error", "scan to map [m]"))
    lines: dict[str, dict[str, tuple[Floats, Floats]]] = {stage: {} for stage, _ in stages}
    for record in records:
        for stage, _ in stages:
            values = np.asarray(record.result.steps[stage], dtype=np.float64)
            if np.isfinite(values).any():
                lines[stage][record.method] = _binned(_seconds(record), values, np.median, STRETCHES)
    told = [(stage, title) for stage, title in stages if lines[stage]]
    if not told:
        return None

    def draw(*panels: Axes) -> None:
        for axes, (stage, title) in zip(panels, told, strict=True):
            for label, (seconds, values) in lines[stage].items():
                axes.plot(seconds, values, **_line(strokes, label))
            axes.set_ylim(bottom=0.0)
            axes.set_ylabel(title)
        panels[-1].set_xlabel("time [s]")

    return _drawing(draw, panels=len(told))


def world_path(record: RunRecord) -> Floats:
    """The positions (N, 2) a run answered, in the frame of the truth (m); finite ones only."""
    steps = record.result.steps
    poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1).astype(np.float64)
    poses = poses[np.isfinite(poses).all(axis=1)]
    return se2.compose(record.scores.world_from_start.row, poses)[:, :2]


def _drawing(draw: Callable[..., None], remark: str = "", panels: int = 1, legend: bool = True) -> Drawing:
    return Drawing(_file(draw, panels, legend), remark, partial(_file, draw, panels, legend, "pdf"))


class _DrawnOnce(Figure):
    """A figure that is only laid out where matplotlib draws it unseen to lay it out: half the time, the same bytes."""

    def draw(self, renderer: RendererBase) -> None:
        """Lays itself out, or draws itself once that is done."""
        engine = self.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):  # savefig puts another in its place after the layout
            engine.execute(self)
        else:
            super().draw(renderer)


def _file(draw: Callable[..., None], panels: int, legend: bool, form: Literal["svg", "pdf"] = "svg") -> bytes:
    undated = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Creator": None, "Producer": None}}
    with mpl.rc_context(STYLE):
        figure = _DrawnOnce(figsize=SIZE, layout="constrained")
        axes = list(figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0])
        draw(*axes)
        if legend:
            _legend(figure, axes)
        out = io.BytesIO()
        figure.savefig(out, format=form, metadata=undated[form])
    return out.getvalue()


def _legend(figure: Figure, panels: Sequence[Axes]) -> None:
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    columns = 5 if max(map(len, handles), default=0) < 14 else 4 if max(map(len, handles)) < 22 else 3
    legend = figure.legend(
        handles.values(), handles.keys(), loc="outside lower center", ncols=columns, handlelength=2.4
    )
    for shown, text in zip(legend.legend_handles, legend.get_texts(), strict=True):
        named = handles[text.get_text()].get_gid()
        text.set_gid(named)
        if shown is not None:
            shown.set_gid(named)


def _line(strokes: Strokes, label: str) -> dict[str, Any]:
    stroke = strokes[label]
    dashes = (0, stroke.dash) if stroke.dash else "-"
    return {"color": stroke.colour, "linestyle": dashes, "linewidth": 1.3, "label": label, "gid": OF + label}


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


def _plain_log(axes: Axes, which: str) -> None:
    axis = axes.xaxis if which == "x" else axes.yaxis
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter("")


def _seconds(record: RunRecord) -> Floats:
    stamps = record.result.steps["stamp_ns"]
    return np.asarray((stamps - stamps[0]) * 1e-9)


def _frame(paths: Sequence[Floats]) -> tuple[Floats, Floats]:
    """The corners of the drawing: all paths with a margin, but none that spreads to twice what is usual."""
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
    """At most POINTS of the points (N, 2), evenly spaced in index, first and last kept."""
    if len(points) <= POINTS:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, POINTS).round().astype(int)])


def _binned(seconds: Floats, values: Floats, of: Callable[[Floats], Any], most: int) -> tuple[Floats, Floats]:
    """At most so many stretches of a series: their mean time and what ``of`` makes of their finite values."""
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
