"""Kinematic ICP: point-to-point ICP that corrects wheel odometry only by motions that a wheeled robot can make.

Guadagnino et al. 2024: the answer is the motion of the wheels followed by an arc, with two unknowns: its length along
the robot's heading and its turn. A robot with wheels does not move sideways, so the scans do not correct that. The step
minimises the mean squared distance of the pairs plus beta times the squared length; beta is one over the mean squared
distance of the first pairs, so that good odometry is changed less. Pairs are dropped beyond three times the size of a
map's cell plus the mean error of the odometry so far, measured at the longest range (equation 9 and 10).

Different from the paper, which is made for halls and streets with a 3D lidar:

* beta is multiplied by ``trust_m`` squared. The paper's is one over square metres beside terms without a unit, which is
  ``trust_m = 1``. With the few centimetres of a first distance indoors, the length then never changes.
* The local map is that of evalkit's front end, the same for all registrations, not a map of voxels of 1 m.
* The length of a step is the length of its arc.

Without wheel odometry there is nothing to correct: such a recording is refused. In a gap of the odometry the front end
predicts a constant velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from evalkit.core import se2
from evalkit.core.errors import DataMissing
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.odometry.frontend import PARAMETERS as FRONT_END
from evalkit.odometry.frontend import FrontEnd, FrontEndSettings
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter, with_defaults
from evalkit.plugins.specs import OdometrySpec
from evalkit_baselines.paper.association import Association, CloudCache

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

MIN_PAIRS = 3


@dataclass(frozen=True)
class KinematicSettings:
    """Parameters of the registration."""

    max_iterations: int = parameter(10, "", "largest number of iterations", low=1)
    epsilon: float = parameter(1e-4, "m and rad", "stop where a step is smaller", low=0.0)
    trust_m: float = parameter(0.007, "m", "weight of the odometry's length; 1: as in the paper, 0: none", low=0.0)
    cell_m: float = parameter(0.02, "m", "error of the map: pairs are dropped beyond three times this", low=1e-3)
    max_range_m: float = parameter(12.0, "m", "range at which a turn of the odometry is an error in metres", low=0.1)


class _Limit:
    """The largest distance of a pair (m), which grows with the errors of the odometry so far (paper, eq. 9, 10)."""

    def __init__(self, cell_m: float, range_m: float) -> None:
        self._cell_m, self._range_m = cell_m, range_m
        self._squares, self._count = 0.0, 0

    @property
    def metres(self) -> float:
        return 3.0 * (self._cell_m + math.sqrt(self._squares / max(self._count, 1)))

    def add(self, correction: Pose) -> None:
        """Add the error of one step: its shift, and its turn at the longest range."""
        turn = 2.0 * self._range_m * math.sin(abs(correction.theta) / 2.0)
        self._squares += (math.hypot(correction.x, correction.y) + turn) ** 2
        self._count += 1


@dataclass(frozen=True)
class KinematicRegistration:
    """A Registration whose answer is the guess, which must be that of the wheels, followed by an arc."""

    settings: KinematicSettings
    limit: _Limit
    _recent: CloudCache[cKDTree] = field(default_factory=CloudCache, init=False, repr=False, compare=False)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return ``target_from_source`` on an arc from ``guess``; ``error`` is the root mean square distance (m)."""
        if min(len(target), len(source)) < MIN_PAIRS:
            return Match.not_converged(guess)
        association = Association(self._recent.get(target, _index), len(source), self.limit.metres)
        pose, history = guess.row, list[Iteration]()
        beta, converged = math.nan, False
        while len(history) < self.settings.max_iterations and not converged:
            moved = se2.transform(pose, source.points)
            nearest, distance = association.find(moved)
            at = np.flatnonzero(np.isfinite(distance))
            if len(at) < MIN_PAIRS:
                return Match.not_converged(guess, len(at))
            squared = float((distance[at] ** 2).mean())
            if not history:
                beta = self.settings.trust_m**2 / max(squared, 1e-12)
            gaps = target.points.take(nearest[at], axis=0) - moved.take(at, axis=0)
            length, turn = solve_step(source.points.take(at, axis=0), gaps, float(pose[2]), beta)
            pose = se2.compose(pose, arc(length, turn))
            history.append(Iteration(math.sqrt(squared), len(at), Pose.of(pose)))
            converged = math.hypot(length, turn) < self.settings.epsilon
        last = history[-1]
        return Match(last.target_from_source, converged, len(history), last.error, last.inliers, tuple(history))


