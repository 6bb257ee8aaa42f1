"""A flat world of straight walls and circles, and the one ray caster of evalkit."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats

_BLOCK = 192  # beams cast together: fits the cache, and their sector is narrow enough to exclude most walls
_OVERLAP = 1e-9  # share by which walls are lengthened, so that rounding opens no gap at a corner
_PARALLEL = 1e-9  # m: a wall whose ends lie within this distance of the beam's line counts as parallel: not hit


@dataclass(frozen=True, eq=False)
class World:
    """Walls ``segments`` (S, 4) as x1, y1, x2, y2 and ``circles`` (C, 3) as x, y, radius, in metres.

    Boundaries reflect beams from both sides. Raises ValueError for a wall of zero length or a radius that is not
    positive.
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
            raise ValueError("segments: a wall has zero length")
        if (self.circles[:, 2] <= 0.0).any():
            raise ValueError("circles: a radius is not positive")

    def cast(self, origins: ArrayLike, angles: ArrayLike) -> Floats:
        """Return the distances (B,) in m to the nearest boundary along beams from ``origins`` (B, 2).

        ``angles`` (B,) are in the world frame (rad). The distance is ``inf`` where a beam hits nothing; a beam
        parallel to a wall does not hit that wall. Fastest when consecutive beams are close together, as in a scan.
        """
        starts = np.asarray(origins, dtype=np.float64)
        bearings = np.asarray(angles, dtype=np.float64)
        directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        ranges = np.empty(len(bearings))
        for first in range(0, len(bearings), _BLOCK):
            beams = slice(first, first + _BLOCK)
            segments, circles = self._select_ahead(starts[beams], directions[beams])
            ranges[beams] = np.minimum(
                _cast_to_segments(starts[beams], directions[beams], segments),
                _cast_to_circles(starts[beams], directions[beams], circles),
            )
        return ranges

    def clearance(self, points: ArrayLike) -> Floats:
        """Return the distances (N,) in m from points (N, 2) to the nearest boundary."""
        return np.asarray(self._distances(np.asarray(points, dtype=np.float64)).min(axis=1, initial=np.inf))

    def normals(self, points: ArrayLike) -> Floats:
        """Return the unit normals (N, 2) of the boundary nearest to each point (N, 2); a circle's points outwards."""
        at = np.asarray(points, dtype=np.float64)
        nearest = self._distances(at).argmin(axis=1)
        along = self.segments[:, 2:] - self.segments[:, :2]
        wall = nearest < len(along)
        normals = np.empty_like(at)
        normals[wall] = np.stack([-along[:, 1], along[:, 0]], axis=1)[nearest[wall]]
        normals[~wall] = at[~wall] - self.circles[nearest[~wall] - len(along), :2]
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))

    def _distances(self, points: Floats) -> Floats:
        """Return the distances (N, S + C) from points (N, 2) to every segment, then to every circle."""
        at = points[:, None, :]
        start, along = self.segments[:, :2], self.segments[:, 2:] - self.segments[:, :2]
        share = np.clip(((at - start) * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
        to_walls = np.linalg.norm(at - start - share[..., None] * along, axis=-1)
        to_circles = np.abs(np.linalg.norm(at - self.circles[:, :2], axis=-1) - self.circles[:, 2])
        return np.concatenate([to_walls, to_circles], axis=1)

    def _select_ahead(self, origins: Floats, directions: Floats) -> tuple[Floats, Floats]:
        """Return the segments and circles that reach into the sector covered by these beams."""
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


def closed_outline(corners: ArrayLike) -> Floats:
    """Return the walls (N, 4) of the closed polygon through ``corners`` (N, 2), in m."""
    points = np.asarray(corners, dtype=np.float64)
    return np.concatenate([points, np.roll(points, -1, axis=0)], axis=1)


def _cast_to_segments(origins: Floats, directions: Floats, segments: Floats) -> Floats:
    """Return the distances (B,) to the nearest segment: Cramer's rule on origin + t direction = start + u along."""
    along = segments[:, 2:] - segments[:, :2]
    start_cross_along = segments[:, 0] * along[:, 1] - segments[:, 1] * along[:, 0]
    origin_cross_direction = origins[:, 0] * directions[:, 1] - origins[:, 1] * directions[:, 0]
    # matrix products avoid (B, S) temporaries
    normals = np.stack([along[:, 1], -along[:, 0]])
    tilt = directions @ normals
    distance = start_cross_along - origins @ normals
    share = directions @ np.stack([-segments[:, 1], segments[:, 0]]) - origin_cross_direction[:, None]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance /= tilt
        share /= tilt
    missed = ~((np.abs(tilt) > _PARALLEL) & (distance >= 0.0) & (share >= -_OVERLAP) & (share <= 1.0 + _OVERLAP))
    distance[missed] = np.inf
    return np.asarray(distance.min(axis=1, initial=np.inf))


def _cast_to_circles(origins: Floats, directions: Floats, circles: Floats) -> Floats:
    """Return the distances (B,) to the nearest circle: the first crossing ahead, from outside or inside."""
    if not len(circles):
        return np.full(len(origins), np.inf)
    ahead = directions @ circles[:, :2].T - (origins * directions).sum(axis=1)[:, None]
    aside = (
        directions @ np.stack([circles[:, 1], -circles[:, 0]])
        - (directions[:, 0] * origins[:, 1] - directions[:, 1] * origins[:, 0])[:, None]
    )
    with np.errstate(invalid="ignore"):  # nan, the root of a negative number, is a miss
        half_chord = np.sqrt(circles[:, 2] ** 2 - aside**2)
    near, far = ahead - half_chord, ahead + half_chord
    distance = np.where(near >= 0.0, near, np.where(far >= 0.0, far, np.inf))
    return np.asarray(distance.min(axis=1, initial=np.inf))
