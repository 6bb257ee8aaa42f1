"""Point-to-point ICP of "Occupancy grid mapping based on ICP for indoor autonomous vehicles", equation by equation.

Where the printed equations contain errors, the corrected ones are used:

====  =====================  ===============================  ======================================================
eq.   printed                here                             taken literally
====  =====================  ===============================  ======================================================
(4)   R = U V^T of           theta = atan2(K01 - K10,         it is R^T: each step turns the wrong way, and nothing
      K = U S V^T            K00 + K11)                       converges
(4)   no reflection guard    an angle cannot mirror           a single wall may come back mirrored
(5)   *mean squared*         ``error="mean"`` (m)             Table 1 lists the mean distance; squared, real scans
      distance                                                stop after two iterations
(5)   not said when          ``error_at="after"`` the step    iteration counts move by less than one
(9)   T_k = dT T_{k-1}       the same, with dT in the         a dT in the *body* frame belongs on the right; on the
                             target's frame                   left it throws the pose away once the heading is not 0
====  =====================  ===============================  ======================================================

Not in the paper, and off by default: ``metric="line"``, the distance to the wall instead of to the point. There a pair
with a target point that was seen from the other side of its wall (``Cloud.seen_from``, ``origin``) is none: thin walls
have two faces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter
from evalkit_baselines.paper.association import Association, CloudCache

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MAX_SUPPORT = 20
"""Points of a mean that count: the points of one scan share the error of its pose."""

CLEAR_VIEW = 0.1
"""Share across its line of the directions that a target point was seen from: a smaller one is of no side."""

CLEAR_LOOK = 0.02
"""The same for the direction to where the source was seen from."""

Target: TypeAlias = "tuple[cKDTree, Floats | None]"  # with the normals (M, 2) of metric "line"


@dataclass(frozen=True)
class Icp:
    """The paper's registration (section 2).

    Errors are returned in metres: for "mean-squared" the stop rule compares squares and the result is their root.
    Every ``Iteration`` holds the error that the stop rule compared. With too few pairs the result is the guess, not
    converged, with error nan.

    Search trees of recent targets are kept, found by the identity of their (frozen) clouds. That saves time between
    calls and cannot change a result.
    """

    epsilon: float = parameter(1e-4, "m (mean-squared: m^2)", "stop when the error changes by less", low=0.0)
    max_iterations: int = parameter(40, "", "stop after this number of iterations, not converged", low=1)
    error: Literal["mean", "mean-squared", "rmse"] = parameter(
        "mean", "", "quantity of the stop rule", choices=("mean", "mean-squared", "rmse")
    )
    error_at: Literal["after", "before"] = parameter(
        "after", "", "error of the same pairs after or before the step", choices=("after", "before")
    )
    one_to_one: bool = parameter(
        True, "", "of several source points with the same target point only the closest is used"
    )
    max_correspondence_m: float = parameter(0.3, "m", "pairs farther apart are dropped; 0 keeps all", low=0.0)
    min_pairs: int = parameter(3, "", "with fewer pairs the result is the guess, not converged", low=2)
    metric: Literal["point", "line"] = parameter(
        "point", "", "distance to the point, or to the line through it", choices=("point", "line")
    )
    line_neighbours: int = parameter(8, "", "target points that define a line (metric 'line')", low=2)
    cauchy_m: float = parameter(0.0, "m", "scale of the Cauchy weight of metric 'line'; 0: equal weights", low=0.0)
    share_noise: bool = parameter(
        False, "", "metric 'line': pairs with the same target point share its noise, and weigh less the more they are"
    )
    trace: bool = parameter(False, "", "keep the pairs of every iteration")
    _recent: CloudCache[Target] = field(default_factory=CloudCache, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_fields("paper ICP", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``, starting from ``guess``; history has one entry per iteration."""
        history: list[Iteration] = []
        if not len(target) or not len(source):
            return Match.not_converged(guess)
        tree, normals = self._recent.get(target, self._index)
        association = Association(tree, len(source), self.max_correspondence_m or math.inf)
        pose = guess.row
        viewer = None if source.origin is None else guess.transform(source.origin[None])[0]
        moved = se2.transform(pose, source.points)
        previous, converged = math.inf, False
        while len(history) < self.max_iterations and not converged:
            at, onto = self._pairs(association, moved, target, normals, viewer)
            if len(at) < self.min_pairs:
                return Match(guess, False, len(history), math.nan, len(at), tuple(history))
            goal = target.points.take(onto, axis=0)  # take is several times faster than indexing
            facing = None if normals is None else normals.take(onto, axis=0)
            before = moved.take(at, axis=0)
            step = self._step(before, goal, facing, self._shares(onto, target))
            pose = se2.compose(step, pose)  # eq. 9: the step is in the target's frame
            moved = se2.transform(pose, source.points)
            error = self._error((moved.take(at, axis=0) if self.error_at == "after" else before) - goal, facing)
            converged = abs(error - previous) < self.epsilon
            previous = error
            pairs = np.stack([at, onto], axis=1) if self.trace else None
            history.append(Iteration(self._metres(error), len(at), Pose.of(pose), pairs))
        last = history[-1]
        return Match(last.target_from_source, converged, len(history), last.error, last.inliers, tuple(history))

    def _index(self, target: Cloud) -> Target:
        from scipy.spatial import cKDTree  # noqa: PLC0415 - the spec of a back end is listed without SciPy

        tree = cKDTree(target.points, leafsize=16, balanced_tree=False)  # fastest to build, and queries are not slower
        support = target.support if target.noisy else None
        return tree, line_normals(tree, self.line_neighbours, support) if self.metric == "line" else None

    def _pairs(
        self, association: Association, moved: Floats, target: Cloud, normals: Floats | None, viewer: Floats | None
    ) -> tuple[Ints, Ints]:
        """Return the indices into source (K,), ascending, and target (K,)."""
        nearest, distance = association.find(moved)  # eq. 2
        at = np.flatnonzero(np.isfinite(distance))
        if normals is not None and target.seen_from is not None and viewer is not None:
            at = at[~_seen_from_behind(nearest[at], target, normals, viewer)]
        if self.one_to_one:
            at = at[select_closest(nearest[at], distance[at], len(target))]
        return at, nearest[at]

    def _shares(self, onto: Ints, target: Cloud) -> Floats | None:
        return share_noise(onto, target) if self.share_noise and self.metric == "line" else None

    def _step(self, source: Floats, target: Floats, normals: Floats | None, share: Floats | None) -> Floats:
        if normals is None:
            return fit_motion(source, target)
        return fit_to_lines(source, target, normals, self.cauchy_m, share)

    def _error(self, residuals: Floats, normals: Floats | None) -> float:
        """Return equation 5 over residual vectors (K, 2), in the unit of the stop rule."""
        squares = _dot(residuals, residuals) if normals is None else _dot(residuals, normals) ** 2
        if self.error == "mean":
            return float(np.sqrt(squares).sum()) / len(squares)
        squared = float(squares.sum()) / len(squares)
        return squared if self.error == "mean-squared" else math.sqrt(squared)

    def _metres(self, error: float) -> float:
        return math.sqrt(error) if self.error == "mean-squared" else error


