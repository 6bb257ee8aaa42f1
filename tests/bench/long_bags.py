"""Bags of any length, written scan by scan: laps of the synthetic lab, with few beams, and wheel odometry."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit_datasets.worlds import floorplans
from evalkit_datasets.worlds.lidar import LidarModel
from evalkit_datasets.worlds.robot import RouteDrive, WheelOdometryModel
from evalkit_datasets.worlds.synthetic import LAB, Synthetic

KINDS = ("sqlite3", "mcap", "ros1")
RATE_HZ = 10.0
SPEED_MPS = 0.3
BEGUN_NS = 1_700_000_000 * 10**9  # a header without a time is a different case


def drive(scans: int, beams: int) -> Synthetic:
    """Return at least the given number of scans (at most two more) of a lidar with few beams, at 10 Hz."""
    plan = floorplans.load_plan("lab")
    laps = scans / RATE_HZ * SPEED_MPS / plan.route.length_m
    sensor = LAB.make(laps=0.02).base_from_sensor
    lidar = LidarModel(RATE_HZ, samples_per_s=round(beams * RATE_HZ))
    return Synthetic(plan, RouteDrive(plan.route, SPEED_MPS, laps), lidar, WheelOdometryModel(), sensor)


def write(folder: Path, kind: str, scans: int, beams: int = 90) -> Path:
    """Write a bag with /scan, /odom and one transform in /tf_static; keeps only a few messages in memory."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    one = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    if "tf2_msgs/msg/TFMessage" not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    path = folder / f"{kind}-{scans}{'.bag' if one else ''}"
    writer: Any = (
        rosbag1.Writer(path)
        if one
        else rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[kind.upper()])
    )
    serialize = store.serialize_ros1 if one else store.serialize_cdr
    messages = _Messages(store.types, one)
    sequence = drive(scans, beams)
    with writer:
        topics = {
            name: (writer.add_connection(name, kind_of, typestore=store), kind_of)
            for name, kind_of in (
                ("/scan", "sensor_msgs/msg/LaserScan"),
                ("/odom", "nav_msgs/msg/Odometry"),
                ("/tf_static", "tf2_msgs/msg/TFMessage"),
            )
        }

        def put(topic: str, stamp_ns: int, message: Any) -> None:
            connection, kind_of = topics[topic]
            writer.write(connection, stamp_ns, serialize(message, kind_of))

        put("/tf_static", BEGUN_NS, messages.mounting(sequence.base_from_sensor.row))
        for frame in sequence.frames():
            stamp_ns = BEGUN_NS + frame.scan.stamp_ns
            if frame.odom_from_base is not None:
                put("/odom", stamp_ns, messages.odometry(stamp_ns, frame.odom_from_base.row))
            put("/scan", stamp_ns, messages.scan(stamp_ns, frame.scan))
    return path


class _Messages:
    """ROS messages of either version."""

    def __init__(self, types: Any, one: bool) -> None:
        self._types, self._one = types, one
        self._nothing = np.zeros(36)

    def _made(self, name: str, *values: Any, **named: Any) -> Any:
        return self._types[name](*values, **named)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        time = self._made("builtin_interfaces/msg/Time", stamp_ns // 10**9, stamp_ns % 10**9)
        return self._made(
            "std_msgs/msg/Header", **({"seq": 0} if self._one else {}), stamp=time, frame_id=frame
        )  # fmt: skip

    def _turn(self, theta: float) -> Any:
        return self._made("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(theta / 2), math.cos(theta / 2))

    def scan(self, stamp_ns: int, scan: Scan) -> Any:
        """Return a LaserScan."""
        ranges = scan.ranges.astype(np.float32)
        step = float(scan.angles[1] - scan.angles[0])
        header = self._header(stamp_ns, "laser")
        return self._made(
            "sensor_msgs/msg/LaserScan", header, float(scan.angles[0]), float(scan.angles[-1]), step,
            scan.time_increment_ns * 1e-9, 1.0 / RATE_HZ, scan.range_min_m, scan.range_max_m, ranges,
            np.zeros(0, np.float32),
        )  # fmt: skip

    def odometry(self, stamp_ns: int, row: Floats) -> Any:
        """Return an Odometry of base_link in odom."""
        zero = self._made("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        point = self._made("geometry_msgs/msg/Point", float(row[0]), float(row[1]), 0.0)
        pose = self._made("geometry_msgs/msg/Pose", point, self._turn(float(row[2])))
        twist = self._made("geometry_msgs/msg/Twist", zero, zero)
        return self._made(
            "nav_msgs/msg/Odometry", self._header(stamp_ns, "odom"), "base_link",
            self._made("geometry_msgs/msg/PoseWithCovariance", pose, self._nothing),
            self._made("geometry_msgs/msg/TwistWithCovariance", twist, self._nothing),
        )  # fmt: skip

    def mounting(self, row: Floats) -> Any:
        """Return the transform from base_link to the lidar."""
        place = self._made("geometry_msgs/msg/Vector3", float(row[0]), float(row[1]), 0.1)
        transform = self._made("geometry_msgs/msg/Transform", place, self._turn(float(row[2])))
        stamped = self._made(
            "geometry_msgs/msg/TransformStamped", self._header(0, "base_link"), "laser", transform
        )  # fmt: skip
        return self._made("tf2_msgs/msg/TFMessage", [stamped])
