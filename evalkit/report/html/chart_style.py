"""The style of every figure: fonts, axes, legend and file output, on white, without pyplot.

``charts`` draws numbers and ``run_figures`` draws runs, both in this style. The same numbers give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any, Literal

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.axis import Axis as MatplotlibAxis
from matplotlib.backend_bases import RendererBase
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from evalkit.report.html.palette import Stroke

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
LIMIT: Any = {"color": "#b42318", "linewidth": 1.2, "linestyle": (0, (5, 3))}
"""The line style of limits and other named values."""

FileFormat = Literal["svg", "pdf"]
Draw = Callable[[Axes], None]


def render_figure(
    panels: Sequence[Draw], size: tuple[float, float], min_legend: int | None = None, form: FileFormat = "svg"
) -> bytes:
    """Draw panels one below the other over a common horizontal axis; return the file.

    ``size`` in inches. ``min_legend``: the legend is drawn from this number of entries on, None for no legend.
    """
    with mpl.rc_context(STYLE):
        figure = _LayoutOnceFigure(figsize=size, layout="constrained")
        axes = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
        for draw, own in zip(panels, axes, strict=True):
            draw(own)
        if min_legend is not None:
            _draw_legend(figure, axes, min_legend)
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


def _draw_legend(figure: Figure, panels: Sequence[Axes], min_entries: int) -> None:
    """Draw one legend below all panels."""
    handles: dict[str, Any] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if len(handles) < min_entries:
        return
    longest = max(map(len, handles), default=0)
    columns = next((count for length, count in ((14, 5), (20, 4), (30, 3)) if longest < length), 2)
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns, handlelength=2.4)
