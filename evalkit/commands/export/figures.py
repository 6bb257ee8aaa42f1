"""Figures for a paper in their final size: runs, maps side by side, and error against CPU time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import product

from matplotlib.axes import Axes
from matplotlib.transforms import Bbox, BboxBase

from evalkit.commands.export.latex import Files, Width, file_name
from evalkit.commands.export.results import ExportSelection, MetricColumn, SummaryRow
from evalkit.metrics.runtime import COST
from evalkit.report.html import maps, run_figures
from evalkit.report.html.chart_style import FileFormat, PaperStyle, format_log_axis, render_figure, render_pictures

WIDTH_INCHES: dict[Width, float] = {"column": 3.4, "text": 7.0}
"""Widths of one column and of the text of a page with two columns."""

MAX_MAPS = 4

TUNED = "settings chosen on these data"


def draw_figures(results: ExportSelection, form: FileFormat, width: Width = "column", font: str = "") -> Files:
    """Yield the figures of each sequence's lowest seed, drawn in their final size with text of 7 pt or more.

    ``font``: a font family of this machine, "" for the sans serif of the report.
    """
    paper = PaperStyle(WIDTH_INCHES[width], font)
    kinds = (("trajectories", run_figures.draw_trajectories), ("errors", run_figures.draw_errors),
             ("runtimes", run_figures.draw_runtimes), ("residuals", run_figures.draw_residuals))  # fmt: skip
    for sequence in results.sequences:
        for kind, draw in kinds:
            drawn = draw(results.first_runs(sequence), results.strokes)
            if drawn is not None:
                yield f"{file_name(sequence)}-{kind}.{form}", drawn.draw(form, paper)
        for kind, found in (("maps", draw_maps(results, sequence, form, paper)),
                            ("accuracy-time", draw_accuracy_time(results, sequence, form, paper))):  # fmt: skip
            if found is not None:
                yield f"{file_name(sequence)}-{kind}.{form}", found


def draw_maps(results: ExportSelection, sequence: str, form: FileFormat, paper: PaperStyle) -> bytes | None:
    """Draw the maps of the first and of the last methods by rank side by side; None without a map."""
    rows = _rows(results, sequence, results.deciding(sequence))
    order = {row.method: row.rank or len(rows) for row in rows}
    runs = sorted(
        (run for run in results.first_runs(sequence) if run.scores.grid is not None),
        key=lambda run: order.get(run.method, len(rows)),
    )
    shown = runs if len(runs) <= MAX_MAPS else [*runs[: MAX_MAPS - 1], runs[-1]]
    grids = [run.scores.grid for run in shown if run.scores.grid is not None]
    window = maps.find_window(grids)
    if window is None:
        return None
    column = results.column(results.deciding(sequence))
    errors = {row.method: _quantity(column, row) for row in rows if column is not None and row.median is not None}
    across, along = window.size_m

    def draw(axes: Axes, at: int) -> None:
        axes.imshow(
            maps.compute_greys(grids[at], window), cmap="gray", vmin=0, vmax=15, interpolation="nearest",
            extent=(window.x_min, window.x_max, window.y_min, window.y_max),
        )  # fmt: skip
        axes.set_axis_off()
        axes.set_title(f"{shown[at].method}\n{errors.get(shown[at].method, '')}".rstrip(), fontsize=paper.size_pt)
        if at == 0:
            bar, margin = window.scale_bar_m, 0.04 * across
            place = window.x_min + margin, window.y_min + margin
            axes.plot([place[0], place[0] + bar], [place[1]] * 2, color="black", linewidth=1.5)
            axes.annotate(f"{bar:g} m", place, (0, 3), textcoords="offset points", fontsize=paper.MIN_PT)

    panels = [partial(draw, at=at) for at in range(len(shown))]
    return render_pictures(panels, along / across, form, paper)


def draw_accuracy_time(results: ExportSelection, sequence: str, form: FileFormat, paper: PaperStyle) -> bytes | None:
    """Draw the error in the deciding metric over the CPU time a scan, a dot a method; None without two of them.

    An open diamond instead of the dot: settings of the method were chosen on these data.
    """
    deciding = results.deciding(sequence)
    column, costs = results.column(deciding), {row.method: row.median for row in _rows(results, sequence, COST)}
    points = [
        (row, row.median, cost)
        for row in _rows(results, sequence, deciding)
        if row.median is not None and (cost := costs.get(row.method))
    ]
    if column is None or len(points) < 2:
        return None

    def draw(axes: Axes) -> None:
        for row, error, cost in points:
            colour = results.strokes[row.method].colour
            if row.spread is not None:
                axes.vlines(cost, row.spread.low, row.spread.high, color=colour, linewidth=0.8)
            tuned = results.is_tuned(row.method, sequence)
            axes.plot(
                cost, error, "D" if tuned else "o", color=colour, mfc="white" if tuned else colour, markersize=4.0
            )
        axes.set_xscale("log")
        format_log_axis(axes.xaxis)
        low, high = min(error for _, error, _ in points), max(error for _, error, _ in points)
        if low > 0.0 and high > 10.0 * low:
            axes.set_yscale("log")
            format_log_axis(axes.yaxis)
        axes.margins(x=0.15)
        if any(results.is_tuned(row.method, sequence) for row, *_ in points):
            axes.plot([], [], "D", color="black", mfc="white", markersize=4.0, label=TUNED)
            axes.legend(fontsize=paper.MIN_PT, frameon=False, handletextpad=0.2)
        axes.set(xlabel="CPU time per scan [ms]", ylabel=f"{column.label} [{column.unit}]")
        colours = [results.strokes[row.method].colour for row, *_ in points]
        label_points(axes, [(row.method, (cost, error)) for row, error, cost in points], colours, paper.MIN_PT)

    return render_figure([draw], (paper.width_in, min(0.7 * paper.width_in, 3.0)), None, form, paper)


def label_points(
    axes: Axes, points: Sequence[tuple[str, tuple[float, float]]], colours: Sequence[str], size_pt: float
) -> None:
    """Write a name beside each point (x, y) of a finished figure, where it covers least of other names and points."""
    figure = axes.figure.get_figure(root=True)
    if figure is None:
        raise ValueError("axes belong to no figure")
    figure.draw_without_rendering()
    middles = axes.transData.transform([place for _, place in points])
    dots = [Bbox([middle - 4.0, middle + 4.0]) for middle in middles]
    names: list[Bbox] = []
    for (name, place), colour in zip(points, colours, strict=True):
        write = partial(
            axes.annotate, name, place, textcoords="offset points", va="center", fontsize=size_pt, color=colour
        )
        tried = []
        for rank, (up, right) in enumerate(product((0.5, -0.5, 1.5, -1.5, 2.5, -2.5), (True, False))):
            offset, side = (4.0 if right else -4.0, up * 1.2 * size_pt), "left" if right else "right"
            label = write(xytext=offset, ha=side)
            box = label.get_window_extent()
            label.remove()
            covered = sum(_overlap(box, other) for other in (*names, *dots))
            outside = box.width * box.height - _overlap(box, axes.bbox)
            tried.append((covered + outside, rank, box, offset, side))
        _, _, box, offset, side = min(tried, key=lambda one: one[:2])
        leader = {"arrowstyle": "-", "linewidth": 0.4, "color": colour, "shrinkA": 0.0, "shrinkB": 2.0}
        write(xytext=offset, ha=side, arrowprops=leader).set_in_layout(False)
        names.append(box)


def _overlap(one: Bbox, other: BboxBase) -> float:
    """Return the area that two boxes share."""
    shared = Bbox.intersection(one, other)
    return 0.0 if shared is None else float(shared.width * shared.height)


def _rows(results: ExportSelection, sequence: str, metric: str) -> list[SummaryRow]:
    return [row for row in results.rows if row.sequence == sequence and row.metric == metric]


def _quantity(column: MetricColumn, row: SummaryRow) -> str:
    return f"{row.median:.{column.digits}f} {column.unit}".rstrip()
