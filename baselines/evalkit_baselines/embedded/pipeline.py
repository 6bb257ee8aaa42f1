"""The core's pipeline from scan to pose as an Odometry: the code of a board, one call per scan."""

from __future__ import annotations

import math
from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np

from evalkit.core.errors import BadParameter
from evalkit.core.odometry_estimate import OdometryEstimate, Stage, StageEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.timing import Cost, Stopwatch
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Parameter
from evalkit_baselines.embedded import registration
from evalkit_baselines.embedded.compiled import load_core, to_real

FRONT_END = (
    "scan_to_scan", "scan_to_map", "deskew", "local_radius_m", "keyframes", "keyframe_distance_m",
    "keyframe_angle_deg", "min_inliers", "local_map", "local_map_voxel_m", "local_map_radius_m",
)  # fmt: skip

LOCAL_MAPS = ("keyframes", "voxels")

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("precision", "double", "", "floating-point precision of the core", choices=("double", "float")),
    Parameter("beams", 4096, "", "largest number of beams of a scan; memory is allocated once", low=1, high=1 << 20),
    Parameter(
        "voxels", 1 << 17, "", "local_map 'voxels': largest number of voxels; memory is allocated once",
        low=1, high=1 << 26,
    ),
    *(p for p in registration.PARAMETERS if p.name != "trace"),
    *(
        replace(p, choices=LOCAL_MAPS, meaning="the points of the last keyframes, or one lasting map of voxels")
        if p.name == "local_map"
        else replace(p, meaning="side of the voxels of the lasting map; 0 with local_map 'keyframes'")
        if p.name == "local_map_voxel_m"
        else p
        for p in frontend.PARAMETERS
        if p.name in FRONT_END
    ),
)  # fmt: skip


NOT_RUN, ACCEPTED = -1, 1
"""Values of the core's ``ek_stage_outcome``; 0: the guess was kept."""

_StageAnswer = tuple[int, bool, int, float, int]


class CompiledPipeline:
    """An Odometry: the method of the NumPy ICP in evalkit's front end, in C; parameters as in ``PARAMETERS``.

    Reports both stages like evalkit's front end. Raises BadParameter for a lasting map without a size of voxels and for
    keyframes with one; ValueError with the core's message for a scan of more than ``beams`` beams and for one that is
    not later than the one before ("a parameter is outside its range"); ValueError when the lasting map is full.
    """

    def __init__(self, **parameters: Any) -> None:
        self._core = load_core(parameters["precision"])
        self._voxels = parameters["voxels"]
        voxel, lasting = parameters["local_map_voxel_m"], parameters["local_map"] == "voxels"
        if lasting != (voxel > 0.0):
            expected = (
                "a positive number: a lasting map consists of voxels" if lasting else "0: keyframes are not thinned"
            )
            raise BadParameter("embedded pipeline", "local_map_voxel_m", voxel, expected)
        self._pipeline = self._core.Pipeline(
            registration.make_icp(self._core, parameters),
            scan_to_scan=parameters["scan_to_scan"],
            scan_to_map=parameters["scan_to_map"],
            deskew=parameters["deskew"],
            local_radius=parameters["local_radius_m"],
            keyframes=parameters["keyframes"],
            keyframe_distance=parameters["keyframe_distance_m"],
            keyframe_angle=math.radians(parameters["keyframe_angle_deg"]),
            min_inliers=parameters["min_inliers"],
            beams=parameters["beams"],
            neighbours=parameters["line_neighbours"],
            map_voxel=voxel,
            map_radius=parameters["local_map_radius_m"],
            voxels=self._voxels,
        )

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one scan in the core."""
        conversion = Stopwatch()
        with conversion:
            ranges, angles = read_beams(frame.scan, self._core)
        row, scan_to_scan, scan_to_map = self._pipeline.update(
            stamp_ns=frame.scan.stamp_ns,
            time_increment_ns=frame.scan.time_increment_ns,
            ranges=ranges,
            angles=angles,
            odom_from_base=to_row(frame.odom_from_base),
            start_from_end=to_row(frame.start_from_end),
            base_from_sensor=to_row(frame.base_from_sensor),
            range_limits=(frame.scan.range_min_m, frame.scan.range_max_m),
        )
        if self._pipeline.dropped_cells:
            raise ValueError(f"the lasting map is full: {self._voxels} voxels; set 'voxels' to more")
        with conversion:
            answers: dict[Stage, _StageAnswer] = {"s2s": scan_to_scan, "s2m": scan_to_map}
            stages: dict[Stage, StageEstimate] = {
                name: make_stage_estimate(*answer) for name, answer in answers.items() if answer[0] != NOT_RUN
            }
            accepted = any(stage.accepted for stage in stages.values()) if stages else None
            pose = Pose(*row)
        return OdometryEstimate(pose, stages, accepted, Cost(conversion.cpu_ns))


def read_beams(scan: Scan, core: ModuleType) -> tuple[Any, Any]:
    """Return ranges and angles (B,); one invalid beam for a scan without beams, which the core would reject."""
    if not len(scan.ranges):
        return to_real(np.array([np.nan]), core), to_real(np.zeros(1), core)
    return to_real(scan.ranges, core), to_real(scan.angles, core)


def make_stage_estimate(state: int, converged: bool, iterations: int, error: float, inliers: int) -> StageEstimate:
    """Return the estimate of a stage from the core's answer."""
    return StageEstimate(state == ACCEPTED, converged, iterations, error, inliers)


def to_row(pose: Pose | None) -> tuple[float, float, float] | None:
    """Return x, y (m) and theta (rad), or None without a pose."""
    return None if pose is None else (pose.x, pose.y, pose.theta)
