"""Runs as ROS 2 bags in MCAP, which Foxglove, RViz and `ros2 bag play` open: scans, poses, paths, odometry, the map."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.commands.export.poses import world_poses
from evalkit.core.errors import BadData
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps
from evalkit.plugins.protocols import Sequence as Recording
from evalkit.results.run_record import RunRecord

WORLD, BASE, TRUTH, LASER = "world", "base_link", "truth", "laser"
EARLIEST_NS = 10**9
"""ROS takes time 0 for no time: a recording that begins before one second is moved to begin there."""

UNEVEN_RAD = 1e-3

TYPES = {
    "/scan": "sensor_msgs/msg/LaserScan",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/estimate": "nav_msgs/msg/Path",
    "/truth": "nav_msgs/msg/Path",
    "/map": "nav_msgs/msg/OccupancyGrid",
}

KEPT = {"/tf_static", "/estimate", "/truth", "/map"}
"""Sent once: `ros2 bag play` offers these to late comers too, as RViz asks of the static transform and the map."""

Sent = tuple[int, str, Any]
"""When (ns), on which topic, what."""


def write(folder: Path, record: RunRecord, recording: Recording) -> Path:
    """The folder of a bag (metadata.yaml and one .mcap) of one run; an old one of that name is replaced.

    Frames: world_from_base_link is the answer, world_from_truth the truth; /scan is in the lidar's frame.
    """
    maker = Messages()
    path = folder / record.key
    shutil.rmtree(path, ignore_errors=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bag(path, maker, _sent(maker, record, recording))
    return path


def write_bag(path: Path, maker: Messages, messages: Iterable[Sent]) -> None:
    """The folder of a ROS 2 bag, which must not exist yet, with the messages in the order of time."""
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415 - only who exports pays for it

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for stamp, topic, message in sorted(messages, key=lambda sent: sent[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, TYPES[topic], typestore=maker.store, offered_qos_profiles=_offered(topic)
                )
            writer.write(connections[topic], stamp, maker.store.serialize_cdr(message, TYPES[topic]))


def _offered(topic: str) -> list[Any]:
    """The quality of service of a topic: reliable, and kept for late comers where it is sent once."""
    from rosbags import interfaces as ros  # noqa: PLC0415 - as above

    forever = ros.QosTime(9223372036, 854775807)  # as rosbag2 writes it
    durability = ros.QosDurability.TRANSIENT_LOCAL if topic in KEPT else ros.QosDurability.VOLATILE
    return [
        ros.Qos(ros.QosHistory.KEEP_LAST, 10, ros.QosReliability.RELIABLE, durability, forever, forever,
                ros.QosLiveliness.AUTOMATIC, forever, False)
    ]  # fmt: skip


def _sent(maker: Messages, record: RunRecord, recording: Recording) -> Iterator[Sent]:
    stamps, poses = world_poses(record)
    shift = max(EARLIEST_NS - int(stamps[0]), 0)
    begin = int(stamps[0]) + shift
    yield begin, "/estimate", maker.path(stamps + shift, poses)
    if record.scores.grid is not None:
        yield begin, "/map", maker.grid(begin, record.scores.grid)
    true = record.truth.trajectory
    if true is not None and len(true):
        yield begin, "/truth", maker.path(true.stamps_ns + shift, true.poses)
        reached = stamps[(stamps >= true.stamps_ns[0]) & (stamps <= true.stamps_ns[-1])]
        for stamp, row in zip(reached.tolist(), true.at(reached), strict=True):
            yield stamp + shift, "/tf", maker.transform(stamp + shift, WORLD, TRUTH, Pose.of(row))
    for stamp, row in zip(stamps.tolist(), poses, strict=True):
        yield stamp + shift, "/tf", maker.transform(stamp + shift, WORLD, BASE, Pose.of(row))
    yield from recorded(maker, recording, shift, begin)


def recorded(maker: Messages, recording: Recording, shift: int, begin: int) -> Iterator[Sent]:
    """What was recorded: scans, wheel odometry and the lidar's place, ``shift`` ns later, the place by ``begin``."""
    seat = None
    for frame in recording.frames():
        stamp = frame.scan.stamp_ns + shift
        if frame.base_from_sensor != seat:
            seat = frame.base_from_sensor
            yield min(stamp, begin), "/tf_static", maker.transform(stamp, BASE, LASER, seat)
        yield stamp, "/scan", maker.scan(stamp, frame.scan)
        if frame.odom_from_base is not None:
            yield stamp, "/odom", maker.odometry(stamp, frame)


