"""The core's log-odds grid as a Mapper of growing size."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.errors import BadParameter
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import Parameter
from evalkit_baselines.embedded.compiled import load_core, to_real
from evalkit_baselines.paper import grid
from evalkit_baselines.paper.grid import CHUNK, MAX_CELLS

UNKNOWN = np.iinfo(np.int16).min
THOUSANDTHS = np.float32(1000.0)
MAX_SIDE_CELLS = 1 << 15  # cells per side, limit of the core
MAX_BEAM_CELLS = 8192  # cells, limit of the core
NO_POINTS = np.zeros((0, 2))
NOT_IN_CORE = ("once_per_scan", "traversal")
MAX_LOG_ODDS = 15.0

PARAMETERS: tuple[Parameter, ...] = tuple(
    replace(p, low=max(p.low, -MAX_LOG_ODDS), high=min(p.high, MAX_LOG_ODDS)) if p.name.startswith("l_") else p
    for p in grid.PARAMETERS
    if p.name not in NOT_IN_CORE
)
"""The parameters of the NumPy grid; a scan always adds to a cell once, with the exact traversal."""

POLYGON_PARAMETERS: tuple[Parameter, ...] = (
    *PARAMETERS,
    Parameter(
        "widest_gap_deg", 3.0, "deg", "between beams that are farther apart nothing is freed", low=0.0, high=85.0
    ),
)


class CompiledGrid:
    """The core's map in double precision; parameters as in ``PARAMETERS``.

    ``polygon``: a scan frees the cells inside its outline instead of those that its beams cross; parameters as in
    ``POLYGON_PARAMETERS``. On a board the map has a fixed size. Here it grows in steps of ``CHUNK`` cells like the
    NumPy grid, and raises BadParameter at the same limits.
    """

    def __init__(
        self, polygon: bool, resolution_m: float, clear_no_returns: bool, widest_gap_deg: float = 0.0, **log_odds: float
    ) -> None:
        self._core = load_core("double")
        self._outline = {"polygon": polygon, "widest_gap": math.radians(widest_gap_deg)}
        self._resolution_m, self._clear_no_returns = resolution_m, clear_no_returns
        self._log_odds = log_odds
        self._grid: Any = None
        self._low, self._high = (
            np.zeros(2, dtype=np.int64),
            np.zeros(2, dtype=np.int64),
        )  # cells: first, end
        self._edges = (0, 0, 0, 0)  # the same: left, bottom, right, top
        self._range_max_m = 0.0

    def update(self, scan: Scan, world_from_sensor: Pose) -> None:
        """Add one scan whose beams all start at the sensor."""
        hits = scan.points()
        misses = self._misses(scan) if self._clear_no_returns else NO_POINTS
        if len(hits) or len(misses):
            if not self._has_room(scan, world_from_sensor):
                self._make_room(np.concatenate([hits, misses, np.zeros((1, 2))]), world_from_sensor, scan.range_max_m)
            self._grid.add(
                (world_from_sensor.x, world_from_sensor.y, world_from_sensor.theta),
                to_real(hits, self._core),
                to_real(misses, self._core),
            )

    def grid(self) -> OccupancyGrid:
        """Return the map of all scans so far, cut to the observed cells; (0, 0) cells before the first scan."""
        cells = np.zeros((0, 0), dtype=np.int16) if self._grid is None else self._grid.cells()
        observed = cells != UNKNOWN
        rows, columns = _span(observed.any(axis=1)), _span(observed.any(axis=0))
        seen = observed[rows, columns]
        log_odds = np.where(seen, cells[rows, columns], 0).astype(np.float32) / THOUSANDTHS
        x, y = (self._low + np.array([columns.start, rows.start])) * self._resolution_m
        return OccupancyGrid(log_odds, seen, self._resolution_m, float(x), float(y))

    def _misses(self, scan: Scan) -> Floats:
        angles = scan.angles[scan.no_returns]
        return scan.range_max_m * np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def _has_room(self, scan: Scan, world_from_sensor: Pose) -> bool:
        """Whether the map contains all beams, without a check of every end."""
        if self._grid is None or scan.range_max_m > self._range_max_m:
            return False
        if self._reaches(world_from_sensor, scan.range_max_m):
            return True
        hits_m = float(np.max(scan.ranges, where=scan.hits, initial=0.0))
        return not self._clear_no_returns and self._reaches(world_from_sensor, hits_m)

    def _reaches(self, world_from_sensor: Pose, range_m: float) -> bool:
        x, y = world_from_sensor.x / self._resolution_m, world_from_sensor.y / self._resolution_m
        left, bottom, right, top = self._edges
        cells = range_m / self._resolution_m + 1.0  # one for rounding
        return left <= x - cells and x + cells <= right and bottom <= y - cells and y + cells <= top

    def _make_room(self, points: Floats, world_from_sensor: Pose, range_max_m: float) -> None:
        """Grow the map where the scan leaves it, and the longest beam where the scan's is longer."""
        reached = world_from_sensor.transform(points) / self._resolution_m
        if not np.abs(reached).max() < 1e9:  # beyond, cells cannot be numbered
            raise self._too_large(f"{np.abs(reached).max() * self._resolution_m:.3g} m")
        low, high = np.floor(reached.min(axis=0)).astype(np.int64), np.floor(reached.max(axis=0)).astype(np.int64) + 1
        longer = range_max_m > self._range_max_m
        if not longer and (low >= self._low).all() and (high <= self._high).all():
            return
        if self._grid is not None:
            low, high = np.minimum(low, self._low), np.maximum(high, self._high)
        low, high = low // CHUNK * CHUNK, -(-high // CHUNK) * CHUNK
        columns, rows = (high - low).tolist()
        if columns * rows > MAX_CELLS or max(columns, rows) > MAX_SIDE_CELLS:
            raise self._too_large(f"{columns * self._resolution_m:.0f} m x {rows * self._resolution_m:.0f} m")
        range_max_m = max(range_max_m, self._range_max_m)
        if range_max_m > MAX_BEAM_CELLS * self._resolution_m:
            raise self._too_large(f"beams of {range_max_m:.0f} m")
        self._set_extent((*low.tolist(), columns, rows), range_max_m)
        self._low, self._high, self._range_max_m = low, high, range_max_m
        self._edges = (*low.tolist(), *high.tolist())

    def _set_extent(self, extent: tuple[int, int, int, int], range_max_m: float) -> None:
        if self._grid is None:
            self._grid = self._core.Grid(
                resolution=self._resolution_m, range_max=range_max_m, extent=extent, **self._outline, **self._log_odds
            )
        else:
            self._grid.move(extent, range_max_m)

    def _too_large(self, reach: str) -> BadParameter:
        return BadParameter("embedded-log-odds", "resolution_m", self._resolution_m, f"larger cells: {reach}")


def _span(marked: Bools) -> slice:
    """Return the slice from the first mark (N,) to the last; empty without marks."""
    places = np.flatnonzero(marked)
    return slice(int(places[0]), int(places[-1]) + 1) if len(places) else slice(0, 0)