def solve_step(source: Floats, gaps: Floats, heading: float, beta: float) -> tuple[float, float]:
    """Return the length (m) and turn (rad) that minimise mean |gap - motion of the point|^2 + beta length^2.

    ``source`` (K, 2): points in the base frame. ``gaps`` (K, 2): from the moved point to its target, in the target's
    frame. ``heading``: of the base in that frame (rad). Linearised; the turn is 0 where all points are at the base.
    """
    cos, sin = math.cos(heading), math.sin(heading)
    ahead = gaps[:, 0] * cos + gaps[:, 1] * sin  # the gaps in the base frame
    aside = gaps[:, 1] * cos - gaps[:, 0] * sin
    x, y = source.T
    a, b, d = 1.0 + beta, -float(y.mean()), float((x * x + y * y).mean())
    p, q = float(ahead.mean()), float((x * aside - y * ahead).mean())
    determinant = a * d - b * b
    if determinant <= 1e-12:
        return p / a, 0.0
    return (d * p - b * q) / determinant, (a * q - b * p) / determinant


def arc(length: float, turn: float) -> Floats:
    """Return the motion (3,) of a base that drives an arc of a length (m) and turns by an angle (rad)."""
    half = 0.5 * turn
    chord = length * float(np.sinc(half / math.pi))  # sin(half) / half
    return np.array([chord * math.cos(half), chord * math.sin(half), turn])


def _index(target: Cloud) -> cKDTree:
    from scipy.spatial import cKDTree  # noqa: PLC0415 - the spec of a back end is listed without SciPy

    return cKDTree(target.points, leafsize=16, balanced_tree=False)


class KinematicIcp:
    """Kinematic ICP on one sequence: evalkit's front end, whose guess is the motion of the wheels."""

    def __init__(self, settings: KinematicSettings, front_end: FrontEndSettings) -> None:
        self._limit = _Limit(settings.cell_m, settings.max_range_m)
        registration = KinematicRegistration(settings, self._limit)
        self._front_end = FrontEnd(registration, registration, front_end)
        self._last: tuple[Pose, Pose | None] | None = None  # answer and wheel odometry at the last scan

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one scan; raises DataMissing where the recording begins without wheel odometry."""
        if self._last is None and frame.odom_from_base is None:
            raise DataMissing(
                "kinematic-icp",
                "the recording has no wheel odometry at its first scan, and this method corrects wheel odometry",
                "begin at a scan that has it (start = N), or leave this method out of the comparison",
            )
        estimate = self._front_end.update(frame)
        if self._last is not None:
            pose, wheels = self._last
            if estimate.accepted and wheels is not None and frame.odom_from_base is not None:
                self._limit.add((pose @ wheels.inverse() @ frame.odom_from_base).inverse() @ estimate.pose)
        self._last = estimate.pose, frame.odom_from_base
        return estimate


_FRONT_END = tuple(each for each in with_defaults(FRONT_END, scan_to_scan=False) if each.name != "prior")
"""The front end's parameters: its prior is always the wheels, and the paper has no scan-to-scan stage."""


def make(**parameters: Any) -> KinematicIcp:
    """Make a new Kinematic ICP with the parameters of ``KinematicSettings`` and of the front end."""
    front_end = {each.name: parameters.pop(each.name) for each in _FRONT_END if each.name in parameters}
    settings = KinematicSettings(**parameters)
    check_fields("kinematic-icp", settings)
    return KinematicIcp(settings, FrontEndSettings(**{"scan_to_scan": False, **front_end}))


SPEC = OdometrySpec(
    make=make,
    summary="Kinematic ICP: corrects wheel odometry along arcs only",
    citation="Guadagnino, Mersch, Vizzo, Gupta, Malladi, Lobefaro, Doisy and Stachniss, Kinematic-ICP, 2024",
    licence="MIT",
    guess="wheel odometry, which it requires",
    parameters=(*declared_parameters(KinematicSettings), *_FRONT_END),
    tuned_on=("lab", "loop"),
)
