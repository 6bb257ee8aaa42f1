"""The neighbourhoods of points: number of points, covariance ellipse and direction."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Bools, Ints
from evalkit.core.se2 import Floats

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

PATCH_M = 0.5
FLATNESS = 9.0
MIN_HITS = 5
"""A neighbourhood contains all points within 0.5 m of a point.

It is a piece of wall if it has at least five points and lambda_max > 9 lambda_min.
"""

CELLS = 8
"""Cells along a radius, by which points are summed: the fastest from 4 to 16, for 20,000 points along walls."""

MAX_EXAMINED = 100_000
"""Up to this many pairs of a point and a middle, each is examined, which takes a third of the time of cells."""

_BLOCK = 12_000
"""Pairs that are examined at once, so that they stay in the cache."""


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Statistics of K neighbourhoods.

    ``counts`` (K,): number of points. ``small``, ``large`` (K,): variances along the short and the long axis (m2).
    ``direction`` (K,): of the long axis, radians within [0, pi).
    """

    counts: Ints
    small: Floats
    large: Floats
    direction: Floats

    @property
    def flat(self) -> Bools:
        """Which neighbourhoods (K,) are pieces of wall."""
        return np.asarray((self.counts >= MIN_HITS) & (self.large > FLATNESS * self.small))


@dataclass(frozen=True, eq=False)
class PointCells:
    """Points in square cells, for neighbourhoods of one radius around several sets of middles.

    ``radius_m``: of the neighbourhoods. ``x``, ``y`` (N,): the points in the order of cells (m). ``starts``, ``sizes``
    (C,): the points of each cell. ``centre_x``, ``centre_y`` (C,): of cells (m). ``moments``: sums of 1, x, y, xx, xy
    and yy (C,) of the points of each cell, relative to its centre. ``tree``: of the centres.
    """

    radius_m: float
    x: Floats
    y: Floats
    starts: Ints
    sizes: Ints
    centre_x: Floats
    centre_y: Floats
    moments: tuple[Floats, ...]
    tree: cKDTree


def sort_into_cells(points: Floats, radius_m: float = PATCH_M) -> PointCells:
    """Return the cells of points (N, 2), N > 0; a radius is eight cells long."""
    side = radius_m / CELLS
    cells = np.floor(points / side)
    order = np.lexsort(cells.T)
    points, cells = points[order], cells[order]
    starts = np.flatnonzero(np.concatenate([[True], (cells[1:] != cells[:-1]).any(axis=1)]))
    sizes, centres = np.diff(np.append(starts, len(points))), (cells[starts] + 0.5) * side
    (x, y), (cx, cy) = (np.ascontiguousarray(one.T) for one in (points, centres))
    offsets = x - np.repeat(cx, sizes), y - np.repeat(cy, sizes)
    moments = tuple(np.add.reduceat(one, starts) for one in _list_moments(*offsets))
    return PointCells(radius_m, x, y, starts, sizes, cx, cy, moments, build_kd_tree(centres))


def compute_neighbourhoods(points: Floats | PointCells, middles: Floats, radius_m: float = PATCH_M) -> Neighbourhoods:
    """Return the neighbourhoods of points (N, 2), N > 0, around ``middles`` (K, 2), K > 0; without a point,
    variances are nan.

    ``points``: their cells if they are asked for several times; these have a radius of their own.
    """
    return _describe_moments(_sum_moments(points, middles, radius_m))


def compute_neighbourhoods_each(clouds: Iterable[tuple[Floats, Floats]]) -> Neighbourhoods:
    """Return the neighbourhoods of several clouds, one after the other: points (N, 2), N > 0, around middles (K, 2).

    For few middles in each: all points are examined.
    """
    found, count = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))], 0
    for points, middles in clouds:
        at, dx, dy = _find_offsets(points, middles, PATCH_M)
        found.append((at + count, dx, dy))
        count += len(middles)
    at, dx, dy = (np.concatenate(one) for one in zip(*found, strict=True))
    return _describe_moments(_add_moments(at, _list_moments(dx, dy), count))


def _describe_moments(moments: Floats) -> Neighbourhoods:
    """Return the neighbourhoods with these sums (6, K) of 1, x, y, xx, xy and yy."""
    counts, *sums = moments
    small, large, direction = np.full((3, len(counts)), np.nan)
    some = counts > 0
    small[some], large[some], direction[some] = _compute_ellipses(*(one[some] / counts[some] for one in sums))
    return Neighbourhoods(counts.astype(np.int64), small, large, direction)


