"""Gauss-Newton on the occupancy below the points of a scan, from coarse cells to fine (Kohlbrecher et al. 2011).

The residual of a point is 1 - p, where p is the probability of the map at the point by bilinear interpolation. It has
a slope only beside an occupied cell, so the basin is one coarse cell wide: three grids, each with cells of twice the
side, widen it.

What differs from the paper, and why:

* The map is made of the target's points, because a registration has no beams: cells without a point are free. The
  points of a cell count as one, at their mean, and are shared among the four cells around it, so that the answer
  depends little on where the cells lie.
* Directions that the target does not constrain are left to the guess. A step that does not lower the cost is damped,
  and the descent on a grid ends where steps are short, not after a fixed number of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.gauss_newton import Evaluate, StopRule, Terms, descend
from evalkit_baselines.paper.association import CloudCache
from evalkit_baselines.target_grid import TargetGrid


class LikelihoodField:
    """Probabilities that cells are occupied, from the points (N, 2) of a target in metres.

    ``occupied``: the probability after one point; s points leave 1 - (1 - occupied)^s. Raises BadParameter for a target
    too large for its cells.
    """

    def __init__(self, points: Floats, cell_m: float, occupied: float) -> None:
        self.grid = TargetGrid.around("likelihood-field", points, cell_m, cell_m)
        at = self.grid.locate(voxel_means(points, cell_m))
        shares = np.stack([(1 - at.u) * (1 - at.v), at.u * (1 - at.v), (1 - at.u) * at.v, at.u * at.v])
        cells = self.grid.around_cell(at.cell)
        hits = np.bincount(cells.ravel(), weights=shares.ravel(), minlength=self.grid.columns * self.grid.rows)
        self._p = -np.expm1(math.log1p(-occupied) * hits)

    def read(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the probabilities (N,) at points (N, 2) and their gradients (2, N) in 1/m; 0 outside."""
        at = self.grid.locate(points)
        p, gradient = self.grid.interpolate(self._p.take(self.grid.around_cell(at.cell)), at)
        return p * at.inside, gradient


@dataclass(frozen=True)
class LikelihoodFieldMatcher:
    """A Registration. The fields of recent targets are kept, found by the identity of their (frozen) clouds."""

    cell_m: float = parameter(0.05, "m", "side of the smallest cells", low=0.005, high=1.0)
    levels: int = parameter(3, "", "grids, each with cells of twice the side of the one before", low=1, high=6)
    occupied: float = parameter(0.9, "", "probability of a cell with one point", low=0.01, high=0.999)
    max_iterations: int = parameter(20, "", "largest number of evaluations of each grid", low=1, high=10_000)
    step_m: float = parameter(5e-4, "m", "stop where a step is shorter", low=0.0)
    weak: float = parameter(
        0.01, "", "leave directions to the guess that less than this share of the points observes", low=0.0, high=1.0
    )
    _recent: CloudCache[tuple[LikelihoodField, ...]] = field(default_factory=CloudCache, init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields("likelihood-field", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``; not converged where no three points lie beside occupied cells.

        ``error`` is the mean of (1 - p) of these points times the side of the smallest cells (m): their distance where
        p falls linearly. ``inliers`` is their number. Raises BadParameter for a target too large for its cells.
        """
        if not len(target) or not len(source):
            return Match.not_converged(guess)
        stop = StopRule(self.max_iterations, self.step_m, self.weak)
        pose, iterations = guess, 0
        match = Match.not_converged(guess)
        for level in reversed(range(self.levels)):
            match = descend(self.cost_of(target, level), source, pose, stop)
            pose, iterations = match.target_from_source, iterations + match.iterations
        if not match.inliers or math.isnan(match.error):
            return Match.not_converged(guess, match.inliers)
        return replace(match, iterations=iterations)

    def cost_of(self, target: Cloud, level: int = 0) -> Evaluate:
        """Return the cost against a target in the grid of a level, 0 the finest: the sum of (1 - p)^2 / 2."""
        read = self._recent.get(target, self._fields)[level].read

        def evaluate(points: Floats) -> Terms:
            p, (gx, gy) = read(points)
            missing = 1.0 - p
            near = p > 0.0
            inliers = int(near.sum())
            return Terms(
                cost=0.5 * float(missing @ missing),
                slope=np.stack([-missing * gx, -missing * gy]),
                curvature=np.stack([gx * gx, gx * gy, gy * gy]),
                near=inliers,
                error_m=self.cell_m * float(missing[near].sum()) / inliers if inliers else math.nan,
                steep=inliers / (self.cell_m * 2**level) ** 2,
            )

        return evaluate

    def _fields(self, target: Cloud) -> tuple[LikelihoodField, ...]:
        return tuple(LikelihoodField(target.points, self.cell_m * 2**n, self.occupied) for n in range(self.levels))


SPEC = RegistrationSpec(
    make=LikelihoodFieldMatcher,
    summary="Gauss-Newton on the occupancy below the points, from coarse cells to fine",
    citation="Kohlbrecher, von Stryk, Meyer and Klingauf, A flexible and scalable SLAM system with full 3D motion "
    "estimation, SSRR 2011",
    licence="MIT",
    parameters=declared_parameters(LikelihoodFieldMatcher),
)
