"""Slice a 3D point cloud to a planar scan: the nearest point of every direction within a band of heights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evalkit.core.errors import BadParameter
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import Parameter
from evalkit_datasets.parsing.range_minimum import raise_range_min_m

MAX_BEAMS = 20_000

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("height_min_m", -0.1, "m", "point clouds: lowest height taken, in the lidar's frame (z up)"),
    Parameter("height_max_m", 0.1, "m", "point clouds: largest height taken, in the lidar's frame (z up)"),
    Parameter("beams", 720, "", "point clouds: directions of a turn; of each, the nearest point is kept", low=8,
              high=MAX_BEAMS),
)  # fmt: skip


@dataclass(frozen=True)
class CloudSlice:
    """The band of heights ``height_min_m`` to ``height_max_m`` (z in the lidar's frame) and the number of directions.

    A direction without a point in the band is invalid (nan), not free: a beam may have passed above or below.
    """

    height_min_m: float = -0.1
    height_max_m: float = 0.1
    beams: int = 720
    range_min_m: float = 0.1
    range_max_m: float = 200.0

    def __post_init__(self) -> None:
        if not self.height_min_m < self.height_max_m:
            found = f"{self.height_min_m:g} to {self.height_max_m:g} m"
            raise BadParameter("point cloud", "height_min_m", found, "less than height_max_m")

    def beyond(self, owner: str, range_min_m: float) -> CloudSlice:
        """Return the slice without points nearer than ``range_min_m``, a parameter of the reader ``owner``."""
        low = raise_range_min_m(owner, self.range_min_m, range_min_m, self.range_max_m)
        return replace(self, range_min_m=low)

    def cut(self, points: Floats) -> tuple[Floats, Floats]:
        """Return ranges (B,) in m, nan where there is no point, and angles (B,) in rad of points (N, 3).

        Angles are those of the points themselves, of empty directions their middle; they increase from -pi.
        """
        x, y, z = points.T
        distances = np.hypot(x, y)
        inside = (z >= self.height_min_m) & (z <= self.height_max_m)
        inside &= (distances >= self.range_min_m) & (distances < self.range_max_m)  # nan is never inside
        distances, bearings = distances[inside], np.arctan2(y[inside], x[inside])
        step = 2.0 * np.pi / self.beams
        cells = np.minimum(((bearings + np.pi) / step).astype(np.int64), self.beams - 1)
        order = np.lexsort((distances, cells))
        filled, first = np.unique(cells[order], return_index=True)
        ranges: Floats = np.full(self.beams, np.nan)
        angles = np.asarray(-np.pi + step * (np.arange(self.beams) + 0.5), dtype=np.float64)
        ranges[filled], angles[filled] = distances[order][first], bearings[order][first]
        return ranges, angles


def read_packed_points(
    data: NDArray[np.uint8], fields: Mapping[str, tuple[str, int]], shape: tuple[int, int, int, int], big_endian: bool
) -> Floats | None:
    """Return the points (N, 3) in packed bytes, None if the layout does not fit them.

    ``fields``: NumPy type and offset of each field. ``shape``: rows, points in a row, bytes of a row, bytes of a point.
    """
    rows, columns, row_step, point_step = shape
    row_step = row_step or columns * point_step
    usable = min(shape[:2]) > 0 and point_step > 0 and columns * point_step <= row_step and rows * row_step <= len(data)
    if not usable or not {"x", "y", "z"} <= set(fields):
        return None
    order = ">" if big_endian else "<"
    kinds = [(order + fields[axis][0], fields[axis][1]) for axis in "xyz"]
    if any(kind[1:] not in ("f4", "f8") or not 0 <= at <= point_step - int(kind[2:]) for kind, at in kinds):
        return None
    layout = np.dtype({"names": list("xyz"), "formats": [kind for kind, _ in kinds], "offsets": [at for _, at in kinds],
                       "itemsize": point_step})  # fmt: skip
    whole = data[: rows * row_step].reshape(rows, row_step)[:, : columns * point_step]
    packed = np.ascontiguousarray(whole).view(layout).reshape(-1)
    with np.errstate(invalid="ignore"):
        return np.stack([packed[axis].astype(np.float64) for axis in "xyz"], axis=-1)
