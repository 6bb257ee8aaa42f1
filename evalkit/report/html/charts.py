"""Charts of numbers as SVG: lines, panels, heat maps, histograms, scatter plots, bars, images and flow charts."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from evalkit.core.se2 import Floats
from evalkit.report.html.chart_style import LIMIT, format_log_axis, line_style, render_figure
from evalkit.report.html.method_colours import DASHES, HUES, Stroke

WIDE = (6.0, 3.7)  # inches: letters of 10 pt are 8 px high on a phone, and 9 px where three figures are side by side
SQUARE = (5.0, 4.4)
AxisKind = Literal["linear", "log"]


@dataclass(frozen=True, slots=True)
class Axis:
    """The label of an axis with its unit, its scale and limits; ``ticks``: the only marked values, if given."""

    label: str
    scale: AxisKind = "linear"
    low: float | None = None
    high: float | None = None
    ticks: Sequence[float] = ()


@dataclass(frozen=True, slots=True)
class Curve:
    """A line through (x, y), both (N,); ``low`` and ``high`` (N,): a band around it; ``marks``: draw its points."""

    label: str
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    stroke: Stroke | None = None
    marks: bool = False


@dataclass(frozen=True, slots=True)
class Points:
    """Points (N, 2) of one label; ``size`` in points; ``joined``: draw a line; a label "" is not in the legend.

    ``mark``: the mark of a point, in the notation of matplotlib.
    """

    label: str
    points: Floats
    colour: str
    size: float = 3.0
    joined: bool = False
    alpha: float = 1.0
    mark: str = "o"


@dataclass(frozen=True, slots=True)
class ShadedSpan:
    """A shaded range of the horizontal axis (``low`` < ``high``), or a line if they are equal."""

    low: float
    high: float
    label: str = ""
    colour: str = "#f3dca9"


def compute_log_ticks(low: float, high: float, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> tuple[float, ...]:
    """Return ``steps`` times the powers of ten between positive ends, with three digits."""
    powers = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    ticks = (float(f"{step * 10.0**power:.3g}") for power in powers for step in steps)
    return tuple(tick for tick in ticks if low <= tick <= high)


def stroke(number: int) -> Stroke:
    """Return the n-th stroke of the palette, hues first."""
    return Stroke(HUES[number % len(HUES)], DASHES[number // len(HUES) % len(DASHES)])


def lines(
    curves: Sequence[Curve],
    x: Axis,
    y: Axis,
    spans: Sequence[ShadedSpan] = (),
    levels: Mapping[str, float] | None = None,
) -> bytes:
    """Draw curves; ``spans`` shade ranges of x, ``levels`` are named horizontal lines."""

    def draw(axes: Axes) -> None:
        _draw_spans(axes, spans)
        for number, curve in enumerate(curves):
            drawn = line_style(curve.stroke or stroke(number))
            axes.plot(curve.x, curve.y, label=curve.label, marker="o" if curve.marks else "", markersize=4, **drawn)
            if curve.low is not None and curve.high is not None:
                axes.fill_between(curve.x, curve.low, curve.high, color=drawn["color"], alpha=0.16, linewidth=0)
        _draw_levels(axes, levels or {})
        _set_axes(axes, x, y)

    return render_figure([draw], WIDE, min_legend=2)


def panels(
    groups: Sequence[tuple[Sequence[Curve], Axis]], x: Axis, spans: Sequence[ShadedSpan] = (), height: float = 2.3
) -> bytes:
    """Draw panels one below the other over a common horizontal axis; ``height`` of each in inches."""

    def panel(curves: Sequence[Curve], y: Axis, last: bool) -> Callable[[Axes], None]:
        def draw(axes: Axes) -> None:
            _draw_spans(axes, spans)
            for number, curve in enumerate(curves):
                drawn = line_style(curve.stroke or stroke(number))
                axes.plot(curve.x, curve.y, label=curve.label, marker="o" if curve.marks else "", markersize=3, **drawn)
            _set_axes(axes, x if last else Axis("", x.scale, x.low, x.high, x.ticks), y)

        return draw

    drawings = [panel(curves, y, number == len(groups) - 1) for number, (curves, y) in enumerate(groups)]
    return render_figure(drawings, (WIDE[0], 0.8 + height * len(groups)), min_legend=2 if len(groups) == 1 else 1)


def heat(
    values: Floats, x: Axis, y: Axis, columns: Sequence[float], rows: Sequence[float], of: Axis,
    printed: Callable[[float], str] | None = None, contours: Sequence[float] = (),
) -> bytes:  # fmt: skip
    """Draw a table (R, C) of values as colours, first row lowest; NaN is grey. ``printed`` formats a value in its cell.

    ``columns`` (C,) and ``rows`` (R,) are the values at the cells' middles, drawn at even spacing; ``of`` names the
    colours and limits them; ``contours`` are lines between the cells where the values pass through them.
    """
    table = np.asarray(values, dtype=np.float64)

    def draw(axes: Axes) -> None:
        norm = LogNorm if of.scale == "log" else Normalize
        scale = norm(of.low, of.high, clip=True)
        axes.set_facecolor("#e9edf2")
        image = axes.imshow(table, origin="lower", cmap="cividis", norm=scale, aspect="auto", interpolation="nearest")
        if contours:
            drawn = axes.contour(table, levels=sorted(contours), colors="#ffffff", linewidths=1.6)
            axes.clabel(drawn, fmt=lambda level: f"{level:g}", fontsize=9)
        if printed is not None:
            for (row, column), value in np.ndenumerate(table):
                if np.isfinite(value):
                    ink = "#000000" if scale(value) > 0.55 else "#ffffff"
                    axes.text(column, row, printed(float(value)), ha="center", va="center", color=ink, fontsize=8)
        axes.set_xticks(range(table.shape[1]), [f"{value:g}" for value in columns])
        axes.set_yticks(range(table.shape[0]), [f"{value:g}" for value in rows])
        axes.set(xlabel=x.label, ylabel=y.label)
        axes.grid(False)
        bar = axes.figure.colorbar(image, ax=axes, shrink=0.9)
        bar.set_label(of.label)
        if of.scale == "log":
            format_log_axis(bar.ax.yaxis)

    return render_figure([draw], SQUARE)


def histogram(
    series: Mapping[str, Floats], x: Axis, bins: int = 40, levels: Mapping[str, float] | None = None
) -> bytes:
    """Draw histograms with common bins; ``levels`` are named vertical lines."""
    finite = {label: values[np.isfinite(values)] for label, values in series.items()}
    everything = np.concatenate([*finite.values(), np.zeros(0)])
    edges = np.histogram_bin_edges(everything, bins=bins, range=_data_range(everything, x))

    def draw(axes: Axes) -> None:
        for number, (label, values) in enumerate(finite.items()):
            colour = stroke(number).colour
            axes.hist(values, bins=edges.tolist(), histtype="stepfilled", color=colour, alpha=0.25)
            axes.hist(values, bins=edges.tolist(), histtype="step", color=colour, linewidth=1.4, label=label)
        for label, value in (levels or {}).items():
            axes.axvline(value, **LIMIT, label=label)
        _set_axes(axes, x, Axis("count", low=0.0))

    return render_figure([draw], WIDE, min_legend=2)


def scatter(layers: Sequence[Points], x: Axis, y: Axis, equal: bool = True) -> bytes:
    """Draw points in the plane, later layers on top; ``equal`` gives both axes one scale."""

    def draw(axes: Axes) -> None:
        for layer in layers:
            label, kind = layer.label or "_unnamed", "-" if layer.joined else ""
            marker = "" if layer.joined else layer.mark
            axes.plot(
                *np.asarray(layer.points, dtype=np.float64).reshape(-1, 2).T, kind or "none", marker=marker,
                color=layer.colour, markersize=layer.size, linewidth=layer.size if layer.joined else 0.0,
                markeredgewidth=0.0, alpha=layer.alpha, label=label,
            )  # fmt: skip
        _set_axes(axes, x, y)
        if equal:
            axes.set_aspect("equal", adjustable="datalim" if x.low is None else "box")

    return render_figure([draw], SQUARE if equal else WIDE, min_legend=2)


def bars(
    labels: Sequence[str], values: Floats, x: Axis, low: Floats | None = None, high: Floats | None = None,
    zero: float = 0.0, colours: Sequence[str] = (),
) -> bytes:  # fmt: skip
    """Draw one horizontal bar per label from ``zero``, the first on top, with intervals from ``low`` to ``high``."""
    heights = np.arange(len(labels))[::-1]

    def draw(axes: Axes) -> None:
        filled = list(colours) or [HUES[0]] * len(labels)
        axes.barh(heights, np.asarray(values) - zero, left=zero, height=0.62, color=filled, alpha=0.55)
        if low is not None and high is not None:
            axes.hlines(heights, low, high, color="#1c2128", linewidth=1.4)
        axes.axvline(zero, color="#59636e", linewidth=1.0)
        axes.set_yticks(heights, labels)
        _set_axes(axes, x, Axis(""))
        axes.grid(False, axis="y")

    return render_figure([draw], (WIDE[0], 0.9 + 0.32 * max(len(labels), 2)))


def picture(image: Any, extent_m: tuple[float, float, float, float], layers: Sequence[Points] = ()) -> bytes:
    """Draw an image (H, W) of grey in 0..1 or (H, W, 3), first row on top, at (left, right, bottom, top) in metres."""

    def draw(axes: Axes) -> None:
        axes.imshow(image, extent=extent_m, cmap="gray", vmin=0.0, vmax=1.0, interpolation="nearest")
        for layer in layers:
            axes.plot(
                *np.asarray(layer.points, dtype=np.float64).reshape(-1, 2).T, color=layer.colour, alpha=layer.alpha,
                linestyle="-" if layer.joined else "none", linewidth=layer.size, marker="" if layer.joined else "o",
                markersize=layer.size, markeredgewidth=0.0, label=layer.label or "_unnamed",
            )  # fmt: skip
        axes.set(xlabel="x [m]", ylabel="y [m]", xlim=extent_m[:2], ylim=extent_m[2:])
        axes.set_aspect("equal", adjustable="box")
        axes.grid(False)

    return render_figure([draw], SQUARE, min_legend=2)


@dataclass(frozen=True, slots=True)
class Box:
    """A box of a flow chart at (column, row), row 0 on top; ``kind`` "choice": a question, "end": start or end."""

    name: str
    text: str
    column: float
    row: float
    kind: Literal["step", "choice", "end", "store"] = "step"


def flow(boxes: Sequence[Box], arrows: Sequence[tuple[str, str, str]]) -> bytes:
    """Draw boxes and arrows; ``arrows``: (from, to, label) by the boxes' names."""
    known = {box.name: box for box in boxes}
    columns = [box.column for box in boxes]
    rows = [box.row for box in boxes]
    size = (1.2 + 2.3 * (max(columns) - min(columns) + 1.0), 0.5 + 0.95 * (max(rows) - min(rows) + 1.0))

    def draw(axes: Axes) -> None:
        for box in boxes:
            _draw_box(axes, box)
        for start, end, words in arrows:
            _draw_arrow(axes, known[start], known[end], words)
        axes.set(xlim=(min(columns) - 0.62, max(columns) + 0.62), ylim=(max(rows) + 0.5, min(rows) - 0.5))
        axes.axis("off")

    return render_figure([draw], size)


