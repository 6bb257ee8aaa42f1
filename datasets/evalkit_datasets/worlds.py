"""Flat worlds of straight walls and round obstacles: what a beam meets there, and what a perfect map shows."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats

_BLOCK = 192  # beams cast together: small enough for the cache, and a sector narrow enough to leave most walls out
_OVERLAP = 1e-9  # share by which walls are longer than drawn, so that no beam slips through a corner by rounding
_ALONG = 1e-9  # m: a wall whose end is no further off the beam's direction is not met, only passed along
_CERTAIN = 5.0  # log-odds of a cell whose state is known


@dataclass(frozen=True, eq=False)
class World:
    """Walls ``segments`` (S, 4) of x1, y1, x2, y2 and ``circles`` (C, 3) of x, y, radius, all in metres.

    Every boundary is seen from both sides. ValueError for a wall without length or a circle without radius.
    """

    segments: Floats
    circles: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        for name, width in (("segments", 4), ("circles", 3)):
            rows = np.array(getattr(self, name), dtype=np.float64).reshape(-1, width)
            if not np.isfinite(rows).all():
                raise ValueError(f"{name}: not finite at row {int(np.argmax(~np.isfinite(rows).all(axis=1)))}")
            rows.flags.writeable = False
            object.__setattr__(self, name, rows)
        if (self.segments[:, :2] == self.segments[:, 2:]).all(axis=1).any():
            raise ValueError("segments: a wall begins where it ends")
        if (self.circles[:, 2] <= 0.0).any():
            raise ValueError("circles: a radius is not positive")

    def cast(self, origins: ArrayLike, angles: ArrayLike) -> Floats:
        """The distances (B,) in m along beams, each from its own origin (B, 2) at its angle (B,) in the world frame.

        ``inf`` where a beam meets nothing. A beam exactly along a wall does not meet that wall.
        Quickest when neighbouring beams leave near each other in similar directions, as in a scan.
        """
        starts = np.asarray(origins, dtype=np.float64)
        bearings = np.asarray(angles, dtype=np.float64)
        directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        ranges = np.empty(len(bearings))
        for first in range(0, len(bearings), _BLOCK):
            beams = slice(first, first + _BLOCK)
            segments, circles = self._ahead(starts[beams], directions[beams])
            ranges[beams] = np.minimum(
                _to_segments(starts[beams], directions[beams], segments),
                _to_circles(starts[beams], directions[beams], circles),
            )
        return ranges

    def clearance(self, points: ArrayLike) -> Floats:
        """The distances (N,) in m from points (N, 2) to the nearest boundary."""
        at = np.asarray(points, dtype=np.float64)[:, None, :]
        start, along = self.segments[:, :2], self.segments[:, 2:] - self.segments[:, :2]
        share = np.clip(((at - start) * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
        to_walls = np.linalg.norm(at - start - share[..., None] * along, axis=-1)
        to_circles = np.abs(np.linalg.norm(at - self.circles[:, :2], axis=-1) - self.circles[:, 2])
        return np.asarray(np.concatenate([to_walls, to_circles], axis=1).min(axis=1, initial=np.inf))

    def _ahead(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """The segments and circles that lie neither wholly left nor wholly right of the sector these beams cover."""
        middle = directions.sum(axis=0)
        length = float(np.hypot(*middle))
        narrowest = float((directions @ middle).min()) / length if length > 1e-6 else -1.0
        if narrowest < 0.1:  # wider than about 168 degrees
            return self.segments, self.circles
        cos, sin = middle / length
        cos_half, sin_half = narrowest, np.sqrt(max(1.0 - narrowest**2, 0.0))
        # inward normals of the sector's right and left edge, as columns
        inward = np.array(
            [
                [-(sin * cos_half - cos * sin_half), sin * cos_half + cos * sin_half],
                [cos * cos_half + sin * sin_half, -(cos * cos_half - sin * sin_half)],
            ]
        )
        centre = origins.mean(axis=0)
        slack = float(np.linalg.norm(origins - centre, axis=1).max()) + 1e-6
        ends = (self.segments.reshape(-1, 2, 2) - centre) @ inward
        seen = (ends.max(axis=1) >= -slack).all(axis=1)
        near = ((self.circles[:, :2] - centre) @ inward >= -slack - self.circles[:, 2:]).all(axis=1)
        return self.segments[seen], self.circles[near]


def truth_grid(world: World, resolution_m: float, seen_from: ArrayLike, range_m: float = 12.0) -> OccupancyGrid:
    """The map a perfect lidar would draw from the positions ``seen_from`` (N, 2), in the world frame.

    Free: the cells whose centre is in sight of a position, within ``range_m``. Occupied: the cells a boundary passes
    through, however little, that touch free ones (8 neighbours). All else is unobserved: the inside of a box, the far
    side of a pillar. Multiples of the resolution are cell centres, so that a wall drawn on one is not moved by half
    a cell. ValueError if a position stands on a boundary.
    """
    positions = np.asarray(seen_from, dtype=np.float64)
    return _grid(world.segments.tobytes(), world.circles.tobytes(), resolution_m, positions.tobytes(), range_m)


@lru_cache(maxsize=8)  # seeds of one drive share it, and it takes half a second
def _grid(segments: bytes, circles: bytes, resolution_m: float, seen_from: bytes, range_m: float) -> OccupancyGrid:
    world = World(np.frombuffer(segments).reshape(-1, 4), np.frombuffer(circles).reshape(-1, 3))
    positions = np.frombuffer(seen_from).reshape(-1, 2)
    corner = np.floor(positions.min(axis=0) / resolution_m - range_m / resolution_m - 2.0)
    origin = (corner + 0.5) * resolution_m
    shape = (np.ceil((positions.max(axis=0) + range_m - origin) / resolution_m) + 2.0).astype(np.int64)
    boundary = _mask(_boundary_cells(world, resolution_m, origin), shape)
    path = _mask(np.floor((positions - origin) / resolution_m).astype(np.int64), shape)
    if (path & boundary).any():
        raise ValueError("seen_from: a position stands on a boundary")
    # what can be reached without crossing a boundary: only there is it worth casting beams
    within = ndimage.distance_transform_edt(~path) * resolution_m <= range_m
    regions, _ = ndimage.label(within & ~boundary)
    rows, columns = np.nonzero(np.isin(regions, np.unique(regions[path])))
    free = np.zeros_like(path)
    centres = origin + resolution_m * (np.stack([columns, rows], axis=1) + 0.5)
    free[rows, columns] = _in_sight(world, centres, positions, range_m)
    occupied = boundary & ndimage.binary_dilation(free, np.ones((3, 3), dtype=np.bool_))
    return _cropped(free, occupied, resolution_m, origin)


def _in_sight(world: World, points: Floats, positions: Floats, range_m: float) -> Bools:
    """Which points (N, 2) are joined to one of the positions (K, 2) by a line that meets no boundary."""
    seen = np.zeros(len(points), dtype=np.bool_)
    for position in positions:
        x, y = (points - position).T
        asked = np.flatnonzero(~seen & (x**2 + y**2 <= range_m**2))
        bearings = np.arctan2(y[asked], x[asked])
        order = np.argsort(bearings)  # neighbouring beams together: casting leaves more out
        asked = asked[order]
        ranges = world.cast(np.broadcast_to(position, (len(asked), 2)), bearings[order])
        seen[asked] = np.hypot(x[asked], y[asked]) <= ranges
    return seen


def _cropped(free: Bools, occupied: Bools, resolution_m: float, origin: Floats) -> OccupancyGrid:
    """The grid of masks (H, W), cut to what is observed with one unobserved cell around it."""
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


def _boundary_cells(world: World, resolution_m: float, origin: Floats) -> Ints:
    """The columns and rows (N, 2) of the cells that boundaries pass through; repetitions are kept."""
    segments = (world.segments.reshape(-1, 2, 2) - origin) / resolution_m
    walls = [_cells_of_segment(start, end) for start, end in segments]
    circles = [
        _cells_of_circle((row[:2] - origin) / resolution_m, float(row[2]) / resolution_m) for row in world.circles
    ]
    return np.concatenate([np.zeros((0, 2), dtype=np.int64), *walls, *circles])


def _cells_of_segment(start: Floats, end: Floats) -> Ints:
    """The cells (N, 2) of a segment given in cells: between two crossings of the grid's lines it stays in one cell."""
    crossings = [np.array([0.0, 1.0])]
    for low, high in zip(start, end, strict=True):
        lines = np.arange(np.ceil(min(low, high)), np.floor(max(low, high)) + 1.0)
        if low != high:
            crossings.append((lines - low) / (high - low))
    shares = np.sort(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middles = 0.5 * (shares[1:] + shares[:-1])
    cells: Ints = np.floor(start + middles[:, None] * (end - start)).astype(np.int64)
    return cells


def _cells_of_circle(centre: Floats, radius: float) -> Ints:
    """The cells (N, 2) of a circle given in cells, by the same argument as for a segment."""
    columns = np.arange(np.ceil(centre[0] - radius), np.floor(centre[0] + radius) + 1.0)
    rows = np.arange(np.ceil(centre[1] - radius), np.floor(centre[1] + radius) + 1.0)
    from_x = np.arccos(np.clip((columns - centre[0]) / radius, -1.0, 1.0))
    from_y = np.arcsin(np.clip((rows - centre[1]) / radius, -1.0, 1.0))
    angles = np.sort(np.concatenate([from_x, -from_x, from_y, np.pi - from_y, [0.0]]) % (2.0 * np.pi))
    middles = 0.5 * (angles + np.append(angles[1:], angles[0] + 2.0 * np.pi))
    return np.floor(centre + radius * np.stack([np.cos(middles), np.sin(middles)], axis=1)).astype(np.int64)


def _mask(cells: Ints, shape: Ints) -> Bools:
    """The mask (rows, columns) of the columns and rows (N, 2) that lie inside a grid of ``shape`` columns and rows."""
    mask = np.zeros((int(shape[1]), int(shape[0])), dtype=np.bool_)
    inside = cells[((cells >= 0) & (cells < shape)).all(axis=1)]
    mask[inside[:, 1], inside[:, 0]] = True
    return mask


def _to_segments(origins: Floats, directions: Floats, segments: Floats) -> Floats:
    """The distances (B,) to the nearest segment, by Cramer's rule on origin + t direction = start + u along."""
    along = segments[:, 2:] - segments[:, :2]
    start_cross_along = segments[:, 0] * along[:, 1] - segments[:, 1] * along[:, 0]
    origin_cross_direction = origins[:, 0] * directions[:, 1] - origins[:, 1] * directions[:, 0]
    # one product of matrices each instead of (B, S) temporaries
    normals = np.stack([along[:, 1], -along[:, 0]])
    tilt = directions @ normals
    distance = start_cross_along - origins @ normals
    share = directions @ np.stack([-segments[:, 1], segments[:, 0]]) - origin_cross_direction[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance /= tilt
        share /= tilt
    missed = ~((np.abs(tilt) > _ALONG) & (distance >= 0.0) & (share >= -_OVERLAP) & (share <= 1.0 + _OVERLAP))
    distance[missed] = np.inf
    return np.asarray(distance.min(axis=1, initial=np.inf))


def _to_circles(origins: Floats, directions: Floats, circles: Floats) -> Floats:
    """The distances (B,) to the nearest circle: the first crossing ahead, from outside or from inside."""
    if not len(circles):
        return np.full(len(origins), np.inf)
    ahead = directions @ circles[:, :2].T - (origins * directions).sum(axis=1)[:, None]
    aside = (
        directions @ np.stack([circles[:, 1], -circles[:, 0]])
        - (directions[:, 0] * origins[:, 1] - directions[:, 1] * origins[:, 0])[:, None]
    )
    with np.errstate(invalid="ignore"):  # the root of a negative number, nan, is a miss
        half_chord = np.sqrt(circles[:, 2] ** 2 - aside**2)
    near, far = ahead - half_chord, ahead + half_chord
    distance = np.where(near >= 0.0, near, np.where(far >= 0.0, far, np.inf))
    return np.asarray(distance.min(axis=1, initial=np.inf))
