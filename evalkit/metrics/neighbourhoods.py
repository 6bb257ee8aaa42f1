"""The neighbourhoods of points: number of points, covariance ellipse and direction."""

from __future__ import annotations

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
    """Return the neighbourhoods of points (N, 2) around ``middles`` (K, 2), K > 0; without a point,
    variances are nan."""
    balls = build_kd_tree(points).query_ball_point(middles, radius_m, return_sorted=False)
    neighbours = [np.asarray(ball, dtype=np.int64) for ball in balls]
    counts = np.array([len(indices) for indices in neighbours], dtype=np.int64)
    small, large, direction = np.full((3, len(counts)), np.nan)
    some = counts > 0
    if some.any():
        offsets = points[np.concatenate(neighbours)] - np.repeat(middles, counts, axis=0)
        small[some], large[some], direction[some] = _compute_ellipses(offsets, counts[some])
    return Neighbourhoods(counts, small, large, direction)


def build_kd_tree(points: Floats) -> cKDTree:
    """Return a k-d tree of points (N, 2)."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


def thin_evenly(points: Floats, max_rows: int) -> Floats:
    """Return at most ``max_rows`` of the rows (N, ...), evenly spaced, including the first and the last."""
    return np.asarray(points[np.unique(np.linspace(0, len(points) - 1, min(max_rows, len(points))).astype(int))])


def _compute_ellipses(offsets: Floats, counts: Ints) -> tuple[Floats, Floats, Floats]:
    """Return smaller and larger eigenvalue (K,) and the long axis of the covariance of each group of ``counts`` (K,)
    offsets.
    """
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    x, y = offsets[:, 0], offsets[:, 1]
    mean_x, mean_y, xx, xy, yy = (np.add.reduceat(v, starts) / counts for v in (x, y, x * x, x * y, y * y))
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.maximum(half - root, 0.0), half + root, 0.5 * np.arctan2(2.0 * xy, xx - yy) % np.pi
