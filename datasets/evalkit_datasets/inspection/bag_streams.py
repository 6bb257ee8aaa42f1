"""All lidars, odometry and transforms of a ROS 1 or ROS 2 bag in one pass."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets import rosbag_parser
from evalkit_datasets.inspection.streams import LaserStream, OdometryStream, RecordingStreams, Topic
from evalkit_datasets.rosbag_parser import Contents, Sweep
from evalkit_datasets.transforms import TransformTree, planar_pose_from_matrix

WANTED = {*rosbag_parser.LASER, rosbag_parser.ODOMETRY, *rosbag_parser.TRANSFORMS}
TWO_FRAMES = 2  # from "odom" to a child that moves


@dataclass(eq=False)
class _Taken:
    """One topic's messages with when each was recorded, and the twists of odometry."""

    kind: str
    contents: Contents = field(default_factory=Contents)
    sweeps: list[Sweep] = field(default_factory=list)
    recorded_ns: list[int] = field(default_factory=list)
    twists: list[tuple[float, float]] = field(default_factory=list)


def read(path: Path) -> RecordingStreams:
    """The streams of a bag; BadData as the reader of bags says it."""
    taken: dict[str, _Taken] = {}
    tree = Contents()
    with rosbag_parser.open_bag(path) as reader:
        seconds = max((reader.end_time - reader.start_time) * 1e-9, 0.0)
        topics = [
            Topic(name, str(about.msgtype), int(about.msgcount), _rate(int(about.msgcount), seconds))
            for name, about in sorted(reader.topics.items())
        ]
        wanted = [connection for connection in reader.connections if connection.msgtype in WANTED]
        for connection, recorded_ns, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype in rosbag_parser.TRANSFORMS:
                rosbag_parser.take_transforms(tree, message, connection.topic.endswith("tf_static"))
                continue
            own = taken.setdefault(connection.topic, _Taken(connection.msgtype))
            _take(own, connection.topic, message, int(recorded_ns))
    wheels = [_wheels(own) for own in taken.values() if own.kind == rosbag_parser.ODOMETRY and own.contents.odometry]
    return RecordingStreams(
        path,
        "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag",
        topics,
        [_laser(name, own) for name, own in sorted(taken.items()) if own.sweeps],
        [*wheels, *_by_transforms(tree.tree)],
        tree.tree,
        damaged=tree.damaged + sum(own.contents.damaged for own in taken.values()),
    )


def _rate(count: int, seconds: float) -> float:
    return (count - 1) / seconds if count > 1 and seconds > 0.0 else float("nan")


def _take(own: _Taken, topic: str, message: Any, recorded_ns: int) -> None:
    before = sum(map(len, own.contents.odometry.values()))
    if own.kind != rosbag_parser.ODOMETRY:
        sweep = rosbag_parser.take_sweep(own.contents, message, own.kind == rosbag_parser.LASER[1], recorded_ns)
        if sweep is not None:
            own.sweeps.append(sweep)
            own.recorded_ns.append(recorded_ns)
        return
    rosbag_parser.take_odometry(own.contents, topic, message)
    if sum(map(len, own.contents.odometry.values())) > before:  # else damaged, and counted as such
        own.recorded_ns.append(recorded_ns)
        own.twists.append((float(message.twist.twist.linear.x), float(message.twist.twist.angular.z)))


def _laser(topic: str, own: _Taken) -> LaserStream:
    sweeps = own.sweeps
    first = sweeps[0]
    return LaserStream(
        topic,
        own.kind.split("/")[-1],
        first.frame,
        _stamps([sweep.stamp_ns for sweep in sweeps]),
        _stamps(own.recorded_ns),
        [sweep.ranges for sweep in sweeps],
        first.angles(),
        first.range_min_m,
        first.range_max_m,
        first.time_increment_ns,
        own.contents.damaged,
        own.contents.unstamped,
    )


def _wheels(own: _Taken) -> OdometryStream:
    """The odometry of a topic; where its messages change frames, those of the first frames only."""
    (topic, parent, child), samples = next(iter(own.contents.odometry.items()))
    whole = len(own.contents.odometry) == 1
    return OdometryStream(
        topic,
        parent,
        child,
        samples.stamps_ns,
        samples.poses,
        np.array(own.twists) if whole else None,
        _stamps(own.recorded_ns) if whole else None,
    )


def _by_transforms(tree: TransformTree) -> list[OdometryStream]:
    """What tf says of a base that moves in "odom"."""
    return [
        OdometryStream("tf", parent, child, _stamps([edge.stamp_ns for edge in edges]),
               _rows([planar_pose_from_matrix(edge.parent_from_child).row for edge in edges]))
        for (parent, child), edges in sorted(tree.moving.items())
        if parent == "odom" and len(edges) >= TWO_FRAMES
    ]  # fmt: skip


def _stamps(values: list[int]) -> Stamps:
    return np.array(values, dtype=np.int64)


def _rows(values: list[Floats]) -> Floats:
    return np.array(values, dtype=np.float64).reshape(-1, 3)
