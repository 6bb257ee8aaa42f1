"""Map metrics without ground truth: entropy, wall thickness, corners, enclosed areas, agreement of two halves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.maps import nearest_distances_m
from evalkit.metrics.neighbourhoods import build_kd_tree, compute_neighbourhoods, thin_evenly
from evalkit.metrics.table import (
    DIVERGED,
    Evidence,
    Metric,
    MissingMap,
    PlacedScans,
    cached,
    make_score,
    with_grid,
    with_support,
)

MAX_HITS = 20_000
MAX_PLACES = 1000
MIN_WALL_SHARE = 0.05
CORNER_APART_M = 0.2
CORNER_RESPONSE = 1.8e-5
"""In units of (occupied - free)^4. Right angles of walls 2 to 5 cells thick give 2e-5 to 1e-4, slanted walls less."""
_RIM = 8
"""Empty cells added around the image in which corners are detected."""
MIN_AREA_CELLS = 4
CLEARED = -1.0
NOISE_M = 0.1
"""A hit at most this far from a wall of the other map counts as range noise, although its cell may be cleared."""
MIN_SHARED = 100
NO_HIT = "no mapped scan has a hit"
NO_OVERLAP = "the two halves of the run observed almost no common places"
_NO_CELLS = "the map has no occupied or no free cell"
_NO_HALVES = "the two halves of the run have no maps"


def map_entropy(grid: OccupancyGrid) -> float:
    """Return the mean entropy of the observed cells in nats: 0 if all are certain, ln 2 if nothing is known."""
    p = grid.probability()[grid.observed]
    p = np.clip(p, 1e-12, 1.0 - 1e-12)
    return float(-np.mean(p * np.log(p) + (1.0 - p) * np.log(1.0 - p)))


def wall_thicknesses(hits: Floats) -> tuple[Floats, float]:
    """Return the wall thickness (K,) in metres where hits (N, 2), N > 0, lie along a line, and the share of such
    places.

    The thickness is sqrt(lambda_min) of the hits within 0.5 m of a hit, where lambda_max > 9 lambda_min. At most 20,000
    hits and 1,000 places, evenly spaced in the order of time.
    """
    points = thin_evenly(hits, MAX_HITS)
    places = compute_neighbourhoods(points, thin_evenly(points, MAX_PLACES))
    return np.sqrt(places.small[places.flat]), float(places.flat.mean())


def occupied_share(grid: OccupancyGrid) -> float:
    """Return the number of occupied cells divided by the number of occupied and free cells, of which there is at least
    one.
    """
    occupied, free = grid.occupied().sum(), grid.free().sum()
    return float(occupied / (occupied + free))


def find_corners(grid: OccupancyGrid) -> Floats:
    """Return the corners (K, 2) of the occupied cells in the world (m).

    Laplacian of Gaussian (1 cell) of the 0/1 image, Harris response (window 1.5 cells, k = 0.05), peaks above an
    absolute threshold, at most one within 0.2 m.
    """
    from scipy import ndimage

    occupied = grid.occupied()
    if not occupied.any():
        return np.zeros((0, 2))
    rows, columns = (np.flatnonzero(occupied.any(axis=axis)) for axis in (1, 0))
    image = np.pad(occupied[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], _RIM).astype(np.float32)
    edges = -ndimage.gaussian_laplace(image, 1.0)
    x, y = (ndimage.gaussian_filter(edges, 1.0, order=order) for order in ((0, 1), (1, 0)))
    xx, xy, yy = (ndimage.gaussian_filter(product, 1.5) for product in (x * x, x * y, y * y))
    response = xx * yy - xy * xy - 0.05 * (xx + yy) ** 2
    reach = max(int(np.ceil(CORNER_APART_M / grid.resolution_m)), 1)
    peaks = (response > CORNER_RESPONSE) & (response == ndimage.maximum_filter(response, 2 * reach + 1))
    labels, count = ndimage.label(peaks, np.ones((3, 3)))
    cluster, places = labels[peaks] - 1, np.argwhere(peaks)
    sizes = np.bincount(cluster, minlength=count)
    at = np.stack([np.bincount(cluster, along, minlength=count) / sizes for along in places.T], axis=-1)
    cells = at[:, ::-1] - _RIM + [columns[0], rows[0]]
    return np.asarray([grid.origin_x, grid.origin_y] + (cells + 0.5) * grid.resolution_m)


@cached
def find_mapped_corners(evidence: Evidence) -> Floats:
    """Return the corners (K, 2) of the map (m); none without a map."""
    return np.zeros((0, 2)) if isinstance(evidence.grid, MissingMap) else find_corners(evidence.grid)


def _score_corners(evidence: Evidence) -> Score:
    return with_cells(lambda grid: make_score(len(find_mapped_corners(evidence)), int(grid.occupied().sum())))(evidence)


def find_enclosed_areas(grid: OccupancyGrid) -> Ints:
    """Return the sizes (K,) in cells of the free areas enclosed by cells that are not free, without the largest area.

    Areas of fewer than 4 cells and areas at the border of the grid do not count.
    """
    from scipy import ndimage

    free = grid.free()
    labels, count = ndimage.label(free)
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    kept = sizes >= MIN_AREA_CELLS
    if count:
        kept[np.argmax(sizes)] = False
    border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    kept[border[border > 0] - 1] = False
    return np.asarray(sizes[kept], dtype=np.int64)


def cleared_share(hits: Floats, other: OccupancyGrid) -> tuple[float, int]:
    """Return the share of hits (N, 2) in free space of the other map, and the number of hits in cells it has observed.

    Free space: cells with log-odds < -1, without the centre of an occupied cell within 0.1 m.
    """
    log_odds, observed = look_up_cells(hits, other)
    count = int(observed.sum())
    suspects = hits[observed & (log_odds < CLEARED)]
    walls = build_kd_tree(other.centres(other.occupied()))
    far = np.isinf(walls.query(suspects, distance_upper_bound=NOISE_M)[0])
    return (float(far.sum() / count), count) if count else (0.0, 0)


def split_distances(first: OccupancyGrid, second: OccupancyGrid) -> Floats:
    """Return the distance (N,) from the occupied cells of each map to the nearest occupied cell of the other.

    Only cells that the other map has observed count.
    """
    cells = [grid.centres(grid.occupied()) for grid in (first, second)]
    if not all(map(len, cells)):
        return np.zeros(0)
    shared = [cells[0][look_up_cells(cells[0], second)[1]], cells[1][look_up_cells(cells[1], first)[1]]]
    return np.concatenate([nearest_distances_m(shared[0], cells[1]), nearest_distances_m(shared[1], cells[0])])


def collect_hits(mapped: PlacedScans) -> Floats:
    """Return the hits (N, 2) of scans with known sensor poses, in the world (m)."""
    return np.concatenate([np.zeros((0, 2)), *(se2.transform(pose, scan.points()) for scan, pose in mapped)])


@cached
def collect_all_hits(evidence: Evidence) -> Floats:
    """Return the hits (N, 2) of all mapped scans, in the world (m)."""
    return collect_hits(evidence.mapped)


def look_up_cells(points: Floats, grid: OccupancyGrid) -> tuple[Floats, Bools]:
    """Return the log-odds (N,) at points (N, 2), and which points (N,) lie in observed cells."""
    cells = np.floor((points - [grid.origin_x, grid.origin_y]) / grid.resolution_m).astype(np.int64)
    rows, columns = cells[:, 1], cells[:, 0]
    height, width = grid.shape
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    rows, columns = np.where(inside, rows, 0), np.where(inside, columns, 0)
    return grid.log_odds[rows, columns].astype(np.float64), np.asarray(inside & grid.observed[rows, columns])


def with_cells(measure: Callable[[OccupancyGrid], Score]) -> Callable[[Evidence], Score]:
    """Return ``measure`` of a map with occupied and free cells as a function of the evidence."""

    def check(grid: OccupancyGrid) -> Score:
        if not grid.occupied().any() or not grid.free().any():
            return Score(None, 0, _NO_CELLS)
        return measure(grid)

    return with_grid(check)


def _make_thickness_score(statistic: Callable[[Floats], np.floating | float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        if len(collect_all_hits(evidence)) == 0:
            return Score(None, 0, NO_HIT)
        thicknesses, share = _compute_thicknesses(evidence)
        if share < MIN_WALL_SHARE:
            return Score(None, len(thicknesses), f"only {100.0 * share:.0f} % of the hits lie along a wall")
        return make_score(statistic(thicknesses), len(thicknesses))

    return compute


def _score_wall_share(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, 0, NO_HIT)
    return make_score(100.0 * _compute_thicknesses(evidence)[1], min(len(points), MAX_PLACES))


@cached
def _compute_thicknesses(evidence: Evidence) -> tuple[Floats, float]:
    return wall_thicknesses(collect_all_hits(evidence))


def _score_enclosed_areas(grid: OccupancyGrid) -> Score:
    return make_score(len(find_enclosed_areas(grid)), int(grid.free().sum()))


def _score_enclosed_size(grid: OccupancyGrid) -> Score:
    return make_score(find_enclosed_areas(grid).sum() * grid.resolution_m**2, int(grid.free().sum()))


def _score_cleared(evidence: Evidence) -> Score:
    first, second, middle = evidence.first_half, evidence.second_half, len(evidence.mapped) // 2
    if isinstance(first, MissingMap) or isinstance(second, MissingMap):
        return Score(None, 0, _NO_HALVES)
    one, shared_one = cleared_share(collect_hits(evidence.mapped[:middle]), second)
    other, shared_other = cleared_share(collect_hits(evidence.mapped[middle:]), first)
    if min(shared_one, shared_other) < MIN_SHARED:
        return Score(None, shared_one + shared_other, NO_OVERLAP)
    return make_score(50.0 * (one + other), shared_one + shared_other)


def _score_split(evidence: Evidence) -> Score:
    first, second = evidence.first_half, evidence.second_half
    if isinstance(first, MissingMap) or isinstance(second, MissingMap):
        return Score(None, 0, _NO_HALVES)
    distances = split_distances(first, second)
    if len(distances) < MIN_SHARED:
        return Score(None, len(distances), NO_OVERLAP)
    return make_score(distances.mean(), len(distances))


def _count_cells(grid: OccupancyGrid) -> int:
    return int((grid.occupied() | grid.free()).sum())


FILATOV = "after Filatov et al., arXiv 1708.02354, 2017; thresholds and units frozen by evalkit"
WARP = "a smooth warp of the whole map; only maps of the same scans by the same mapper are comparable"
WALL = "Spread sqrt(lambda_min) across the wall of the hits within 0.5 m of a hit, where they lie along a line"

_ROWS = (
    Metric("map_entropy", "map entropy", "nat", "lower", "map consistency",
           "Mean entropy of the occupancy over the observed cells.", "Blanco et al., RSS 2008 (map "
           "entropy); per observed cell: evalkit",
           f"scans scattered over unobserved cells, which lower it, so that it is uninformative in a bare room; {WARP}",
           with_cells(lambda grid: make_score(map_entropy(grid), int(grid.observed.sum()))), 4),
    Metric("wall_thickness_m", "wall thickness", "m", "lower", "map consistency",
           f"{WALL} (lambda_max > 9 lambda_min), over all mapped scans; mean over at most 1,000 places. A wall of "
           "width w gives w / sqrt(12).", "after Razlaw et al., ECMR 2015 (mean plane variance)",
           f"duplicated walls so far apart that they do not count as a line; {WARP}",
           _make_thickness_score(np.mean)),
    Metric("wall_thickness_p95_m", "wall thickness, 95 %", "m", "lower", "map consistency",
           f"{WALL}; 95th percentile.", "as wall thickness",
           f"duplicated walls so far apart that they do not count as a line; {WARP}",
           _make_thickness_score(lambda values: np.percentile(values, 95))),
    Metric("wall_share_percent", "hits along a wall", "%", "higher", "map consistency",
           "Share of the examined places at which the hits within 0.5 m lie along a line.", "as wall thickness",
           f"the thickness of the walls; furniture and corners lower it; {WARP}", _score_wall_share, 1),
    Metric("split_distance_m", "distance between the halves of the run", "m", "lower", "map consistency",
           "Mean distance from the occupied cells of the map of one half of the run, observed in the other half, to "
           "the nearest occupied cell of the other half's map; over both directions.", "evalkit",
           f"drift within places observed in one half only; {WARP}", _score_split, headline=True),
    Metric("cleared_percent", "free-space violation", "%", "lower", "map consistency",
           "Share of the hits of one half of the run, in cells observed in the other half, that lie in cleared cells "
           "(log-odds < -1) without an occupied cell within 10 cm; mean of both directions.", "evalkit",
           "walls duplicated less than 10 cm apart; drift along a wall. Sensor noise and pedestrians raise it: with 5 "
           "cm (1 sigma) of noise, perfect poses give 2 to 6 %; " + WARP,
           _score_cleared, 2),
    Metric("occupied_percent", "occupied share", "%", "", "map consistency",
           "Number of occupied cells (p > 0.65) divided by the number of occupied and free (p < 0.196) cells.", FILATOV,
           "most errors: blurred walls can raise or lower it",
           with_cells(lambda grid: make_score(100.0 * occupied_share(grid), _count_cells(grid))), 2),
    Metric("corners", "corners", "", "lower", "map consistency",
           "Number of corners of the occupied cells: Harris peaks of their Laplacian of Gaussian, at most one in 0.2 "
           "m.",
           FILATOV, f"walls so blurred that they have no corners; {WARP}",
           _score_corners, 0),
    Metric("enclosed_areas", "enclosed areas", "", "lower", "map consistency",
           "Number of free areas of at least 4 cells enclosed by occupied or unknown cells, without the largest area "
           "and without areas at the border of the grid.",
           FILATOV, f"duplicated walls without a gap between them; {WARP}", with_cells(_score_enclosed_areas), 0),
    Metric("enclosed_m2", "enclosed area", "m2", "lower", "map consistency",
           "Total size of the enclosed areas.", FILATOV, f"duplicated walls without a gap between them; {WARP}",
           with_cells(_score_enclosed_size), 2),
)  # fmt: skip

NO_MAP = ("no map: ...", _NO_CELLS)
"""Reasons for a missing value of a metric of the map."""

_HALVES = (_NO_HALVES, NO_OVERLAP)

METRICS = with_support(
    _ROWS,
    {
        "map_entropy": ("observed cells", NO_MAP),
        "wall_thickness*": (
            "places where hits lie along a line",
            (NO_HIT, "only ... % of the hits lie along a wall", DIVERGED),
        ),
        "wall_share_percent": ("places examined", (NO_HIT, DIVERGED)),
        "split_distance_m": ("occupied cells observed in the other half", _HALVES),
        "cleared_percent": ("hits in cells observed in the other half", _HALVES),
        "occupied_percent": ("occupied and free cells", NO_MAP),
        "corners": ("occupied cells", NO_MAP),
        "enclosed_*": ("free cells", NO_MAP),
    },
)
