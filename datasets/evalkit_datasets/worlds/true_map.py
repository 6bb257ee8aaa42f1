"""The occupancy grid that a perfect lidar would map in a simulated world: the true map of a synthetic sequence."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats
from evalkit.core.world import World

_CERTAIN = 5.0  # log-odds of a cell whose state is known


def build_true_grid(world: World, resolution_m: float, seen_from: ArrayLike, range_m: float = 12.0) -> OccupancyGrid:
    """Return the grid that a perfect lidar maps from the positions ``seen_from`` (N, 2), in the world frame.

    A cell is free if its centre is visible from a position within ``range_m``. It is occupied if a boundary passes
    through it and it touches a free cell (8 neighbours). All other cells are unobserved, such as the inside of a box.
    Multiples of the resolution are cell centres, so that a wall on such a line is not shifted by half a cell. Raises
    ValueError if a position is on a boundary.
    """
    positions = np.asarray(seen_from, dtype=np.float64)
    return _build_cached(world.segments.tobytes(), world.circles.tobytes(), resolution_m, positions.tobytes(), range_m)


@lru_cache(maxsize=8)  # shared by all seeds of a drive; takes half a second
def _build_cached(
    segments: bytes, circles: bytes, resolution_m: float, seen_from: bytes, range_m: float
) -> OccupancyGrid:
    from scipy import ndimage  # noqa: PLC0415 - the specs of data sets are listed without SciPy

    world = World(np.frombuffer(segments).reshape(-1, 4), np.frombuffer(circles).reshape(-1, 3))
    positions = np.frombuffer(seen_from).reshape(-1, 2)
    corner = np.floor(positions.min(axis=0) / resolution_m - range_m / resolution_m - 2.0)
    origin = (corner + 0.5) * resolution_m
    shape = (np.ceil((positions.max(axis=0) + range_m - origin) / resolution_m) + 2.0).astype(np.int64)
    boundary = _make_mask(_find_boundary_cells(world, resolution_m, origin), shape)
    path = _make_mask(np.floor((positions - origin) / resolution_m).astype(np.int64), shape)
    if (path & boundary).any():
        raise ValueError("seen_from: a position is on a boundary")
    # beams are cast only into regions connected to the path
    within = ndimage.distance_transform_edt(~path) * resolution_m <= range_m
    regions, _ = ndimage.label(within & ~boundary)
    rows, columns = np.nonzero(np.isin(regions, np.unique(regions[path])))
    free = np.zeros_like(path)
    centres = origin + resolution_m * (np.stack([columns, rows], axis=1) + 0.5)
    free[rows, columns] = _find_visible(world, centres, positions, range_m)
    occupied = boundary & ndimage.binary_dilation(free, np.ones((3, 3), dtype=np.bool_))
    return _crop(free, occupied, resolution_m, origin)


def _find_visible(world: World, points: Floats, positions: Floats, range_m: float) -> Bools:
    """Return which points (N, 2) are visible from at least one of the positions (K, 2)."""
    seen = np.zeros(len(points), dtype=np.bool_)
    for position in positions:
        x, y = (points - position).T
        candidates = np.flatnonzero(~seen & (x**2 + y**2 <= range_m**2))
        bearings = np.arctan2(y[candidates], x[candidates])
        order = np.argsort(bearings)  # neighbouring beams together: casting excludes more walls
        candidates = candidates[order]
        ranges = world.cast(np.broadcast_to(position, (len(candidates), 2)), bearings[order])
        seen[candidates] = np.hypot(x[candidates], y[candidates]) <= ranges
    return seen


def _crop(free: Bools, occupied: Bools, resolution_m: float, origin: Floats) -> OccupancyGrid:
    """Return the grid of masks (H, W), cropped to the observed cells and a border of one unobserved cell."""
    observed = free | occupied
    rows, columns = np.flatnonzero(observed.any(axis=1)), np.flatnonzero(observed.any(axis=0))
    top, left = rows[0] - 1, columns[0] - 1
    cut = (slice(top, rows[-1] + 2), slice(left, columns[-1] + 2))
    log_odds = np.where(occupied, _CERTAIN, np.where(free, -_CERTAIN, 0.0)).astype(np.float32)
    return OccupancyGrid(
        log_odds[cut],
        observed[cut],
        resolution_m,
        float(origin[0] + left * resolution_m),
        float(origin[1] + top * resolution_m),
    )


def _find_boundary_cells(world: World, resolution_m: float, origin: Floats) -> Ints:
    """Return columns and rows (N, 2) of the cells that boundaries pass through; may contain duplicates."""
    segments = (world.segments.reshape(-1, 2, 2) - origin) / resolution_m
    walls = [_find_segment_cells(start, end) for start, end in segments]
    circles = [
        _find_circle_cells((row[:2] - origin) / resolution_m, float(row[2]) / resolution_m) for row in world.circles
    ]
    return np.concatenate([np.zeros((0, 2), dtype=np.int64), *walls, *circles])


def _find_segment_cells(start: Floats, end: Floats) -> Ints:
    """Return the cells (N, 2) of a segment given in cell units: between two grid lines it stays in one cell."""
    crossings = [np.array([0.0, 1.0])]
    for low, high in zip(start, end, strict=True):
        lines = np.arange(np.ceil(min(low, high)), np.floor(max(low, high)) + 1.0)
        if low != high:
            crossings.append((lines - low) / (high - low))
    shares = np.sort(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middles = 0.5 * (shares[1:] + shares[:-1])
    cells: Ints = np.floor(start + middles[:, None] * (end - start)).astype(np.int64)
    return cells


def _find_circle_cells(centre: Floats, radius: float) -> Ints:
    """Return the cells (N, 2) of a circle given in cell units, found in the same way as for a segment."""
    columns = np.arange(np.ceil(centre[0] - radius), np.floor(centre[0] + radius) + 1.0)
    rows = np.arange(np.ceil(centre[1] - radius), np.floor(centre[1] + radius) + 1.0)
    from_x = np.arccos(np.clip((columns - centre[0]) / radius, -1.0, 1.0))
    from_y = np.arcsin(np.clip((rows - centre[1]) / radius, -1.0, 1.0))
    angles = np.sort(np.concatenate([from_x, -from_x, from_y, np.pi - from_y, [0.0]]) % (2.0 * np.pi))
    middles = 0.5 * (angles + np.append(angles[1:], angles[0] + 2.0 * np.pi))
    return np.floor(centre + radius * np.stack([np.cos(middles), np.sin(middles)], axis=1)).astype(np.int64)


def _make_mask(cells: Ints, shape: Ints) -> Bools:
    """Return the mask (rows, columns) of cells (N, 2) given as column and row; cells outside ``shape`` are ignored."""
    mask = np.zeros((int(shape[1]), int(shape[0])), dtype=np.bool_)
    inside = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
    mask[inside[:, 1], inside[:, 0]] = True
    return mask
