"""Parameters that ``paper-slam`` and ``embedded-slam`` share."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.plugins.parameters import parameter
from evalkit_baselines.slam import pose_graph


@dataclass(frozen=True)
class LoopSettings:
    """Parameters of the loop closure."""

    loop_path_m: float = parameter(15.0, "m", "a loop is at least so long through the graph", low=1.0)
    loop_spacing_m: float = parameter(1.0, "m", "path between two candidates", low=0.0)
    loop_radius_m: float = parameter(7.0, "m", "largest distance of a candidate, and half the search window", low=0.5)
    loop_submap_m: float = parameter(3.0, "m", "path on either side of a keyframe whose points are matched", low=0.0)
    loop_cell_m: float = parameter(0.1, "m", "cell of branch and bound", low=0.02, high=1.0)
    loop_score: float = parameter(0.55, "", "smallest score of branch and bound", low=0.0, high=1.0)
    loop_ambiguity: float = parameter(
        0.92, "", "share of the best score that another motion may not reach", low=0.0, high=1.0
    )
    loop_near_m: float = parameter(0.15, "m", "a point within this distance lies on the other map", low=0.01)
    loop_overlap: float = parameter(0.7, "", "smallest share of points on the other map", low=0.0, high=1.0)
    loop_in_view: float = parameter(
        0.95,
        "",
        "smallest share of points on the other map among those that its scans could see, where score and overlap reach "
        "only three quarters of their limits",
        low=0.0,
        high=1.0,
    )
    loop_degenerate_m: float = parameter(0.13, "m", "largest 1-sigma error of the matched position", low=0.0)
    loop_gate: float = parameter(pose_graph.SLOW_GATE, "", "largest chi-square of a confirmed closure", low=0.0)
    loop_quick_gate: float = parameter(
        pose_graph.QUICK_GATE, "", "largest chi-square of a closure without confirmation", low=0.0
    )


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
