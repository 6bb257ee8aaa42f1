"""Maps as grey PNG images of a common window, for comparison by eye."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evalkit.core.grid import OccupancyGrid

PIXELS = 640  # longest side of a picture
UNKNOWN = 205 / 255  # map_server's grey

Greys = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class MapWindow:
    """The part of the world (m) that all maps of a sequence show."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return self.x_max - self.x_min, self.y_max - self.y_min

    @property
    def scale_bar_m(self) -> float:
        """The largest round length of at most a quarter of the width."""
        quarter = self.size_m[0] / 4.0
        power = 10.0 ** np.floor(np.log10(quarter))
        return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= quarter))


def find_window(grids: Sequence[OccupancyGrid], reference: OccupancyGrid | None = None) -> MapWindow | None:
    """Return the window that contains the observed cells of all maps, except of maps above twice the usual size.

    ``reference``: the true map, whose size is then the usual one; else the median size is. None if no cell is observed.
    """
    boxes = np.array([box for grid in grids if (box := _observed_box(grid)) is not None])
    usual = _observed_box(reference) if reference is not None else None
    if usual is None:
        if len(boxes) == 0:
            return None
        diagonals = np.hypot(boxes[:, 1] - boxes[:, 0], boxes[:, 3] - boxes[:, 2])
        usual = boxes[np.argsort(diagonals)[(len(boxes) - 1) // 2]]
    limit = 2.0 * np.hypot(usual[1] - usual[0], usual[3] - usual[2])
    kept = [usual, *(box for box in boxes if np.hypot(box[1] - box[0], box[3] - box[2]) <= limit)]
    low, high = np.min(kept, axis=0), np.max(kept, axis=0)
    return MapWindow(float(low[0]), float(high[1]), float(low[2]), float(high[3]))


def render_map(grid: OccupancyGrid, shown: MapWindow) -> bytes:
    """Return a PNG of the map within a window: black occupied, white free, grey not observed."""
    return encode_png(compute_greys(grid, shown))


def compute_greys(grid: OccupancyGrid, shown: MapWindow) -> Greys:
    """Return levels 0 (p >= 0.9) to 15 (p <= 0.1), row 0 at the top; a pixel of several cells shows the darkest."""
    width, height = shown.size_m
    per_pixel, step = _sampling(grid, shown)
    columns, rows = (max(1, round(side / step / per_pixel)) * per_pixel for side in (width, height))
    x = shown.x_min + (np.arange(columns) + 0.5) * step
    y = shown.y_max - (np.arange(rows) + 0.5) * step
    column = np.floor((x - grid.origin_x) / grid.resolution_m).astype(int)
    row = np.floor((y - grid.origin_y) / grid.resolution_m).astype(int)
    inside = np.ix_((row >= 0) & (row < grid.shape[0]), (column >= 0) & (column < grid.shape[1]))
    cells = np.ix_(row[inside[0].ravel()], column[inside[1].ravel()])
    white = np.full((rows, columns), UNKNOWN)
    free = np.clip((0.9 - grid.probability()[cells]) / 0.8, 0.0, 1.0)
    white[inside] = np.where(grid.observed[cells], free, UNKNOWN)
    return np.round(15.0 * _darkest(white, per_pixel)).astype(np.uint8)


def measure_image(grid: OccupancyGrid, shown: MapWindow) -> tuple[int, int]:
    """Return the width and height of a map's image in pixels."""
    per_pixel, step = _sampling(grid, shown)
    width, height = (max(1, round(side / step / per_pixel)) for side in shown.size_m)
    return width, height


def pixel_m(grid: OccupancyGrid, shown: MapWindow) -> float:
    """Return the size of a pixel of the map's image in metres."""
    per_pixel, step = _sampling(grid, shown)
    return per_pixel * step


def encode_png(levels: Greys) -> bytes:
    """Return a PNG file of 16 grey levels (H, W), by ISO/IEC 15948: 4 bits a pixel, no filter."""
    height, width = levels.shape
    even = np.pad(levels, ((0, 0), (0, width % 2)))
    packed = (even[:, 0::2] << 4) | even[:, 1::2]
    raw = np.pad(packed, ((0, 0), (1, 0))).astype(np.uint8).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 4, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(raw, 9)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(_chunk(kind, body) for kind, body in chunks)


def _sampling(grid: OccupancyGrid, shown: MapWindow) -> tuple[int, float]:
    """Return the number of samples per pixel along each side, and their distance (m)."""
    longest = max(shown.size_m)
    per_pixel = int(np.clip(np.ceil(longest / grid.resolution_m / PIXELS), 1, 4))
    return per_pixel, max(longest / (PIXELS * per_pixel), grid.resolution_m / 4.0)


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def _darkest(white: NDArray[np.float64], block: int) -> NDArray[np.float64]:
    rows, columns = white.shape
    blocks = white.reshape(rows // block, block, columns // block, block)
    darkest, lightest = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    return np.asarray(np.where(darkest < 0.5, darkest, lightest))


def _observed_box(grid: OccupancyGrid) -> NDArray[np.float64] | None:
    rows, columns = np.flatnonzero(grid.observed.any(axis=1)), np.flatnonzero(grid.observed.any(axis=0))
    if rows.size == 0:
        return None
    x, y, step = grid.origin_x, grid.origin_y, grid.resolution_m
    return np.array(
        [x + columns[0] * step, x + (columns[-1] + 1) * step, y + rows[0] * step, y + (rows[-1] + 1) * step]
    )
