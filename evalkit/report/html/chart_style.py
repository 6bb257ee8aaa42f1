"""The style of every figure: fonts, axes, legend and file output, on white, without pyplot.

``charts`` draws numbers and ``run_figures`` draws runs, both in this style. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import matplotlib as mpl
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.axis import Axis as MatplotlibAxis
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from evalkit.core.errors import UnknownName
from evalkit.report.html.method_colours import Stroke

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
    "pdf.fonttype": 42,  # TrueType as journals require
    "svg.hashsalt": "evalkit",  # the same figure twice is the same bytes
    "path.simplify_threshold": 0.5,
}

METADATA: Any = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
MAX_LEGEND = 5
"""Columns of a legend with short names."""

LIMIT: Any = {"color": "#b42318", "linewidth": 1.2, "linestyle": (0, (5, 3))}
"""The line style of limits and other named values."""

FileFormat = Literal["svg", "pdf"]


@dataclass(frozen=True)
class PaperStyle:
    """A figure for a paper: drawn in its final width, with no text below ``MIN_PT``. ``font``: a family, or ""."""

    width_in: float
    font: str = ""
    size_pt: float = 8.0
    MIN_PT: ClassVar[float] = 7.0

    def __post_init__(self) -> None:
        if self.font and self.font not in font_manager.get_font_names():
            raise UnknownName("font family", self.font, font_manager.get_font_names())

    @property
    def columns(self) -> int:
        """The number of pictures or names side by side."""
        return 4 if self.width_in > 5.0 else 2

    @property
    def rc(self) -> dict[str, Any]:
        """The settings of matplotlib that differ from ``STYLE``."""
        sizes = {"font.size": self.size_pt, "legend.fontsize": self.MIN_PT}
        return sizes | ({"font.family": self.font} if self.font else {})


Draw = Callable[[Axes], None]


def render_figure(
    panels: Sequence[Draw],
    size: tuple[float, float],
    min_legend: int | None = None,
    form: FileFormat = "svg",
    paper: PaperStyle | None = None,
) -> bytes:
    """Draw panels one below the other over a common horizontal axis; return the file.

    ``size`` in inches; with ``paper`` only its ratio counts. ``min_legend``: the legend is drawn from this number of
    entries on, None for no legend.
    """
    if paper is not None:
        size = paper.width_in, paper.width_in * size[1] / size[0]
    with mpl.rc_context(STYLE | (paper.rc if paper else {})):
        figure = _LayoutOnceFigure(figsize=size, layout="constrained")
        axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        for draw, own in zip(panels, axes, strict=True):
            draw(own)
        if min_legend is not None:
            _draw_legend(figure, axes, min_legend, paper.columns if paper else MAX_LEGEND)
        return _save(figure, form)


def render_pictures(panels: Sequence[Draw], ratio: float, form: FileFormat, paper: PaperStyle) -> bytes:
    """Draw pictures side by side, in two columns or four; return the file. ``ratio``: height of a picture by width."""
    columns = min(len(panels), paper.columns)
    rows = -(-len(panels) // columns)
    height = rows * (paper.width_in * ratio / columns + 4.0 * paper.size_pt / 72.0)
    with mpl.rc_context(STYLE | paper.rc):
        figure = _LayoutOnceFigure(figsize=(paper.width_in, height), layout="constrained")
        places = list(figure.subplots(rows, columns, squeeze=False).flat)
        for draw, axes in zip(panels, places, strict=False):
            draw(axes)
        for axes in places[len(panels) :]:
            axes.set_axis_off()
        return _save(figure, form)


def _save(figure: Figure, form: FileFormat) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format=form, metadata=METADATA[form])
    return out.getvalue()


def line_style(stroke: Stroke, width: float = 1.5) -> dict[str, Any]:
    """Return the keyword arguments of matplotlib for a stroke."""
    return {"color": stroke.colour, "linestyle": (0, stroke.dash) if stroke.dash else "-", "linewidth": width}


def format_log_axis(axis: MatplotlibAxis) -> None:
    """Write the values of a logarithmic axis as plain numbers."""
    axis.set_major_formatter(lambda value, _: f"{value:g}")
    axis.set_minor_formatter("")


class _LayoutOnceFigure(Figure):
    """A figure that computes only its layout when savefig draws it for layout: half the time, the same bytes."""

    def draw(self, renderer: RendererBase) -> None:
        """Compute the layout, or draw once the layout is fixed."""
        engine = self.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):  # savefig replaces the engine after the layout
            engine.execute(self)
        else:
            super().draw(renderer)


def _draw_legend(figure: Figure, panels: Sequence[Axes], min_entries: int, most: int) -> None:
    """Draw one legend below all panels."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if len(handles) < min_entries:
        return
    longest = max(map(len, handles), default=0)
    columns = min(next((count for length, count in ((14, MAX_LEGEND), (20, 4), (30, 3)) if longest < length), 2), most)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns, handlelength=2.4)
