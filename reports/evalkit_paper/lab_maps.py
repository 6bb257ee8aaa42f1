"""Maps of Figure 10 along the poses of a back end: of the laboratory and of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import spread_indices
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.consistency import collect_hits
from evalkit.metrics.evaluate import render_map
from evalkit.metrics.maps import compare_walls, f1
from evalkit.metrics.metric import MissingMap, PlacedScans
from evalkit.metrics.trajectory import rms
from evalkit.plugins import registry
from evalkit_paper import map_faults, plan_fit, stage_errors
from evalkit_paper.chapter import Case

ODOMETRY = Case("odometry only", parameters={"scan_to_scan": False, "scan_to_map": False})
LITERAL = Case("last 10 scans, mean square", "paper-literal", {"local_map": "scans", "deskew": False})
PAPER = Case("paper")
TIGHT = Case("paper-tight", "paper-tight")

MAX_SHOWN = 4000
"""Maximum number of contradicted hits in the figure, evenly spaced."""


def map_laboratory(
    *, backend: str, parameters: Mapping[str, Any], sequence: Mapping[str, Any], scans: int
) -> dict[str, Any]:  # fmt: skip
    """Map the laboratory in the frame of the ground truth. Keys: those of ``grid_to_json``, "path", "ate_m", "f1"."""
    drive = registry.dataset("lab").make(**sequence)
    truth = drive.truth()
    if truth.trajectory is None or truth.grid is None:
        raise ValueError("lab: no truth")
    found = stage_errors.run_with_errors(drive, backend, parameters)
    world_from_base = stage_errors.align(found.estimate, truth.trajectory)
    grid = _build_map(_select_scans(found, world_from_base, scans))
    return grid_to_json(grid) | {
        "path": world_from_base.poses[:, :2],
        "ate_m": rms(stage_errors.position_errors_m(found.estimate, truth.trajectory)),
        "f1": f1(compare_walls(grid, truth.grid)),
    }


def true_lab_map(*, sequence: Mapping[str, Any]) -> dict[str, Any]:
    """True map of the laboratory."""
    grid = registry.dataset("lab").make(**sequence).truth().grid
    if grid is None:
        raise ValueError("lab: no true map")
    return grid_to_json(grid)


def map_recording(*, name: str, backend: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Map a recording in the frame of its first pose, with residuals over time and contradictions between its halves.

    Keys: "times_s", "yaw_dps" (from odometry), "s2s" and "s2m" (N, 6); "hits" and "contradicted", their numbers;
    "places" (K, 2), positions (m) of contradicted hits.
    """
    found = stage_errors.run_with_errors(registry.dataset(name).make(), backend, parameters)
    mapped = _select_scans(found, found.estimate, len(found.frames))
    middle = len(mapped) // 2
    halves = mapped[:middle], mapped[middle:]
    first, second = (_build_map(half) for half in halves)
    wrong = [
        points[map_faults.find_contradicted(points, other)]
        for points, other in ((collect_hits(halves[0]), second), (collect_hits(halves[1]), first))
    ]
    places = np.concatenate(wrong)
    return grid_to_json(_build_map(mapped)) | {
        "times_s": (found.stamps_ns - found.stamps_ns[0]) * 1e-9,
        "yaw_dps": stage_errors.yaw_rates_dps(found.stamps_ns, _odometry_poses(found)),
        **{stage: found.errors[stage] for stage in stage_errors.STAGES},
        "path": found.poses[:, :2],
        "hits": sum(len(collect_hits(half)) for half in halves),
        "contradicted": len(places),
        "places": places[:: max(len(places) // MAX_SHOWN, 1)],
    }


def fit_recording_on_floor(*, name: str, backend: str) -> dict[str, Any]:
    """Fit a recording's own map on the map that comes with it.

    Keys: those of ``grid_to_json``, "walls" (N, 2) of the fitted map, the fields of ``plan_fit.PlanFit``, and
    "odometry", the first odometry pose; {} if the recording has no map.
    """
    sequence = registry.dataset(name).make()
    known = sequence.truth().plan
    if known is None:
        return {}
    found = stage_errors.run_with_errors(sequence, backend, {})
    grid = _build_map(_select_scans(found, found.estimate, len(found.frames)))
    points = grid.centres(grid.occupied())
    placed = plan_fit.fit_on_plan(points, known.centres(known.occupied()))
    return grid_to_json(known) | {
        "walls": placed.plan_from_map.transform(points),
        "path": placed.plan_from_map.transform(found.poses[:, :2]),
        "pose": placed.plan_from_map.row,
        "mean_m": placed.mean_m,
        "within": placed.within,
        "rival": placed.rival,
        "odometry": (found.frames[0].odom_from_base or Pose()).row,
    }


def grid_to_json(grid: OccupancyGrid) -> dict[str, Any]:
    """Convert a grid to the values of a result."""
    return {
        "log_odds": np.asarray(grid.log_odds),
        "observed": np.asarray(grid.observed),
        "lattice": [grid.resolution_m, grid.origin_x, grid.origin_y],
    }


def grid_of(result: Mapping[str, Any]) -> OccupancyGrid:
    """Read the grid from a result of ``grid_to_json``."""
    return OccupancyGrid(result["log_odds"], result["observed"], *result["lattice"])


def _select_scans(found: stage_errors.StageErrors, world_from_base: Trajectory, max_scans: int) -> PlacedScans:
    """At most ``max_scans`` evenly spaced scans, deskewed by odometry, with their sensor poses."""
    return tuple(
        (
            found.frames[index].scan.deskewed(found.frames[index].base_from_sensor, found.frames[index].start_from_end),
            se2.compose(world_from_base.poses[index], found.frames[index].base_from_sensor.row),
        )
        for index in spread_indices(len(found.frames), max_scans).tolist()
    )


def _build_map(mapped: PlacedScans) -> OccupancyGrid:
    grid = render_map(mapped, registry.mapper("log-odds").make)
    if isinstance(grid, MissingMap):
        raise ValueError(f"no map: {grid.reason}")
    return grid


def _odometry_poses(found: stage_errors.StageErrors) -> Floats:
    return np.array([(frame.odom_from_base or Pose()).row for frame in found.frames])
