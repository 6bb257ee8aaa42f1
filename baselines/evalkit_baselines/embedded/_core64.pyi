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
    """Immutable index for exact nearest neighbours among points (N, 2) in metres.

    For ``lines``, with normals from the given number of neighbours, computed when needed; for many registrations, with
    a table of so many tiles; ``support`` (N,): of how many points each is the mean, 1 or more; ``seen_from`` (N, 2):
    the mean of the unit vectors from these to where they were seen from; ``noisy``: support counts in lines, too.
    """

    def __init__(
        self,
        points: Array,
        neighbours: int = 0,
        *,
        table: int = 0,
        support: NDArray[np.uint32] | None = None,
        seen_from: Array | None = None,
        noisy: bool = False,
    ) -> None: ...
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
        share_noise: bool = False,
    ) -> None: ...
    def register(
        self,
        target: Index,
        source: Array,
        guess: Row,
        trace: bool = False,
        *,
        origin: tuple[float, float] | None = None,
    ) -> tuple[Row, bool, int, float, int, Sequence[tuple[float, int, Row, NDArray[np.int64]]]]:
        """``target_from_source``, converged, iterations, error (m), inliers; if traced, for each iteration the error
        (in the unit of the stop rule), inliers, pose and pairs (K, 2). The source was seen from ``origin`` (m)."""

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

def optimise_graph(
    poses: Array,
    steps: Array,
    step_information: Array,
    ends: NDArray[np.uint32],
    motions: Array,
    information: Array,
    *,
    max_iterations: int,
    tolerance: float,
    phi: float = 0.0,
    slice_work: int = ...,
) -> tuple[Array, float, int, bool, Array]:
    """Poses (N, 3) after Gauss-Newton from ``poses`` (ek/pose_graph.h), chi-square, iterations, converged, and the
    weights (L, 1) of the loops between rows ``ends`` (L, 2). Information: rows xx, xy, xt, yy, yt, tt."""

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
        neighbours: int = 8,
        map_voxel: float = 0.0,
        map_radius: float = 15.0,
        voxels: int = 1,
    ) -> None:
        """``map_voxel`` (m) 0: match with the last keyframes; else with one lasting map of up to ``voxels`` voxels."""

    @property
    def dropped_cells(self) -> int:
        """Cells of keyframes for which the lasting map had no room."""

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

class Slam:
    """A SLAM (ek/slam.h), with settings by the names of its parameters: real numbers, and whole numbers."""

    def __init__(self, icp: Icp, real: dict[str, float], number: dict[str, int]) -> None: ...
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
    ) -> tuple[Row, Row, Stage, Stage, int, int, int]:
        """``start_from_base`` and the pose in the continuous frame at the first beam, both stages, flags (1 lost, 2
        corrected, 4 full), the last keyframe, and the operations of the scan."""
    def correct(self, keyframes: NDArray[np.uint32], poses: Array) -> Array:
        """Corrected poses (N, 3) of scans from their keyframes (N,) and poses (N, 3) in the continuous frame."""
    def records(self) -> list[tuple[int, int, Row, int, float, float, int, int]]:
        """Candidates: later and earlier keyframe, motion, outcome, its two numbers, flags (1 accepted, 2 unconfirmed, 4
        found again, 8 withdrawn, 16 no room), and the part of the drive."""
    @property
    def memory_bytes(self) -> int:
        """Memory, fixed at the start."""
    @property
    def keyframes(self) -> int:
        """Number of keyframes."""
    @property
    def dropped_cells(self) -> int:
        """Cells of scans for which the lasting map had no room."""
    @property
    def unrecorded(self) -> int:
        """Candidates for which there was no room; they close no loop."""
    @property
    def busy(self) -> bool:
        """Whether a loop, an optimisation or the map is in work."""
