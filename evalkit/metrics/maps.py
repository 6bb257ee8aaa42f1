"""Compare the occupied cells of the map of an estimate with those of the ground-truth map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.table import (
    DIVERGED,
    NO_TRUE_MAP,
    Evidence,
    Metric,
    MissingMap,
    cached,
    make_score,
    with_support,
    with_true_grid,
)

TOLERANCE_M = 0.1
INLIER_M = 0.2
NO_WALL = "the map has no wall"
NO_TRUE_WALL = "the ground-truth map has no wall"
_SLACK_M = 1e-6  # cells at exactly the tolerance are within it
_EDGE = 1e-6  # cells: a centre at this distance below an edge counts as on the edge


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


def compare_walls(mapped: OccupancyGrid, true: OccupancyGrid) -> WallDistances:
    """Return the distances between the occupied cells of two grids; both need at least one.

    The grids may differ in origin and resolution.
    """
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    coarser = max(true, mapped, key=lambda grid: grid.resolution_m)
    return WallDistances(ours, theirs, nearest_distances_m(ours, theirs), nearest_distances_m(theirs, ours), coarser)


def nearest_distances_m(points: ArrayLike, others: ArrayLike) -> Floats:
    """Return the distance (N,) from each point (N, 2) to the nearest of the others (M, 2), M > 0."""
    return np.asarray(build_kd_tree(np.asarray(others)).query(np.asarray(points))[0], dtype=np.float64)


def precision(walls: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Return the share of mapped cells within the tolerance of a true cell."""
    return float(np.mean(walls.to_true <= tolerance_m + _SLACK_M))


