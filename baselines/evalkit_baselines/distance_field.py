"""Gauss-Newton on the distance to the nearest occupied cell (Pedrosa, Pereira and Lau 2018).

The residual of a point is its distance to the target, read from a grid by bilinear interpolation; no pairs are made. A
Cauchy weight and a cap on the distance limit what a point without a counterpart does. The basin of convergence ends at
the cap.

What differs from the paper, and why:

* Occupied cells have a place: the mean of the target's points in them instead of their centre. The answer then does not
  depend on where the cells lie.
* Distances are computed where they are read: a centre of a cell is searched once, when a point first falls beside it,
  and kept as long as the target. The result is that of the whole field, exactly. A map of 30 m x 30 m has 360,000
  cells, and a scan reads 2,000 of them.
* Directions that the target does not constrain (along a corridor) are left to the guess. A step that does not lower
  the cost is damped.
* Where wheel odometry gives the first guess, it starts the match with the map, as in the paper's system; a scan that
  is matched with the one before is the worse guess where scans are thin (see ``baselines/README.md``).
* The paper has cells of 0.05 m. Here they are 0.1 m: noise of the target's points then moves the field less.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Ints
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

if TYPE_CHECKING:
    from scipy.spatial import cKDTree


class DistanceField:
    """Distances to the nearest occupied cell of a target (m), at most ``cap_m``, computed where they are read.

    Raises BadParameter for a target too large for its cells.
    """

    def __init__(self, points: Floats, cell_m: float, cap_m: float) -> None:
        from scipy.spatial import cKDTree  # noqa: PLC0415 - the spec of a back end is listed without SciPy

        self._cap_m = cap_m
        self._grid = TargetGrid.around("distance-field", points, cell_m, cap_m)
        self._tree: cKDTree = cKDTree(voxel_means(points, cell_m), balanced_tree=False)
        self._known: NDArray[np.float32] = np.full(self._grid.columns * self._grid.rows, -1.0, dtype=np.float32)

    def read(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the distances (N,) in metres at points (N, 2) and their gradients (2, N); the cap and 0 outside."""
        at = self._grid.locate(points)
        cells = self._grid.around_cell(at.cell)
        values = self._known.take(cells)
        if values.min(initial=0.0) < 0.0:
            self._search(np.unique(cells[values < 0.0]))
            values = self._known.take(cells)
        distance, gradient = self._grid.interpolate(values.astype(np.float64), at)
        return np.where(at.inside, distance, self._cap_m), gradient

    def _search(self, cells: Ints) -> None:
        distance, _ = self._tree.query(self._grid.centres(cells), distance_upper_bound=self._cap_m)
        self._known[cells] = np.minimum(distance, self._cap_m)


@dataclass(frozen=True)
class DistanceFieldMatcher:
    """A Registration. The fields of recent targets are kept, found by the identity of their (frozen) clouds."""

    cell_m: float = parameter(0.05, "m", "side of a cell", low=0.005, high=1.0)
    cap_m: float = parameter(0.5, "m", "largest distance: a point farther from the target does not pull", low=0.02)
    cauchy_m: float = parameter(0.15, "m", "distance at which the weight of a point is a half", low=1e-3)
    max_iterations: int = parameter(50, "", "largest number of evaluations of the field", low=1, high=10_000)
    step_m: float = parameter(5e-4, "m", "stop where a step is shorter", low=0.0)
    weak: float = parameter(
        0.01, "", "leave directions to the guess that less than this share of the points observes", low=0.0, high=1.0
    )
    _recent: CloudCache[DistanceField] = field(default_factory=CloudCache, init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields("distance-field", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``; not converged where no three points are within the cap.

        ``error`` is their mean distance (m), ``inliers`` their number. Raises BadParameter for a target too large for
        its cells.
        """
        if not len(target) or not len(source):
            return Match.not_converged(guess)
        stop = StopRule(self.max_iterations, self.step_m, self.weak)
        return descend(self.cost_of(target), source, guess, stop)

    def cost_of(self, target: Cloud) -> Evaluate:
        """Return the cost against a target: the sum of c^2 / 2 log(1 + (d / c)^2), with Gauss-Newton curvature."""
        distances = self._recent.get(target, lambda cloud: DistanceField(cloud.points, self.cell_m, self.cap_m))

        def evaluate(points: Floats) -> Terms:
            distance, (gx, gy) = distances.read(points)
            squared = (distance / self.cauchy_m) ** 2
            weight = 1.0 / (1.0 + squared)
            pull_x, pull_y = weight * gx, weight * gy
            near = distance < self.cap_m
            inliers = int(near.sum())
            return Terms(
                cost=0.5 * self.cauchy_m**2 * float(np.log1p(squared).sum()),
                slope=np.stack([pull_x * distance, pull_y * distance]),
                curvature=np.stack([pull_x * gx, pull_x * gy, pull_y * gy]),
                near=inliers,
                error_m=float(distance[near].sum()) / inliers if inliers else math.nan,
                steep=float(inliers),
            )

        return evaluate


SPEC = RegistrationSpec(
    make=DistanceFieldMatcher,
    summary="Gauss-Newton on the distance to the nearest occupied cell, without pairs",
    citation="Pedrosa, Pereira and Lau, A non-linear least squares approach to SLAM using a dynamic likelihood field, "
    "Journal of Intelligent and Robotic Systems 93, 2019",
    licence="MIT",
    parameters=declared_parameters(DistanceFieldMatcher),
    frontend={"scan_to_scan_with_odometry": False},
    tuned_on=("lab", "loop", "fr079", "rplidar-slambot"),
)
