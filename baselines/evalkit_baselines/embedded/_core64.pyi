"""The embedded core in double precision, compiled from binding/ by the installation.

Arrays must be C-contiguous with dtype ``REAL``; others raise TypeError. An error of the core raises ValueError with the
core's message. Motions are rows x, y (m), theta (rad).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
Row = tuple[float, float, float]
Stage = tuple[int, bool, int, float, int]
"""Result of a stage: outcome (-1 skipped, 0 guess kept, 1 accepted), converged, iterations, error (m), inliers."""
Extent = tuple[int, int, int, int]
"""Left and bottom cell, columns, rows; multiples of 32."""

REAL: str
"""The dtype of all arrays."""

def defaults() -> dict[str, dict[str, float]]:
    """Default parameters of "icp", "scan_to_scan", "scan_to_map", "frontend" and "grid".

    Names and units are those of the Python parameters, except ``error`` and ``error_before`` (see ``Icp``) and
    ``keyframe_angle_rad``.
    """

class Index:
    """Immutable index for exact nearest neighbours among points (N, 2) in metres; for ``lines``, with normals from the
    given number of neighbours (within ``radius``); for many registrations, with a table of so many tiles."""

    def __init__(self, points: Array, neighbours: int = 0, radius: float = ..., table: int = 0) -> None: ...
    def __len__(self) -> int: ...

def normals(points: Array, neighbours: int, radius: float) -> Array:
    """Unit normals (N, 2) of points (N, 2) in metres from their neighbours within a radius (m; ek/normals.h)."""

class Icp:
    """ICP (ek/icp.h); ``error``: 0 mean, 1 mean squared, 2 its root; ``lines``: distances to lines, not points."""

    def __init__(
        self,
        *,
        epsilon: float,
        max_iterations: int,
        error: int,
        error_before: bool,
        one_to_one: bool,
        max_correspondence: float,
        min_pairs: int,
        lines: bool = False,
        cauchy: float = 0.0,
    ) -> None: ...
    def register(
        self, target: Index, source: Array, guess: Row, trace: bool = False
    ) -> tuple[Row, bool, int, float, int, Sequence[tuple[float, int, Row, NDArray[np.int64]]]]:
        """``target_from_source``, converged, iterations, error (m), inliers; if traced, for each iteration the error
        (in the unit of the stop rule), inliers, pose and pairs (K, 2)."""

class Grid:
    """Log-odds occupancy grid (ek/grid.h); ``polygon``: cells inside the outline of a scan, not along its beams."""

    def __init__(
        self,
        *,
        resolution: float,
        l_occ: float,
        l_free: float,
        l_min: float,
        l_max: float,
        range_max: float,
        extent: Extent,
        polygon: bool = False,
        widest_gap: float = 0.0,
    ) -> None: ...
    def add(self, world_from_sensor: Row, hits: Array, misses: Array) -> None:
        """Draws the beams from the sensor to points (N, 2) of its frame: ends occupied (hits) or free (misses)."""
    def move(self, extent: Extent, range_max: float) -> None:
        """Change extent and longest beam (m) of the map; cells inside both extents keep their values."""
    def cells(self) -> NDArray[np.int16]:
        """A copy (rows, columns) in thousandths of log-odds, -32768 where unknown."""
    @property
    def touched(self) -> int:
        """Cells of the last scan within the map."""
    @property
    def ignored_beams(self) -> int:
        """Beams of the last scan that were longer than 1 m beyond the longest."""

class Pipeline:
    """A sequence's way from scans to poses (ek/pipeline.h), without map."""

    def __init__(
        self,
        icp: Icp,
        *,
        scan_to_scan: bool,
        scan_to_map: bool,
        deskew: bool,
        local_radius: float,
        keyframes: int,
        keyframe_distance: float,
        keyframe_angle: float,
        min_inliers: int,
        beams: int,
    ) -> None: ...
    def update(
        self,
        *,
        stamp_ns: int,
        time_increment_ns: int,
        ranges: Array,
        angles: Array,
        odom_from_base: Row | None,
        start_from_end: Row | None,
        base_from_sensor: Row,
        range_limits: tuple[float, float],
    ) -> tuple[Row, Stage, Stage]:
        """``start_from_base`` at the first beam of the scan of ranges (B,) at angles (B,); and both stages."""
