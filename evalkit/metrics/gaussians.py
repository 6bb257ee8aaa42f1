"""Holds the map of an estimate against the true map voxel by voxel, each a Gaussian, by the exact distance of both."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.table import Evidence, Metric, cached, make_score, with_support

VOXEL_M = 1.0
MIN_CELLS = 5
MIN_VOXELS = 3
_FAR = 1 << 32
"""More rows than any map has: column and row in one number."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """Per voxel: its column and row (K, 2), the mean (K, 2) of its points in m, their covariance (K, 2, 2) in m2."""

    at: Ints
    means: Floats
    covariances: Floats


def fit_voxels(points: Floats, size_m: float = VOXEL_M, at_least: int = MIN_CELLS) -> Voxels:
    """The Gaussians of points (N, 2) in squares of that size, one corner of one at the origin."""
    squares_of = np.floor(points / size_m).astype(np.int64)
    flat = squares_of[:, 0] * _FAR + squares_of[:, 1]
    found, which, counts = np.unique(flat, return_inverse=True, return_counts=True)
    count = len(found)
    x, y = points.T
    means = np.stack([np.bincount(which, x, count), np.bincount(which, y, count)], axis=1) / counts[:, None]
    dx, dy = (points - means[which]).T
    xx, xy, yy = (np.bincount(which, one * other, count) for one, other in ((dx, dx), (dx, dy), (dy, dy)))
    squares = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    rows = (found + _FAR // 2) % _FAR - _FAR // 2
    keys = np.stack([(found - rows) // _FAR, rows], axis=1)
    kept = counts >= at_least
    return Voxels(keys[kept], means[kept], squares[kept] / counts[kept][:, None, None])


def wasserstein_distances(means: Floats, covariances: Floats, others: Floats, other_covariances: Floats) -> Floats:
    """Wasserstein-2 distance (K,) between Gaussians of the plane, in the unit of the means (K, 2).

    W2^2 = |mu1 - mu2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2); for 2 x 2 matrices the trace of that root is
    sqrt(tr(S1 S2) + 2 sqrt(det S1 det S2)).
    """
    apart = np.sum((means - others) ** 2, axis=-1)
    both = np.trace(covariances @ other_covariances, axis1=-2, axis2=-1)
    areas = np.sqrt(np.maximum(np.linalg.det(covariances) * np.linalg.det(other_covariances), 0.0))
    root = np.sqrt(np.maximum(both + 2.0 * areas, 0.0))
    traces = np.trace(covariances, axis1=-2, axis2=-1) + np.trace(other_covariances, axis1=-2, axis2=-1)
    return np.asarray(np.sqrt(np.maximum(apart + traces - 2.0 * root, 0.0)))


def voxel_distances(mapped: Floats, true: Floats, size_m: float = VOXEL_M) -> tuple[Ints, Floats]:
    """Column and row (K, 2) of the voxels in which both clouds have a Gaussian, and how far apart they are (K,)."""
    ours, theirs = fit_voxels(mapped, size_m), fit_voxels(true, size_m)
    index = {(int(column), int(row)): place for place, (column, row) in enumerate(theirs.at)}
    pairs = [(i, index[int(c), int(r)]) for i, (c, r) in enumerate(ours.at) if (int(c), int(r)) in index]
    one, other = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    apart = wasserstein_distances(
        ours.means[one], ours.covariances[one], theirs.means[other], theirs.covariances[other]
    )
    return ours.at[one], apart


def spatial_consistency(at: Ints, apart: Floats) -> float:
    """Standard deviation over mean of the distances (K,) among each voxel and its up to 8 neighbours, mean over voxels.

    Voxels with fewer than three distances around them are left out; nan if all are.
    """
    near = np.abs(at[:, None, :] - at[None, :, :]).max(axis=-1) <= 1
    counts = near.sum(axis=1)
    means = (near @ apart) / counts
    spread = np.sqrt(np.maximum((near @ apart**2) / counts - means**2, 0.0))
    kept = (counts >= MIN_VOXELS) & (means > 0.0)
    return float(np.mean(spread[kept] / means[kept])) if kept.any() else float("nan")


def _scored(measure: Callable[[Ints, Floats], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        if evidence.truth.grid is None:
            return Score(None, 0, "no true map")
        if evidence.grid is None:
            return Score(None, 0, f"no map: {evidence.no_grid}")
        at, apart = _distances(evidence)
        if len(apart) < MIN_VOXELS:
            return Score(None, len(apart), f"the maps share {len(apart)} squares with walls, {MIN_VOXELS} are needed")
        value = measure(at, apart)
        if np.isnan(value):
            return Score(None, len(apart), "no square with walls has two neighbours with walls")
        return make_score(value, len(apart))

    return compute


@cached
def _distances(evidence: Evidence) -> tuple[Ints, Floats]:
    ours, theirs = (
        np.zeros((0, 2)) if grid is None else grid.centres(grid.occupied())
        for grid in (evidence.grid, evidence.truth.grid)
    )
    return voxel_distances(ours, theirs)


MAPEVAL = "Hu et al., MapEval, RA-L 2025; there with Cholesky factors in place of the matrix root: not comparable"
SQUARES = f"squares of {VOXEL_M:g} m in which both maps have {MIN_CELLS} wall cells"

_ROWS = (
    Metric("map_awd_m", "Wasserstein distance of the walls", "m", "lower", "map against truth",
           f"Wasserstein-2 distance between the Gaussians of the wall cells of both maps, mean over {SQUARES}.",
           MAPEVAL, "walls in squares where one map has none; which cell is wrong within a square",
           _scored(lambda _, apart: float(apart.mean()))),
    Metric("map_scs", "spatial consistency of that", "", "lower", "map against truth",
           "Standard deviation over mean of those distances among a square and its neighbours, mean over squares: how "
           "uneven the error is from place to place.", MAPEVAL, "how large the error is: an even one scores 0",
           _scored(spatial_consistency)),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "*": (
            "squares with walls in both maps",
            (
                "no true map",
                "no map: ...",
                "the maps share ... squares with walls, ... are needed",
                "no square with walls has two neighbours with walls",
            ),
        )
    },
)
