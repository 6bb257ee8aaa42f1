"""Occupancy grids as pictures, with marks in colours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats

Extent = tuple[float, float, float, float]
"""Left, right, bottom, top (m)."""

FREE, UNKNOWN, WALL = (1.0, 1.0, 1.0), (0.86, 0.88, 0.9), (0.12, 0.13, 0.15)
GHOST, SMEAR, WIPED, TRUE, PATH = "#d1242f", "#e69f00", "#0072b2", "#56b4e9", "#009e73"
RGB = {GHOST: (0.82, 0.14, 0.18), SMEAR: (0.9, 0.62, 0.0)}


def extent(grid: OccupancyGrid) -> Extent:
    """Where a map's picture lies in the world."""
    rows, columns = grid.shape
    right, top = grid.origin_x + columns * grid.resolution_m, grid.origin_y + rows * grid.resolution_m
    return grid.origin_x, right, grid.origin_y, top


def image(grid: OccupancyGrid, marks: Mapping[str, Bools] | None = None) -> Floats:
    """The map in colours (H, W, 3), first row on top."""
    colours = np.full((*grid.shape, 3), UNKNOWN)
    colours[grid.free()] = FREE
    colours[grid.occupied()] = WALL
    for colour, mask in (marks or {}).items():
        colours[mask] = RGB[colour]
    return np.flipud(colours)


def cut(grid: OccupancyGrid, window: Extent) -> Floats:
    """The part of a map's image within (left, right, bottom, top), to whole cells."""
    rows, _ = grid.shape
    left, right = (round((value - grid.origin_x) / grid.resolution_m) for value in window[:2])
    bottom, top = (round((value - grid.origin_y) / grid.resolution_m) for value in window[2:])
    return image(grid)[rows - top : rows - bottom, left:right]
