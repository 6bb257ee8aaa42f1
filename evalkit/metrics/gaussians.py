"""Compare the map with the ground-truth map voxel by voxel, each as a Gaussian, by the exact Wasserstein distance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.metric import NO_TRUE_MAP, Evidence, MissingMap, cached, find_occupied, make_metrics, make_score

VOXEL_M = 1.0
MIN_CELLS = 5
MIN_VOXELS = 3
_FAR = 1 << 32
"""Larger than the number of rows of any map: encodes column and row as one number."""


@dataclass(frozen=True, eq=False)
class Voxels:
    """Gaussians of K voxels.

    ``at`` (K, 2): column and row. ``means`` (K, 2): in m. ``covariances`` (K, 2, 2): in m2.
    """

    at: Ints
    means: Floats
    covariances: Floats


def fit_voxels(points: Floats, size_m: float = VOXEL_M) -> Voxels:
    """Return the Gaussians of points (N, 2) in squares of ``size_m``; one square has a corner at the origin."""
    squares_of = np.floor(points / size_m).astype(np.int64)
    flat = _number_squares(squares_of)
    keys_of_squares, which, counts = np.unique(flat, return_inverse=True, return_counts=True)
    count = len(keys_of_squares)
    x, y = points.T
    means = np.stack([np.bincount(which, x, count), np.bincount(which, y, count)], axis=1) / counts[:, None]
    dx, dy = (points - means[which]).T
    xx, xy, yy = (np.bincount(which, one * other, count) for one, other in ((dx, dx), (dx, dy), (dy, dy)))
    squares = np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)
    rows = (keys_of_squares + _FAR // 2) % _FAR - _FAR // 2
    keys = np.stack([(keys_of_squares - rows) // _FAR, rows], axis=1)
    kept = counts >= MIN_CELLS
    return Voxels(keys[kept], means[kept], squares[kept] / counts[kept][:, None, None])


def _number_squares(at: Ints) -> Ints:
    """Return one number (K,) for each column and row (K, 2), in the order of columns, then rows."""
    return at[:, 0] * _FAR + at[:, 1]


def wasserstein_distances(means: Floats, covariances: Floats, others: Floats, other_covariances: Floats) -> Floats:
    """Return the Wasserstein-2 distance (K,) between Gaussians of the plane, in the unit of the means (K, 2).

    W2^2 = |mu1 - mu2|^2 + tr(S1 + S2 - 2 (S1^1/2 S2 S1^1/2)^1/2); for 2 x 2 matrices the trace of that root is
    sqrt(tr(S1 S2) + 2 sqrt(det S1 det S2)).
    """
    apart = np.sum((means - others) ** 2, axis=-1)
    both = np.trace(covariances @ other_covariances, axis1=-2, axis2=-1)
    areas = np.sqrt(np.maximum(np.linalg.det(covariances) * np.linalg.det(other_covariances), 0.0))
    root = np.sqrt(np.maximum(both + 2.0 * areas, 0.0))
    traces = np.trace(covariances, axis1=-2, axis2=-1) + np.trace(other_covariances, axis1=-2, axis2=-1)
    return np.asarray(np.sqrt(np.maximum(apart + traces - 2.0 * root, 0.0)))


def voxel_distances(mapped: Floats, true: Floats) -> tuple[Ints, Floats]:
    """Return column and row (K, 2) of the voxels with a Gaussian in both clouds, and their distances (K,)."""
    ours, theirs = fit_voxels(mapped), fit_voxels(true)
    _, one, other = np.intersect1d(_number_squares(ours.at), _number_squares(theirs.at), True, return_indices=True)
    apart = wasserstein_distances(
        ours.means[one], ours.covariances[one], theirs.means[other], theirs.covariances[other]
    )
    return ours.at[one], apart


def spatial_consistency(at: Ints, apart: Floats) -> float:
    """Return the standard deviation divided by the mean of the distances (K,) around each voxel, averaged over voxels.

    Around a voxel: itself and its up to 8 neighbours. Voxels with fewer than three distances around them are omitted;
    nan if all are.
    """
    keys, steps = _number_squares(at), range(-1, 2)
    order = np.argsort(keys)
    counts, sums, squares = np.zeros((3, len(keys)))
    for shift in (column * _FAR + row for column in steps for row in steps):
        places = np.searchsorted(keys, keys + shift, sorter=order)
        beside = order[np.minimum(places, len(keys) - 1)]
        met = keys[beside] == keys + shift
        counts += met
        sums += np.where(met, apart[beside], 0.0)
        squares += np.where(met, apart[beside] ** 2, 0.0)
    means = sums / counts
    spread = np.sqrt(np.maximum(squares / counts - means**2, 0.0))
    kept = (counts >= MIN_VOXELS) & (means > 0.0)
    return float(np.mean(spread[kept] / means[kept])) if kept.any() else float("nan")


def _score_with(measure: Callable[[Ints, Floats], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        found = _compare_voxels(evidence)
        if isinstance(found, Score):
            return found
        at, apart = found
        if len(apart) < MIN_VOXELS:
            reason = f"the maps share {len(apart)} squares with walls, at least {MIN_VOXELS} are needed"
            return Score(None, len(apart), reason)
        return make_score(measure(at, apart), len(apart), _NO_NEIGHBOURS)

    return compute


@cached
def _compare_voxels(evidence: Evidence) -> tuple[Ints, Floats] | Score:
    """Return the voxels of both maps with their distances, or a score without value if a map is missing."""
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None:
        return Score(None, reason=NO_TRUE_MAP)
    if isinstance(mapped, MissingMap):
        return Score(None, reason=f"no map: {mapped.reason}")
    return voxel_distances(mapped.centres(find_occupied(mapped)), true.centres(find_occupied(true)))


_NO_NEIGHBOURS = "no square with walls has two neighbours with walls"


METRICS = make_metrics(
    "gaussians",
    {
        "map_awd_m": _score_with(lambda _, apart: float(apart.mean())),
        "map_scs": _score_with(spatial_consistency),
    },
    VOXEL_M=VOXEL_M,
    MIN_CELLS=MIN_CELLS,
)
