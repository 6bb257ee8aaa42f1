"""Front end: turn a registration into an odometry by scan-to-scan, then scan-to-map matching (paper, figures 2 and 4).

All registrations run in this front end, so pairwise back ends differ in the registration alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from evalkit.core.odometry_estimate import OdometryEstimate, Stage, StageEstimate
from evalkit.core.pose import TOO_FAR, Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import NO_COST, Cost
from evalkit.odometry.local_map import GridMap, KeyframeMap, VoxelMap, voxel_means
from evalkit.odometry.motion_prior import MotionPrior
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameters import (
    Parameter,
    Value,
    declared_parameters,
    parameter,
    resolve_parameters,
    with_defaults,
)
from evalkit.plugins.protocols import Odometry, Registration
from evalkit.plugins.specs import FIRST_STAGE, BackendSpec, OdometrySpec, RegistrationSpec, make_first_stage_parameter

EVERY_SCAN = ("scans", "grid")
"""Local maps that take every scan; the others take keyframes only."""


@dataclass(frozen=True)
class FrontEndSettings:
    """Parameters of the front end."""

    prior: str = parameter(
        "odometry",
        "",
        "source of the first guess; without odometry: constant velocity",
        choices=("odometry", "constant-velocity", "none"),
    )
    scan_to_scan: bool = parameter(True, "", "register each scan with the one before")
    scan_to_scan_with_odometry: bool = parameter(
        True, "", "also where wheel odometry gives the first guess; otherwise it starts the scan-to-map stage itself"
    )
    scan_to_map: bool = parameter(True, "", "register each scan with the local map, starting from stage one's answer")
    deskew: bool = parameter(True, "", "undo the motion within a scan by the prior's velocity")
    local_radius_m: float = parameter(0.0, "m", "use only points within this distance of the base; 0: all", low=0.0)
    source_voxel_m: float = parameter(0.0, "m", "thin the scan to one mean per cell of this side; 0: off", low=0.0)
    local_map: str = parameter(
        "keyframes",
        "",
        "the points of the last keyframes or of the last scans, one lasting map of voxels, or the "
        "occupied cells of a grid drawn from every scan",
        choices=("keyframes", "scans", "voxels", "grid"),
    )
    keyframes: int = parameter(10, "", "number of keyframes (or scans) in the local map", low=1)
    keyframe_distance_m: float = parameter(0.5, "m", "a new keyframe after this distance", low=0.0)
    keyframe_angle_deg: float = parameter(20.0, "deg", "or after this turn", low=0.0)
    local_map_voxel_m: float = parameter(
        0.0, "m", "thin the local map to one mean per cell of this side; 0: off", low=0.0
    )
    local_map_radius_m: float = parameter(
        15.0, "m", "voxels and grid only: match with points within this distance of the base", low=1.0
    )
    local_map_cell_m: float = parameter(0.05, "m", "grid only: side of a cell", low=0.005, high=10.0)
    local_map_probability: float = parameter(
        0.5, "", "grid only: match with cells of a larger probability", low=0.0, high=1.0
    )
    min_inliers: int = parameter(
        10, "", "a result with fewer pairs is not accepted; the guess is kept", low=0
    )  # fmt: skip


PARAMETERS = declared_parameters(FrontEndSettings)


def settable_parameters(spec: BackendSpec) -> tuple[Parameter, ...]:
    """Return all parameters that can be set on a back end: its own and, for a registration, those of the front end."""
    if not isinstance(spec, RegistrationSpec):
        return spec.parameters
    return (*spec.parameters, *spec.first_stage_parameters(), *with_defaults(PARAMETERS, **spec.frontend))


def complete_parameters(owner: str, spec: BackendSpec, given: Mapping[str, object]) -> dict[str, Value]:
    """Return all parameters of a back end with the given values.

    ``s2s.NAME`` sets the registration's parameter NAME for the scan-to-scan stage only. Raises UnknownName or
    BadParameter. The parameters of a back end that is missing or broken are unknown: its values are returned as given.
    """
    known = settable_parameters(spec)
    if not spec.parameters and (spec.broken or spec.missing()):
        return {name: value for name, value in given.items() if isinstance(value, (bool, int, float, str))}
    extra = [make_first_stage_parameter(p, p.default) for p in spec.parameters if FIRST_STAGE + p.name in given]
    names = {parameter.name for parameter in known}
    return resolve_parameters(owner, (*known, *(p for p in extra if p.name not in names)), given)


def make_odometry(spec: BackendSpec, parameters: Mapping[str, Value]) -> Odometry:
    """Make a new odometry of a back end from complete parameters; raises TypeError for a map, which has none."""
    if isinstance(spec, RegistrationSpec):
        settings = FrontEndSettings(**{p.name: parameters[p.name] for p in PARAMETERS})  # type: ignore[arg-type]  # by name
        return FrontEnd(*spec.make_stages(parameters), settings)
    if isinstance(spec, OdometrySpec):
        return spec.make(**parameters)
    raise TypeError(f"a {spec.kind} cannot be made an odometry")


class LocalMap(Protocol):
    """The points that the scan-to-map stage matches a scan with."""

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose) -> None:
        """Add a keyframe's points (N, 2), in the base frame; ``base_from_sensor`` is the pose of the sensor."""
        ...

    def cloud(self, near: Pose) -> Cloud:
        """Return the points around a pose, in the start frame; the same object until the next ``add``."""
        ...


