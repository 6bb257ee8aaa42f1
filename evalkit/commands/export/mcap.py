"""Export runs as ROS 2 bags in MCAP for Foxglove, RViz and `ros2 bag play`: scans, poses, paths, odometry, map."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.commands.export.poses import world_poses
from evalkit.core.errors import BadData
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.output_files import staging_folder
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.results.run_record import RunRecord

WORLD, BASE, TRUTH, LASER, ODOM = "world", "base_link", "truth", "laser", "odom"
MIN_STAMP_NS = 10**9
"""In ROS, time 0 means "no time": a sequence that begins before one second is shifted to begin there."""

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

LATCHED = {"/tf_static", "/estimate", "/truth", "/map"}
"""Topics with a single message, offered also to late subscribers, as RViz expects of the transform and the map."""

BagMessage = tuple[int, str, Any]
"""Stamp (ns), topic, message."""


def write_run(folder: Path, run: RunRecord, sequence: SensorSequence) -> Path:
    """Write the bag of one run (metadata.yaml and one .mcap) and return its folder; older files are replaced.

    Frames: world_from_base_link is the estimate, world_from_truth the ground truth, world_from_odom such that the wheel
    odometry begins at the estimate; /scan is in the lidar's frame.
    """
    builder = MessageBuilder()
    path = folder / run.key
    with staging_folder(path, folder) as place:
        write_bag(place, builder, _run_messages(builder, run, sequence))
    return path


def write_bag(path: Path, builder: MessageBuilder, messages: Iterable[BagMessage]) -> None:
    """Write a ROS 2 bag into a folder, which must not exist yet, with the messages sorted by time."""
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415 - loaded only to export

    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for stamp, topic, message in sorted(messages, key=lambda message: message[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, TYPES[topic], typestore=builder.store, offered_qos_profiles=_quality_of_service(topic)
                )
            writer.write(connections[topic], stamp, builder.store.serialize_cdr(message, TYPES[topic]))


def _quality_of_service(topic: str) -> list[Any]:
    """Return the quality of service of a topic: reliable, and transient local if latched."""
    from rosbags import interfaces as ros  # noqa: PLC0415 - as above

    forever = ros.QosTime(9223372036, 854775807)  # as rosbag2 writes it
    durability = ros.QosDurability.TRANSIENT_LOCAL if topic in LATCHED else ros.QosDurability.VOLATILE
    return [
        ros.Qos(ros.QosHistory.KEEP_LAST, 10, ros.QosReliability.RELIABLE, durability, forever, forever,
                ros.QosLiveliness.AUTOMATIC, forever, False)
    ]  # fmt: skip


def _run_messages(builder: MessageBuilder, run: RunRecord, sequence: SensorSequence) -> Iterator[BagMessage]:
    stamps, poses = world_poses(run)
    shift = max(MIN_STAMP_NS - int(stamps[0]), 0)
    begin = int(stamps[0]) + shift
    yield begin, "/estimate", builder.path(stamps + shift, poses)
    if run.scores.grid is not None:
        yield begin, "/map", builder.grid(begin, run.scores.grid)
    true = run.truth.trajectory
    if true is not None and len(true):
        yield begin, "/truth", builder.path(true.stamps_ns + shift, true.poses)
        covered = stamps[(stamps >= true.stamps_ns[0]) & (stamps <= true.stamps_ns[-1])]
        for stamp, row in zip(covered.tolist(), true.at(covered), strict=True):
            yield stamp + shift, "/tf", builder.transform(stamp + shift, WORLD, TRUTH, Pose.of(row))
    for stamp, row in zip(stamps.tolist(), poses, strict=True):
        yield stamp + shift, "/tf", builder.transform(stamp + shift, WORLD, BASE, Pose.of(row))
    answers = {stamp: Pose.of(row) for stamp, row in zip(stamps.tolist(), poses, strict=True)}
    yield from sequence_messages(builder, sequence, shift, begin, answers)


def sequence_messages(
    builder: MessageBuilder, sequence: SensorSequence, shift: int, begin: int, answers: Mapping[int, Pose] | None = None
) -> Iterator[BagMessage]:
    """Yield scans, wheel odometry and the lidar's mount, shifted by ``shift`` ns; the mount at latest at ``begin``.

    ``answers``: world_from_base by stamp; the first one of a frame with odometry states where that has its origin.
    """
    mount, waiting = None, answers or {}
    for frame in sequence.frames():
        stamp = frame.scan.stamp_ns + shift
        if frame.base_from_sensor != mount:
            mount = frame.base_from_sensor
            yield min(stamp, begin), "/tf_static", builder.transform(stamp, BASE, LASER, mount)
        yield stamp, "/scan", builder.scan(stamp, frame.scan)
        if frame.odom_from_base is None:
            continue
        yield stamp, "/odom", builder.odometry(stamp, frame)
        if (answer := waiting.get(frame.scan.stamp_ns)) is not None:
            origin = answer @ frame.odom_from_base.inverse()
            yield begin, "/tf_static", builder.transform(begin, WORLD, ODOM, origin)
            waiting = {}


class MessageBuilder:
    """Builds ROS 2 messages."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 - as above

        self.store = get_typestore(Stores.ROS2_HUMBLE)
        if TYPES["/tf"] not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TYPES["/tf"]))

    def scan(self, stamp: int, scan: Scan) -> Any:
        """Return a LaserScan. Raises BadData if the beams are not evenly spaced, which the message requires."""
        steps = np.diff(scan.angles)
        step = float(np.mean(steps))
        if np.abs(scan.angles - (scan.angles[0] + step * np.arange(len(scan.angles)))).max() > UNEVEN_RAD:
            what = "the beams are not evenly spaced, which sensor_msgs/LaserScan requires"
            raise BadData(f"scan at {scan.stamp_ns} ns", "", what, "export it in format rerun")
        nothing = np.zeros(0, dtype=np.float32)
        return self._build(
            "sensor_msgs/msg/LaserScan", self._header(stamp, LASER),
            float(scan.angles[0]), float(scan.angles[-1]), step,
            scan.time_increment_ns * 1e-9, scan.duration_ns * 1e-9, scan.range_min_m, scan.range_max_m,
            scan.ranges.astype(np.float32), nothing,
        )  # fmt: skip

    def transform(self, stamp: int, parent: str, child: str, pose: Pose) -> Any:
        """Return a TFMessage with one transform."""
        moved = self._build(
            "geometry_msgs/msg/Transform",
            self._build("geometry_msgs/msg/Vector3", pose.x, pose.y, 0.0),
            self._quaternion(pose.theta),
        )
        stamped = self._build("geometry_msgs/msg/TransformStamped", self._header(stamp, parent), child, moved)
        return self._build("tf2_msgs/msg/TFMessage", [stamped])

    def odometry(self, stamp: int, frame: Frame) -> Any:
        """Return the wheel odometry that the back ends received; its speeds are unknown and 0."""
        none = self._build("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self._build("geometry_msgs/msg/Twist", none, none)
        return self._build(
            "nav_msgs/msg/Odometry",
            self._header(stamp, ODOM),
            BASE,
            self._build(
                "geometry_msgs/msg/PoseWithCovariance", self._pose(frame.odom_from_base or Pose()), np.zeros(36)
            ),
            self._build("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36)),
        )

    def path(self, stamps: Stamps, poses: Floats) -> Any:
        """Return a Path in the world frame."""
        stamped = [
            self._build("geometry_msgs/msg/PoseStamped", self._header(stamp, WORLD), self._pose(Pose.of(row)))
            for stamp, row in zip(stamps.tolist(), poses, strict=True)
        ]
        return self._build("nav_msgs/msg/Path", self._header(int(stamps[0]), WORLD), stamped)

    def grid(self, stamp: int, grid: OccupancyGrid) -> Any:
        """Return an OccupancyGrid: occupancy in percent, -1 if not observed."""
        cells = np.where(grid.observed, np.round(100.0 * grid.probability()), -1.0).astype(np.int8)
        rows, columns = grid.shape
        about = self._build(
            "nav_msgs/msg/MapMetaData", self._time(stamp), grid.resolution_m, columns, rows,
            self._pose(Pose(grid.origin_x, grid.origin_y)),
        )  # fmt: skip
        return self._build("nav_msgs/msg/OccupancyGrid", self._header(stamp, WORLD), about, cells.ravel())

    def _build(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def _time(self, stamp: int) -> Any:
        return self._build("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)

    def _header(self, stamp: int, frame: str) -> Any:
        return self._build("std_msgs/msg/Header", self._time(stamp), frame)

    def _pose(self, pose: Pose) -> Any:
        point = self._build("geometry_msgs/msg/Point", pose.x, pose.y, 0.0)
        return self._build("geometry_msgs/msg/Pose", point, self._quaternion(pose.theta))

    def _quaternion(self, theta: float) -> Any:
        return self._build("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