HALF_BOX = (0.44, 0.29)
FILLS = {"step": "#e1ecfb", "choice": "#fff1d6", "end": "#e9edf2", "store": "#e3f0e6"}


def _draw_box(axes: Axes, box: Box) -> None:
    wide, high = HALF_BOX
    shape = "round,pad=0,rounding_size=0.28" if box.kind == "end" else "round,pad=0,rounding_size=0.05"
    axes.add_patch(
        FancyBboxPatch(
            (box.column - wide, box.row - high), 2 * wide, 2 * high, boxstyle=shape, mutation_aspect=1.0,
            facecolor=FILLS[box.kind], edgecolor="#59636e", linewidth=1.0,
        )
    )  # fmt: skip
    axes.text(box.column, box.row, textwrap.fill(box.text, 26), ha="center", va="center", fontsize=8.5)


def _draw_arrow(axes: Axes, start: Box, end: Box, words: str) -> None:
    wide, high = HALF_BOX
    across, down = end.column - start.column, end.row - start.row
    if abs(across) < 1e-9 and 0 < down <= 1.5:  # to the next one below
        a, b, bend = (start.column, start.row + high), (end.column, end.row - high), "arc3"
    elif abs(across) < 1e-9:  # back up, or past others, around the right side
        a, b = (start.column + wide, start.row), (end.column + wide, end.row)
        bend = "arc3,rad=0.35" if down < 0 else "arc3,rad=-0.35"
    else:
        side = 1.0 if across > 0 else -1.0
        level = abs(down) < 0.6
        a = (start.column + side * wide, start.row) if level else (start.column, start.row + np.sign(down) * high)
        b = (end.column - side * wide, end.row)
        bend = "arc3" if level else "angle,angleA=90,angleB=0,rad=4"
    axes.add_patch(
        FancyArrowPatch(
            a, b, connectionstyle=bend, arrowstyle="-|>", mutation_scale=11, color="#30363d", linewidth=1.1,
            shrinkA=0, shrinkB=0,
        )
    )  # fmt: skip
    if words and abs(across) > 1e-9 and a[1] == b[1]:
        axes.text(0.5 * (a[0] + b[0]), a[1] - 0.07, words, fontsize=8, color="#59636e", ha="center")
    elif words:
        bulge = 0.22 if bend.startswith("arc3,") else 0.0
        axes.text(
            0.5 * (a[0] + b[0]) + 0.03 + bulge, 0.5 * (a[1] + b[1]), words, fontsize=8, color="#59636e", va="center"
        )


