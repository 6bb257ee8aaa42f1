"""``embedded-slam``: what ``paper-slam`` computes, in C99 with memory fixed at the start and bounded work per scan.

With ``work`` 0 every loop is closed within the scan that found it, as in ``paper-slam``; otherwise search, optimisation
and the redrawing of the map continue with the next scans. ``../embedded/SLAM.md`` describes memory and speed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import IntEnum, IntFlag
from typing import Any

import numpy as np

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate, Stage, StageEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.timing import Cost, Stopwatch
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import declared_parameters, parameter
from evalkit.plugins.specs import SlamSpec
from evalkit_baselines import embedded, paper
from evalkit_baselines.embedded.compiled import compiled_missing, load_core, to_real
from evalkit_baselines.embedded.pipeline import NOT_RUN, make_stage_estimate, read_beams, to_row
from evalkit_baselines.embedded.registration import make_icp
from evalkit_baselines.slam import loop_reasons
from evalkit_baselines.slam.paper_slam import SPEC as REFERENCE
from evalkit_baselines.slam.second_try import FINE_CORRESPONDENCE_M
from evalkit_baselines.slam.settings import LoopSettings, SlamSettings


@dataclass(frozen=True)
class EmbeddedSlamSettings(SlamSettings):
    """Parameters of ``embedded-slam``: those of ``paper-slam``, the work of a scan, and the memory."""

    precision: str = parameter("double", "", "floating-point precision of the core", choices=("double", "float"))
    work: int = parameter(
        200_000,
        "",
        "operations for loops, optimisation and map in a scan every 0.1 s or faster; more in proportion in "
        "slower ones, up to 20 times; 0: no limit",
        low=0,
        high=1 << 62,
    )
    beams: int = parameter(4096, "", "largest number of beams of a scan", low=1, high=1 << 20)
    keyframes: int = parameter(4000, "", "room for keyframes; then no loop is closed any more", low=2, high=1 << 20)
    keyframe_points: int = parameter(2_000_000, "", "room for their points, together", low=1, high=1 << 28)
    loops: int = parameter(128, "", "room for closed loops", low=1, high=1024)
    records: int = parameter(4096, "", "room for reported candidates", low=1, high=1 << 20)
    voxels: int = parameter(65536, "", "room for voxels of the lasting map", low=256, high=1 << 26)
    map_points: int = parameter(32768, "", "room for voxels around the robot", low=256, high=1 << 26)
    loop_points: int = parameter(65536, "", "room for points of either map of a loop", low=256, high=1 << 20)
    score_cells: int = parameter(1 << 20, "", "room for cells of branch and bound", low=1 << 14, high=1 << 26)


PARAMETERS = declared_parameters(EmbeddedSlamSettings)

_LIMITS = (
    "work", "beams", "keyframes", "keyframe_points", "loops", "records", "voxels", "map_points", "loop_points",
    "score_cells",
)  # fmt: skip


class _Outcome(IntEnum):
    """``ek_loop_outcome`` of the core."""

    PASSED, FEW_POINTS, SCORE, AMBIGUOUS, OVERLAP, DEGENERATE, CHI, CONTRADICTED = range(8)


_DESCRIPTIONS: Mapping[_Outcome, Callable[..., str]] = {
    _Outcome.PASSED: loop_reasons.describe_passed,
    _Outcome.FEW_POINTS: loop_reasons.describe_few_points,
    _Outcome.SCORE: loop_reasons.describe_low_score,
    _Outcome.AMBIGUOUS: loop_reasons.describe_ambiguous,
    _Outcome.OVERLAP: loop_reasons.describe_little_overlap,
    _Outcome.DEGENERATE: loop_reasons.describe_degenerate,
    _Outcome.CHI: loop_reasons.describe_far,
    _Outcome.CONTRADICTED: loop_reasons.describe_contradiction,
}
"""What describes a candidate, from both numbers of its record."""


class _Flag(IntFlag):
    """Flags of a record of the core."""

    ACCEPTED, UNCONFIRMED, FOUND_AGAIN, WITHDRAWN, NO_ROOM = 1, 2, 4, 8, 16


_UNMATCHED, _CORRECTED, _FULL = 1, 2, 4


class EmbeddedSlam:
    """A Slam; poses are ``start_from_base`` at the first beam of each scan."""

    def __init__(self, settings: EmbeddedSlamSettings) -> None:
        self._settings = settings
        self._core = load_core("float" if settings.precision == "float" else "double")
        matcher = {each.name: each.default for each in embedded.MAP_LINE.parameters} | {"share_noise": True}
        real = {each.name.removesuffix("_m"): getattr(settings, each.name) for each in fields(LoopSettings)} | {
            "fine_correspondence": FINE_CORRESPONDENCE_M,
            "keyframe_distance": settings.keyframe_distance_m,
            "keyframe_angle": math.radians(settings.keyframe_angle_deg),
            "map_voxel": settings.map_voxel_m,
            "map_radius": settings.map_radius_m,
            "map_reach": settings.map_reach_m,
            "drift": settings.drift_m,
            "drift_angle": math.radians(settings.drift_deg),
        }
        number = {name: getattr(settings, name) for name in _LIMITS}
        number["use_odometry"] = int(settings.prior == "odometry")
        self._slam = self._core.Slam(make_icp(self._core, matcher), real, number)
        self._stamps_ns: list[int] = []
        self._keyframe_of: list[int] = []
        self._odom_from_base: list[tuple[float, float, float]] = []
        self._keyframe_stamps_ns: list[int] = []
        self._full_since: int | None = None

    @property
    def memory_bytes(self) -> int:
        """Memory of the core, fixed at the start."""
        return int(self._slam.memory_bytes)

    def update(self, frame: Frame) -> OdometryEstimate:
        """Match one scan and go on with the search for loops; corrections move this pose and earlier ones.

        Raises ValueError with the core's message where time does not advance, for more than ``beams`` beams, and for
        poses beyond 250 km.
        """
        if self._stamps_ns and frame.scan.stamp_ns <= self._stamps_ns[-1]:
            found = f"stamp {frame.scan.stamp_ns} ns is not later than the one before, {self._stamps_ns[-1]} ns"
            raise ValueError(f"embedded-slam: {found}; give the scans in the order of time")
        conversion = Stopwatch()
        with conversion:
            ranges, angles = read_beams(frame.scan, self._core)
        odometry = self._settings.prior == "odometry"
        online, odom, scan_to_scan, scan_to_map, flags, keyframe, _ = self._slam.update(
            stamp_ns=frame.scan.stamp_ns,
            time_increment_ns=frame.scan.time_increment_ns,
            ranges=ranges,
            angles=angles,
            odom_from_base=to_row(frame.odom_from_base),
            start_from_end=to_row(frame.start_from_end) if odometry else None,
            base_from_sensor=to_row(frame.base_from_sensor),
            range_limits=(frame.scan.range_min_m, frame.scan.range_max_m),
        )
        with conversion:
            self._stamps_ns.append(frame.scan.stamp_ns)
            self._keyframe_of.append(keyframe)
            self._odom_from_base.append(odom)
            if self._slam.keyframes > len(self._keyframe_stamps_ns):
                self._keyframe_stamps_ns.append(frame.scan.stamp_ns)
            if self._full_since is None and flags & _FULL:
                self._full_since = len(self._stamps_ns)
            answers: dict[Stage, tuple[int, bool, int, float, int]] = {"s2s": scan_to_scan, "s2m": scan_to_map}
            stages: dict[Stage, StageEstimate] = {
                name: make_stage_estimate(*answer) for name, answer in answers.items() if answer[0] != NOT_RUN
            }
            accepted = any(stage.accepted for stage in stages.values()) if stages else None
            accepted = False if flags & _UNMATCHED else accepted
        corrected = bool(flags & _CORRECTED)
        return OdometryEstimate(Pose(*online), stages, accepted, Cost(conversion.cpu_ns), corrected)

    def trajectory(self) -> Trajectory:
        """Return the corrected poses: between two keyframes the correction is distributed by the driven distance."""
        if not self._stamps_ns:
            return Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), "start", "base")
        odom = to_real(np.array(self._odom_from_base), self._core)
        poses = self._slam.correct(np.array(self._keyframe_of, dtype=np.uint32), odom)
        return Trajectory(np.array(self._stamps_ns), np.asarray(poses, dtype=np.float64), "start", "base")

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return all candidates that are decided so far, as many as there is room for."""
        stamps = self._keyframe_stamps_ns
        return tuple(
            LoopClosure(
                stamps[later],
                stamps[earlier],
                Pose(*motion),
                bool(_Flag(flags) & _Flag.ACCEPTED),
                _describe(_Outcome(outcome), numbers, _Flag(flags), section),
                found_again=bool(_Flag(flags) & _Flag.FOUND_AGAIN),
            )
            for later, earlier, motion, outcome, *numbers, flags, section in self._slam.records()
        )

    def remarks(self) -> tuple[str, ...]:
        """Return which memory was used up, with the parameter to raise."""
        settings, core = self._settings, self._slam
        remarks = []
        if self._full_since is not None:
            name = "keyframes" if core.keyframes >= settings.keyframes else "keyframe_points"
            where = f"from scan {self._full_since:,} of {len(self._stamps_ns):,} on"
            remarks.append(
                f"no room for keyframes, and no loop closed, {where}: raise {name} ({getattr(settings, name)})"
            )
        closures = sum(bool(_Flag(flags) & _Flag.NO_ROOM) for *_, flags, _ in core.records())
        for name, count, what in (
            ("voxels", core.dropped_cells, "groups of points in the map"),
            ("loops", closures, "loops"),
            ("records", core.unrecorded, "candidates, which close no loop"),
        ):
            if count:
                remarks.append(f"no room for {count:,} {what}: raise {name} ({getattr(settings, name)})")
        return tuple(remarks)


