"""Which place of the drive is compared next with the last keyframe.

It is the nearest earlier keyframe that is far apart through the graph, within the radius that the drift since then
allows. While another part of the drive is not connected, its places are compared, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evalkit.core.pose import Pose
from evalkit_baselines.slam.keyframes import DOUBTED_M, Edge, Keyframes
from evalkit_baselines.slam.settings import LoopSettings

_ALL, _AROUND = 2, 3
"""Turns at which the next of all places is compared, and a place around where the robot seems to be, as if the graph
predicted no motion."""


class LoopPlace(NamedTuple):
    """A keyframe to compare with the last one, and where that may be, ``start_from_last``; None: at any heading.

    ``known``: the graph predicts the motion between them.
    """

    row: int
    expected: Pose | None
    known: bool = True


class LoopPlaces:
    """Chooses the place; it remembers whose turn it is, and how far all places have been compared."""

    def __init__(self, settings: LoopSettings) -> None:
        self._settings = settings
        self._next_place = 0
        self._turn = 0

    def find_beside(self, keyframes: Keyframes, loop: Edge, known: bool) -> LoopPlace | None:
        """Return the place beside a loop, which another one there may confirm; ``known``: the graph predicted it."""
        last = keyframes.pose(len(keyframes) - 1)
        pose = keyframes.pose(loop.first) @ loop.first_from_second
        pose = pose @ (keyframes.pose(loop.second).inverse() @ last)
        is_apart = bool(keyframes.apart_m[loop.first] >= DOUBTED_M)
        row = self._nearest_other_part(keyframes, pose) if is_apart else self._nearest_place(keyframes, pose)
        return None if row is None else LoopPlace(row, pose, known)

    def find_next(self, keyframes: Keyframes, measured: bool) -> LoopPlace | None:
        """Return the nearest place; while another part of the drive is not connected, by turns one of it.

        Of five turns three are for its place nearest to where the robot seems to be: the first and the fourth within
        what the graph predicts by the odometry since then, the third within the radius. The second is for the next of
        all places, the last for the nearest place of the own part. Without such a prediction, or such a place, these
        are as the second.
        """
        pose = keyframes.pose(len(keyframes) - 1)
        row, apart = self._nearest_place(keyframes, pose), keyframes.apart_m
        if not (apart >= DOUBTED_M).any():
            return None if row is None else LoopPlace(row, pose)
        self._turn = (self._turn + 1) % 5
        near = self._nearest_other_part(keyframes, pose)
        known = near is not None and measured and bool(np.isfinite(apart[near]))
        if self._turn == 0 and row is not None:
            return LoopPlace(row, pose)
        if near is not None and (self._turn in {1, _AROUND} or (known and self._turn != _ALL)):
            return LoopPlace(near, pose if measured else None, known and self._turn != _AROUND)
        return LoopPlace(self._next_of_all(keyframes), None, known=False)

    def _nearest_place(self, keyframes: Keyframes, pose: Pose) -> int | None:
        apart = keyframes.apart_m
        distance = np.hypot(keyframes.poses[:, 0] - pose.x, keyframes.poses[:, 1] - pose.y)
        radius = np.minimum(self._settings.loop_radius_m, 1.0 + 0.1 * apart)
        eligible = np.flatnonzero((apart >= self._settings.loop_path_m) & (apart < DOUBTED_M) & (distance <= radius))
        if not len(eligible):
            return None
        return int(eligible[np.argmin(distance[eligible])])

    def _nearest_other_part(self, keyframes: Keyframes, pose: Pose) -> int | None:
        distance = np.hypot(keyframes.poses[:, 0] - pose.x, keyframes.poses[:, 1] - pose.y)
        distance = np.where(keyframes.apart_m >= DOUBTED_M, distance, np.inf)
        return int(np.argmin(distance)) if distance.min() <= self._settings.loop_radius_m else None

    def _next_of_all(self, keyframes: Keyframes) -> int:
        """Return the next place of the other parts, half a radius of path after the last one."""
        path, apart = np.array(keyframes.path_m), keyframes.apart_m
        ahead = np.flatnonzero((apart >= DOUBTED_M) & (path >= path[min(self._next_place, len(path) - 1)]))
        if not len(ahead):
            self._next_place = 0
            ahead = np.flatnonzero(apart >= DOUBTED_M)
        place = int(ahead[0])
        self._next_place = int(np.searchsorted(path, path[place] + 0.5 * self._settings.loop_radius_m))
        return place
