"""The map that scans are matched with: the keyframes around the robot whose poses agree with each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import ORIGIN, VoxelMap
from evalkit_baselines.slam.keyframes import Keyframes

MAX_VOXEL_POINTS = 200
"""A voxel with so many points takes no more."""

_GRID_FROM_ODOM = Pose(0.0, 0.0, 0.4)
"""The voxels are turned against ``odom``: walls that run along rows of voxels, as they do where a robot starts along a
wall, bend the map. After the 283 m of ``long-loop`` the heading was 1 deg off; with turned voxels it is 0.3 deg off."""

REBUILT_EVERY_M = 5.0
"""Keyframes that came too far apart through the graph leave the map after this path."""


class NewKeyframe(NamedTuple):
    """Points (N, 2) of a keyframe in the base frame, its pose ``odom_from_base``, and that of the lidar on the base."""

    points: Floats
    odom_from_base: Pose
    base_from_sensor: Pose


class LastingMap:
    """The map of evalkit's front end (a LocalMap), in the continuous frame ``odom`` of the front end.

    A keyframe belongs to it while it is within ``reach_m`` of the robot through the graph, so a place seen long ago
    does not pull the scans before a loop closure has connected it. A correction moves the map, not the robot: ``odom``
    stays continuous and ``odom_from_start`` changes.
    """

    def __init__(self, keyframes: Keyframes, voxel_m: float, radius_m: float, reach_m: float) -> None:
        self._keyframes, self._voxel_m, self._radius_m, self._reach_m = keyframes, voxel_m, radius_m, reach_m
        self._voxels = VoxelMap(voxel_m, radius_m, MAX_VOXEL_POINTS, keeps_views=True)
        self._built_at_m = 0.0
        self._around: tuple[Cloud, Cloud] | None = None  # the last cloud of the voxels, and the same in ``odom``
        self._waiting: NewKeyframe | None = None
        self.odom_from_start = Pose()
        self.noisy = False
        """That of the clouds taken from now on."""

    def add(self, points: Floats, start_from_base: Pose, base_from_sensor: Pose = ORIGIN) -> None:
        """Hold a keyframe until ``take`` returns it; the front end's start frame is ``odom`` here."""
        self._waiting = NewKeyframe(points, start_from_base, base_from_sensor)

    def add_between(self, points: Floats, odom_from_base: Pose, base_from_sensor: Pose) -> None:
        """Draw a scan (N, 2) between two keyframes; ``move`` leaves it out.

        Near the end of the map, where few scans have seen a wall, its points are noisy, and a scan matched with them is
        off to one side.
        """
        self._voxels.collect(points, _GRID_FROM_ODOM @ odom_from_base, base_from_sensor)

    def take(self) -> NewKeyframe | None:
        """Return the keyframe that the last scan became, if any, once."""
        waiting, self._waiting = self._waiting, None
        return waiting

    def cloud(self, near: Pose) -> Cloud:
        """Return the voxel means (K, 2) around a pose in ``odom``."""
        cloud = self._voxels.cloud(_GRID_FROM_ODOM @ near)
        if self._around is None or self._around[0] is not cloud:
            odom_from_grid = _GRID_FROM_ODOM.inverse()  # a turn: for directions too
            seen_from = None if cloud.seen_from is None else odom_from_grid.transform(cloud.seen_from)
            means = odom_from_grid.transform(cloud.points)
            self._around = cloud, Cloud(means, cloud.frame, cloud.support, seen_from, noisy=self.noisy)
        return self._around[1]

    def extend(self) -> None:
        """Draw the last keyframe; those that came too far apart are left out from time to time."""
        last = len(self._keyframes) - 1
        if self._keyframes.path_m[last] - self._built_at_m >= REBUILT_EVERY_M:
            self._rebuild()
        else:
            self._draw(last)

    def move(self, odom_from_last: Pose) -> None:
        """Put the last keyframe to this pose, and draw the keyframes around it again."""
        self.odom_from_start = odom_from_last @ self._keyframes.pose(len(self._keyframes) - 1).inverse()
        self._rebuild()

    def _rebuild(self) -> None:
        """Draw all keyframes that belong to the map at their poses of now, the oldest first."""
        keyframes = self._keyframes
        last = len(keyframes) - 1
        self._voxels = VoxelMap(self._voxel_m, self._radius_m, MAX_VOXEL_POINTS, keeps_views=True)
        self._built_at_m = keyframes.path_m[last]
        gap = keyframes.poses[:, :2] - keyframes.poses[last, :2]
        near = np.hypot(gap[:, 0], gap[:, 1]) <= 2.0 * self._radius_m
        for row in np.flatnonzero(near & (keyframes.apart_m <= self._reach_m)):
            self._draw(int(row))

    def _draw(self, row: int) -> None:
        pose = self.odom_from_start @ self._keyframes.pose(row)
        mount = self._keyframes.mounts[row]
        self._voxels.add(self._keyframes.clouds[row], _GRID_FROM_ODOM @ pose, mount)