def recall(walls: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Return the share of true cells within the tolerance of a mapped cell."""
    return float(np.mean(walls.to_mapped <= tolerance_m + _SLACK_M))


def f1(walls: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Return the harmonic mean of precision and recall; 0 if both are 0."""
    p, r = precision(walls, tolerance_m), recall(walls, tolerance_m)
    return 2.0 * p * r / (p + r) if p + r > 0.0 else 0.0


def chamfer(walls: WallDistances) -> float:
    """Return half the sum of both mean distances (m)."""
    return float(0.5 * (walls.to_true.mean() + walls.to_mapped.mean()))


def iou(walls: WallDistances) -> float:
    """Return the cells with a wall in both maps, divided by the cells with a wall in either, on the coarser lattice."""
    ours, theirs = _index_cells(walls.mapped, walls.lattice), _index_cells(walls.true, walls.lattice)
    both = len(np.intersect1d(ours, theirs, assume_unique=True))
    return both / (len(ours) + len(theirs) - both)


def iou_within(walls: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Return the share of cells with a wall in either map that lie within the tolerance of a wall in the other map.

    On the coarser lattice.
    """
    near = [
        walls.mapped[walls.to_true <= tolerance_m + _SLACK_M],
        walls.true[walls.to_mapped <= tolerance_m + _SLACK_M],
    ]
    either = len(np.union1d(_index_cells(walls.mapped, walls.lattice), _index_cells(walls.true, walls.lattice)))
    return len(np.union1d(_index_cells(near[0], walls.lattice), _index_cells(near[1], walls.lattice))) / either


def accuracy(walls: WallDistances, inlier_m: float = INLIER_M) -> float:
    """Return the root mean square distance (m) of the mapped cells within ``inlier_m`` of a true cell; nan if none."""
    inliers = walls.to_true[walls.to_true <= inlier_m + _SLACK_M]
    return float(np.sqrt(np.mean(inliers**2))) if len(inliers) else float("nan")


def _index_cells(points: Floats, lattice: OccupancyGrid) -> Ints:
    cells = np.floor((points - [lattice.origin_x, lattice.origin_y]) / lattice.resolution_m + 1e-6).astype(np.int64)
    return np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])


def _scored(
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


_WITHOUT_WALL = Score(None, 0, NO_WALL)


@cached
def _compare_walls(evidence: Evidence) -> WallDistances | Score:
    """Return the distances between the walls of both maps, or a score without value if they are missing."""
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None or not true.occupied().any():
        return Score(None, 0, NO_TRUE_MAP if true is None else NO_TRUE_WALL)
    if isinstance(mapped, MissingMap):
        return Score(None, 0, f"no map: {mapped.reason}")
    return compare_walls(mapped, true) if mapped.occupied().any() else _WITHOUT_WALL


_NO_INLIER = f"no wall of the map is within {INLIER_M:g} m of a true wall"


def map_coverage(mapped: OccupancyGrid, true: OccupancyGrid) -> float:
    """Return the share of the observed cells of the true map whose centre lies in an observed cell of the map."""
    rows, columns = find_cells(true, mapped)
    height, width = mapped.shape
    met = np.ix_((rows >= 0) & (rows < height), (columns >= 0) & (columns < width))
    seen = mapped.observed[np.ix_(rows[met[0].ravel()], columns[met[1].ravel()])]
    return float((true.observed[met] & seen).sum() / true.observed.sum())


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
        return Score(None, 0, _NOTHING_OBSERVED)
    return make_score(100.0 * map_coverage(mapped, true), int(true.observed.sum()))


_NOTHING_OBSERVED = "the ground-truth map has no observed cell"

F1 = "precision and recall with a distance tolerance, as for boundaries in Martin et al., PAMI 26(5), 2004"
ALIGNED = "errors within the tolerance; errors removed by aligning the estimate to the true trajectory"
MAPEVAL = "Hu et al., MapEval, RA-L 2025"
CELLS = "occupied cells (p > 0.65) of the map of the estimated trajectory"

_ROWS = (
    Metric("map_f1", "map F1 at 10 cm", "", "higher", "map against truth",
           "Harmonic mean of wall precision and wall recall at 10 cm.", F1, ALIGNED,
           _scored(f1, 0.0), headline=True),
    Metric("map_precision", "wall precision at 10 cm", "", "higher", "map against truth",
           f"Share of the {CELLS} whose centre is within 10 cm of the centre of a true wall cell.", F1,
           f"missing walls; {ALIGNED}", _scored(precision)),
    Metric("map_recall", "wall recall at 10 cm", "", "higher", "map against truth",
           "Share of the true wall cells within 10 cm of an occupied cell; the ground-truth map contains only walls "
           "that are visible from the true path.", F1, f"duplicated walls; {ALIGNED}", _scored(recall, 0.0)),
    Metric("map_chamfer_m", "map Chamfer distance", "m", "lower", "map against truth",
           "Half the sum of the mean distance from mapped to true wall cells and from true to mapped wall cells.",
           "Barrow et al., IJCAI 1977; both directions", "whether few walls are far off or many walls a little",
           _scored(chamfer)),
    Metric("map_wall_mean_m", "distance to the true wall, mean", "m", "lower", "map against truth",
           f"Mean distance to the nearest true wall cell, over the {CELLS}.", "evalkit", "missing walls",
           _scored(lambda walls: float(walls.to_true.mean()))),
    Metric("map_wall_p95_m", "distance to the true wall, 95 %", "m", "lower", "map against truth",
           f"95th percentile of the distance to the nearest true wall cell, over the {CELLS}.", "evalkit",
           "missing walls; the worst 5 % of the cells",
           _scored(lambda walls: float(np.percentile(walls.to_true, 95)))),
    Metric("map_iou", "map IoU", "", "higher", "map against truth",
           "Number of cells with a wall in both maps divided by the number with a wall in either map, at the coarser "
           "resolution of the two, without tolerance.", "Jaccard, 1912",
           "the size of an error: one cell counts as much as ten",
           _scored(iou)),
    Metric("map_iou_10cm", "map IoU within 10 cm", "", "higher", "map against truth",
           "Share of the cells with a wall in either map that have a wall of the other map within 10 cm, at the "
           "coarser resolution of the two.", "Jaccard, 1912, with a tolerance band", ALIGNED,
           _scored(iou_within, 0.0)),
    Metric("map_ac_m", "accuracy of near walls (AC)", "m", "lower", "map against truth",
           f"Root mean square distance to the nearest true wall cell, over the {CELLS} within {INLIER_M:g} m of one.",
           MAPEVAL, f"walls more than {INLIER_M:g} m off and missing walls: read it together with completeness",
           _scored(accuracy, not_finite=_NO_INLIER)),
    Metric("map_com", "completeness (COM)", "", "higher", "map against truth",
           f"Share of the true wall cells within {INLIER_M:g} m of an occupied cell.", MAPEVAL,
           f"duplicated walls; errors below {INLIER_M:g} m", _scored(lambda walls: recall(walls, INLIER_M), 0.0)),
    Metric("map_knn_m", "K-NN normalised error", "m", "lower", "map against truth",
           "Mean distance from a true wall cell to the nearest occupied cell.",
           "Santos, Portugal and Rocha, SSRR 2013; used by Trejos et al., Sensors 22, 6903, 2022 (there in cells)",
           "duplicated walls; one wall far off counts as much as many a little off",
           _scored(lambda walls: float(walls.to_mapped.mean()))),
    Metric("map_coverage_percent", "ground-truth map covered", "%", "higher", "map against truth",
           "Share of the observed cells of the ground-truth map whose centre lies in an observed cell of the map.",
           "evalkit", "errors of the observed cells", with_true_grid(_score_coverage), 1),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "map_coverage_percent": (
            "observed cells of the ground-truth map",
            (NO_TRUE_MAP, _NOTHING_OBSERVED, "no map: ..."),
        ),
        "map_ac_m": (
            "occupied cells of both maps",
            (
                NO_TRUE_MAP,
                NO_TRUE_WALL,
                "no map: ...",
                NO_WALL,
                "no wall of the map is within ... m of a true wall",
            ),
        ),
        "*": (
            "occupied cells of both maps",
            (NO_TRUE_MAP, NO_TRUE_WALL, "no map: ...", NO_WALL),
        ),
    },
)