def _describe(outcome: _Outcome, numbers: list[float], flags: _Flag, section: int) -> str:
    """Return why a candidate was accepted or not, as ``paper-slam`` says it."""
    text = _DESCRIPTIONS[outcome](*numbers)
    if flags & _Flag.UNCONFIRMED:
        return loop_reasons.describe_unconfirmed(text)
    if flags & _Flag.NO_ROOM:
        return f"no room for more loops: {text}"
    text = loop_reasons.describe_found_again(text, section) if flags & _Flag.FOUND_AGAIN else text
    return loop_reasons.describe_withdrawn(text) if flags & _Flag.WITHDRAWN else text


def make(**parameters: Any) -> EmbeddedSlam:
    """Make a new ``embedded-slam`` with the parameters of ``EmbeddedSlamSettings``."""
    return EmbeddedSlam(EmbeddedSlamSettings(**parameters))


SPEC = SlamSpec(
    make=make,
    summary="paper-slam in C99: memory fixed at the start, loops closed in slices (work = 0: at once, as paper-slam)",
    citation=paper.CITATION,
    licence="MIT",
    guess=REFERENCE.guess,
    parameters=PARAMETERS,
    missing=compiled_missing,
    tuned_on=REFERENCE.tuned_on,
    reference="paper-slam",
)
