"""The tf tree of a recording: frames, conflicting parents, and the mounting of each lidar."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from evalkit_datasets.commands.inspect.streams import LaserStream
from evalkit_datasets.parsing.transforms import TransformTree, own_name, with_prefix_of
from evalkit_datasets.readers.rosbag import BASE_FRAMES

MAX_LISTED = 8
"""Frames named in a message."""


@dataclass(frozen=True, slots=True)
class FrameLink:
    """One transform of the tree: static, or moving, with the number of its messages."""

    parent: str
    child: str
    static: bool
    messages: int


@dataclass(frozen=True, slots=True)
class LidarMounting:
    """Pose of a lidar on a base, seen from above (m, m, deg). ``problem``: why it cannot be used, "" if it can.

    ``unlinked``: the frame of the odometry if no transform leads from it to the lidar, which is on another base; the
    reader then takes neither the pose nor the direction of the angles from the tree.
    """

    base: str
    sensor: str
    x_m: float = 0.0
    y_m: float = 0.0
    theta_deg: float = 0.0
    mirrored: bool = False
    problem: str = ""
    unlinked: str = ""

    def __str__(self) -> str:
        where = self.problem or f"x {self.x_m:.3f} m, y {self.y_m:.3f} m, rotated by {self.theta_deg:.1f} deg"
        return f"lidar '{self.sensor}' on '{self.base}': {where}"


@dataclass(frozen=True)
class FrameTree:
    """``roots``: frames without a parent; ``contested``: parents of frames with several; ``mountings``: of lidars."""

    names: tuple[str, ...] = ()
    roots: tuple[str, ...] = ()
    links: tuple[FrameLink, ...] = ()
    contested: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mountings: tuple[LidarMounting, ...] = ()


def build_frame_tree(tree: TransformTree, lasers: Sequence[LaserStream], bases: Sequence[str] = ()) -> FrameTree:
    """Return the tree, and the mounting of each lidar on the first base frame connected to it.

    ``bases``: frames that are tried before those with a usual name.
    """
    static = [FrameLink(parent, child, True, 1) for child, parents in tree.static.items() for parent in parents]
    moving = [FrameLink(parent, child, False, tree.counts[parent, child]) for parent, child in tree.moving]
    links = tuple(sorted([*static, *moving], key=lambda link: (link.static, link.parent, link.child)))
    names = tuple(tree.frames())
    parents: dict[str, list[str]] = {}
    for link in links:
        parents.setdefault(link.child, []).append(link.parent)
    contested = {child: tuple(dict.fromkeys(own)) for child, own in parents.items() if len(set(own)) > 1}
    mountings = [mounting for laser in lasers if (mounting := _find_mounting(tree, laser, bases)) is not None]
    return FrameTree(names, tuple(name for name in names if name not in parents), links, contested, tuple(mountings))


def list_frames(tree: FrameTree) -> str:
    """Return the names of the first frames for a message."""
    return ", ".join(tree.names[:MAX_LISTED]) + (", ..." if len(tree.names) > MAX_LISTED else "")


def mirror_if_upside_down(laser: LaserStream, tree: FrameTree) -> LaserStream:
    """Return the scans of a lidar as seen from above, as the reader gives them: the angles change sign upside down."""
    upside_down = any(mounting.sensor == laser.frame and mounting.mirrored for mounting in tree.mountings)
    return replace(laser, angles=-laser.angles) if upside_down else laser


def _find_mounting(tree: TransformTree, laser: LaserStream, bases: Sequence[str]) -> LidarMounting | None:
    """Return None if no base frame is connected to the lidar; frames of its own robot are tried first."""
    own = [base for base in bases if base in with_prefix_of(laser.frame, [own_name(base)])]
    frames = list(dict.fromkeys([*own, *with_prefix_of(laser.frame, BASE_FRAMES), *bases]))
    for base in frames:
        try:
            mounting = tree.find_mounting(base, laser.frame, int(laser.stamps_ns[0]))
        except ValueError as error:
            return LidarMounting(base, laser.frame, problem=str(error))
        if mounting is not None and base in tree.frames():
            pose, unlinked = mounting.base_from_sensor, frames[0] if own and base not in bases else ""
            mirrored = mounting.mirrored and not unlinked
            theta_deg = math.degrees(pose.theta)
            return LidarMounting(base, laser.frame, pose.x, pose.y, theta_deg, mirrored, unlinked=unlinked)
    return None
