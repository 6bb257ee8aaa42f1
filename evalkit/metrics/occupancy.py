"""Holds the probabilities of a map against the truth, cell by cell, and tells how thick its walls are."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.metrics.consistency import NOTHING_DRAWN, WARP, wall_thicknesses, with_grid
from evalkit.metrics.table import Evidence, Metric, make_score, with_support

_EDGE = 1e-6  # cells: a centre this near to an edge lies on it


def find_true_states(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[Bools, Bools]:
    """Which cells (H, W) of a map are occupied in truth, and which are free; the others are not known.

    Occupied: the centre of an occupied cell of the true map lies in the cell or on its edge. Free: the centre of a free
    one does, and of no occupied one. The true map must not be coarser; neither lattice is moved, so that a true map of
    half the cell size or less blurs the truth by a quarter of a cell at most.
    """
    if true.resolution_m > mapped.resolution_m * (1.0 + _EDGE):
        raise ValueError(f"true: its cells of {true.resolution_m} m are coarser than the map's {mapped.resolution_m} m")
    occupied = _touched(mapped, true, true.occupied())
    return occupied, _touched(mapped, true, true.free()) & ~occupied


def log_loss(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[float, int]:
    """Mean of -ln p of the true state (nats) over the observed cells whose true state is known, and how many they are.

    A proper score (Good, 1952): it is least, in the mean, for the right probabilities; a map that knows nothing has ln
    2. (nan, 0) where no such cell is.
    """
    occupied, free = find_true_states(mapped, true)
    known = mapped.observed & (occupied | free)
    if not known.any():
        return float("nan"), 0
    log_odds = mapped.log_odds[known].astype(np.float64)
    signed = np.where(occupied[known], -log_odds, log_odds)
    return float(np.logaddexp(0.0, signed).mean()), int(known.sum())


def wall_width_m(mapped: OccupancyGrid, threshold: float = 0.65) -> float:
    """How thick the walls of a map are drawn (m): the mean over places where its occupied cells lie along a line.

    n cells of size r side by side spread by r^2 (n^2 - 1) / 12 across the wall, so a spread s^2 is a width of
    sqrt(12 s^2 + r^2). nan where no occupied cells lie along a line.
    """
    centres = mapped.centres(mapped.occupied(threshold))
    if len(centres) == 0:
        return float("nan")
    spread, _ = wall_thicknesses(centres)
    return float(np.sqrt(12.0 * spread**2 + mapped.resolution_m**2).mean()) if len(spread) else float("nan")


def _touched(mapped: OccupancyGrid, true: OccupancyGrid, cells: Bools) -> Bools:
    """The cells (H, W) of a map that hold the centre of one of the cells of the true map, or have one on their edge."""
    height, width = mapped.shape
    marked = np.zeros((height, width), dtype=np.bool_)
    rows, columns = np.nonzero(cells)
    for at_y in _reached(true.origin_y, true, mapped.origin_y, mapped, len(cells)):
        for at_x in _reached(true.origin_x, true, mapped.origin_x, mapped, cells.shape[1]):
            y, x = at_y[rows], at_x[columns]
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            marked[y[inside], x[inside]] = True
    return marked


def _reached(own_m: float, grid: OccupancyGrid, other_m: float, other: OccupancyGrid, count: int) -> tuple[Ints, ...]:
    """Along one axis: the other grid's cell (N,) of each centre, and a second answer where one lies on an edge."""
    places = (own_m + (np.arange(count) + 0.5) * grid.resolution_m - other_m) / other.resolution_m
    low, high = (np.floor(places + side).astype(np.int64) for side in (-_EDGE, _EDGE))
    return (low,) if (low == high).all() else (low, high)


def _log_loss(evidence: Evidence) -> Score:
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None:
        return Score(None, 0, "no true map")
    if mapped is None:
        return Score(None, 0, f"no map: {evidence.no_grid}")
    if true.resolution_m > mapped.resolution_m * (1.0 + _EDGE):
        return Score(None, 0, f"the true map's cells of {true.resolution_m:g} m are coarser than the map's")
    value, cells = log_loss(mapped, true)
    return (
        make_score(value, cells) if cells else Score(None, 0, "nothing that the map has observed is known to be true")
    )


def _wall_width(grid: OccupancyGrid) -> Score:
    width, cells = wall_width_m(grid), int(grid.occupied().sum())
    return Score(None, cells, "no occupied cells lie along a line") if np.isnan(width) else make_score(width, cells)


_ROWS = (
    Metric("map_log_loss", "map log-loss", "nat", "lower", "map against truth",
           "Mean of -ln p of the true state over the observed cells whose true state is known: 0 if all are right and "
           "certain, ln 2 for a map that knows nothing, more for one that is sure and wrong.",
           "Good, JRSS B 14, 1952 (a proper score)",
           "cells never observed; how far off a wall is; the mapper's clamping sets the least value", _log_loss),
    Metric("wall_width_m", "wall width in the map", "m", "lower", "map consistency",
           "How thick walls are drawn: where occupied cells lie along a line, the width of a band of cells that "
           "spreads as they do; mean over at most 1,000 places.", "evalkit",
           f"walls that smearing has washed out of the map; the cell size, which is the least value; {WARP}",
           with_grid(_wall_width)),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "map_log_loss": (
            "observed cells whose true state is known",
            (
                "no true map",
                "no map: ...",
                "the true map's cells of ... m are coarser than the map's",
                "nothing that the map has observed is known to be true",
            ),
        ),
        "wall_width_m": ("occupied cells", (*NOTHING_DRAWN, "no occupied cells lie along a line")),
    },
)
