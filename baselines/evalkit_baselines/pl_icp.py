"""PL-ICP: point-to-line ICP whose step is the exact minimum for its pairs (Censi, ICRA 2008).

Each source point is paired with the line through the nearest target point and a neighbour of that point. The step
minimises the sum of squared distances to these lines over all rotations and translations in closed form: the
translation is eliminated, and the rotation is a root of a polynomial of degree four (section IV). Pairs are rejected as
in the paper's own implementation: a share of the worst and those beyond a multiple of a quantile of the distances, and,
of several source points with one target point, those much farther than the best.

Different from the paper, because a target here is a cloud of several scans without an order of beams:

* Nearest points come from a search tree, not from the order of the beams.
* The neighbour that defines the line is the nearest one at ``line_m`` or more. The very next point of a target of
  several scans is a point of the same wall in another scan: the line through both has a random direction.
* The step is computed about the centre of the paired points, and directions that the lines do not constrain (a single
  wall) are not moved along.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter
from evalkit.plugins.specs import RegistrationSpec
from evalkit_baselines.paper.association import Association, CloudCache

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MIN_PAIRS = 3
NEIGHBOURS = 16  # searched for one at the distance that a line needs
FLAT = 1e-9  # a direction with a smaller share of the largest eigenvalue is not constrained


class _Target(NamedTuple):
    tree: cKDTree
    points: Floats
    normals: Floats


class _Pairs(NamedTuple):
    """Rows of the source and of the target (K,), and the distances to the lines (K,) in metres."""

    source: Ints
    target: Ints
    distance: Floats


@dataclass(frozen=True)
class PlIcp:
    """A Registration. ``error`` is the mean distance to the lines (m) over the pairs that were kept.

    Search trees of recent targets are kept, found by the identity of their (frozen) clouds; this cannot change a
    result.
    """

    max_correspondence_m: float = parameter(0.5, "m", "pairs of points farther apart are dropped", low=1e-3)
    max_iterations: int = parameter(20, "", "largest number of iterations", low=1)
    thin_m: float = parameter(0.1, "m", "thin the target to one mean per cell of this side; 0: off", low=0.0)
    line_m: float = parameter(0.3, "m", "smallest distance of the two target points that define a line", low=0.0)
    keep_share: float = parameter(0.95, "", "share of the pairs that are kept, nearest first", low=0.05, high=1.0)
    quantile: float = parameter(0.7, "", "pairs beyond a multiple of this quantile are dropped", low=0.0, high=1.0)
    quantile_factor: float = parameter(2.0, "", "the multiple; 0: off", low=0.0)
    sharing_factor: float = parameter(
        3.0, "", "of the pairs of one target point, drop those farther than this multiple of the best; 0: off", low=0.0
    )
    epsilon_m: float = parameter(1e-4, "m", "stop where a step is shorter (and turns by less, in rad)", low=0.0)
    min_share: float = parameter(0.05, "", "a smaller share of paired points is a failure", low=0.0, high=1.0)
    restart_error_m: float = parameter(
        0.05, "m", "with a larger error restart from six other guesses; 0: never", low=0.0
    )
    restart_m: float = parameter(0.01, "m", "their distance from the answer", low=0.0)
    restart_deg: float = parameter(1.5, "deg", "their turn from the answer", low=0.0)
    _recent: CloudCache[_Target] = field(default_factory=CloudCache, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_fields("pl-icp", self)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``, starting from ``guess``; of several starts that of least error."""
        if min(len(target), len(source)) < MIN_PAIRS:
            return Match.not_converged(guess)
        lines = self._recent.get(target, self._index)
        best = self._descend(lines, source.points, guess)
        if not 0.0 < self.restart_error_m < best.error:
            return best
        for start in self._restarts(best.target_from_source):
            other = self._descend(lines, source.points, start)
            if (other.converged, -other.error) > (best.converged, -best.error):
                best = other
        return best

    def _restarts(self, answer: Pose) -> Iterator[Pose]:
        for axis, size in ((0, self.restart_m), (1, self.restart_m), (2, math.radians(self.restart_deg))):
            for sign in (1.0, -1.0):
                row = answer.row
                row[axis] += sign * size
                yield Pose.of(row)

    def _descend(self, target: _Target, source: Floats, guess: Pose) -> Match:
        """Iterate from one guess until a step is small or the pairs repeat."""
        association = Association(target.tree, len(source), self.max_correspondence_m)
        pose, history, seen = guess.row, list[Iteration](), set[bytes]()
        converged = False
        while len(history) < self.max_iterations and not converged:
            moved = se2.transform(pose, source)
            pairs = self._pairs(target, association, moved)
            if len(pairs.source) < max(MIN_PAIRS, self.min_share * len(source)):
                return Match(guess, False, len(history), math.nan, len(pairs.source), tuple(history))
            key = pairs.source.tobytes() + pairs.target.tobytes()
            at = target.points.take(pairs.target, axis=0)
            step = fit_to_lines(moved.take(pairs.source, axis=0), at, target.normals.take(pairs.target, axis=0))
            pose = se2.compose(step, pose)
            history.append(Iteration(float(pairs.distance.mean()), len(pairs.source), Pose.of(pose)))
            small = max(math.hypot(step[0], step[1]), abs(step[2])) < self.epsilon_m
            converged = key in seen or bool(small)
            seen.add(key)
        last = history[-1]
        return Match(last.target_from_source, converged, len(history), last.error, last.inliers, tuple(history))

    def _index(self, target: Cloud) -> _Target:
        from scipy.spatial import cKDTree  # noqa: PLC0415 - the spec of a back end is listed without SciPy

        points = voxel_means(target.points, self.thin_m) if self.thin_m > 0.0 else target.points
        tree = cKDTree(points, leafsize=16, balanced_tree=False)
        return _Target(tree, points, line_normals(tree, self.line_m))

    def _pairs(self, target: _Target, association: Association, moved: Floats) -> _Pairs:
        nearest, apart = association.find(moved)
        source = np.flatnonzero(np.isfinite(apart))
        onto = nearest[source]
        if self.sharing_factor > 0.0 and len(source):
            least = np.full(len(target.points), np.inf)
            np.minimum.at(least, onto, apart[source])
            kept = apart[source] <= self.sharing_factor * least[onto]
            source, onto = source[kept], onto[kept]
        arms = moved.take(source, axis=0) - target.points.take(onto, axis=0)
        distance = np.abs(np.sum(arms * target.normals.take(onto, axis=0), axis=1))
        return self._trim(_Pairs(source, onto, distance))

    def _trim(self, pairs: _Pairs) -> _Pairs:
        """Return the pairs without the worst."""
        if not len(pairs.distance):
            return pairs
        ordered = np.sort(pairs.distance)
        last = len(ordered) - 1
        limit = ordered[min(math.ceil(self.keep_share * len(ordered)) - 1, last)]
        if self.quantile_factor > 0.0:
            limit = min(limit, self.quantile_factor * ordered[min(int(self.quantile * len(ordered)), last)])
        kept = pairs.distance <= limit
        return _Pairs(pairs.source[kept], pairs.target[kept], pairs.distance[kept])


