"""Holds the map of an estimate against the true map: which walls are there, and how far off."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from evalkit.metrics.table import Evidence, Metric, number, standing_on
from evalkit.se2 import Floats
from evalkit.types import Ints, OccupancyGrid, Score

TOLERANCE_M = 0.1
_SLACK_M = 1e-6  # cells exactly the tolerance apart are within it


@dataclass(frozen=True, eq=False)
class Walls:
    """Occupied cells of two maps: centres (N, 2) and (M, 2) in the world (m), and how far each is from the other map.

    ``to_true`` (N,), ``to_mapped`` (M,): distance from each centre to the nearest one of the other map (m).
    """

    mapped: Floats
    true: Floats
    to_true: Floats
    to_mapped: Floats


def walls(mapped: OccupancyGrid, true: OccupancyGrid) -> Walls:
    """The occupied cells of both grids, which need not share origin or resolution; neither may be without any."""
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    return Walls(ours, theirs, nearest_m(ours, theirs), nearest_m(theirs, ours))


def nearest_m(points: ArrayLike, others: ArrayLike) -> Floats:
    """Distance (N,) from each point (N, 2) to the nearest of the others (M, 2), M > 0."""
    return np.asarray(cKDTree(np.asarray(others)).query(np.asarray(points))[0], dtype=np.float64)


def precision(found: Walls, tolerance_m: float = TOLERANCE_M) -> float:
    """The share of mapped cells within the tolerance of a true one."""
    return float(np.mean(found.to_true <= tolerance_m + _SLACK_M))


def recall(found: Walls, tolerance_m: float = TOLERANCE_M) -> float:
    """The share of true cells within the tolerance of a mapped one."""
    return float(np.mean(found.to_mapped <= tolerance_m + _SLACK_M))


def f1(found: Walls, tolerance_m: float = TOLERANCE_M) -> float:
    """The harmonic mean of precision and recall; 0 where both are."""
    p, r = precision(found, tolerance_m), recall(found, tolerance_m)
    return 2.0 * p * r / (p + r) if p + r > 0.0 else 0.0


def chamfer(found: Walls) -> float:
    """Half the sum of both mean distances (m)."""
    return float(0.5 * (found.to_true.mean() + found.to_mapped.mean()))


def iou(found: Walls, lattice: OccupancyGrid) -> float:
    """Cells with a wall in both maps, of cells with a wall in either, on the lattice of the coarser grid."""
    ours, theirs = _keys(found.mapped, lattice), _keys(found.true, lattice)
    both = len(np.intersect1d(ours, theirs))
    return both / (len(ours) + len(theirs) - both)


def _keys(points: Floats, lattice: OccupancyGrid) -> Ints:
    cells = np.floor((points - [lattice.origin_x, lattice.origin_y]) / lattice.resolution_m + 1e-6).astype(np.int64)
    return np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])


def _scored(
    measure: Callable[[Walls, OccupancyGrid, OccupancyGrid], float], without_walls: float | None = None
) -> Callable[[Evidence], Score]:
    """A measure of evidence; ``without_walls``: its value where the map has no wall at all."""

    def compute(evidence: Evidence) -> Score:
        true, mapped = evidence.truth.grid, evidence.grid
        if true is None or not true.occupied().any():
            return Score(None, 0, "no true map" if true is None else "the true map has no wall")
        if mapped is None:
            return Score(None, 0, f"no map: {evidence.no_grid}")
        if not mapped.occupied().any():
            return Score(without_walls, 0, "the map has no wall")
        found = walls(mapped, true)
        return number(measure(found, mapped, true), len(found.mapped) + len(found.true))

    return compute


def coverage(mapped: OccupancyGrid, true: OccupancyGrid) -> float:
    """The share of the observed cells of the true map whose centre lies in an observed cell of the other."""
    places = true.centres(true.observed)
    cells = np.floor((places - [mapped.origin_x, mapped.origin_y]) / mapped.resolution_m).astype(np.int64)
    inside = ((cells >= 0) & (cells < mapped.shape[::-1])).all(axis=1)
    return float(mapped.observed[cells[inside, 1], cells[inside, 0]].sum() / len(places))


def _coverage(evidence: Evidence) -> Score:
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None or not true.observed.any():
        return Score(None, 0, "no true map" if true is None else "nothing of the true map is observed")
    if mapped is None:
        return Score(None, 0, f"no map: {evidence.no_grid}")
    return number(100.0 * coverage(mapped, true), int(true.observed.sum()))


F1 = "precision and recall with a distance tolerance, as for boundaries in Martin et al., PAMI 26(5), 2004"
ALIGNED = "errors within the tolerance; the map is drawn in the frame that fits the true trajectory best"
CELLS = "Occupied cells (p > 0.65) of the map of the estimated trajectory"

_ROWS = (
    Metric("map_f1", "map F1 at 10 cm", "", "higher", "map against truth",
           "Harmonic mean of wall precision and wall recall at 10 cm.", F1, ALIGNED,
           _scored(lambda found, *_: f1(found), 0.0), headline=True),
    Metric("map_precision", "wall precision at 10 cm", "", "higher", "map against truth",
           f"{CELLS} whose centre is within 10 cm of the centre of a true wall cell, of all.", F1,
           f"walls that are missing; {ALIGNED}", _scored(lambda found, *_: precision(found))),
    Metric("map_recall", "wall recall at 10 cm", "", "higher", "map against truth",
           "True wall cells within 10 cm of an occupied cell, of all; the true map holds only walls that can be seen "
           "from the true path.", F1, f"walls drawn twice; {ALIGNED}", _scored(lambda found, *_: recall(found), 0.0)),
    Metric("map_chamfer_m", "map Chamfer distance", "m", "lower", "map against truth",
           "Half the sum of the mean distance from mapped to true wall cells and from true to mapped ones.",
           "Barrow et al., IJCAI 1977; both directions", "how many walls are wrong: few far or many near",
           _scored(lambda found, *_: chamfer(found))),
    Metric("map_wall_mean_m", "distance to the true wall, mean", "m", "lower", "map against truth",
           f"{CELLS}: mean distance to the nearest true wall cell.", "evalkit", "walls that are missing",
           _scored(lambda found, *_: float(found.to_true.mean()))),
    Metric("map_wall_p95_m", "distance to the true wall, 95 %", "m", "lower", "map against truth",
           f"{CELLS}: 95th percentile of the distance to the nearest true wall cell.", "evalkit",
           "walls that are missing; the worst twentieth",
           _scored(lambda found, *_: float(np.percentile(found.to_true, 95)))),
    Metric("map_iou", "map IoU", "", "higher", "map against truth",
           "Cells with a wall in both maps, of cells with a wall in either, at the coarser resolution of the two, "
           "without tolerance.", "Jaccard, 1912", "how far off a wall is: one cell is as bad as ten",
           _scored(lambda found, mapped, true: iou(found, max(true, mapped, key=lambda grid: grid.resolution_m)))),
    Metric("map_coverage_percent", "true map covered", "%", "higher", "map against truth",
           "Cells that the true map has observed whose centre lies in a cell that the map has observed, of all.",
           "evalkit", "whether what is there is right", _coverage, 1),
)  # fmt: skip

METRICS = standing_on(
    _ROWS,
    {
        "map_coverage_percent": (
            "observed cells of the true map",
            ("no true map", "nothing of the true map is observed", "no map: ..."),
        ),
        "*": (
            "occupied cells of both maps",
            ("no true map", "the true map has no wall", "no map: ...", "the map has no wall"),
        ),
    },
)
