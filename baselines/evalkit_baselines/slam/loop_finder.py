"""Find and verify loop closures: place, branch and bound, ICP, fit, uniqueness, observability, chi-square.

A candidate is a place that ``LoopPlaces`` names. Points of several keyframes on either side are matched, because single
scans of equal rooms differ less.
A candidate is rejected with the first of these reasons:

1. *score*: branch and bound finds no motion, within three sigma of what the graph predicts, that fits;
2. *ambiguous*: another motion within the gate fits nearly as well (equal doors of a corridor);
3. *overlap*: after ICP too few points lie on the other map;
4. *degenerate*: the geometry does not fix the position (a bare corridor);
5. *chi2*: the motion contradicts the graph: the squared Mahalanobis distance of its residual is above the gate;
6. *contradicted*: too many points are missing on the other map where its scans could see them.

A robot that returns from another room sees only a part of the first map. Where the graph predicts the motion, three
quarters of the score and of the overlap are therefore enough, if the walls fix the position twice as well and nearly
nothing is contradicted.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.correlative import (
    ScoreGrid,
    Window,
    bounded_search,
    branch_and_bound,
    mild_prior,
    other_headings,
    windows_around,
)
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.protocols import Registration
from evalkit_baselines.paper.icp import line_normals
from evalkit_baselines.slam import pose_graph
from evalkit_baselines.slam.continuity import could_see
from evalkit_baselines.slam.keyframes import DOUBTED_M, Edge, Keyframes
from evalkit_baselines.slam.loop_places import LoopPlace, LoopPlaces
from evalkit_baselines.slam.loop_reasons import (
    describe_ambiguous,
    describe_contradiction,
    describe_degenerate,
    describe_far,
    describe_few_points,
    describe_little_overlap,
    describe_low_score,
    describe_passed,
)
from evalkit_baselines.slam.observability import Openness, measure_openness
from evalkit_baselines.slam.settings import LoopSettings

MIN_POINTS = 50
"""Points of either map, thinned, that a candidate needs."""
_SOURCE_POINTS = 300
_SIGMAS = 3.0
_MIN_WINDOW_M, _MIN_WINDOW_RAD = 0.3, math.radians(3.0)
_MAX_WINDOW_RAD = math.radians(30.0)
_COARSE = 2.0
"""After a lost track the cells of branch and bound have so many times the side: the windows are large."""

_PART, _PART_DEGENERATE = 0.75, 0.5
"""Share of ``loop_score`` and ``loop_overlap`` that is enough for maps that lie on each other in part, and share of
``loop_degenerate_m`` that is then allowed: parts of a corridor are equal."""

_CORRELATED = 10.0
"""Points near each other have the same error: so many count as one."""
_FLOOR = np.diag([0.015**2, 0.015**2, 0.004**2])
"""Covariance of the best closure: maps of noisy scans are no better (m^2, rad^2)."""

_PART_VARIANCE = 15.0
"""Further variance of a closure of maps that lie on each other in part, as a multiple of that: 6 cm and 1 deg in all.
What only one of them saw, such as the other face of a thin wall, pulls at the match."""

_CLEAR_RATIO = 0.3
"""From this ratio of eigenvalues on (see ``observability``) the position along a corridor is as good as across."""


class Candidate(NamedTuple):
    """The edge that a candidate measured, whether it passed all checks, and why or why not.

    ``chi_square``: of its residual, nan where it was not computed. ``is_local``: the search window was small.
    ``known``: the graph predicted the motion.
    """

    edge: Edge
    passed: bool
    reason: str
    chi_square: float = math.nan
    is_local: bool = False
    known: bool = True


class _Prediction(NamedTuple):
    """The motion ``target_from_source`` that the graph predicts and its covariance (3, 3) in the source's frame.

    ``known``: where False, the motion is a guess to search around. ``turned``: or a place, at any heading. ``apart``:
    both belong to parts of the drive that no closure connects.
    """

    motion: Pose
    covariance: Floats
    known: bool = True
    turned: bool = False
    apart: bool = False

    @property
    def part(self) -> float:
        """Share of the least score and overlap that may be enough."""
        return _PART if self.known and not self.apart else 1.0


class _Found(NamedTuple):
    """What branch and bound found: the motion and its score, or None and the reason; whether the window was small."""

    motion: Pose | None
    reason: str
    is_local: bool
    score: float = math.nan


class LoopFinder:
    """Proposes at most one verified candidate per keyframe: bounded work whatever the length of the drive."""

    def __init__(self, settings: LoopSettings, coarse: Registration, fine: Registration) -> None:
        self._settings, self._coarse, self._fine = settings, coarse, fine
        self._places = LoopPlaces(settings)
        self._tried_at_m = -math.inf

    def find(self, keyframes: Keyframes, expected: Candidate | None, measured: bool) -> Candidate | None:
        """Return the candidate of the last keyframe, None where there is no place to compare.

        ``expected``: an unconfirmed one, beside which another one may confirm it. ``measured``: the keyframe has wheel
        odometry.
        """
        last = len(keyframes) - 1
        if keyframes.path_m[last] - self._tried_at_m < self._settings.loop_spacing_m:
            return None
        beside = None if expected is None else self._places.find_beside(keyframes, expected.edge, expected.known)
        place = beside or self._places.find_next(keyframes, measured)
        if place is None:
            return None
        self._tried_at_m = keyframes.path_m[last]
        return self._verify(keyframes, place, last)

    def _verify(self, keyframes: Keyframes, place: LoopPlace, last: int) -> Candidate:
        settings, other, predicted = self._settings, place.row, self._predict(keyframes, place, last)
        reach = settings.loop_radius_m if predicted.apart else settings.loop_submap_m
        target = voxel_means(keyframes.points_around(other, keyframes.near_in_time(other, reach)), 0.05)
        source = voxel_means(keyframes.points_around(last, keyframes.near_in_time(last, settings.loop_submap_m)), 0.1)
        guess = Edge(other, last, predicted.motion, np.eye(3))
        if min(len(source), len(target)) < MIN_POINTS:
            return Candidate(guess, False, describe_few_points(min(len(source), len(target)), MIN_POINTS))
        found = self._search(target, source, predicted)
        if found.motion is None:
            return Candidate(guess, False, found.reason)
        cloud = Cloud(target, "target")
        coarse = self._coarse.register(cloud, Cloud(source, "source"), found.motion)
        match = self._fine.register(cloud, Cloud(source, "source"), coarse.target_from_source)
        candidate, missing = self._judge(target, source, match, predicted, guess, found)
        if not candidate.passed or missing is None:
            return candidate
        on_map = len(source) - len(missing)
        hidden = self._count_hidden(keyframes, other, keyframes.near_in_time(other, reach), missing)
        share = on_map / (len(source) - hidden)
        if not share >= settings.loop_in_view:
            reason = describe_contradiction(share, settings.loop_in_view)
            return candidate._replace(passed=False, reason=reason)
        return candidate

    def _count_hidden(self, keyframes: Keyframes, at: int, rows: Ints, points: Floats) -> int:
        """Return how many points (N, 2) in the frame of one keyframe the scans of several could not see."""
        for row in rows:
            mount = keyframes.mounts[row]
            sensor = Pose(mount.x, mount.y, 0.0)
            at_from_sensor = Pose.of(se2.between(keyframes.poses[at], keyframes.poses[row])) @ sensor
            before, now = sensor.inverse().transform(keyframes.clouds[row]), at_from_sensor.inverse().transform(points)
            points = points[~could_see(before, now, self._settings.loop_near_m)]
        return len(points)

    def _predict(self, keyframes: Keyframes, place: LoopPlace, last: int) -> _Prediction:
        other, apart = keyframes.pose(place.row), bool(keyframes.apart_m[place.row] >= DOUBTED_M)
        if place.known:
            motion = other.inverse() @ keyframes.pose(last)
            covariance = pose_graph.relative_covariance(keyframes.graph(), place.row, last)
            return _Prediction(motion, covariance, apart=apart)
        anywhere = np.diag([1e4, 1e4, 1e2])
        if place.expected is None:
            return _Prediction(Pose(), anywhere, known=False, turned=True, apart=apart)
        return _Prediction(other.inverse() @ place.expected, anywhere, known=False, apart=apart)

    def _search(self, target: Floats, source: Floats, predicted: _Prediction) -> _Found:
        settings, motion = self._settings, predicted.motion
        cos, sin = math.cos(motion.theta), math.sin(motion.theta)
        turn = np.array([[cos, -sin], [sin, cos]])
        sigma = np.sqrt(np.diag(turn @ predicted.covariance[:2, :2] @ turn.T))
        half = np.clip(_SIGMAS * sigma, _MIN_WINDOW_M, settings.loop_radius_m)
        sigma_rad = math.sqrt(predicted.covariance[2, 2])
        half_rad = min(max(_SIGMAS * sigma_rad, _MIN_WINDOW_RAD), _MAX_WINDOW_RAD)
        if predicted.turned:  # places half a radius apart are searched one after the other
            half, half_rad = np.full(2, 0.5 * settings.loop_radius_m), math.pi
        cell_m = settings.loop_cell_m * (_COARSE if predicted.apart else 1.0)
        grid = ScoreGrid.from_points(target, cell_m, cell_m, 5)
        thinned = source[:: max(len(source) // _SOURCE_POINTS, 1)]
        window = Window(motion, float(half[0]), float(half[1]), half_rad)
        weight = mild_prior(half / _SIGMAS, half_rad / _SIGMAS)
        least = predicted.part * settings.loop_score
        best, bound = bounded_search(grid, thinned, window, least, weight)
        is_local = bool(half.max() <= 0.75)
        if best is None:
            return _Found(None, describe_low_score(bound, least), is_local)
        bound = settings.loop_ambiguity * best.score
        turned = [] if predicted.known else [other_headings(best.target_from_source)]
        if not predicted.known:  # another place that fits may be farther away than where this one was sought
            window = Window(motion, settings.loop_radius_m, settings.loop_radius_m, math.pi)
        for part in (*windows_around(window, best.target_from_source), *turned):
            rival = branch_and_bound(grid, thinned, part, bound)
            if rival is not None and self._is_possible(rival.target_from_source, predicted):
                return _Found(None, describe_ambiguous(rival.score / best.score, best.score), is_local)
        return _Found(best.target_from_source, "", is_local, best.score)

    def _is_possible(self, motion: Pose, predicted: _Prediction) -> bool:
        covariance = predicted.covariance + _FLOOR + np.diag([self._settings.loop_cell_m**2] * 2 + [1e-4])
        return _chi_square(motion, predicted.motion, covariance) <= 2.0 * self._settings.loop_gate

    def _judge(
        self, target: Floats, source: Floats, match: Match, predicted: _Prediction, guess: Edge, found: _Found
    ) -> tuple[Candidate, Floats | None]:
        """Return the candidate; where it passes in part only, also the points that are missing on the target."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

        settings, motion, is_local = self._settings, match.target_from_source, found.is_local
        tree, moved = cKDTree(target), motion.transform(source)
        distance, nearest = map(np.asarray, tree.query(moved, distance_upper_bound=settings.loop_near_m))
        on_map = np.isfinite(distance)
        overlap = float(on_map.mean())
        measured = Edge(guess.first, guess.second, motion, guess.information)
        least = predicted.part * settings.loop_overlap
        if not overlap >= least:
            return Candidate(measured, False, describe_little_overlap(overlap, least), is_local=is_local), None
        is_part = not (found.score > settings.loop_score and overlap >= settings.loop_overlap)
        normals = line_normals(tree, 8)[nearest[on_map]]
        covariance = _covariance(source[on_map], normals, motion, max(match.error, 0.01)) + _FLOOR
        covariance += _open_covariance(measure_openness(source[on_map]))
        loosest = math.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])
        most = settings.loop_degenerate_m * (_PART_DEGENERATE if is_part else 1.0)
        if loosest > most:
            return Candidate(measured, False, describe_degenerate(loosest, most), is_local=is_local), None
        covariance += (_PART_VARIANCE if is_part else 0.0) * _FLOOR
        chi = _chi_square(motion, predicted.motion, predicted.covariance + covariance)
        information = np.asarray(np.linalg.inv(covariance), dtype=np.float64)
        edge = Edge(guess.first, guess.second, motion, 0.5 * (information + information.T))
        if not chi <= settings.loop_gate:
            return Candidate(edge, False, describe_far(chi, settings.loop_gate), chi, is_local), None
        candidate = Candidate(edge, True, describe_passed(chi, overlap), chi, is_local, predicted.known)
        return candidate, moved[~on_map] if is_part else None