PARAMETERS = declared_parameters(Icp)


def fit_motion(source: Floats, target: Floats) -> Floats:
    """Return the least-squares motion (3,) ``target_from_source`` of pairs (K, 2) (eq. 3, 4).

    In the plane no SVD is needed: V diag(1, det(V U^T)) U^T of K = U S V^T is the rotation by this angle.
    """
    p_bar, q_bar = _centroid(source), _centroid(target)
    K = (source - p_bar).T @ (target - q_bar)  # eq. 3: the sum of (p - p_bar)(q - q_bar)^T
    theta = math.atan2(K[0, 1] - K[1, 0], K[0, 0] + K[1, 1])  # eq. 4, corrected
    return _about(p_bar, q_bar, theta)


def fit_to_lines(
    source: Floats, target: Floats, normals: Floats, cauchy_m: float = 0.0, share: Floats | None = None
) -> Floats:
    """Return the motion (3,) that minimises the distances of points (K, 2) to the lines through their targets.

    Linearised once in theta; not part of the paper. Nothing moves in a direction that the lines do not constrain (a
    single wall). ``cauchy_m``: pairs have the weight 1 / (1 + (distance / cauchy_m)^2); 0: equal weights. ``share``
    (K,): factors of these weights.
    """
    centre = _centroid(source)
    distance = _dot(target - source, normals)
    weight = 1.0 / (1.0 + (distance / cauchy_m) ** 2) if cauchy_m else np.ones(len(distance))
    weight = weight if share is None else weight * share
    (x, y), (nx, ny) = source.T, normals.T
    jacobian = np.array([nx, ny, (x - centre[0]) * ny - (y - centre[1]) * nx])
    weighted = jacobian * weight
    values, axes = np.linalg.eigh(weighted @ jacobian.T)
    inverse = np.divide(1.0, values, out=np.zeros(3), where=values > 1e-9 * values[-1])  # an unconstrained direction: 0
    dx, dy, theta = axes @ (inverse * (weighted @ distance @ axes))
    return _about(centre, centre + np.array([dx, dy]), theta)


