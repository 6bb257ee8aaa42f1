"""The neighbourhoods of points: how many there are, and the ellipse that they make."""

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
"""A patch is all points within 0.5 m of one; of five and more with lambda_max > 9 lambda_min it is a piece of wall."""


@dataclass(frozen=True, eq=False)
class Neighbourhoods:
    """Per neighbourhood (K,): how many points, the variances along its short and its long axis (m2), and which way.

    ``direction``: of the long axis, in radians within [0, pi).
    """

    counts: Ints
    small: Floats
    large: Floats
    direction: Floats

    @property
    def flat(self) -> Bools:
        """Which patches (K,) are pieces of wall."""
        return np.asarray((self.counts >= MIN_HITS) & (self.large > FLATNESS * self.small))


def compute_neighbourhoods(points: Floats, middles: Floats, radius_m: float = PATCH_M) -> Neighbourhoods:
    """The patches of points (N, 2) around middles (K, 2), K > 0; one without any point has variances of nan."""
    balls = build_kd_tree(points).query_ball_point(middles, radius_m, return_sorted=False)
    neighbours = [np.asarray(ball, dtype=np.int64) for ball in balls]
    counts = np.array([len(indices) for indices in neighbours], dtype=np.int64)
    small, large, direction = np.full((3, len(counts)), np.nan)
    some = counts > 0
    if some.any():
        offsets = points[np.concatenate(neighbours)] - np.repeat(middles, counts, axis=0)
        small[some], large[some], direction[some] = _ellipses(offsets, counts[some])
    return Neighbourhoods(counts, small, large, direction)


def build_kd_tree(points: Floats) -> cKDTree:
    """Return a k-d tree of points (N, 2)."""
    from scipy.spatial import cKDTree

    return cKDTree(points)


def thin_evenly(points: Floats, most: int) -> Floats:
    """At most that many of the rows (N, ...), evenly spaced, first and last among them."""
    return np.asarray(points[np.unique(np.linspace(0, len(points) - 1, min(most, len(points))).astype(int))])


def _ellipses(offsets: Floats, counts: Ints) -> tuple[Floats, Floats, Floats]:
    """Eigenvalues (K,), smaller and larger, of the covariance of each run of ``counts`` (K,) offsets; the long axis."""
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    x, y = offsets[:, 0], offsets[:, 1]
    mean_x, mean_y, xx, xy, yy = (np.add.reduceat(v, starts) / counts for v in (x, y, x * x, x * y, y * y))
    xx, xy, yy = xx - mean_x**2, xy - mean_x * mean_y, yy - mean_y**2
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    return np.maximum(half - root, 0.0), half + root, 0.5 * np.arctan2(2.0 * xy, xx - yy) % np.pi