def _chi_square(motion: Pose, predicted: Pose, covariance: Floats) -> float:
    residual = se2.between(motion.row, predicted.row)
    return float(residual @ np.linalg.solve(covariance, residual))


def _covariance(points: Floats, normals: Floats, motion: Pose, sigma_m: float) -> Floats:
    """Return the covariance (3, 3) of a point-to-line fit in the source's frame; large where nothing is observed."""
    facing = se2.transform([0.0, 0.0, -motion.theta], normals)
    jacobian = np.column_stack([facing, points[:, 0] * facing[:, 1] - points[:, 1] * facing[:, 0]])
    hessian = jacobian.T @ jacobian / (_CORRELATED * sigma_m**2)
    return np.asarray(np.linalg.inv(hessian + np.diag([1e-4, 1e-4, 1e-2])), dtype=np.float64)


def _open_covariance(openness: Openness) -> Floats:
    """Return the covariance (3, 3) along a corridor, where few points fix the position: 0.1 m at a ratio of 0.1.

    Measured on closures in corridors with door niches: the scatter of their points alone does not show their errors.
    """
    covariance = np.zeros((3, 3))
    sigma_m = 0.15 * max(1.0 - openness.ratio / _CLEAR_RATIO, 0.0)
    covariance[:2, :2] = sigma_m**2 * np.outer(openness.direction, openness.direction)
    return np.asarray(covariance)
