"""Maps of Figure 10: drawn along what a back end answered, of the laboratory and of a recording, as results of jobs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.consistency import collect_hits
from evalkit.metrics.evaluate import draw
from evalkit.metrics.maps import compare_walls, f1
from evalkit.metrics.table import PlacedScans
from evalkit.metrics.trajectory import rms
from evalkit.plugins import registry
from evalkit.plugins.protocols import Value
from evalkit_paper import map_faults, plan_fit, stage_errors


@dataclass(frozen=True)
class Variant:
    """What a map is drawn along."""

    name: str
    backend: str = "paper"
    parameters: Mapping[str, Value] = field(default_factory=dict)


ODOMETRY = Variant("odometry only", parameters={"scan_to_scan": False, "scan_to_map": False})
LITERAL = Variant("last 10 scans, mean square", "paper-literal", {"local_map": "scans", "deskew": False})
PAPER = Variant("paper")
TIGHT = Variant("paper-tight", "paper-tight")

MAX_SHOWN = 4000
"""So many contradicted hits are kept for the drawing, evenly."""


def lab(
    *, backend: str, parameters: Mapping[str, Any], sequence: Mapping[str, Any], scans: int
) -> dict[str, Any]:  # fmt: skip
    """A map of the laboratory in the truth's frame, aligned by the trajectory: ``kept`` grid, "path", "ate_m", "f1"."""
    drive = registry.dataset("lab").make(**sequence)
    truth = drive.truth()
    if truth.trajectory is None or truth.grid is None:
        raise ValueError("lab: no truth")
    found = stage_errors.follow(drive, backend, parameters)
    world_from_base = stage_errors.aligned(found.estimate, truth.trajectory)
    grid = _grid(_mapped(found, world_from_base, scans))
    return kept(grid) | {
        "path": world_from_base.poses[:, :2],
        "ate_m": rms(stage_errors.position_errors_m(found.estimate, truth.trajectory)),
        "f1": f1(compare_walls(grid, truth.grid)),
    }


def plan(*, sequence: Mapping[str, Any]) -> dict[str, Any]:
    """The true map of the laboratory."""
    grid = registry.dataset("lab").make(**sequence).truth().grid
    if grid is None:
        raise ValueError("lab: no true map")
    return kept(grid)


def recording(*, name: str, backend: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """A map of a recording in the frame of its start, residuals over time, and what its halves hold against each other.

    "times_s", "yaw_dps" (by the odometry) and "s2s", "s2m" (N, 6); "hits" of them "contradicted", "places" (K, 2) of
    the contradicted ones.
    """
    found = stage_errors.follow(registry.dataset(name).make(), backend, parameters)
    mapped = _mapped(found, found.estimate, len(found.frames))
    middle = len(mapped) // 2
    halves = mapped[:middle], mapped[middle:]
    first, second = (_grid(half) for half in halves)
    wrong = [
        points[map_faults.contradicted(points, other)]
        for points, other in ((collect_hits(halves[0]), second), (collect_hits(halves[1]), first))
    ]
    places_ = np.concatenate(wrong)
    return kept(_grid(mapped)) | {
        "times_s": (found.stamps_ns - found.stamps_ns[0]) * 1e-9,
        "yaw_dps": stage_errors.yaw_rates_dps(found.stamps_ns, _odometry(found)),
        **{stage: found.errors[stage] for stage in stage_errors.STAGES},
        "path": found.poses[:, :2],
        "hits": sum(len(collect_hits(half)) for half in halves),
        "contradicted": len(places_),
        "places": places_[:: max(len(places_) // MAX_SHOWN, 1)],
    }


def floor(*, name: str, backend: str) -> dict[str, Any]:
    """The map shipped with a recording, and where the recording's own map fits on it best.

    ``kept`` grid, "walls" (N, 2) of the recording's map laid on it, ``places.Placed``, and where its "odometry"
    starts; {} without such a map.
    """
    sequence = registry.dataset(name).make()
    known = sequence.truth().plan
    if known is None:
        return {}
    found = stage_errors.follow(sequence, backend, {})
    grid = _grid(_mapped(found, found.estimate, len(found.frames)))
    points = grid.centres(grid.occupied())
    placed = plan_fit.place(points, known.centres(known.occupied()))
    return kept(known) | {
        "walls": placed.plan_from_map.transform(points),
        "path": placed.plan_from_map.transform(found.poses[:, :2]),
        "pose": placed.plan_from_map.row,
        "mean_m": placed.mean_m,
        "within": placed.within,
        "rival": placed.rival,
        "odometry": (found.frames[0].odom_from_base or Pose()).row,
    }


def kept(grid: OccupancyGrid) -> dict[str, Any]:
    """A grid as a job's result."""
    return {
        "log_odds": np.asarray(grid.log_odds),
        "observed": np.asarray(grid.observed),
        "lattice": [grid.resolution_m, grid.origin_x, grid.origin_y],
    }


def grid_of(result: Mapping[str, Any]) -> OccupancyGrid:
    """The grid ``kept`` in a result."""
    return OccupancyGrid(result["log_odds"], result["observed"], *result["lattice"])


def _mapped(found: stage_errors.Followed, world_from_base: Trajectory, most: int) -> PlacedScans:
    """At most so many scans, evenly, the motion within them undone by the odometry, with where the sensor was."""
    chosen = np.unique(np.linspace(0, len(found.frames) - 1, min(most, len(found.frames))).astype(int)).tolist()
    return tuple(
        (
            found.frames[index].scan.deskewed(found.frames[index].base_from_sensor, found.frames[index].start_from_end),
            se2.compose(world_from_base.poses[index], found.frames[index].base_from_sensor.row),
        )
        for index in chosen
    )


def _grid(mapped: PlacedScans) -> OccupancyGrid:
    grid, why = draw(mapped, registry.mapper("log-odds").make)
    if grid is None:
        raise ValueError(f"no map: {why}")
    return grid


def _odometry(found: stage_errors.Followed) -> Floats:
    return np.array([(frame.odom_from_base or Pose()).row for frame in found.frames])
