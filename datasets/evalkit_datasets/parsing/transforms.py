"""A tree of 3D transforms as published by ROS, and the planar pose of a sensor on its base."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.io.tum import MAX_TILT_RAD
from evalkit_datasets.parsing.buffers import PoseBuffer


@dataclass(frozen=True, slots=True)
class Mounting:
    """Pose of a lidar on the base, seen from above. ``mirrored``: it is upside down, so its angles are reversed."""

    base_from_sensor: Pose
    mirrored: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Transform:
    """One transform ``parent_from_child`` (4, 4) at one time."""

    stamp_ns: int
    parent: str
    child: str
    parent_from_child: Floats


def own_name(frame: str) -> str:
    """Return the name of a frame without the prefix of its robot: "odom" of "robot1/odom"."""
    return frame.rpartition("/")[2]


def with_prefix_of(frame: str, names: Iterable[str]) -> list[str]:
    """Return names with the prefix that a frame has of its robot, if any, and then without."""
    prefix, plain = frame.rpartition("/")[0], list(names)
    return [*(f"{prefix}/{name}" for name in plain), *plain] if prefix else plain


@dataclass(eq=False)
class TransformTree:
    """Static and moving transforms by child frame; a frame may be published under several parents.

    ``near_ns``: only the moving transform nearest to this time is kept, None: all are. ``odometry_parents``: parents
    (with any prefix of a robot) whose moving children also keep all their planar poses, in ``paths``. ``counts``:
    messages of each moving child.
    """

    static: dict[str, dict[str, Transform]] = field(default_factory=dict)
    moving: dict[tuple[str, str], list[Transform]] = field(default_factory=dict)
    near_ns: int | None = None
    odometry_parents: frozenset[str] = frozenset()
    paths: dict[tuple[str, str], PoseBuffer] = field(default_factory=dict)
    counts: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add(self, edge: Transform, static: bool) -> None:
        """Add one transform; a static one replaces an earlier one, as in tf2."""
        if static:
            self.static.setdefault(edge.child, {})[edge.parent] = edge
            return
        pair = edge.parent, edge.child
        self.counts[pair] += 1
        if not self.odometry_parents.isdisjoint((edge.parent, own_name(edge.parent))):
            pose = planar_pose_from_matrix(edge.parent_from_child)
            self.paths.setdefault(pair, PoseBuffer()).append(edge.stamp_ns, pose.row)
        kept = self.moving.setdefault(pair, [])
        if self.near_ns is None or not kept:
            kept.append(edge)
        elif abs(edge.stamp_ns - self.near_ns) < abs(kept[0].stamp_ns - self.near_ns):
            kept[0] = edge

    def frames(self) -> list[str]:
        """Return the names of all frames, sorted."""
        names = {name for child, parents in self.static.items() for name in (child, *parents)}
        return sorted(names | {name for pair in self.moving for name in pair})

    def find_mounting(self, base: str, sensor: str, stamp_ns: int) -> Mounting | None:
        """Return how the sensor is mounted on the base at a time, or None if no transforms connect them.

        Raises ValueError for a lidar tilted by more than 30 deg: its scans do not lie in the plane.
        """
        matrix = self._find_transform(base, sensor, stamp_ns)
        if matrix is None:
            return None
        upright = float(np.clip(matrix[2, 2], -1.0, 1.0))
        tilt = math.acos(abs(upright))
        if tilt > MAX_TILT_RAD:
            raise ValueError(f"'{sensor}' is tilted by {math.degrees(tilt):.0f} deg to the plane of '{base}'")
        return Mounting(planar_pose_from_matrix(matrix), upright < 0.0)

    def _find_transform(self, base: str, sensor: str, stamp_ns: int) -> Floats | None:
        """Return ``base_from_sensor`` (4, 4), found breadth first."""
        base_from_frame: dict[str, Floats] = {base: np.eye(4)}
        queue = [base]
        while queue and sensor not in base_from_frame:
            frame = queue.pop(0)
            for neighbour, frame_from_neighbour in self._neighbours(frame, stamp_ns):
                if neighbour not in base_from_frame:
                    base_from_frame[neighbour] = base_from_frame[frame] @ frame_from_neighbour
                    queue.append(neighbour)
        return base_from_frame.get(sensor)

    def _neighbours(self, frame: str, stamp_ns: int) -> Iterable[tuple[str, Floats]]:
        for parents in self.static.values():
            yield from _select_edges(frame, parents.values())
        for edges in self.moving.values():
            yield from _select_edges(frame, [min(edges, key=lambda edge: abs(edge.stamp_ns - stamp_ns))])


def _select_edges(frame: str, edges: Iterable[Transform]) -> Iterable[tuple[str, Floats]]:
    """Yield the other frame and ``frame_from_other`` of each edge at a frame."""
    for edge in edges:
        if edge.parent == frame:
            yield edge.child, edge.parent_from_child
        elif edge.child == frame:
            yield edge.parent, np.asarray(np.linalg.inv(edge.parent_from_child), dtype=np.float64)


def planar_pose_from_matrix(matrix: Floats) -> Pose:
    """Return x, y and the direction of the x axis, seen from above, of a transform (4, 4)."""
    return Pose(float(matrix[0, 3]), float(matrix[1, 3]), math.atan2(matrix[1, 0], matrix[0, 0]))


def matrix_from_quaternion(
    translation: tuple[float, float, float], quaternion: tuple[float, float, float, float]
) -> Floats:
    """Return the transform (4, 4) of a translation (m) and a quaternion (x, y, z, w).

    Raises ValueError if a value is not finite or the quaternion does not have unit length.
    """
    length = math.sqrt(sum(part * part for part in quaternion))
    if not (math.isfinite(sum(translation)) and abs(length - 1.0) < 0.05):
        raise ValueError(f"translation {translation}, quaternion {quaternion} is not a transform")
    x, y, z, w = (part / length for part in quaternion)
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation
    return matrix