class Messages:
    """Makes ROS 2 messages."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 - as above

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        if TYPES["/tf"] not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TYPES["/tf"]))

    def scan(self, stamp: int, scan: Scan) -> Any:
        """A LaserScan; BadData where its beams are not evenly spaced, which the message cannot say."""
        steps = np.diff(scan.angles)
        step = float(np.mean(steps))
        if np.abs(scan.angles - (scan.angles[0] + step * np.arange(len(scan.angles)))).max() > UNEVEN_RAD:
            what = "its beams are not evenly spaced, which sensor_msgs/LaserScan cannot say"
            raise BadData(f"scan at {scan.stamp_ns} ns", "", what, "export it in format rerun")
        nothing = np.zeros(0, dtype=np.float32)
        return self._make(
            "sensor_msgs/msg/LaserScan", self._header(stamp, LASER),
            float(scan.angles[0]), float(scan.angles[-1]), step,
            scan.time_increment_ns * 1e-9, scan.duration_ns * 1e-9, scan.range_min_m, scan.range_max_m,
            scan.ranges.astype(np.float32), nothing,
        )  # fmt: skip

    def transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        """A TFMessage of one transform."""
        moved = self._make(
            "geometry_msgs/msg/Transform",
            self._make("geometry_msgs/msg/Vector3", pose.x, pose.y, 0.0),
            self._turn(pose.theta),
        )
        stamped = self._make("geometry_msgs/msg/TransformStamped", self._header(stamp, parent), child, moved)
        return self._make("tf2_msgs/msg/TFMessage", [stamped])

    def odometry(self, stamp: int, frame: Frame) -> Any:
        """The wheel odometry the back ends were given; speeds are not told and stay 0."""
        none = self._make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self._make("geometry_msgs/msg/Twist", none, none)
        return self._make(
            "nav_msgs/msg/Odometry",
            self._header(stamp, "odom"),
            BASE,
            self._make(
                "geometry_msgs/msg/PoseWithCovariance", self._pose(frame.odom_from_base or Pose()), np.zeros(36)
            ),
            self._make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        )

    def path(self, stamps: Stamps, poses: Floats) -> Any:
        """A Path in the world."""
        stamped = [
            self._make("geometry_msgs/msg/PoseStamped", self._header(stamp, WORLD), self._pose(Pose.of(row)))
            for stamp, row in zip(stamps.tolist(), poses, strict=True)
        ]
        return self._make("nav_msgs/msg/Path", self._header(int(stamps[0]), WORLD), stamped)

    def grid(self, stamp: int, grid: OccupancyGrid) -> Any:
        """An OccupancyGrid: per cent of occupancy, -1 where nothing was seen."""
        cells = np.where(grid.observed, np.round(100.0 * grid.probability()), -1.0).astype(np.int8)
        rows, columns = grid.shape
        about = self._make(
            "nav_msgs/msg/MapMetaData", self._time(stamp), grid.resolution_m, columns, rows,
            self._pose(Pose(grid.origin_x, grid.origin_y)),
        )  # fmt: skip
        return self._make("nav_msgs/msg/OccupancyGrid", self._header(stamp, WORLD), about, cells.ravel())

    def _make(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def _time(self, stamp: int) -> Any:
        return self._make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)

    def _header(self, stamp: int, frame: str) -> Any:
        return self._make("std_msgs/msg/Header", self._time(stamp), frame)

    def _pose(self, pose: Pose) -> Any:
        point = self._make("geometry_msgs/msg/Point", pose.x, pose.y, 0.0)
        return self._make("geometry_msgs/msg/Pose", point, self._turn(pose.theta))

    def _turn(self, theta: float) -> Any:
        return self._make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
