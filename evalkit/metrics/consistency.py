"""Map metrics without ground truth: entropy, wall thickness, corners, enclosed areas, agreement of two halves."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import permutations

import numpy as np

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.corners import find_corners
from evalkit.metrics.lattice import REACH, build_wall_tree, distances_to_walls_m, find_squared_distances
from evalkit.metrics.metric import (
    Evidence,
    MissingMap,
    PlacedScans,
    cached,
    find_occupied,
    find_probabilities,
    find_surprises,
    make_metrics,
    make_score,
    place_hits,
    with_grid,
)
from evalkit.metrics.neighbourhoods import (
    Neighbourhoods,
    PointCells,
    compute_neighbourhoods,
    sort_into_cells,
    thin_evenly,
)

MAX_HITS = 20_000
MAX_PLACES = 1000
MIN_WALL_SHARE = 0.05
MIN_AREA_CELLS = 4
CLEARED = -1.0
NOISE_M = 0.1
"""A hit at most this far from a wall of the other map counts as range noise, although its cell may be cleared."""
_HALF_DIAGONAL, _EDGE = math.sqrt(0.5), 1e-6  # of a cell
MIN_SHARED = 100
NO_HIT = "no mapped scan has a hit"
NO_OVERLAP = "the two halves of the run observed almost no common places"
_NO_CELLS = "the map has no occupied or no free cell"
_NO_HALVES = "the two halves of the run have no maps"


def map_entropy(grid: OccupancyGrid) -> float:
    """Return the mean entropy of the observed cells in nats: 0 if all are certain, ln 2 if nothing is known."""
    more = np.minimum(np.abs(grid.log_odds.astype(np.float64)), 700.0)  # beyond, the less likely state is certainly not
    p = find_probabilities(grid)
    entropies = find_surprises(grid) + more * np.minimum(p, 1.0 - p)
    return float(np.mean(entropies[grid.observed]))


def wall_thicknesses(hits: Floats) -> tuple[Floats, float]:
    """Return the wall thickness (K,) in metres where hits (N, 2), N > 0, lie along a line, and the share of such
    places.

    The thickness is sqrt(lambda_min) of the hits within 0.5 m of a hit, where lambda_max > 9 lambda_min. At most 20,000
    hits and 1,000 places, evenly spaced in the order of time.
    """
    return _measure_thicknesses(sample_neighbourhoods(hits))


def sample_neighbourhoods(hits: Floats) -> Neighbourhoods:
    """Return the neighbourhoods of at most 20,000 of the hits (N, 2), N > 0, around at most 1,000 of them."""
    points = thin_evenly(hits, MAX_HITS)
    return compute_neighbourhoods(points, thin_evenly(points, MAX_PLACES))


def _measure_thicknesses(places: Neighbourhoods) -> tuple[Floats, float]:
    return np.sqrt(places.small[places.flat]), float(places.flat.mean())


def occupied_share(grid: OccupancyGrid) -> float:
    """Return the number of occupied cells divided by the number of occupied and free cells, of which there is at least
    one.
    """
    occupied, free = np.count_nonzero(find_occupied(grid)), np.count_nonzero(grid.free())
    return float(occupied / (occupied + free))


def _score_corners(grid: OccupancyGrid) -> Score:
    return make_score(len(find_corners(grid)), int(np.count_nonzero(find_occupied(grid))))


def find_enclosed_areas(grid: OccupancyGrid) -> Ints:
    """Return the sizes (K,) in cells of the free areas enclosed by cells that are not free, without the largest area.

    Areas of fewer than 4 cells and areas at the border of the grid do not count.
    """
    from scipy import ndimage

    free = grid.free()
    labels, count = ndimage.label(free)
    sizes = np.bincount(labels.ravel())[1:]
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
    count = int(np.count_nonzero(observed))
    suspects = hits[observed & (log_odds < CLEARED)]
    rows, columns, _ = other.find_cells(suspects)
    squares, beyond = find_squared_distances(rows, columns, other)
    apart, within_cell = np.sqrt(squares), _HALF_DIAGONAL + _EDGE  # of the centres of cells; of a hit from its centre
    apart[beyond] = REACH  # or more
    near = (apart + within_cell) * other.resolution_m <= NOISE_M
    near[beyond] = False
    far = (apart - within_cell) * other.resolution_m > NOISE_M
    unclear = np.flatnonzero(~near & ~far)
    far[unclear] = np.isinf(build_wall_tree(other).query(suspects[unclear], distance_upper_bound=NOISE_M)[0])
    return (float(np.count_nonzero(far) / count), count) if count else (0.0, 0)


def split_distances(first: OccupancyGrid, second: OccupancyGrid) -> Floats:
    """Return the distance (N,) from the occupied cells of each map to the nearest occupied cell of the other.

    Only cells that the other map has observed count.
    """
    if not all(find_occupied(grid).any() for grid in (first, second)):
        return np.zeros(0)
    distances = []
    for grid, other in permutations((first, second)):
        own = find_occupied(grid)
        shared = np.flatnonzero(own)[look_up_cells(grid.centres(own), other)[1]]
        distances.append(distances_to_walls_m(grid, shared, other))
    return np.concatenate(distances)


def collect_hits(mapped: PlacedScans) -> Floats:
    """Return the hits (N, 2) of scans with known sensor poses, in the world (m)."""
    return np.concatenate([np.zeros((0, 2)), *map(place_hits, mapped)])


@cached
def collect_half_hits(evidence: Evidence) -> tuple[Floats, Floats]:
    """Return the hits (N, 2) of the first and of the second half of the mapped scans, in the world (m)."""
    middle = len(evidence.mapped) // 2
    return collect_hits(evidence.mapped[:middle]), collect_hits(evidence.mapped[middle:])


@cached
def collect_all_hits(evidence: Evidence) -> Floats:
    """Return the hits (N, 2) of all mapped scans, in the world (m)."""
    return np.concatenate(collect_half_hits(evidence))


@cached
def sample_all_hits(evidence: Evidence) -> PointCells:
    """Return at most 20,000 hits of all mapped scans, of which there is at least one, in cells."""
    return sort_into_cells(thin_evenly(collect_all_hits(evidence), MAX_HITS))


@cached
def sample_all_neighbourhoods(evidence: Evidence) -> Neighbourhoods:
    """Return the neighbourhoods of the hits of all mapped scans, of which there is at least one."""
    points = thin_evenly(collect_all_hits(evidence), MAX_HITS)
    return compute_neighbourhoods(sample_all_hits(evidence), thin_evenly(points, MAX_PLACES))


def look_up_cells(points: Floats, grid: OccupancyGrid) -> tuple[Floats, Bools]:
    """Return the log-odds (N,) at points (N, 2), and which points (N,) lie in observed cells."""
    rows, columns, inside = grid.find_cells(points)
    return grid.log_odds[rows, columns].astype(np.float64), np.asarray(inside & grid.observed[rows, columns])


def with_cells(measure: Callable[[OccupancyGrid], Score]) -> Callable[[Evidence], Score]:
    """Return ``measure`` of a map with occupied and free cells as a function of the evidence."""
    return with_grid(lambda grid: measure(grid) if _has_cells(grid) else Score(None, reason=_NO_CELLS))


@cached
def _has_cells(grid: OccupancyGrid) -> bool:
    return bool(find_occupied(grid).any() and grid.free().any())


def _make_thickness_score(statistic: Callable[[Floats], np.floating | float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        if len(collect_all_hits(evidence)) == 0:
            return Score(None, reason=NO_HIT)
        thicknesses, share = _compute_thicknesses(evidence)
        if share < MIN_WALL_SHARE:
            return Score(None, len(thicknesses), f"only {100.0 * share:.0f} % of the hits lie along a wall")
        return make_score(statistic(thicknesses), len(thicknesses))

    return compute


def _score_wall_share(evidence: Evidence) -> Score:
    points = collect_all_hits(evidence)
    if len(points) == 0:
        return Score(None, reason=NO_HIT)
    return make_score(100.0 * _compute_thicknesses(evidence)[1], min(len(points), MAX_PLACES))


@cached
def _compute_thicknesses(evidence: Evidence) -> tuple[Floats, float]:
    return _measure_thicknesses(sample_all_neighbourhoods(evidence))


@cached
def _find_mapped_areas(grid: OccupancyGrid) -> tuple[Ints, int]:
    """Return the sizes (K,) of the enclosed areas, and the number of free cells."""
    return find_enclosed_areas(grid), int(np.count_nonzero(grid.free()))


def _score_enclosed_areas(grid: OccupancyGrid) -> Score:
    areas, cells = _find_mapped_areas(grid)
    return make_score(len(areas), cells)


def _score_enclosed_size(grid: OccupancyGrid) -> Score:
    areas, cells = _find_mapped_areas(grid)
    return make_score(areas.sum() * grid.resolution_m**2, cells)


def _score_cleared(evidence: Evidence) -> Score:
    first, second = evidence.first_half, evidence.second_half
    if isinstance(first, MissingMap) or isinstance(second, MissingMap):
        return Score(None, reason=_NO_HALVES)
    earlier, later = collect_half_hits(evidence)
    one, shared_one = cleared_share(earlier, second)
    other, shared_other = cleared_share(later, first)
    if min(shared_one, shared_other) < MIN_SHARED:
        return Score(None, shared_one + shared_other, NO_OVERLAP)
    return make_score(50.0 * (one + other), shared_one + shared_other)


def _score_split(evidence: Evidence) -> Score:
    first, second = evidence.first_half, evidence.second_half
    if isinstance(first, MissingMap) or isinstance(second, MissingMap):
        return Score(None, reason=_NO_HALVES)
    distances = split_distances(first, second)
    if len(distances) < MIN_SHARED:
        return Score(None, len(distances), NO_OVERLAP)
    return make_score(distances.mean(), len(distances))


def _count_cells(grid: OccupancyGrid) -> int:
    return int(np.count_nonzero(find_occupied(grid) | grid.free()))


METRICS = make_metrics(
    "consistency",
    {
        "map_entropy": with_cells(lambda grid: make_score(map_entropy(grid), int(np.count_nonzero(grid.observed)))),
        "wall_thickness_m": _make_thickness_score(np.mean),
        "wall_thickness_p95_m": _make_thickness_score(lambda values: np.percentile(values, 95)),
        "wall_share_percent": _score_wall_share,
        "split_distance_m": _score_split,
        "cleared_percent": _score_cleared,
        "occupied_percent": with_cells(lambda grid: make_score(100.0 * occupied_share(grid), _count_cells(grid))),
        "corners": with_cells(_score_corners),
        "enclosed_areas": with_cells(_score_enclosed_areas),
        "enclosed_m2": with_cells(_score_enclosed_size),
    },
)
