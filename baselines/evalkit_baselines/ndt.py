"""The normal distributions transform in the plane (Biber and Strasser 2003).

Each cell of the target holds the normal distribution of its points. A point scores exp(-d^2 / 2), with d its
Mahalanobis distance from the distribution of its cell; the sum over the points is maximised. Four grids, shifted by
half a cell, let every place lie near the middle of a cell.

What differs from the paper, and why:

* The Hessian is guarded: of a point's curvature only the part that is never negative is used (its score times the
  inverse covariance), so that every step goes uphill. The paper adds a multiple of the identity where the exact one is
  not positive.
* A distribution is at least ``thinnest`` times as wide across a wall as along it, as in the paper, which has 0.001.
  On walls without noise so narrow a distribution has no basin: see the parameter.
* Directions that the target does not constrain are left to the guess.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import product

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.gauss_newton import Evaluate, StopRule, Terms, descend
from evalkit_baselines.paper.association import CloudCache
from evalkit_baselines.target_grid import TargetGrid

NEAR = 9.0  # squared Mahalanobis distance of a point that has something to match: 3 standard deviations


class NormalCells:
    """Normal distributions of a target's points (N, 2) in the cells of one grid, whose origin is at ``shift_m``.

    Cells with fewer than ``min_points`` points have none. Raises BadParameter for a target too large for its cells.
    """

    def __init__(self, points: Floats, cell_m: float, shift_m: Floats, min_points: int, thinnest: float) -> None:
        shifted = points - shift_m
        self._shift_m = shift_m
        self._grid = TargetGrid.around("ndt", shifted, cell_m, cell_m)
        cells, inverse, counts = np.unique(self._grid.cell_of(shifted), return_inverse=True, return_counts=True)
        sums = np.stack([np.bincount(inverse, weights=axis) for axis in points.T])
        full = counts >= max(min_points, 1)
        means = sums / counts
        x, y = points.T - means[:, inverse]
        moments = np.stack([np.bincount(inverse, weights=w) for w in (x * x, x * y, y * y)]) / counts
        self.means: Floats = means[:, full]
        self.inverses, self.widths = invert_covariances(moments[:, full], thinnest, cell_m)
        self._index = np.full(self._grid.columns * self._grid.rows, -1, dtype=np.int32)
        self._index[cells[full]] = np.arange(int(full.sum()))

    def find(self, points: Floats) -> tuple[Ints, Ints]:
        """Return which points (N, 2) lie in a cell with a distribution (K,), and the number of that cell (K,)."""
        shifted = points - self._shift_m
        rows = np.flatnonzero(self._grid.contains(shifted))
        found = self._index[self._grid.cell_of(shifted[rows])].astype(np.int64)
        return rows[found >= 0], found[found >= 0]


def invert_covariances(moments: Floats, thinnest: float, cell_m: float) -> tuple[Floats, Floats]:
    """Return the inverses (3, K) of covariances (3, K), each (xx, xy, yy) in m^2, and their smaller deviations (K,).

    The smaller variance is raised to ``thinnest`` times the larger; a cell whose points coincide counts as wide as one
    whose points lie on a line of ``cell_m`` would be across it.
    """
    xx, xy, yy = moments
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    large = np.maximum(mean + half, thinnest * cell_m**2 / 12.0)
    small = np.maximum(mean - half, thinnest * large)
    cos, sin = np.cos(along), np.sin(along)
    inverses = np.stack(
        [cos**2 / large + sin**2 / small, cos * sin * (1.0 / large - 1.0 / small), sin**2 / large + cos**2 / small]
    )
    return inverses, np.sqrt(small)


@dataclass(frozen=True)
class NdtMatcher:
    """A Registration. The distributions of recent targets are kept, found by the identity of their (frozen) clouds."""

    cell_m: float = parameter(0.5, "m", "side of a cell", low=0.02, high=20.0)
    min_points: int = parameter(3, "", "points of a cell with a distribution", low=3, high=1_000)
    thinnest: float = parameter(0.01, "", "smallest variance of a cell as a share of its largest", low=1e-6, high=1.0)
    max_iterations: int = parameter(40, "", "largest number of evaluations", low=1, high=10_000)
    step_m: float = parameter(5e-4, "m", "stop where a step is shorter", low=0.0)
    weak: float = parameter(
        0.01, "", "leave directions to the guess that less than this share of the points observes", low=0.0, high=1.0
    )
    _recent: CloudCache[tuple[NormalCells, ...]] = field(default_factory=CloudCache, init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields("ndt", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``; not converged where no three points lie near a distribution.

        ``inliers``: points within three standard deviations in some grid. ``error``: their mean distance (m), as the
        Mahalanobis distance times the smaller standard deviation of the cell. Raises BadParameter for a target too
        large for its cells.
        """
        if not len(target) or not len(source):
            return Match.not_converged(guess)
        return descend(self.cost_of(target), source, guess, StopRule(self.max_iterations, self.step_m, self.weak))

    def cost_of(self, target: Cloud) -> Evaluate:
        """Return the cost against a target: minus the mean score of each point in the four grids, summed."""
        grids = self._recent.get(target, self._grids)

        def evaluate(points: Floats) -> Terms:
            cost = 0.0
            slope, curvature = np.zeros((2, len(points))), np.zeros((3, len(points)))
            distance = np.full(len(points), np.inf)
            for cells in grids:
                rows, cell = cells.find(points)
                x, y = points[rows].T - cells.means[:, cell]
                xx, xy, yy = inverse = cells.inverses[:, cell]
                pull_x, pull_y = xx * x + xy * y, xy * x + yy * y
                squared = x * pull_x + y * pull_y
                score = np.exp(-0.5 * squared) / len(grids)
                cost -= float(score.sum())
                slope[:, rows] += score * np.stack([pull_x, pull_y])
                curvature[:, rows] += score * inverse
                metres = np.where(squared < NEAR, np.sqrt(squared) * cells.widths[cell], np.inf)
                distance[rows] = np.minimum(distance[rows], metres)
            near = np.isfinite(distance)
            inliers = int(near.sum())
            error_m = float(distance[near].sum()) / inliers if inliers else math.nan
            return Terms(cost, slope, curvature, inliers, error_m, float(curvature[0].sum() + curvature[2].sum()))

        return evaluate

    def _grids(self, target: Cloud) -> tuple[NormalCells, ...]:
        shifts = product((0.0, 0.5 * self.cell_m), repeat=2)
        return tuple(
            NormalCells(target.points, self.cell_m, np.array(shift), self.min_points, self.thinnest) for shift in shifts
        )


SPEC = RegistrationSpec(
    make=NdtMatcher,
    summary="normal distributions transform: the score of points in the distributions of cells",
    citation="Biber and Strasser, The normal distributions transform: a new approach to laser scan matching, IROS 2003",
    licence="MIT",
    parameters=declared_parameters(NdtMatcher),
)
