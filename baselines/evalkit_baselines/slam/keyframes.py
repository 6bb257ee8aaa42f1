"""The keyframes of a drive: their points, their corrected poses, and the graph that connects them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose import Pose
from evalkit.core.pose_graph import PoseGraph
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import ORIGIN
from evalkit_baselines.slam.match_doubt import Doubt
from evalkit_baselines.slam.observability import ALL_OPEN, BLIND, ROOM_RATIO, Openness, measure_openness

CLOSURE_LENGTH_M = 0.5
"""Length that a loop closure adds to the distance through the graph."""

UNKNOWN = np.diag([1e-4, 1e-4, 1e-2])
"""Information of a motion that is not known: 100 m, 10 rad."""

NO_DOUBT = Doubt()

LOST_DOUBT = Doubt(0.5**2, math.radians(10.0) ** 2)
"""Variance of a step by wheel odometry alone where the track was lost: 0.5 m, 10 deg. Either the odometry is right, and
the matches before were hardly more wrong than that, or the robot was carried, and it says nothing."""

DOUBTED_M = 1e9
"""Length of such a step through the graph: from here on, two keyframes are connected by such steps only. What lies
before does not belong to the map."""

OPEN_FACTOR = 20.0
"""Variance along the walls of a bare corridor, as a multiple of that in a room."""


class Step(IntEnum):
    """How the motion between two keyframes is known: matched, or after a lost track by wheel odometry alone, or not."""

    MATCHED = 0
    MEASURED = 1
    UNKNOWN = 2


@dataclass(frozen=True)
class DriftModel:
    """Assumed random errors of matched motions, 1 sigma after one metre; they grow with the root of the path."""

    sigma_m: float = 0.02
    sigma_rad: float = math.radians(0.3)

    def information(self, length_m: float, openness: Openness, doubt: Doubt) -> Floats:
        """Return the information (3, 3) of a motion over a path, in the frame of the scan at its end."""
        length = max(length_m, 0.05)
        share = min(max((ROOM_RATIO - openness.ratio) / (ROOM_RATIO - BLIND), 0.0), 1.0)
        variance = self.sigma_m**2 * length * (np.eye(2) + OPEN_FACTOR * share * np.outer(*[openness.direction] * 2))
        information = np.zeros((3, 3))
        information[:2, :2] = np.linalg.inv(variance + doubt.position_m2 * np.eye(2))
        information[2, 2] = 1.0 / (self.sigma_rad**2 * length + doubt.heading_rad2)
        return 0.5 * (information + information.T)


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured motion ``first_from_second`` between two keyframes, with its information (3, 3)."""

    first: int
    second: int
    first_from_second: Pose
    information: Floats


