"""The neighbourhoods of points: number of points, covariance ellipse and direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

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


def compute_neighbourhoods(points: Floats, middles: Floats, radius_m: float = PATCH_M) -> Neighbourhoods:
    """Return the neighbourhoods of points (N, 2), N > 0, around ``middles`` (K, 2), K > 0; without a point,
    variances are nan."""
    counts, *sums = _sum_moments(points, middles, radius_m)
    small, large, direction = np.full((3, len(middles)), np.nan)
    some = counts > 0
    small[some], large[some], direction[some] = _compute_ellipses(*(one[some] / counts[some] for one in sums))
    return Neighbourhoods(counts.astype(np.int64), small, large, direction)


def build_kd_tree(points: Floats) -> cKDTree:
    """Return a k-d tree of points (N, 2), split at the middle of a cell instead of at its median: built in half the
    time."""
    from scipy.spatial import cKDTree

    return cKDTree(points, balanced_tree=False, compact_nodes=False)


def thin_evenly(points: Floats, max_rows: int) -> Floats:
    """Return at most ``max_rows`` of the rows (N, ...), evenly spaced, including the first and the last."""
    rows = np.linspace(0, len(points) - 1, min(max_rows, len(points))).astype(int)
    return np.asarray(points[rows[np.diff(rows, prepend=-1) > 0]])  # np.unique takes a hundred times as long


def _sum_moments(points: Floats, middles: Floats, radius_m: float) -> Floats:
    """Return the sums (6, K) of 1, x, y, xx, xy and yy of the points within the radius, relative to each middle.

    A cell that lies within the radius as a whole contributes its own sums; only points in cells on the border are
    examined one by one.
    """
    side = radius_m / CELLS
    reach = side * math.sqrt(0.5) * (1.0 + 1e-9)
    cells = np.floor(points / side)
    order = np.lexsort(cells.T)
    points, cells = points[order], cells[order]
    starts = np.flatnonzero(np.concatenate([[True], (cells[1:] != cells[:-1]).any(axis=1)]))
    sizes, centres = np.diff(np.append(starts, len(points))), (cells[starts] + 0.5) * side
    own = [np.add.reduceat(one, starts) for one in _list_moments(points - np.repeat(centres, sizes, axis=0))]
    pairs = build_kd_tree(middles).sparse_distance_matrix(
        build_kd_tree(centres), radius_m + reach, output_type="ndarray"
    )
    whole = pairs["v"] <= radius_m - reach
    at, cell = pairs["i"][whole], pairs["j"][whole]
    count, x, y, xx, xy, yy = (one[cell] for one in own)
    dx, dy = (centres[cell] - middles[at]).T
    moved = (
        count, x + count * dx, y + count * dy, xx + (2.0 * x + count * dx) * dx,
        xy + x * dy + (y + count * dy) * dx, yy + (2.0 * y + count * dy) * dy,
    )  # fmt: skip
    total = np.stack([np.bincount(at, one, len(middles)) for one in moved])
    at, cell = pairs["i"][~whole], pairs["j"][~whole]
    count = sizes[cell]
    rows = np.arange(count.sum()) + np.repeat(starts[cell] - np.cumsum(count) + count, count)
    at = np.repeat(at, count)
    offsets = points[rows] - middles[at]
    near = np.sum(offsets * offsets, axis=1) <= radius_m * radius_m
    moments = _list_moments(offsets[near])
    return np.asarray(total + np.stack([np.bincount(at[near], one, len(middles)) for one in moments]), np.float64)


def _list_moments(offsets: Floats) -> tuple[Floats, ...]:
    x, y = offsets.T
    return np.ones(len(x)), x, y, x * x, x * y, y * y


def _compute_ellipses(mean_x: Floats, mean_y: Floats, xx: Floats, xy: Floats, yy: Floats) -> tuple[Floats, ...]:
    """Return smaller and larger eigenvalue (K,) and the long axis (K,) of covariances, from means of moments (K,)."""
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.maximum(half - root, 0.0), half + root, 0.5 * np.arctan2(2.0 * xy, xx - yy) % np.pi
