"""Holds the map of an estimate against the true map: which walls are there, and how far off."""

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
from evalkit.metrics.table import DIVERGED, Evidence, Metric, cached, make_score, with_support

TOLERANCE_M = 0.1
INLIER_M = 0.2
NO_WALL = "the map has no wall"
_SLACK_M = 1e-6  # cells exactly the tolerance apart are within it
_EDGE = 1e-6  # cells: a centre this near below an edge lies on it


@dataclass(frozen=True, eq=False)
class WallDistances:
    """Occupied cells of two maps: centres (N, 2) and (M, 2) in the world (m), and how far each is from the other map.

    ``to_true`` (N,), ``to_mapped`` (M,): distance from each centre to the nearest one of the other map (m).
    ``lattice``: the coarser of both grids.
    """

    mapped: Floats
    true: Floats
    to_true: Floats
    to_mapped: Floats
    lattice: OccupancyGrid


def compare_walls(mapped: OccupancyGrid, true: OccupancyGrid) -> WallDistances:
    """The occupied cells of both grids, which need not share origin or resolution; neither may be without any."""
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    coarser = max(true, mapped, key=lambda grid: grid.resolution_m)
    return WallDistances(ours, theirs, nearest_distances_m(ours, theirs), nearest_distances_m(theirs, ours), coarser)


def nearest_distances_m(points: ArrayLike, others: ArrayLike) -> Floats:
    """Distance (N,) from each point (N, 2) to the nearest of the others (M, 2), M > 0."""
    return np.asarray(build_kd_tree(np.asarray(others)).query(np.asarray(points))[0], dtype=np.float64)