@dataclass
class Keyframes:
    """Keyframes in the order of time. ``poses[k]`` is ``start_from_keyframe``, corrected; the first is the identity.

    ``clouds[k]`` (N, 2): points in the keyframe's frame (m), seen by a lidar at the pose ``mounts[k]`` in it.
    ``path_m[k]``: driven distance. ``sections[k]``: number of the part of the drive without a lost track. ``kinds[k]``:
    of the step to a keyframe.
    """

    drift: DriftModel
    reach_m: float = math.inf  # points farther from a keyframe are not matched
    stamps_ns: list[int] = field(default_factory=list)
    clouds: list[Floats] = field(default_factory=list)
    mounts: list[Pose] = field(default_factory=list)
    path_m: list[float] = field(default_factory=list)
    sections: list[int] = field(default_factory=list)
    kinds: list[Step] = field(default_factory=list)
    steps: list[Edge] = field(default_factory=list)
    loops: list[Edge] = field(default_factory=list)
    _poses: Floats = field(default_factory=lambda: np.zeros((256, 3)))
    _apart_m: Floats = field(default_factory=lambda: np.zeros(256))
    _openness: tuple[Openness, Openness] = (ALL_OPEN, ALL_OPEN)  # of the last two keyframes

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def poses(self) -> Floats:
        """Corrected poses (N, 3) ``start_from_keyframe``."""
        return self._poses[: len(self)]

    @property
    def apart_m(self) -> Floats:
        """Distances (N,) from the last keyframe through the graph: the shortest way along steps and loops."""
        return self._apart_m[: len(self)]

    def pose(self, row: int) -> Pose:
        """Return the corrected pose of a keyframe."""
        return Pose.of(self._poses[row])

    def add(
        self,
        stamp_ns: int,
        points: Floats,
        last_from_keyframe: Pose,
        kind: Step = Step.MATCHED,
        doubt: Doubt = NO_DOUBT,
        mount: Pose = ORIGIN,
    ) -> None:
        """Add a keyframe by its motion from the last one."""
        row, length = len(self), math.hypot(last_from_keyframe.x, last_from_keyframe.y)
        openness = measure_openness(points, self.reach_m)
        if row == len(self._poses):
            self._poses = np.concatenate([self._poses, np.zeros_like(self._poses)])
            self._apart_m = np.concatenate([self._apart_m, np.zeros_like(self._apart_m)])
        if row:
            self._poses[row] = (self.pose(row - 1) @ last_from_keyframe).row
            if kind is Step.MEASURED:
                doubt = Doubt(*np.add(doubt, LOST_DOUBT))
            information = UNKNOWN if kind is Step.UNKNOWN else self.drift.information(length, openness, doubt)
            self.steps.append(Edge(row - 1, row, last_from_keyframe, information))
            self._apart_m[:row] += _graph_length(kind, length)
        self._apart_m[row] = 0.0
        self._openness = (self._openness[1], openness)
        self.stamps_ns.append(stamp_ns)
        self.clouds.append(points)
        self.mounts.append(mount)
        self.path_m.append((self.path_m[-1] if row else 0.0) + length)
        self.sections.append((self.sections[-1] if row else 0) + (kind is not Step.MATCHED))
        self.kinds.append(kind)

    def is_last_step_seen(self) -> bool:
        """Return whether the walls fix the position at the last two keyframes in all directions."""
        return all(openness.is_closed for openness in self._openness)

    def is_last_in_room(self) -> bool:
        """Return whether the walls fix the position well at the last keyframe."""
        return self._openness[1].is_room

    def graph(self) -> PoseGraph:
        """Return the pose graph; steps first, then loops."""
        edges = [*self.steps, *self.loops]
        return PoseGraph(
            self.poses,
            np.array([edge.first for edge in edges], dtype=np.int64),
            np.array([edge.second for edge in edges], dtype=np.int64),
            np.array([edge.first_from_second.row for edge in edges]),
            np.array([edge.information for edge in edges]),
        )

    def trusted(self) -> Bools:
        """Return which edges of the graph (M,) are never doubted: the steps."""
        return np.arange(len(self.steps) + len(self.loops)) < len(self.steps)

    def correct(self, poses: Floats, loops: Sequence[Edge]) -> None:
        """Replace all poses (N, 3) and the loops, and measure the distances through the graph again."""
        self._poses[: len(self)] = poses
        self.loops = list(loops)
        self._apart_m[: len(self)] = self._distances()

    def join(self, loop: Edge, contradicts: bool) -> None:
        """Move all that is connected with the last keyframe to where a loop from another part of the drive puts it.

        ``contradicts``: the steps by odometry alone between these parts are not known any more.
        """
        part = self.apart_m < DOUBTED_M
        start_from_second = self.pose(loop.first) @ loop.first_from_second
        moved = start_from_second @ self.pose(loop.second).inverse()
        self.poses[part] = se2.compose(moved.row, self.poses[part])
        for row in np.flatnonzero(part[1:] != part[:-1]) + 1 if contradicts else ():
            self.kinds[row] = Step.UNKNOWN
            self.steps[row - 1] = replace(self.steps[row - 1], information=UNKNOWN)

    def near_in_time(self, row: int, reach_m: float) -> Ints:
        """Return the keyframes (K,) of the same part of the drive within a driven distance of one, ascending."""
        path, sections = np.array(self.path_m), np.array(self.sections)
        return np.flatnonzero((np.abs(path - path[row]) <= reach_m) & (sections == sections[row]))

    def points_around(self, row: int, rows: Ints) -> Floats:
        """Return the points (K, 2) of several keyframes in the frame of one."""
        moved = [se2.transform(se2.between(self._poses[row], self._poses[each]), self.clouds[each]) for each in rows]
        return np.concatenate(moved)

    def _distances(self) -> Floats:
        from scipy.sparse import csr_matrix  # noqa: PLC0415 - specs are listed without SciPy
        from scipy.sparse.csgraph import dijkstra  # noqa: PLC0415 - likewise

        size = len(self)
        steps = map(_graph_length, self.kinds[1:], np.diff(self.path_m))
        rows = np.r_[np.arange(size - 1), [loop.first for loop in self.loops]].astype(np.int64)
        columns = np.r_[np.arange(1, size), [loop.second for loop in self.loops]].astype(np.int64)
        lengths = np.r_[np.array([*steps]) + 1e-9, np.full(len(self.loops), CLOSURE_LENGTH_M)]
        links = csr_matrix((lengths, (rows, columns)), shape=(size, size))
        return np.asarray(dijkstra(links, directed=False, indices=np.array([size - 1]))[0], dtype=np.float64)


def _graph_length(kind: Step, length_m: float) -> float:
    """Return the length of a step through the graph (m)."""
    return {Step.MATCHED: length_m, Step.MEASURED: DOUBTED_M, Step.UNKNOWN: math.inf}[kind]
