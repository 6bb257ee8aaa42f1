"""Compare the occupied cells of the map of an estimate with those of the ground-truth map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.lattice import distances_to_walls_m
from evalkit.metrics.metric import (
    DIVERGED,
    NO_TRUE_MAP,
    Evidence,
    MissingMap,
    cached,
    find_occupied,
    make_metrics,
    make_score,
    with_true_grid,
)

TOLERANCE_M = 0.1
INLIER_M = 0.2
NO_WALL = "the map has no wall"
NO_TRUE_WALL = "the ground-truth map has no wall"
_SLACK_M = 1e-6  # cells at exactly the tolerance are within it
_EDGE = 1e-6  # cells: a centre at this distance from an edge counts as on the edge


@dataclass(frozen=True, eq=False)
class WallDistances:
    """Distances between the occupied cells of two maps.

    ``mapped`` (N, 2), ``true`` (M, 2): cell centres in the world (m). ``to_true`` (N,), ``to_mapped`` (M,): distance to
    the nearest cell of the other map (m). ``lattice``: the grid with the coarser cells.
    """

    mapped: Floats
    true: Floats
    to_true: Floats
    to_mapped: Floats
    lattice: OccupancyGrid

    @cached_property
    def sides(self) -> list[tuple[Ints, Ints]]:
        """The numbers (N,), (M,) of the lattice's cells in which the mapped and the true cells lie.

        Four times if centres lie on edges, as those of lattices half a cell apart do: for both sides along x and y, so
        that none is preferred.
        """

        def find(*side: float) -> tuple[Ints, Ints]:
            return _index_cells(self.mapped, self.lattice, side), _index_cells(self.true, self.lattice, side)

        upper, lower = find(_EDGE, _EDGE), find(-_EDGE, -_EDGE)
        if all((one == other).all() for one, other in zip(upper, lower, strict=True)):
            return [upper]
        return [upper, lower, find(_EDGE, -_EDGE), find(-_EDGE, _EDGE)]


def compare_walls(mapped: OccupancyGrid, true: OccupancyGrid) -> WallDistances:
    """Return the distances between the occupied cells of two grids; both need at least one.

    The grids may differ in origin and resolution.
    """
    ours, theirs = find_occupied(mapped), find_occupied(true)
    coarser = max(true, mapped, key=lambda grid: grid.resolution_m)
    to_true = distances_to_walls_m(mapped, np.flatnonzero(ours), true)
    to_mapped = distances_to_walls_m(true, np.flatnonzero(theirs), mapped)
    return WallDistances(mapped.centres(ours), true.centres(theirs), to_true, to_mapped, coarser)


def precision(walls: WallDistances) -> float:
    """Return the share of mapped cells within the tolerance of a true cell."""
    return float(np.mean(walls.to_true <= TOLERANCE_M + _SLACK_M))


def recall(walls: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Return the share of true cells within the tolerance of a mapped cell."""
    return float(np.mean(walls.to_mapped <= tolerance_m + _SLACK_M))


def f1(walls: WallDistances) -> float:
    """Return the harmonic mean of precision and recall; 0 if both are 0."""
    p, r = precision(walls), recall(walls)
    return 2.0 * p * r / (p + r) if p + r > 0.0 else 0.0


def chamfer(walls: WallDistances) -> float:
    """Return half the sum of both mean distances (m)."""
    return float(0.5 * (walls.to_true.mean() + walls.to_mapped.mean()))


def iou(walls: WallDistances) -> float:
    """Return the cells with a wall in both maps, divided by the cells with a wall in either, on the coarser lattice.

    Mean over the sides of edges on which centres lie.
    """
    either = [_count_cells(np.concatenate(cells)) for cells in walls.sides]
    both = [sum(map(_count_cells, cells)) - count for cells, count in zip(walls.sides, either, strict=True)]
    return float(np.mean(np.divide(both, either)))


def iou_within(walls: WallDistances) -> float:
    """Return the share of cells with a wall in either map that lie within the tolerance of a wall in the other map.

    On the coarser lattice; mean over the sides of edges on which centres lie.
    """
    near = np.concatenate([walls.to_true, walls.to_mapped]) <= TOLERANCE_M + _SLACK_M
    cells = [np.concatenate(own) for own in walls.sides]
    return float(np.mean([_count_cells(each[near]) / _count_cells(each) for each in cells]))


def accuracy(walls: WallDistances, inlier_m: float = INLIER_M) -> float:
    """Return the root mean square distance (m) of the mapped cells within ``inlier_m`` of a true cell; nan if none."""
    inliers = walls.to_true[walls.to_true <= inlier_m + _SLACK_M]
    return float(np.sqrt(np.mean(inliers**2))) if len(inliers) else float("nan")