def precision(found: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """The share of mapped cells within the tolerance of a true one."""
    return float(np.mean(found.to_true <= tolerance_m + _SLACK_M))


def recall(found: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """The share of true cells within the tolerance of a mapped one."""
    return float(np.mean(found.to_mapped <= tolerance_m + _SLACK_M))


def f1(found: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """The harmonic mean of precision and recall; 0 where both are."""
    p, r = precision(found, tolerance_m), recall(found, tolerance_m)
    return 2.0 * p * r / (p + r) if p + r > 0.0 else 0.0


def chamfer(found: WallDistances) -> float:
    """Half the sum of both mean distances (m)."""
    return float(0.5 * (found.to_true.mean() + found.to_mapped.mean()))


def iou(found: WallDistances) -> float:
    """Cells with a wall in both maps, of cells with a wall in either, on the lattice of the coarser grid."""
    ours, theirs = _keys(found.mapped, found.lattice), _keys(found.true, found.lattice)
    both = len(np.intersect1d(ours, theirs, assume_unique=True))
    return both / (len(ours) + len(theirs) - both)


def iou_within(found: WallDistances, tolerance_m: float = TOLERANCE_M) -> float:
    """Cells with a wall in either map within the tolerance of a wall in the other, of all, on the same lattice."""
    near = [
        found.mapped[found.to_true <= tolerance_m + _SLACK_M],
        found.true[found.to_mapped <= tolerance_m + _SLACK_M],
    ]
    either = len(np.union1d(_keys(found.mapped, found.lattice), _keys(found.true, found.lattice)))
    return len(np.union1d(_keys(near[0], found.lattice), _keys(near[1], found.lattice))) / either


def accuracy(found: WallDistances, inlier_m: float = INLIER_M) -> float:
    """Root mean square distance (m) of the mapped cells within ``inlier_m`` of a true one; nan without any."""
    inliers = found.to_true[found.to_true <= inlier_m + _SLACK_M]
    return float(np.sqrt(np.mean(inliers**2))) if len(inliers) else float("nan")


def _keys(points: Floats, lattice: OccupancyGrid) -> Ints:
    cells = np.floor((points - [lattice.origin_x, lattice.origin_y]) / lattice.resolution_m + 1e-6).astype(np.int64)
    return np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])


def _scored(
    measure: Callable[[WallDistances], float], without_walls: float | None = None
) -> Callable[[Evidence], Score]:
    """A measure of evidence; ``without_walls``: its value where the map has no wall at all."""

    def compute(evidence: Evidence) -> Score:
        found = _walls(evidence)
        if isinstance(found, str):
            return Score(without_walls if found == NO_WALL else None, 0, found)
        return make_score(measure(found), len(found.mapped) + len(found.true))

    return compute


@cached
def _walls(evidence: Evidence) -> WallDistances | str:
    """The walls of both maps, or why there are none to compare."""
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None or not true.occupied().any():
        return "no true map" if true is None else "the true map has no wall"
    if mapped is None:
        return f"no map: {evidence.no_grid}"
    return compare_walls(mapped, true) if mapped.occupied().any() else NO_WALL


def _accuracy(evidence: Evidence) -> Score:
    found = _scored(accuracy)(evidence)
    return replace(found, reason=_NO_INLIER) if found.reason == DIVERGED else found


_NO_INLIER = f"no wall of the map is within {INLIER_M:g} m of a true one"


def map_coverage(mapped: OccupancyGrid, true: OccupancyGrid) -> float:
    """The share of the observed cells of the true map whose centre lies in an observed cell of the other."""
    rows, columns = find_cells(true, mapped)
    height, width = mapped.shape
    met = np.ix_((rows >= 0) & (rows < height), (columns >= 0) & (columns < width))
    seen = mapped.observed[np.ix_(rows[met[0].ravel()], columns[met[1].ravel()])]
    return float((true.observed[met] & seen).sum() / true.observed.sum())


def find_cells(grid: OccupancyGrid, other: OccupancyGrid) -> tuple[Ints, Ints]:
    """In which row of another grid each row (H,) of a grid has its centres, and in which column each column (W,)."""
    found = []
    for own, theirs, count in zip(
        (grid.origin_y, grid.origin_x), (other.origin_y, other.origin_x), grid.shape, strict=True
    ):
        centres = own + (np.arange(count) + 0.5) * grid.resolution_m
        found.append(np.floor((centres - theirs) / other.resolution_m + _EDGE).astype(np.int64))
    return found[0], found[1]


def _coverage(evidence: Evidence) -> Score:
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None or not true.observed.any():
        return Score(None, 0, "no true map" if true is None else "nothing of the true map is observed")
    if mapped is None:
        return Score(None, 0, f"no map: {evidence.no_grid}")
    return make_score(100.0 * map_coverage(mapped, true), int(true.observed.sum()))


F1 = "precision and recall with a distance tolerance, as for boundaries in Martin et al., PAMI 26(5), 2004"
ALIGNED = "errors within the tolerance; the map is drawn in the frame that fits the true trajectory best"
MAPEVAL = "Hu et al., MapEval, RA-L 2025"
CELLS = "Occupied cells (p > 0.65) of the map of the estimated trajectory"

_ROWS = (
    Metric("map_f1", "map F1 at 10 cm", "", "higher", "map against truth",
           "Harmonic mean of wall precision and wall recall at 10 cm.", F1, ALIGNED,
           _scored(f1, 0.0), headline=True),
    Metric("map_precision", "wall precision at 10 cm", "", "higher", "map against truth",
           f"{CELLS} whose centre is within 10 cm of the centre of a true wall cell, of all.", F1,
           f"walls that are missing; {ALIGNED}", _scored(precision)),
    Metric("map_recall", "wall recall at 10 cm", "", "higher", "map against truth",
           "True wall cells within 10 cm of an occupied cell, of all; the true map holds only walls that can be seen "
           "from the true path.", F1, f"walls drawn twice; {ALIGNED}", _scored(recall, 0.0)),
    Metric("map_chamfer_m", "map Chamfer distance", "m", "lower", "map against truth",
           "Half the sum of the mean distance from mapped to true wall cells and from true to mapped ones.",
           "Barrow et al., IJCAI 1977; both directions", "how many walls are wrong: few far or many near",
           _scored(chamfer)),
    Metric("map_wall_mean_m", "distance to the true wall, mean", "m", "lower", "map against truth",
           f"{CELLS}: mean distance to the nearest true wall cell.", "evalkit", "walls that are missing",
           _scored(lambda found: float(found.to_true.mean()))),
    Metric("map_wall_p95_m", "distance to the true wall, 95 %", "m", "lower", "map against truth",
           f"{CELLS}: 95th percentile of the distance to the nearest true wall cell.", "evalkit",
           "walls that are missing; the worst twentieth",
           _scored(lambda found: float(np.percentile(found.to_true, 95)))),
    Metric("map_iou", "map IoU", "", "higher", "map against truth",
           "Cells with a wall in both maps, of cells with a wall in either, at the coarser resolution of the two, "
           "without tolerance.", "Jaccard, 1912", "how far off a wall is: one cell is as bad as ten",
           _scored(iou)),
    Metric("map_iou_10cm", "map IoU within 10 cm", "", "higher", "map against truth",
           "Cells with a wall in either map that have a wall of the other within 10 cm, of all cells with a wall in "
           "either, at the coarser resolution of the two.", "Jaccard, 1912, with a tolerance band", ALIGNED,
           _scored(iou_within, 0.0)),
    Metric("map_ac_m", "accuracy of near walls (AC)", "m", "lower", "map against truth",
           f"{CELLS} within {INLIER_M:g} m of a true wall cell: root mean square of that distance.", MAPEVAL,
           f"walls farther off than {INLIER_M:g} m and walls that are missing: read it with completeness", _accuracy),
    Metric("map_com", "completeness (COM)", "", "higher", "map against truth",
           f"True wall cells within {INLIER_M:g} m of an occupied cell, of all; counted over the true cells, so "
           "that it cannot exceed 1.", MAPEVAL, f"walls drawn twice; errors below {INLIER_M:g} m",
           _scored(lambda found: recall(found, INLIER_M), 0.0)),
    Metric("map_knn_m", "K-NN normalised error", "m", "lower", "map against truth",
           "Mean distance from a true wall cell to the nearest occupied cell.",
           "Santos, Portugal and Rocha, SSRR 2013; used by Trejos et al., Sensors 22, 6903, 2022 (there in cells)",
           "walls drawn twice; one wall far off weighs as many a little off",
           _scored(lambda found: float(found.to_mapped.mean()))),
    Metric("map_coverage_percent", "true map covered", "%", "higher", "map against truth",
           "Cells that the true map has observed whose centre lies in a cell that the map has observed, of all.",
           "evalkit", "whether what is there is right", _coverage, 1),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "map_coverage_percent": (
            "observed cells of the true map",
            ("no true map", "nothing of the true map is observed", "no map: ..."),
        ),
        "map_ac_m": (
            "occupied cells of both maps",
            (
                "no true map",
                "the true map has no wall",
                "no map: ...",
                NO_WALL,
                "no wall of the map is within ... m of a true one",
            ),
        ),
        "*": (
            "occupied cells of both maps",
            ("no true map", "the true map has no wall", "no map: ...", NO_WALL),
        ),
    },
)