def share_noise(onto: Ints, target: Cloud) -> Floats:
    """Return the weights (K,) of pairs with the target points ``onto`` (K,), among all pairs with the same one.

    The source points of c pairs have independent errors of variance 1; their target point, the mean of n such points,
    has one of variance 1 / n, which all c pairs share. The sum of the c residuals has the variance c + c^2 / n, so
    each weighs 1 / (1 + c / n) (generalised least squares). At the end of a wall many points have the same pair.
    """
    pairs = np.bincount(onto, minlength=len(target))
    return np.asarray(1.0 / (1.0 + pairs / _count_points(len(target), target.support)))[onto]


def _count_points(means: int, support: Ints | None) -> Floats:
    """Return of how many points each of some means (M,) is one, as far as they count; None: of one each."""
    return np.ones(means) if support is None else np.asarray(np.minimum(support, MAX_SUPPORT), dtype=np.float64)


def _seen_from_behind(onto: Ints, target: Cloud, normals: Floats, viewer: Floats) -> Bools:
    """Return which of the target points ``onto`` (K,) were seen from the other side of their lines than ``viewer``."""
    assert target.seen_from is not None
    facing, look = normals[onto], viewer - target.points[onto]
    seen, across = ((facing * vectors).sum(axis=1) for vectors in (target.seen_from[onto], look))
    clear = (np.abs(seen) > CLEAR_VIEW) & (across**2 > CLEAR_LOOK**2 * (look * look).sum(axis=1))
    return np.asarray(clear & ((seen < 0.0) != (across < 0.0)))


def line_normals(tree: cKDTree, neighbours: int, support: Ints | None = None) -> Floats:
    """Return the unit normals (M, 2) of the lines through each point of the tree and its neighbours (PCA).

    ``support`` (M,): of how many points each is the mean; it counts as so many, and at most as ``MAX_SUPPORT``.
    """
    _, near = tree.query(tree.data, k=min(neighbours, tree.n))
    near = np.ascontiguousarray(near.reshape(tree.n, -1).T)  # sums over neighbours are several times faster
    weight = None if support is None else _count_points(tree.n, support)[near]
    x, y = (_from_mean(coordinate[near], weight) for coordinate in np.array(tree.data).T)
    xy, difference = x * y, x * x - y * y
    if weight is not None:
        xy, difference = weight * xy, weight * difference
    along = 0.5 * np.arctan2(2.0 * np.sum(xy, axis=0), np.sum(difference, axis=0))
    return np.stack([-np.sin(along), np.cos(along)], axis=1)


def _from_mean(values: Floats, weight: Floats | None) -> Floats:
    """Return values (K, M) less the means (M,) of their columns, by weights if there are some."""
    if weight is None:
        return np.asarray(values - values.sum(axis=0) / len(values))
    return np.asarray(values - (weight * values).sum(axis=0) / weight.sum(axis=0))


def select_closest(nearest: Ints, distance: Floats, targets: int) -> Ints:
    """Return the rows (ascending) that are the closest of all with the same target point; of equals, the lowest row."""
    least = np.full(targets, np.inf)
    np.minimum.at(least, nearest, distance)
    rows = np.flatnonzero(distance == least[nearest])
    first = np.full(targets, len(nearest), dtype=np.int64)
    np.minimum.at(first, nearest[rows], rows)
    return np.asarray(rows[first[nearest[rows]] == rows])


def _dot(one: Floats, other: Floats) -> Floats:
    """Return the dot products (K,) of vectors (K, 2): several times faster than a sum over the axis of two."""
    return np.asarray(one[:, 0] * other[:, 0] + one[:, 1] * other[:, 1])


def _centroid(points: Floats) -> Floats:
    return np.asarray(np.ones(len(points)) @ points / len(points))  # several times faster than mean(axis=0)


def _about(centre: Floats, moved_centre: Floats, theta: float) -> Floats:
    """Return the motion (3,) with rotation theta (rad) that moves one point to another: t = q_bar - R p_bar (eq. 4)."""
    (px, py), (qx, qy) = centre, moved_centre
    cos, sin = math.cos(theta), math.sin(theta)
    return np.array([qx - cos * px + sin * py, qy - sin * px - cos * py, theta])