def build_kd_tree(points: Floats) -> cKDTree:
    """Return a k-d tree of points (N, 2), split at the middle of a cell instead of at its median: built in half the
    time."""
    from scipy.spatial import cKDTree

    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def nearest_distances_m(points: ArrayLike, others: ArrayLike) -> Floats:
    """Return the distance (N,) from each point (N, 2) to the nearest of the others (M, 2), M > 0."""
    return np.asarray(build_kd_tree(np.asarray(others)).query(np.asarray(points))[0], dtype=np.float64)


def thin_evenly(points: Floats, max_rows: int) -> Floats:
    """Return at most ``max_rows`` of the rows (N, ...), evenly spaced, including the first and the last."""
    rows = np.linspace(0, len(points) - 1, min(max_rows, len(points))).astype(int)
    return np.asarray(points[rows[np.diff(rows, prepend=-1) > 0]])  # np.unique takes a hundred times as long


def _sum_moments(points: Floats | PointCells, middles: Floats, radius_m: float) -> Floats:
    """Return the sums (6, K) of 1, x, y, xx, xy and yy of the points within the radius, relative to each middle."""
    if isinstance(points, PointCells):
        return _sum_cells(points, middles)
    if len(points) * len(middles) <= MAX_EXAMINED:
        at, dx, dy = _find_offsets(points, middles, radius_m)
        return _add_moments(at, _list_moments(dx, dy), len(middles))
    return _sum_cells(sort_into_cells(points, radius_m), middles)


def _find_offsets(points: Floats, middles: Floats, radius_m: float) -> tuple[Ints, Floats, Floats]:
    """Return the middle (P,) and the offset x, y (P,) from it of all points within the radius: each is examined."""
    (x, y), block = np.ascontiguousarray(points.T), max(_BLOCK // len(points), 1)
    found = []
    for begin in range(0, len(middles), block):
        own = middles[begin : begin + block]
        dx, dy = x - own[:, :1], y - own[:, 1:]
        near = np.flatnonzero(dx * dx + dy * dy <= radius_m * radius_m)
        found.append((near // len(points) + begin, dx.ravel()[near], dy.ravel()[near]))
    at, dx, dy = (np.concatenate(one) for one in zip(*found, strict=True))
    return at, dx, dy


def _sum_cells(points: PointCells, middles: Floats) -> Floats:
    """Return the sums (6, K) within the radius.

    A cell that lies within the radius as a whole contributes its own sums; only points in cells on the border are
    examined one by one.
    """
    radius_m, cx, cy, starts, (mx, my) = points.radius_m, points.centre_x, points.centre_y, points.starts, middles.T
    reach = radius_m / CELLS * math.sqrt(0.5) * (1.0 + 1e-9)
    pairs = build_kd_tree(middles).sparse_distance_matrix(points.tree, radius_m + reach, output_type="ndarray")
    whole = pairs["v"] <= radius_m - reach
    at, cell = pairs["i"][whole], pairs["j"][whole]
    count, x, y, xx, xy, yy = (one[cell] for one in points.moments)
    dx, dy = cx[cell] - mx[at], cy[cell] - my[at]
    moved = (
        count, x + count * dx, y + count * dy, xx + (2.0 * x + count * dx) * dx,
        xy + x * dy + (y + count * dy) * dx, yy + (2.0 * y + count * dy) * dy,
    )  # fmt: skip
    total = _add_moments(at, moved, len(middles))
    at, cell = pairs["i"][~whole], pairs["j"][~whole]
    count = points.sizes[cell]
    rows = np.arange(count.sum()) + np.repeat(starts[cell] - np.cumsum(count) + count, count)
    dx, dy = points.x[rows] - np.repeat(mx[at], count), points.y[rows] - np.repeat(my[at], count)
    near = np.flatnonzero(dx * dx + dy * dy <= radius_m * radius_m)
    return total + _add_moments(np.repeat(at, count)[near], _list_moments(dx[near], dy[near]), len(middles))


def _add_moments(at: Ints, moments: tuple[Floats, ...], count: int) -> Floats:
    """Return the sums (6, K) of moments (P,) at each of ``count`` middles."""
    return np.stack([np.bincount(at, one, count) for one in moments]).astype(np.float64, copy=False)


def _list_moments(x: Floats, y: Floats) -> tuple[Floats, ...]:
    return np.ones(len(x)), x, y, x * x, x * y, y * y


def _compute_ellipses(mean_x: Floats, mean_y: Floats, xx: Floats, xy: Floats, yy: Floats) -> tuple[Floats, ...]:
    """Return smaller and larger eigenvalue (K,) and the long axis (K,) of covariances, from means of moments (K,)."""
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.maximum(half - root, 0.0), half + root, 0.5 * np.arctan2(2.0 * xy, xx - yy) % np.pi
