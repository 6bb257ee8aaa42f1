"""Occupancy grids as images with coloured marks."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats

Extent = tuple[float, float, float, float]
"""Left, right, bottom, top (m)."""

FREE, UNKNOWN, WALL = (1.0, 1.0, 1.0), (0.86, 0.88, 0.9), (0.12, 0.13, 0.15)
GHOST, SMEAR, MISSING, TRUE, PATH = "#d1242f", "#e69f00", "#0072b2", "#56b4e9", "#009e73"
RGB = {GHOST: (0.82, 0.14, 0.18), SMEAR: (0.9, 0.62, 0.0)}


def render_image(grid: OccupancyGrid, marks: Mapping[str, Bools] | None = None) -> Floats:
    """Render a map as RGB (H, W, 3), highest y first."""
    colours = np.full((*grid.shape, 3), UNKNOWN)
    colours[grid.free()] = FREE
    colours[grid.occupied()] = WALL
    for colour, mask in (marks or {}).items():
        colours[mask] = RGB[colour]
    return np.flipud(colours)


def crop_image(grid: OccupancyGrid, window: Extent) -> Floats:
    """Crop a map's image to an extent, rounded to whole cells."""
    rows, _ = grid.shape
    left, right = (round((value - grid.origin_x) / grid.resolution_m) for value in window[:2])
    bottom, top = (round((value - grid.origin_y) / grid.resolution_m) for value in window[2:])
    return render_image(grid)[rows - top : rows - bottom, left:right]
