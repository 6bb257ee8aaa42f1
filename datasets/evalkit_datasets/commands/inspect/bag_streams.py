"""Read all lidars, odometry and transforms of a ROS 1 or ROS 2 bag in one pass."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.se2 import Stamps
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, RecordingStreams, ScanSample, Topic
from evalkit_datasets.parsing import bag_file, rosbag_parser
from evalkit_datasets.parsing.bag_file import MessageDamage
from evalkit_datasets.parsing.robots import find_foreign_topics
from evalkit_datasets.parsing.rosbag_parser import ODOMETRY_FRAME, Contents
from evalkit_datasets.parsing.sweeps import CLOUD, LASER_SCAN, MessageFields, Sweep, SweepOptions, guess_fields
from evalkit_datasets.parsing.transforms import TransformTree

WANTED = {*rosbag_parser.LASER, CLOUD, rosbag_parser.ODOMETRY, *rosbag_parser.TRANSFORMS}
MAX_UNUSUAL = 20  # topics with sweeps of unusual types
MIN_TF_POSES = 2  # transforms needed for odometry from tf


NO_OPTIONS = SweepOptions()


@dataclass(eq=False)
class _TopicContent:
    """What is kept of the messages of one topic: times, a sample of the ranges, poses and twists of odometry."""

    kind: str
    options: SweepOptions = NO_OPTIONS
    contents: Contents = field(default_factory=Contents)
    first: Sweep | None = None
    scans: ScanSample = field(default_factory=ScanSample)
    stamps_ns: array[int] = field(default_factory=lambda: array("q"))
    recorded_ns: array[int] = field(default_factory=lambda: array("q"))
    twists: array[float] = field(default_factory=lambda: array("d"))


class _RecordedTimes:
    """Times of recording of the poses in tf, by the frames of the odometry."""

    def __init__(self) -> None:
        self._times: dict[tuple[str, str], array[int]] = {}

    def note(self, tree: TransformTree, recorded_ns: int) -> None:
        """Give all poses that are new in the tree this time."""
        for pair, path in tree.paths.items():
            own = self._times.setdefault(pair, array("q"))
            own.extend([recorded_ns] * (len(path) - len(own)))

    def of(self, pair: tuple[str, str]) -> Stamps:
        return np.asarray(self._times[pair])


def read_bag_streams(
    path: Path, left_out: frozenset[str] = frozenset(), options: SweepOptions = NO_OPTIONS
) -> RecordingStreams:
    """Return the streams of a bag without some topics; raises BadData if it cannot be read.

    ``options``: how the user reads the scans; its fields are those of LaserScan messages.
    """
    taken: dict[str, _TopicContent] = {}
    tree, tf_recorded_ns, lost = Contents(), _RecordedTimes(), MessageDamage()
    with bag_file.open_bag(path) as reader:
        tree.tree.near_ns, tree.tree.odometry_parents = int(reader.start_time), frozenset({ODOMETRY_FRAME})
        seconds = max((reader.end_time - reader.start_time) * 1e-9, 0.0)
        topics = [
            Topic(name, str(about.msgtype), int(about.msgcount), _message_rate_hz(int(about.msgcount), seconds))
            for name, about in sorted(reader.topics.items())
        ]
        unusual, damage = _find_unusual_sweeps(reader), bag_file.find_damage(reader)
        has_laser = any(one.msgtype in rosbag_parser.LASER and one.msgcount for one in reader.connections)
        kinds = WANTED - {CLOUD} if has_laser else WANTED
        wanted = [one for one in reader.connections if one.msgtype in kinds or one.topic in unusual]
        wanted = [one for one in wanted if one.topic not in left_out]
        listed = sum(one.msgcount for one in wanted)
        for connection, message, recorded_ns in bag_file.iter_messages(reader, wanted, lost):
            if connection.msgtype in rosbag_parser.TRANSFORMS:
                rosbag_parser.add_transforms(tree, message, connection.topic.endswith("tf_static"))
                tf_recorded_ns.note(tree.tree, recorded_ns)
                continue
            fields = options.fields if connection.msgtype == LASER_SCAN else unusual.get(connection.topic)
            own = taken.get(connection.topic)
            if own is None:
                own = taken[connection.topic] = _TopicContent(connection.msgtype, replace(options, fields=fields))
            _take_message(own, connection.topic, message, recorded_ns)
    wheels = [
        _make_odometry_stream(own)
        for own in taken.values()
        if own.kind == rosbag_parser.ODOMETRY and own.contents.odometry
    ]
    return RecordingStreams(
        path,
        "ROS 1 bag" if path.suffix == ".bag" else "ROS 2 bag",
        "rosbag",
        topics,
        [
            _make_laser_stream(name, own, own.first, lost.damaged[name])
            for name, own in sorted(taken.items())
            if own.first is not None
        ],
        [*wheels, *_find_tf_odometry(tree.tree, tf_recorded_ns)],
        tree.tree,
        damaged=tree.damaged + sum(own.contents.damaged for own in taken.values()) + lost.damaged.total(),
        first_damage=lost.describe_first(),
        damage=damage,
        missing=max(listed - lost.taken.total(), 0),
        left_out=tuple(sorted(left_out)),
    )


def find_other_robots(streams: RecordingStreams, laser: str, odometry: str = "") -> frozenset[str]:
    """Return the topics with scans, odometry or transforms of other robots than that of a laser.

    ``odometry``: the topic that the user names, which is not left out.
    """
    kinds = (rosbag_parser.ODOMETRY, *rosbag_parser.TRANSFORMS)
    motions = [one.name for one in streams.topics if one.kind in kinds and one.count]
    return find_foreign_topics(laser, [one.topic for one in streams.lasers], motions, odometry)


def _find_unusual_sweeps(reader: Any) -> dict[str, MessageFields]:
    """Return the fields of messages of other types that look like sweeps, by topic, of a bag without usual ones."""
    if any(one.msgtype in (*rosbag_parser.LASER, CLOUD) and one.msgcount for one in reader.connections):
        return {}
    found: dict[str, MessageFields] = {}
    others: set[str] = set()  # types without a sweep: a bag may have very many topics, but has few types
    for connection in reader.connections:
        if connection.msgtype in WANTED | others or not connection.msgcount or len(found) == MAX_UNUSUAL:
            continue
        first = next(bag_file.iter_messages(reader, [connection], MessageDamage()), None)
        fields = None if first is None else guess_fields(first[1])
        if fields is None:
            others.add(connection.msgtype)
        else:
            found[connection.topic] = fields
    return found


def _message_rate_hz(count: int, seconds: float) -> float:
    return (count - 1) / seconds if count > 1 and seconds > 0.0 else float("nan")


def _take_message(own: _TopicContent, topic: str, message: Any, recorded_ns: int) -> None:
    if own.kind != rosbag_parser.ODOMETRY:
        sweep = rosbag_parser.read_sweep(own.contents, message, own.kind, recorded_ns, own.options)
        if sweep is not None:
            own.first = own.first or sweep
            own.scans.append(sweep.ranges)
            own.stamps_ns.append(sweep.stamp_ns)
            own.recorded_ns.append(recorded_ns)
        return
    if rosbag_parser.add_odometry(own.contents, topic, message, recorded_ns):
        own.recorded_ns.append(recorded_ns)
        own.twists.extend((float(message.twist.twist.linear.x), float(message.twist.twist.angular.z)))


def _make_laser_stream(topic: str, own: _TopicContent, first: Sweep, lost: int) -> LaserStream:
    return LaserStream(
        topic,
        own.kind.split("/")[-1],
        first.frame,
        np.asarray(own.stamps_ns),
        np.asarray(own.recorded_ns),
        own.scans,
        first.angles(),
        first.range_min_m,
        first.range_max_m,
        first.time_increment_ns,
        own.contents.damaged + lost,
        own.contents.unstamped,
        str(own.options.fields or ""),
    )


def _make_odometry_stream(own: _TopicContent) -> OdometryStream:
    """Return the odometry of a topic; if its messages change frames, only those with the first frames."""
    (topic, parent, child), samples = next(iter(own.contents.odometry.items()))
    whole = len(own.contents.odometry) == 1
    return OdometryStream(
        topic,
        parent,
        child,
        samples.stamps_ns,
        samples.poses,
        np.asarray(own.twists).reshape(-1, 2) if whole else None,
        np.asarray(own.recorded_ns) if whole else None,
    )


def _find_tf_odometry(tree: TransformTree, recorded: _RecordedTimes) -> list[OdometryStream]:
    """Return the odometry in tf: the moving children of its frame."""
    return [
        OdometryStream("tf", parent, child, path.stamps_ns, path.poses, recorded_ns=recorded.of((parent, child)))
        for (parent, child), path in sorted(tree.paths.items())
        if len(path) >= MIN_TF_POSES
    ]
