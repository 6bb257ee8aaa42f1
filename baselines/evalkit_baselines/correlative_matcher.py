"""Correlative matching as a registration: the best score in a window around the guess, then its maximum between cells.

It searches the window at every call, so that it has no local minima within it. Different from Olson 2009 and Hess et
al. 2016: the answer is finer than the lattice of the search, because a quadratic function is fitted to the scores of
the neighbours of the best motion, three times, and the answer is its maximum. In a direction in which that function is
flat the answer is that of the search, which the prior draws to the guess.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from evalkit.core import se2
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.correlative import FULL, ScoreGrid, Window, branch_and_bound
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.paper.association import CloudCache

REFINEMENTS = 3
TILE_M = 5.0  # target points are cropped around the guess rounded to this, so that near guesses share a grid


@dataclass(frozen=True)
class CorrelativeMatcher:
    """A Registration. ``error`` (m): the distance at which one point has the mean score of the answer.

    ``inliers``: points with more than half of the full score. Grids of recent targets are kept, found by the identity
    of their (frozen) clouds; this cannot change a result.
    """

    window_m: float = parameter(0.3, "m", "search up to this distance from the guess, in x and in y", low=0.01, high=20)
    window_deg: float = parameter(20.0, "deg", "search up to this turn from the guess", low=0.1, high=180.0)
    cell_m: float = parameter(0.05, "m", "side of a cell, and distance of two motions of the search", low=5e-3, high=1)
    sigma_m: float = parameter(0.05, "m", "standard deviation of the Gaussian around a target point", low=5e-3, high=1)
    thin_m: float = parameter(0.05, "m", "thin the source to one mean per cell of this side; 0: off", low=0.0)
    max_range_m: float = parameter(20.0, "m", "source points farther from the base are left out", low=1.0, high=100.0)
    prior_distance: float = parameter(0.5, "1/m", "scores fall by exp(-(distance from guess times this)^2)", low=0.0)
    prior_turn: float = parameter(0.2, "1/rad", "and by exp(-(turn from the guess times this)^2)", low=0.0)
    min_score: float = parameter(0.2, "", "without a better score the guess is kept, not converged", low=0.0, high=1.0)
    min_curvature: float = parameter(
        0.02, "", "a direction is not refined where the score changes by less per squared sigma", low=0.0
    )
    _recent: CloudCache[dict[tuple[int, int], ScoreGrid | None]] = field(
        default_factory=CloudCache, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_fields("correlative", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source`` with the best score in the window around ``guess``."""
        points = voxel_means(source.points, self.thin_m) if self.thin_m > 0.0 else source.points
        points = points[np.hypot(points[:, 0], points[:, 1]) <= self.max_range_m]
        grid = self._grid(target, guess)
        if grid is None:
            return Match.not_converged(guess)
        window = Window(guess, self.window_m, self.window_m, math.radians(self.window_deg))
        found = branch_and_bound(grid, points, window, self.min_score, self._prior)
        if found is None:
            return Match.not_converged(guess)
        motion, flat = found.target_from_source, self.min_curvature * (self.cell_m / self.sigma_m) ** 2
        for _ in range(REFINEMENTS):
            motion = fit_peak(grid, points, motion, flat, lambda rows: self._weight(rows, guess))
        scores = grid.score(motion.transform(points))
        distance = self.sigma_m * math.sqrt(-2.0 * math.log(max(float(scores.mean()), 1.0 / FULL)))
        return Match(motion, True, 1 + REFINEMENTS, distance, int((scores > 0.5).sum()))

    def _prior(self, x: Floats, y: Floats, theta: Floats) -> Floats:
        return np.asarray(np.exp(-(self.prior_distance**2) * (x * x + y * y) - (self.prior_turn * theta) ** 2))

    def _weight(self, motions: Floats, guess: Pose) -> Floats:
        x, y, theta = (motions - guess.row).T
        return self._prior(x, y, se2.wrap(theta))

    def _grid(self, target: Cloud, guess: Pose) -> ScoreGrid | None:
        """Return the grid of the target points that a source point may reach, None where there are none."""
        tile = round(guess.x / TILE_M), round(guess.y / TILE_M)
        grids = self._recent.get(target, lambda _: {})
        if tile not in grids:
            reach = self.max_range_m + math.sqrt(2.0) * self.window_m + 3.0 * self.sigma_m + self.cell_m + TILE_M
            near = np.abs(target.points - np.multiply(tile, TILE_M)).max(axis=1, initial=0.0) <= reach
            depth = int(2.0 * self.window_m / self.cell_m + 1.0).bit_length()
            points = target.points[near]
            grids[tile] = ScoreGrid.from_points(points, self.cell_m, self.sigma_m, depth) if len(points) else None
        return grids[tile]


def fit_peak(
    grid: ScoreGrid,
    points: Floats,
    motion: Pose,
    min_curvature: float = 0.02,
    weigh: Callable[[Floats], Floats] | None = None,
) -> Pose:
    """Return the maximum of the quadratic function fitted to the scores of 27 motions around ``motion``.

    They are one cell apart, and the angle about the points' centre that moves a point at the root mean square distance
    by one cell. ``weigh``: factors (K,) of the scores of motions (K, 3). The answer stays within one such step; it does
    not leave ``motion`` in a principal direction in which the curvature is less than ``min_curvature`` (score per
    squared step).
    """
    moved = motion.transform(points)
    centre = moved.mean(axis=0)
    angle = grid.cell_m / max(math.sqrt(float(((moved - centre) ** 2).sum(axis=1).mean())), grid.cell_m)
    steps = np.array([grid.cell_m, grid.cell_m, angle])
    turns = _about(centre, _NEIGHBOURS * steps)
    scores = grid.score(se2.transform(turns, moved)).mean(axis=1)
    if weigh is not None:
        scores = scores * weigh(se2.compose(turns, motion.row))
    xx, yy, tt, xy, xt, yt, *slope = _FIT @ scores
    curvature, directions = np.linalg.eigh([[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]])
    peaked = curvature < -min_curvature
    along = directions[:, peaked]
    step = along @ (along.T @ np.array(slope) / -curvature[peaked])
    return Pose.of(_about(centre, np.clip(step, -1.0, 1.0) * steps)) @ motion


def _about(centre: Floats, steps: Floats) -> Floats:
    """Return the motions (..., 3) that turn about a point and then shift it, from rows of shift (m) and turn (rad)."""
    turned = se2.transform(steps * [0.0, 0.0, 1.0], centre[None])[..., 0, :]
    return np.concatenate([steps[..., :2] + centre - turned, steps[..., 2:]], axis=-1)


_NEIGHBOURS = np.stack(np.meshgrid(*([[-1.0, 0.0, 1.0]] * 3), indexing="ij"), axis=-1).reshape(-1, 3)


def _least_squares_fit() -> Floats:
    """Return the matrix (9, 27) from scores to the second and first derivatives of the fitted quadratic function."""
    x, y, t = _NEIGHBOURS.T
    terms = [0.5 * x * x, 0.5 * y * y, 0.5 * t * t, x * y, x * t, y * t, x, y, t, np.ones(27)]
    return np.asarray(np.linalg.pinv(np.stack(terms, axis=1))[:9])


_FIT = _least_squares_fit()

SPEC = RegistrationSpec(
    make=CorrelativeMatcher,
    summary="correlative matching: exact search of a window by branch and bound",
    citation="Olson, ICRA 2009; Hess, Kohler, Rapp and Andor, ICRA 2016",
    licence="MIT",
    parameters=declared_parameters(CorrelativeMatcher),
    tuned_on=("lab", "loop", "office"),
)