def _draw_spans(axes: Axes, spans: Sequence[ShadedSpan]) -> None:
    named = set()
    for span in spans:
        label = span.label if span.label not in named else ""
        named.add(span.label)
        if span.low < span.high:
            axes.axvspan(span.low, span.high, color=span.colour, alpha=0.55, linewidth=0, label=label or "_span")
        else:
            axes.axvline(span.low, color=span.colour, linewidth=1.2, label=label or "_span")


def _draw_levels(axes: Axes, levels: Mapping[str, float]) -> None:
    for label, value in levels.items():
        axes.axhline(value, **LIMIT, label=label)


def _set_axes(axes: Axes, x: Axis, y: Axis) -> None:
    for axis, which, set_scale, set_limits, set_label in (
        (x, axes.xaxis, axes.set_xscale, axes.set_xlim, axes.set_xlabel),
        (y, axes.yaxis, axes.set_yscale, axes.set_ylim, axes.set_ylabel),
    ):
        set_label(axis.label)
        if axis.scale == "log":
            set_scale("log")
            format_log_axis(which)
        if axis.ticks:
            which.set_ticks(list(axis.ticks), [f"{tick:g}" for tick in axis.ticks])
            which.set_ticks([], minor=True)
        if axis.low is not None or axis.high is not None:
            set_limits(axis.low, axis.high)


def _data_range(values: Floats, x: Axis) -> tuple[float, float]:
    low = float(values.min()) if len(values) else 0.0
    high = float(values.max()) if len(values) else 1.0
    return (low if x.low is None else x.low, high if x.high is None else x.high)