class Matched(NamedTuple):
    """A matched scan: the answer, and the points that were registered with their pose ``start_from_points``.

    The answer's pose is that of the base at the first beam. It differs where the motion within the scan was not
    measured: see ``MotionPrior``.
    """

    estimate: OdometryEstimate
    source: Cloud
    start_from_points: Pose


class _StageAnswer(NamedTuple):
    """Pose after a stage (the guess where its answer is not accepted), its estimate and its cost."""

    pose: Pose
    estimate: StageEstimate
    cost: Cost


class FrontEnd:
    """The paper's two-stage front end as an Odometry; poses are ``start_from_base`` at the first beam of each scan."""

    def __init__(
        self,
        scan_to_scan: Registration,
        scan_to_map: Registration,
        settings: FrontEndSettings,
        local_map: LocalMap | None = None,
    ) -> None:
        """Make the front end; ``local_map`` replaces the one of the settings."""
        self._registrations: dict[Stage, Registration] = {"s2s": scan_to_scan, "s2m": scan_to_map}
        self._settings = settings
        self._local_map = _make_local_map(settings) if local_map is None else local_map
        self._motion = MotionPrior(settings.prior, settings.deskew)
        self._last: Cloud | None = None
        self._start_from_keyframe = Pose()

    def update(self, frame: Frame) -> OdometryEstimate:
        """Register a scan with the previous one, then with the local map; the settings can switch off either stage."""
        matched = self.match(frame)
        self.keep(frame, matched)
        return matched.estimate

    def match(self, frame: Frame, with_map: Registration | None = None) -> Matched:
        """Return what ``update`` returns, with the points that were registered; nothing is kept.

        ``with_map``: run the scan-to-map stage alone, by this registration.
        """
        start_from_last, last_from_base = self._motion.predict(frame)
        source = self._source(frame)
        stages: dict[Stage, _StageAnswer] = {}
        start_from_points = Pose()
        if self._last is not None:
            if (
                with_map is None
                and self._settings.scan_to_scan
                and (self._settings.scan_to_scan_with_odometry or not self._motion.is_measured(frame))
            ):
                stages["s2s"] = self._register("s2s", self._last, source, last_from_base)
                last_from_base = stages["s2s"].pose
            start_from_points = start_from_last @ last_from_base
            if self._settings.scan_to_map:
                local_map = self._local_map.cloud(start_from_points)
                stages["s2m"] = self._register("s2m", local_map, source, start_from_points, with_map)
                start_from_points = stages["s2m"].pose
        estimates: dict[Stage, StageEstimate] = {name: stage.estimate for name, stage in stages.items()}
        accepted = any(stage.accepted for stage in estimates.values()) if estimates else None
        cost = sum((stage.cost for stage in stages.values()), NO_COST)
        start_from_base = self._motion.find_first_beam(frame, start_from_points)
        return Matched(OdometryEstimate(start_from_base, estimates, accepted, cost), source, start_from_points)

    def keep(self, frame: Frame, matched: Matched, may_be_keyframe: bool = True) -> None:
        """Go on from a scan: the next one is matched with it, and a keyframe enters the local map."""
        pose = matched.start_from_points
        if self._last is None or (may_be_keyframe and self.is_keyframe(pose)):
            self._local_map.add(matched.source.points, pose, frame.base_from_sensor)
            self._start_from_keyframe = pose
        self._last = matched.source
        self._motion.store(frame, pose)

    def set_aside(self, frame: Frame, start_from_base: Pose) -> None:
        """Go on from the pose at the first beam alone: nothing is matched with the points of this scan."""
        self._last = Cloud(np.zeros((0, 2)), "base")
        self._motion.store(frame, start_from_base, matched=False)

    def predict(self, frame: Frame) -> Pose:
        """Return the pose ``start_from_base`` that the motion prior predicts for the next scan."""
        start_from_last, last_from_base = self._motion.predict(frame)
        return start_from_last @ last_from_base

    def extrapolate(self, elapsed_ns: int) -> Pose:
        """Return the motion of the base over a time, which may be negative, at the velocity of the last step."""
        return self._motion.extrapolate(elapsed_ns)

    def is_measured(self, frame: Frame) -> bool:
        """Return whether wheel odometry measured the motion that ``predict`` returns."""
        return self._motion.is_measured(frame)

    def _source(self, frame: Frame) -> Cloud:
        points = frame.points_in_base(self._motion.within_scan(frame) if self._settings.deskew else None)
        if self._settings.local_radius_m > 0.0:
            points = select_near(points, self._settings.local_radius_m)
        if self._settings.source_voxel_m > 0.0:
            points = voxel_means(points, self._settings.source_voxel_m)
        mount = frame.base_from_sensor
        return Cloud(points, "base", origin=np.array([mount.x, mount.y]))

    def _register(
        self, stage: Stage, target: Cloud, source: Cloud, guess: Pose, registration: Registration | None = None
    ) -> _StageAnswer:
        match = (registration or self._registrations[stage]).register(target, source, guess)
        if (found := match.target_from_source).is_too_far:
            raise ValueError(f"register() returned a pose {TOO_FAR}: ({found.x}, {found.y})")
        accepted = match.inliers >= self._settings.min_inliers
        estimate = StageEstimate(accepted, bool(match.converged), match.iterations, match.error, match.inliers)
        return _StageAnswer(found if accepted else guess, estimate, match.cost)

    def is_keyframe(self, start_from_base: Pose) -> bool:
        """Return whether a scan at a pose, which is not the first one, enters the local map."""
        if self._settings.local_map in EVERY_SCAN:
            return True
        moved = self._start_from_keyframe.inverse() @ start_from_base
        far = math.hypot(moved.x, moved.y) >= self._settings.keyframe_distance_m
        return far or abs(moved.theta) >= math.radians(self._settings.keyframe_angle_deg)


def select_near(points: Floats, radius_m: float) -> Floats:
    """Return the points (K, 2) within a radius of the origin."""
    return np.asarray(points[np.hypot(points[:, 0], points[:, 1]) <= radius_m])


def _make_local_map(settings: FrontEndSettings) -> LocalMap:
    if settings.local_map == "voxels":
        return VoxelMap(settings.local_map_voxel_m, settings.local_map_radius_m)
    if settings.local_map == "grid":
        mapper = registry.mapper(defaults.find_default_mapper()).make(resolution_m=settings.local_map_cell_m)
        return GridMap(mapper, settings.local_map_probability, settings.local_map_radius_m)
    return KeyframeMap(settings.keyframes, settings.local_map_voxel_m)
