"""Matplotlib figures of a comparison: dots of errors, maps, errors over time. Each can be restyled by its axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evalkit.core.errors import UnknownName
from evalkit.report.html.maps import find_window

if TYPE_CHECKING:
    from evalkit.api.results import ComparisonResults


class Plots:
    """Figures of the results of a comparison. A figure is closed for pyplot, so that a notebook shows it once."""

    def __init__(self, results: ComparisonResults) -> None:
        self._results = results

    def dots(self, metric: str | None = None) -> Figure:
        """Draw the median of a metric by method, a panel per sequence, with its 95 % interval as a line.

        ``metric``: the first headline metric with a value if not given. Raises UnknownName for a metric without one.
        """
        table = self._results.summary()
        valued = table[table["median"].notna()]
        known = list(dict.fromkeys(valued["metric"]))
        headline = [one["name"] for one in self._results.content["metrics"] if one["headline"] and one["name"] in known]
        name: str = metric or next(iter(headline or known), "")
        if name not in known:
            raise UnknownName("metric", name, known)
        rows = valued[valued["metric"] == name]
        methods = [label for label in self._results.methods if label in set(rows["method"])]
        sequences = list(dict.fromkeys(rows["sequence"]))
        figure, axes = _panels(len(sequences), height=0.6 + 0.3 * len(methods), shared=True)
        for panel, sequence in zip(axes, sequences, strict=True):
            own = rows[rows["sequence"] == sequence]
            heights = [methods.index(label) for label in own["method"]]
            panel.hlines(heights, own["low_95"], own["high_95"], color="0.6")
            panel.plot(own["median"], heights, "o")
            unit = self._results.units[name]
            panel.set(title=sequence, xlabel=f"{name} [{unit}]" if unit else name)
        axes[0].set_yticks(range(len(methods)), methods)
        axes[0].invert_yaxis()
        return figure

    def maps(self, sequence: str | None = None) -> Figure:
        """Draw the map of every method over a sequence in the same window (m), in the frame of the maps."""
        runs = [run for run in self._results.runs(sequence) if run.scores.grid is not None]
        grids = {run.method: run.scores.grid for run in runs if run.scores.grid is not None}
        figure, axes = _panels(len(grids))
        window = find_window(list(grids.values()))
        for panel, (method, grid) in zip(axes, grids.items(), strict=False):
            grey = np.where(grid.observed, 1.0 - grid.probability(), 0.8)
            panel.imshow(grey, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=grid.extent)
            panel.set(title=method, xlabel="x [m]", ylabel="y [m]", facecolor="0.8")
            if window is not None:
                panel.set(xlim=(window.x_min, window.x_max), ylim=(window.y_min, window.y_max))
        return figure

    def error_time(self, sequence: str | None = None) -> Figure:
        """Draw the distance to the ground truth (m) over time (s) of every method over a sequence, one axes."""
        figure, (axes, *_) = _panels(1, height=3.5)
        for run in self._results.runs(sequence):
            errors = run.scores.errors_m
            if errors is not None and np.isfinite(errors).any():
                stamps = run.result.steps["stamp_ns"]
                axes.plot((stamps - stamps[0]) * 1e-9, errors, label=run.method)
        axes.set(xlabel="time [s]", ylabel="distance to the ground truth [m]")
        if axes.lines:
            axes.legend()
        else:
            axes.set_title("no ground-truth trajectory")
        return figure


def _panels(count: int, height: float = 3.0, shared: bool = False) -> tuple[Figure, list[Axes]]:
    """Return a figure of panels beside each other, at least one."""
    options: dict[str, Any] = {"sharey": shared, "squeeze": False, "layout": "constrained"}
    figure, axes = plt.subplots(1, max(count, 1), figsize=(3.2 * max(count, 1) + 1.0, height + 0.8), **options)
    plt.close(figure)
    return figure, list(axes[0])
