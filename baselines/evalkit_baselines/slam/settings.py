"""Parameters that ``paper-slam`` and ``embedded-slam`` share."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.plugins.parameters import parameter
from evalkit_baselines.slam.loop_closure import LoopSettings


@dataclass(frozen=True)
class SlamSettings(LoopSettings):
    """Parameters of loop closure, map, keyframes and drift."""

    prior: str = parameter("odometry", "", "source of the first guess", choices=("odometry", "constant-velocity"))
    map_voxel_m: float = parameter(0.1, "m", "side of the voxels of the lasting map", low=0.01)
    map_radius_m: float = parameter(30.0, "m", "scans are matched with the map within this of the base", low=1.0)
    map_reach_m: float = parameter(20.0, "m", "keyframes farther apart through the graph leave the map", low=1.0)
    keyframe_distance_m: float = parameter(0.3, "m", "a new keyframe after this distance", low=0.01)
    keyframe_angle_deg: float = parameter(10.0, "deg", "or after this turn", low=0.1)
    drift_m: float = parameter(0.02, "m", "1 sigma of the matched position after one metre", low=1e-4)
    drift_deg: float = parameter(0.3, "deg", "1 sigma of the matched heading after one metre", low=1e-3)
