"""A map made elsewhere as a method: ``file:map.yaml`` is held against the true map as it is."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.external.declaration import UNTOLD, digest_of, settings
from evalkit.io import map_server
from evalkit.metrics.consistency import look_up_cells
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import BackendSpec, MapSpec

SUFFIXES = (".yaml", ".yml")

PARAMETERS = (
    Parameter("x_m", 0.0, "m", "where the map's frame stands in the world of the truth"),
    Parameter("y_m", 0.0, "m", "likewise"),
    Parameter("yaw_deg", 0.0, "deg", "and how it is turned there"),
)


def spec(name: str, file: Path, words: list[str]) -> BackendSpec:
    """The method of a map_server file and its ``NAME=VALUE`` words."""
    image = map_server.find_map_image(file)
    return MapSpec(
        make=partial(made, file),
        summary=f"a map made elsewhere, read from {file.name}: not drawn by the common mapper",
        citation=UNTOLD,
        licence=UNTOLD,
        guess="unknown: it was made elsewhere",
        parameters=settings(name, PARAMETERS, words),
        missing=lambda: _absent(file, image),
        digest=digest_of(file, *([image] if image else [])),
    )


def made(file: Path, *, x_m: float, y_m: float, yaw_deg: float) -> OccupancyGrid:
    """The map of a file in the world's frame; BadData where it cannot be read."""
    return placed(map_server.read_map(file), Pose(x_m, y_m, math.radians(yaw_deg)))


def placed(grid: OccupancyGrid, world_from_map: Pose) -> OccupancyGrid:
    """The same map in another frame: shifted as it is, turned by taking for each new cell the old one at its centre."""
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


def _absent(*files: Path | None) -> str:
    gone = (file.name for file in files if file and not file.is_file())
    return next((f"no such file: {name}; mend its path" for name in gone), "")
