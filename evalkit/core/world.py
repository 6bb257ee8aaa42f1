"""A flat world of straight walls and circles, and the one ray caster of evalkit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats

_BLOCK = 24  # consecutive beams that share candidates: their sector is narrow and excludes most boundaries
_TOGETHER = 64  # blocks computed at once: their arrays fit the cache
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
        blocks = -(-len(bearings) // _BLOCK)
        filled = np.minimum(np.arange(blocks * _BLOCK), len(bearings) - 1).reshape(blocks, _BLOCK)  # by the last beam
        ranges = np.full((blocks, _BLOCK), np.inf)
        for first in range(0, blocks, _TOGETHER):
            some = filled[first : first + _TOGETHER]
            x, y = starts[some].transpose(2, 0, 1)
            beams = _Beams(x, y, np.cos(bearings[some]), np.sin(bearings[some]))
            sectors = _find_sectors(beams)
            for reached, distances_to, boundaries in (
                (_segments_reached, _distances_to_segments, self.segments),
                (_circles_reached, _distances_to_circles, self.circles),
            ):
                block, boundary = np.nonzero(reached(sectors, boundaries))
                if len(block):
                    distances = distances_to(beams.take(block), boundaries[boundary].T[..., None])
                    begins = np.flatnonzero(np.diff(block, prepend=-1))  # the pairs of a block are consecutive
                    own = first + block[begins]
                    ranges[own] = np.minimum(ranges[own], np.minimum.reduceat(distances, begins, axis=0))
        return ranges.reshape(-1)[: len(bearings)]

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


def closed_outline(corners: ArrayLike) -> Floats:
    """Return the walls (N, 4) of the closed polygon through ``corners`` (N, 2), in m."""
    points = np.asarray(corners, dtype=np.float64)
    return np.concatenate([points, np.roll(points, -1, axis=0)], axis=1)


class _Beams(NamedTuple):
    """Beams in N blocks (N, B): origins in m and unit directions."""

    x: Floats
    y: Floats
    cos: Floats
    sin: Floats

    def take(self, blocks: Ints) -> _Beams:
        return _Beams(*(values[blocks] for values in self))


class _Sectors(NamedTuple):
    """Sectors that contain the beams of N blocks, as two half planes each: x nx + y ny >= least, all (2, N, 1)."""

    nx: Floats
    ny: Floats
    least: Floats


def _find_sectors(beams: _Beams) -> _Sectors:
    """Return the sectors of blocks of beams; the whole plane for a block wider than about 168 degrees."""
    middle_x, middle_y = beams.cos.sum(axis=1), beams.sin.sum(axis=1)
    length = np.maximum(np.hypot(middle_x, middle_y), 1e-6)
    cos, sin = middle_x / length, middle_y / length
    cos_half = (beams.cos * cos[:, None] + beams.sin * sin[:, None]).min(axis=1)
    sin_half = np.sqrt(np.maximum(1.0 - cos_half**2, 0.0))
    # inward normals of the right and of the left edge
    nx = np.stack([cos * sin_half - sin * cos_half, cos * sin_half + sin * cos_half])
    ny = np.stack([cos * cos_half + sin * sin_half, sin * sin_half - cos * cos_half])
    x, y = beams.x.mean(axis=1), beams.y.mean(axis=1)
    apart = np.hypot(beams.x - x[:, None], beams.y - y[:, None]).max(axis=1) + 1e-6
    least = np.where(cos_half < 0.1, -np.inf, nx * x + ny * y - apart)
    return _Sectors(nx[..., None], ny[..., None], least[..., None])


def _segments_reached(sectors: _Sectors, segments: Floats) -> Bools:
    """Return which of S segments reach into which of N sectors (N, S): an end lies in each half plane."""
    x1, y1, x2, y2 = segments.T
    ends = np.maximum(sectors.nx * x1 + sectors.ny * y1, sectors.nx * x2 + sectors.ny * y2)
    return np.asarray((ends >= sectors.least).all(axis=0))


def _circles_reached(sectors: _Sectors, circles: Floats) -> Bools:
    """Return which of C circles reach into which of N sectors (N, C)."""
    x, y, radius = circles.T
    return np.asarray((sectors.nx * x + sectors.ny * y + radius >= sectors.least).all(axis=0))


def _distances_to_segments(beams: _Beams, segments: Floats) -> Floats:
    """Return the distances (P, B) from blocks of beams to one segment each (4, P, 1), inf for a miss.

    Cramer's rule on origin + t direction = start + u along.
    """
    x1, y1, x2, y2 = segments
    along_x, along_y, from_x, from_y = x2 - x1, y2 - y1, x1 - beams.x, y1 - beams.y
    tilt = beams.cos * along_y - beams.sin * along_x
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance = (from_x * along_y - from_y * along_x) / tilt
        share = (from_x * beams.sin - from_y * beams.cos) / tilt
    hit = (np.abs(tilt) > _PARALLEL) & (distance >= 0.0) & (share >= -_OVERLAP) & (share <= 1.0 + _OVERLAP)
    return np.where(hit, distance, np.inf)


def _distances_to_circles(beams: _Beams, circles: Floats) -> Floats:
    """Return the distances (P, B) from blocks of beams to one circle each (3, P, 1): to the first crossing ahead, from
    outside or inside; inf for a miss.
    """
    x, y, radius = circles
    from_x, from_y = x - beams.x, y - beams.y
    ahead = beams.cos * from_x + beams.sin * from_y
    aside = beams.cos * from_y - beams.sin * from_x
    with np.errstate(invalid="ignore"):  # nan, the root of a negative number, is a miss
        half_chord = np.sqrt(radius**2 - aside**2)
    near, far = ahead - half_chord, ahead + half_chord
    return np.where(near >= 0.0, near, np.where(far >= 0.0, far, np.inf))
