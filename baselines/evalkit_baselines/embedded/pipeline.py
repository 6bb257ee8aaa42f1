"""The core's whole way from a scan to a pose as an Odometry: what a board would run, one call a scan."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evalkit.core import belief
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.timing import conversion
from evalkit.odometry import frontend
from evalkit.plugins.protocols import Parameter
from evalkit_baselines.embedded import registration
from evalkit_baselines.embedded.compiled import core, real

FRONT_END = (
    "scan_to_scan", "scan_to_map", "deskew", "local_radius_m", "keyframes", "keyframe_distance_m",
    "keyframe_angle_deg", "min_inliers",
)  # fmt: skip

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("precision", "double", "", "of all numbers in the core", choices=("double", "float")),
    Parameter("beams", 4096, "", "most beams of a scan: memory is taken once", low=1, high=1 << 20),
    *(p for p in registration.PARAMETERS if p.name != "trace"),
    *(p for p in frontend.PARAMETERS if p.name in FRONT_END),
)


class CompiledPipeline:
    """An Odometry with the meaning of ``paper`` behind evalkit's front end, both in C; parameters as in ``PARAMETERS``.

    Tells of both stages what evalkit's front end would. Raises ValueError with the core's words for a scan of more than
    ``beams`` beams, and for one that is not later than the one before ("a parameter is outside its range").
    """

    def __init__(self, **parameters: Any) -> None:
        self._core = core(parameters["precision"])
        self._pipeline = self._core.Pipeline(
            registration.icp_of(self._core, parameters),
            scan_to_scan=parameters["scan_to_scan"],
            scan_to_map=parameters["scan_to_map"],
            deskew=parameters["deskew"],
            local_radius=parameters["local_radius_m"],
            keyframes=parameters["keyframes"],
            keyframe_distance=parameters["keyframe_distance_m"],
            keyframe_angle=math.radians(parameters["keyframe_angle_deg"]),
            min_inliers=parameters["min_inliers"],
            beams=parameters["beams"],
        )

    def update(self, frame: Frame) -> Pose:
        """``start_from_base`` when the scan's first beam was fired."""
        with conversion():
            ranges, angles = self._beams(frame.scan)
        row, scan_to_scan, scan_to_map = self._pipeline.update(
            stamp_ns=frame.scan.stamp_ns,
            time_increment_ns=frame.scan.time_increment_ns,
            ranges=ranges,
            angles=angles,
            odom_from_base=_row(frame.odom_from_base),
            start_from_end=_row(frame.start_from_end),
            base_from_sensor=_row(frame.base_from_sensor),
            range_limits=(frame.scan.range_min_m, frame.scan.range_max_m),
        )
        with conversion():
            _tell("s2s", *scan_to_scan)
            _tell("s2m", *scan_to_map)
        return Pose(*row)

    def _beams(self, scan: Scan) -> tuple[Any, Any]:
        """Ranges and angles (B,); an invalid one for a scan of none, which the core would refuse."""
        if not len(scan.ranges):
            return real(np.array([np.nan]), self._core), real(np.zeros(1), self._core)
        return real(scan.ranges, self._core), real(scan.angles, self._core)


def _tell(stage: frontend.Stage, told: int, converged: bool, iterations: int, error: float, inliers: int) -> None:
    if told != belief.UNTOLD:  # the stage was asked
        accepted = told == belief.ACCEPTED
        belief.tell_stage(stage, belief.Registered(accepted, converged, iterations, error, inliers))


def _row(pose: Pose | None) -> tuple[float, float, float] | None:
    return None if pose is None else (pose.x, pose.y, pose.theta)
