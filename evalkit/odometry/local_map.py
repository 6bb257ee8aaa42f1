"""Local maps: the last scans or keyframes, a lasting map of voxels, an occupancy grid, or the walls of a known map."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import BadParameter
from evalkit.core.known_map import KnownMap
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Mapper

ORIGIN = Pose()


def voxel_means(points: Floats, size_m: float) -> Floats:
    """Return the mean (K, 2) of the points (N, 2) in each square cell of side ``size_m``, ordered by cell."""
    if len(points) == 0:
        return points
    _, inverse, counts = np.unique(_keys(points, size_m), return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(inverse, weights=points[:, axis]) for axis in (0, 1)], axis=1)
    return np.asarray(sums / counts[:, None])


class KeyframeMap:
    """The points of the last ``keyframes`` keyframes, thinned to voxel means where ``voxel_m`` is positive."""

    def __init__(self, keyframes: int, voxel_m: float) -> None:
        self._clouds: deque[Floats] = deque(maxlen=keyframes)
        self._voxel_m = voxel_m
        self._cloud: Cloud | None = None

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Add a keyframe's points (N, 2) of the base frame and drop the oldest keyframe beyond the limit."""
        del base_from_sensor  # the points alone matter
        self._clouds.append(start_from_base.transform(points))
        self._cloud = None

    def cloud(self, near: Pose) -> Cloud:  # noqa: ARG002 - a few keyframes are always near
        """Return all points in the start frame."""
        if self._cloud is None:
            points = np.concatenate(self._clouds)
            self._cloud = Cloud(voxel_means(points, self._voxel_m) if self._voxel_m > 0.0 else points, "start")
        return self._cloud


class VoxelMap:
    """One lasting map of all keyframes, one mean per square voxel: revisited places are matched where first seen.

    A voxel takes no more points once it has ``max_points``, so that later visits, which drift, do not move the map.
    ``keeps_views``: the cloud says from where its points were seen (``Cloud.seen_from``).
    """

    def __init__(self, voxel_m: float, radius_m: float, max_points: int = 20, keeps_views: bool = False) -> None:
        if not voxel_m > 0.0:
            raise BadParameter(
                "front end", "local_map_voxel_m", voxel_m, "a positive number: a lasting map consists of voxels"
            )
        self._voxel_m, self._radius_m, self._max_points = voxel_m, radius_m, max_points
        self._keeps_views = keeps_views
        self._index: dict[int, int] = {}
        self._sums = np.zeros((1024, 4))  # of the points, and of the unit vectors to where they were seen from
        self._counts = np.zeros(1024, dtype=np.int64)
        self._cloud: Cloud | None = None
        self._centre = Pose()

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Add a keyframe's points (N, 2) of the base frame."""
        self.collect(points, start_from_base, base_from_sensor)
        self._cloud = None

    def collect(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Add points (N, 2) of the base frame, shown by ``cloud`` after the next ``add`` or a move."""
        moved = start_from_base.transform(points)
        added = moved
        if self._keeps_views:
            sensor = start_from_base @ base_from_sensor
            added = np.column_stack([moved, _directions(np.array([sensor.x, sensor.y]) - moved)])
        keys, inverse, counts = np.unique(_keys(moved, self._voxel_m), return_inverse=True, return_counts=True)
        slots = self._slots(keys)
        open_ = self._counts[slots] < self._max_points
        for axis in range(added.shape[1]):
            sums = np.bincount(inverse, weights=added[:, axis], minlength=len(keys))
            self._sums[slots[open_], axis] += sums[open_]
        self._counts[slots[open_]] += counts[open_]

    def cloud(self, near: Pose) -> Cloud:
        """Return the voxel means around a pose, in the start frame; updated after ``add`` or when the pose moved."""
        moved_on = np.hypot(near.x - self._centre.x, near.y - self._centre.y) > 0.1 * self._radius_m
        if self._cloud is None or moved_on:
            used = len(self._index)
            means, counts = self._sums[:used] / self._counts[:used, None], self._counts[:used]
            inside = np.hypot(means[:, 0] - near.x, means[:, 1] - near.y) <= self._radius_m
            seen_from = means[inside, 2:] if self._keeps_views else None
            self._cloud, self._centre = Cloud(means[inside, :2], "start", counts[inside], seen_from), near
        return self._cloud

    def _slots(self, keys: Ints) -> Ints:
        slots = np.array([self._index.setdefault(key, len(self._index)) for key in keys.tolist()], dtype=np.int64)
        while len(self._index) > len(self._counts):
            self._sums = np.concatenate([self._sums, np.zeros_like(self._sums)])
            self._counts = np.concatenate([self._counts, np.zeros_like(self._counts)])
        return slots


class GridMap:
    """The occupied cells of an occupancy grid that grows with every scan, as in the paper.

    A cell is occupied where its probability is above ``probability``; its centre is the point to match with.
    """

    def __init__(self, mapper: Mapper, probability: float, radius_m: float) -> None:
        self._mapper, self._probability, self._radius_m = mapper, probability, radius_m
        self._cloud: Cloud | None = None

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Draw a scan's points (N, 2) of the base frame, each as the end of a beam from the sensor."""
        x, y = base_from_sensor.inverse().transform(points).T
        ranges = np.hypot(x, y)
        scan = Scan(0, ranges, np.arctan2(y, x), 0.0, float(ranges.max(initial=0.0)) + 1.0)
        self._mapper.update(scan, start_from_base @ base_from_sensor)
        self._cloud = None

    def cloud(self, near: Pose) -> Cloud:
        """Return the centres of the occupied cells around a pose, in the start frame."""
        if self._cloud is None:
            grid = self._mapper.grid()
            centres = grid.centres(grid.occupied(self._probability))
            inside = np.hypot(centres[:, 0] - near.x, centres[:, 1] - near.y) <= self._radius_m
            self._cloud = Cloud(centres[inside], "start")
        return self._cloud


class WallsAround:
    """A LocalMap that never grows: the walls of a known map around the robot, in the front end's start frame."""

    def __init__(self, known: KnownMap, map_from_start: Pose, radius_m: float) -> None:
        self._walls = map_from_start.inverse().transform(known.walls)
        self._radius_m = radius_m
        self._near = Cloud(np.empty((0, 2)), "start")
        self._centre: Pose | None = None

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Add nothing: the map is known."""

    def cloud(self, near: Pose) -> Cloud:
        """Return the walls around a pose; the same cloud until the robot has moved by a tenth of the radius."""
        moved = math.inf if self._centre is None else math.hypot(near.x - self._centre.x, near.y - self._centre.y)
        if moved > 0.1 * self._radius_m:
            inside = np.hypot(*(self._walls - [near.x, near.y]).T) <= self._radius_m
            self._near, self._centre = Cloud(self._walls[inside], "start"), near
        return self._near


def _directions(vectors: Floats) -> Floats:
    """Return vectors (N, 2) at length 1; a vector of length 0 stays."""
    length = np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
    return np.asarray(np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0) * vectors)


def _keys(points: Floats, size_m: float) -> Ints:
    cells = np.floor(points / size_m).astype(np.int64)
    return np.asarray(cells[:, 0] * (1 << 32) + cells[:, 1])