def _index_cells(points: Floats, lattice: OccupancyGrid, side: tuple[float, ...]) -> Ints:
    """Return the number (N,) of the cell of a lattice in which each point (N, 2) lies.

    ``side``: what is added along x and y, in cells, and decides for points on an edge.
    """
    places = (points - [lattice.origin_x, lattice.origin_y]) / lattice.resolution_m
    cells = np.floor(places + side).astype(np.int64)
    return np.asarray(cells[:, 0] * (1 << 32) + cells[:, 1])


def _count_cells(cells: Ints) -> int:
    """Return how many different cells there are among some (N,); np.unique takes twenty times as long."""
    ordered = np.sort(cells)
    return len(ordered) - int(np.count_nonzero(ordered[1:] == ordered[:-1]))


def _score_with(
    measure: Callable[[WallDistances], float], without_walls: float | None = None, not_finite: str = DIVERGED
) -> Callable[[Evidence], Score]:
    """Return a measure of the walls as a function of the evidence.

    ``without_walls``: the value if the map has no occupied cell. ``not_finite``: the reason if the measure is nan.
    """

    def compute(evidence: Evidence) -> Score:
        walls = _compare_walls(evidence)
        if isinstance(walls, Score):
            return replace(walls, value=without_walls) if walls is _WITHOUT_WALL else walls
        return make_score(measure(walls), len(walls.mapped) + len(walls.true), not_finite)

    return compute


_WITHOUT_WALL = Score(None, reason=NO_WALL)


@cached
def _compare_walls(evidence: Evidence) -> WallDistances | Score:
    """Return the distances between the walls of both maps, or a score without value if they are missing."""
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None or not find_occupied(true).any():
        return Score(None, reason=NO_TRUE_MAP if true is None else NO_TRUE_WALL)
    if isinstance(mapped, MissingMap):
        return Score(None, reason=f"no map: {mapped.reason}")
    return compare_walls(mapped, true) if find_occupied(mapped).any() else _WITHOUT_WALL


_NO_INLIER = f"no wall of the map is within {INLIER_M:g} m of a true wall"


def map_coverage(mapped: OccupancyGrid, true: OccupancyGrid) -> float:
    """Return the share of the observed cells of the true map whose centre lies in an observed cell of the map."""
    rows, columns = find_cells(true, mapped)
    height, width = mapped.shape
    met = np.ix_((rows >= 0) & (rows < height), (columns >= 0) & (columns < width))
    lines = rows[met[0].ravel()], columns[met[1].ravel()]
    whole = all(len(at) and (np.diff(at) == 1).all() for at in lines)  # cells of the same size: a block
    seen = mapped.observed[tuple(slice(at[0], at[-1] + 1) for at in lines) if whole else np.ix_(*lines)]
    return float(np.count_nonzero(true.observed[met] & seen) / np.count_nonzero(true.observed))


def find_cells(grid: OccupancyGrid, other: OccupancyGrid) -> tuple[Ints, Ints]:
    """Return the row (H,) and the column (W,) of another grid that contain the cell centres of a grid."""
    cells = []
    for own, theirs, count in zip(
        (grid.origin_y, grid.origin_x), (other.origin_y, other.origin_x), grid.shape, strict=True
    ):
        centres = own + (np.arange(count) + 0.5) * grid.resolution_m
        cells.append(np.floor((centres - theirs) / other.resolution_m + _EDGE).astype(np.int64))
    return cells[0], cells[1]


def _score_coverage(mapped: OccupancyGrid, true: OccupancyGrid) -> Score:
    if not true.observed.any():
        return Score(None, reason=_NOTHING_OBSERVED)
    return make_score(100.0 * map_coverage(mapped, true), int(np.count_nonzero(true.observed)))


_NOTHING_OBSERVED = "the ground-truth map has no observed cell"


METRICS = make_metrics(
    "maps",
    {
        "map_f1": _score_with(f1, 0.0),
        "map_precision": _score_with(precision),
        "map_recall": _score_with(recall, 0.0),
        "map_chamfer_m": _score_with(chamfer),
        "map_wall_mean_m": _score_with(lambda walls: float(walls.to_true.mean())),
        "map_wall_p95_m": _score_with(lambda walls: float(np.percentile(walls.to_true, 95))),
        "map_iou": _score_with(iou),
        "map_iou_10cm": _score_with(iou_within, 0.0),
        "map_ac_m": _score_with(accuracy, not_finite=_NO_INLIER),
        "map_com": _score_with(lambda walls: recall(walls, INLIER_M), 0.0),
        "map_knn_m": _score_with(lambda walls: float(walls.to_mapped.mean())),
        "map_coverage_percent": with_true_grid(_score_coverage),
    },
    INLIER_M=INLIER_M,
)
