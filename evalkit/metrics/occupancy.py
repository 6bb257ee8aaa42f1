"""Compare map probabilities with the ground-truth map cell by cell; width of the walls in the map."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.metrics.consistency import wall_thicknesses, with_cells
from evalkit.metrics.metric import find_occupied, find_surprises, make_metrics, make_score, with_true_grid

_EDGE = 1e-6  # cells: a centre at this distance from an edge counts as on the edge


def find_true_states(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[Bools, Bools]:
    """Return which cells (H, W) of a map are truly occupied and which are truly free; the others are unknown.

    Occupied: the cell or its edge contains the centre of an occupied cell of the true map. Free: it contains the centre
    of a free cell and of no occupied cell. The lattices are not shifted, so that a true map of at most half the cell
    size blurs the truth by at most a quarter of a cell. Raises ValueError if the true map is coarser.
    """
    if true.resolution_m > mapped.resolution_m * (1.0 + _EDGE):
        raise ValueError(f"true: its cells of {true.resolution_m} m are coarser than the map's {mapped.resolution_m} m")
    occupied = _find_touched(mapped, true, find_occupied(true))
    return occupied, _find_touched(mapped, true, true.free()) & ~occupied


def log_loss(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[float, int]:
    """Return the mean of -ln p of the true state (nat) over the observed cells with a known true state, and their
    number.

    A proper score (Good, 1952): its expectation is least for the right probabilities; a map without information has ln
    2. (nan, 0) without such a cell.
    """
    occupied, free = find_true_states(mapped, true)
    known = mapped.observed & (occupied | free)
    if not known.any():
        return float("nan"), 0
    wrong = np.maximum(np.where(occupied, -mapped.log_odds, mapped.log_odds), 0.0)  # more for the less likely state
    return float(np.mean((find_surprises(mapped) + wrong)[known])), int(np.count_nonzero(known))


def wall_width_m(mapped: OccupancyGrid) -> float:
    """Return the mean width of the walls in a map (m), over places where its occupied cells lie along a line.

    n adjacent cells of size r have a variance of r^2 (n^2 - 1) / 12 across the wall, so a variance s^2 is a width of
    sqrt(12 s^2 + r^2). nan if no occupied cells lie along a line.
    """
    centres = mapped.centres(mapped.occupied())
    if len(centres) == 0:
        return float("nan")
    spread, _ = wall_thicknesses(centres)
    return float(np.sqrt(12.0 * spread**2 + mapped.resolution_m**2).mean()) if len(spread) else float("nan")


def _find_touched(mapped: OccupancyGrid, true: OccupancyGrid, cells: Bools) -> Bools:
    """Return the cells (H, W) of a map that contain, or touch with an edge, the centre of one of ``cells`` of the true
    map.
    """
    height, width = mapped.shape
    marked = np.zeros((height, width), dtype=np.bool_)
    for at_y in _find_cells(true.origin_y, true, mapped.origin_y, mapped, len(cells)):
        for at_x in _find_cells(true.origin_x, true, mapped.origin_x, mapped, cells.shape[1]):
            if (np.diff(at_y) == 1).all() and (np.diff(at_x) == 1).all():  # cells of the same size: whole blocks
                into_y, own_y = _overlap(at_y[0], height, len(at_y))
                into_x, own_x = _overlap(at_x[0], width, len(at_x))
                marked[into_y, into_x] |= cells[own_y, own_x]
                continue
            rows, columns = np.nonzero(cells)
            y, x = at_y[rows], at_x[columns]
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            marked[y[inside], x[inside]] = True
    return marked


def _overlap(start: int, size: int, count: int) -> tuple[slice, slice]:
    """Return the places of ``count`` lines that begin at ``start`` within 0 to size - 1, and which lines these are."""
    low, high = max(start, 0), min(start + count, size)
    return slice(low, max(high, low)), slice(low - start, max(high, low) - start)


def _find_cells(
    own_m: float, grid: OccupancyGrid, other_m: float, other: OccupancyGrid, count: int
) -> tuple[Ints, ...]:
    """Return, along one axis, the other grid's cell (N,) of each centre, and a second array if a centre lies on an
    edge.
    """
    places = (own_m + (np.arange(count) + 0.5) * grid.resolution_m - other_m) / other.resolution_m
    low, high = (np.floor(places + side).astype(np.int64) for side in (-_EDGE, _EDGE))
    return (low,) if (low == high).all() else (low, high)


def _score_log_loss(mapped: OccupancyGrid, true: OccupancyGrid) -> Score:
    if true.resolution_m > mapped.resolution_m * (1.0 + _EDGE):
        reason = f"the cells of the ground-truth map ({true.resolution_m:g} m) are coarser than those of the map"
        return Score(None, reason=reason)
    value, cells = log_loss(mapped, true)
    return make_score(value, cells, _NO_TRUE_STATE)


def _score_wall_width(grid: OccupancyGrid) -> Score:
    width, cells = wall_width_m(grid), int(np.count_nonzero(find_occupied(grid)))
    return make_score(width, cells, _NO_LINE)


_NO_TRUE_STATE = "no observed cell of the map has a known true state"
_NO_LINE = "no occupied cells lie along a line"


METRICS = make_metrics(
    "occupancy",
    {
        "map_log_loss": with_true_grid(_score_log_loss),
        "wall_width_m": with_cells(_score_wall_width),
    },
)
