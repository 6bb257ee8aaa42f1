"""A map made elsewhere as a method: ``file:map.yaml`` is compared with the true map without alignment."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.external.declaration import NOT_DECLARED, compute_digest, find_missing, override_defaults
from evalkit.io import map_server
from evalkit.metrics.consistency import look_up_cells
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.result_files import read_map
from evalkit.plugins.specs import BackendSpec, MapSpec

SUFFIXES = (".yaml", ".yml")

PARAMETERS = (
    Parameter("x_m", 0.0, "m", "x of the map's frame in the world of the ground truth"),
    Parameter("y_m", 0.0, "m", "y of the map's frame"),
    Parameter("yaw_deg", 0.0, "deg", "rotation of the map's frame"),
)


def map_spec(name: str, file: Path, topic: str, words: list[str]) -> BackendSpec:
    """Make the spec of a map_server file, or of the map of a bag's ``topic``, and its ``NAME=VALUE`` words."""
    image = None if topic else map_server.find_map_image(file)
    return MapSpec(
        make=partial(load_map, file, topic),
        summary=f"a map made elsewhere, read from {file.name}: not drawn by the common mapper",
        citation=NOT_DECLARED,
        licence=NOT_DECLARED,
        guess="unknown: it was made elsewhere",
        parameters=override_defaults(name, PARAMETERS, words),
        missing=partial(find_missing, *([file, image] if image else [file])),
        digest=compute_digest(file, *([image] if image else []), words=topic),
    )


def load_map(file: Path, topic: str, *, x_m: float, y_m: float, yaw_deg: float) -> OccupancyGrid:
    """Load a map in the world's frame; raises BadData where it cannot be read."""
    grid, map_from_grid = read_map(f"{file}?map={topic}" if topic else str(file))
    return transform_map(grid, Pose(x_m, y_m, math.radians(yaw_deg)) @ map_from_grid)


def transform_map(grid: OccupancyGrid, world_from_map: Pose) -> OccupancyGrid:
    """Transform a map to another frame; a rotation takes for each new cell the old cell at its centre."""
    if world_from_map.theta == 0.0:
        x, y = grid.origin_x + world_from_map.x, grid.origin_y + world_from_map.y
        return OccupancyGrid(grid.log_odds, grid.observed, grid.resolution_m, x, y)
    size, (rows, columns) = grid.resolution_m, grid.shape
    sides = np.array([[0, 0], [columns, 0], [0, rows], [columns, rows]], dtype=np.float64) * size
    corners = world_from_map.transform(np.array([grid.origin_x, grid.origin_y]) + sides)
    low, high = corners.min(axis=0), corners.max(axis=0)
    wide, tall = (int(n) for n in np.ceil((high - low) / size))
    x, y = float(low[0]), float(low[1])
    empty = np.zeros((tall, wide), dtype=np.float32)
    centres = OccupancyGrid(empty, empty == 0.0, size, x, y).centres(empty == 0.0)
    log_odds, observed = look_up_cells(world_from_map.inverse().transform(centres), grid)
    seen = observed.reshape(tall, wide)
    return OccupancyGrid(np.where(seen, log_odds.reshape(tall, wide), 0.0).astype(np.float32), seen, size, x, y)