def line_normals(tree: cKDTree, line_m: float) -> Floats:
    """Return the unit normals (M, 2) of the line through each point and its nearest neighbour at ``line_m`` or more.

    Among ``NEIGHBOURS`` neighbours; the farthest of them where none is that far.
    """
    apart, near = map(np.asarray, tree.query(tree.data, k=min(NEIGHBOURS + 1, tree.n)))
    far_enough = apart >= max(line_m, 1e-9)
    column = np.where(far_enough.any(axis=1), far_enough.argmax(axis=1), apart.shape[1] - 1)
    other = near[np.arange(tree.n), column]
    along = tree.data[other] - tree.data
    length = np.hypot(along[:, 0], along[:, 1])
    return np.stack([-along[:, 1], along[:, 0]], axis=1) / np.where(length > 0.0, length, 1.0)[:, None]


def fit_to_lines(source: Floats, target: Floats, normals: Floats) -> Floats:
    """Return the motion (3,) that minimises the squared distances of points (K, 2) to lines, over all rotations.

    ``target`` (K, 2): a point of each line; ``normals`` (K, 2): its unit normal. Paper, section IV and appendix I. In a
    direction that the lines leave free the centre of the points does not move.
    """
    centre = source.mean(axis=0)
    x, y = (source - centre).T
    nx, ny = normals.T
    # a residual is rows @ (shift_x, shift_y, cos, sin) - wanted
    rows = np.stack([nx, ny, x * nx + y * ny, x * ny - y * nx], axis=1)
    wanted = np.sum((target - centre) * normals, axis=1)
    M, r = rows.T @ rows, rows.T @ wanted
    shift_from_turn = np.linalg.pinv(M[:2, :2], rcond=FLAT, hermitian=True)
    S = M[2:, 2:] - M[2:, :2] @ shift_from_turn @ M[:2, 2:]
    h = r[2:] - M[2:, :2] @ shift_from_turn @ r[:2]
    cos, sin = best_direction(S, h)
    shift = shift_from_turn @ (r[:2] - M[:2, 2:] @ [cos, sin])
    moved = centre + shift - [cos * centre[0] - sin * centre[1], sin * centre[0] + cos * centre[1]]
    return np.array([moved[0], moved[1], math.atan2(sin, cos)])


def best_direction(S: Floats, h: Floats) -> tuple[float, float]:
    """Return the unit vector v that minimises v' S v - 2 h' v, S (2, 2) symmetric; (1, 0) where all are equal.

    v = (S + k)^-1 h with the largest root k of |v| = 1, which is a polynomial of degree four in k.
    """
    values, vectors = np.linalg.eigh(S)
    a, b = values.tolist()
    p, q = (vectors.T @ h).tolist()
    size = math.hypot(p, q)
    if size <= FLAT * max(abs(a), abs(b), 1e-300) and b - a <= FLAT * max(abs(b), 1e-300):
        return 1.0, 0.0
    # with k measured from -a: p^2 (k + gap)^2 + q^2 k^2 = k^2 (k + gap)^2
    gap = b - a
    polynomial = [1.0, 2.0 * gap, gap**2 - p**2 - q**2, -2.0 * gap * p**2, -((gap * p) ** 2)]
    k = max((root.real for root in np.roots(polynomial) if abs(root.imag) <= 1e-6 * (size + gap)), default=size)
    first = p / k if k > FLAT * (size + gap) else math.copysign(math.sqrt(max(1.0 - (q / gap) ** 2, 0.0)), p)
    v = vectors @ [first, q / (k + gap)]
    length = math.hypot(v[0], v[1])
    return float(v[0] / length), float(v[1] / length)


SPEC = RegistrationSpec(
    make=PlIcp,
    summary="PL-ICP: point-to-line ICP with the exact step, trimming and restarts",
    citation="Censi, An ICP variant using a point-to-line metric, ICRA 2008",
    licence="MIT",
    parameters=declared_parameters(PlIcp),
    tuned_on=("lab", "loop", "office"),
)
