"""Point clouds and messages of a stranger's type in valid ROS 1 bags, with damaged bytes: read, and inspected."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from bags import bag_tests
from bounds import check_call, folder

from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.readers.rosbag import RosBag

CLOUD, RANGES, POINTS = KINDS = ("sensor_msgs/msg/PointCloud2", "my_msgs/msg/Ranges", "my_msgs/msg/Points")
"""The first byte of an input selects one for the rest of it."""

FIELDS = {RANGES: "ranges=dist angles=angles_deg range_unit=mm angle_unit=deg",
          POINTS: "ranges=points.range angles=points.angle clockwise"}  # fmt: skip


@cache
def _bag():
    """Return a bag with one valid message of every kind, each on the topic of its kind."""
    tests = bag_tests()
    bag = tests.Bag("ros1")
    for text, name in (
        ("std_msgs/Header header\nfloat32[] angles_deg\nuint16[] dist", RANGES),
        ("float32 angle\nfloat32 range", "my_msgs/msg/Point"),
        ("my_msgs/Point[] points", POINTS),
    ):
        bag.store.register(tests.typesys.get_types_from_msg(text, name))
    names = [bag.make("sensor_msgs/msg/PointField", name, 4 * at, 7, 1) for at, name in enumerate("xyz")]
    packed = np.arange(12, dtype=np.float32).view(np.uint8)
    angles, dist = np.array([0.0, 90.0, 180.0], np.float32), np.array([1000, 2000, 3000], np.uint16)
    beams = [bag.make("my_msgs/msg/Point", 0.5 * k, 1.0 + k) for k in range(3)]
    bag.add(
        CLOUD, CLOUD, bag.make(CLOUD, bag.header(tests.T0, "a"), 1, 4, names, False, 12, 48, packed, True), tests.T0
    )
    bag.add(RANGES, RANGES, bag.make(RANGES, bag.header(tests.T0, "a"), angles, dist), tests.T0)
    return bag.add(POINTS, POINTS, bag.make(POINTS, beams), tests.T0)


def seeds() -> list[bytes]:
    """Return a message of every kind."""
    bag = _bag()
    return [bytes([number]) + bytes(bag.store.serialize_ros1(message, kind))
            for number, (_, kind, message, _) in enumerate(bag.messages)]  # fmt: skip


def swollen() -> list[bytes]:
    """Return a cloud of 10^9 points, one with a step of 0 bytes, 10^9 ranges, and lists of 20,000 points."""
    cloud, ranges, points = seeds()
    size = cloud.rindex((12).to_bytes(4, "little") + (48).to_bytes(4, "little"))
    wide = cloud.index((1).to_bytes(4, "little") + (4).to_bytes(4, "little"))
    lie = (10**9).to_bytes(4, "little")
    return [
        cloud[: wide + 4] + lie + cloud[wide + 8 :],
        cloud[: wide + 4] + lie + cloud[wide + 8 : size] + bytes(8) + cloud[size + 8 :],
        ranges[:-10] + lie + ranges[-6:],
        points[:1] + (20_000).to_bytes(4, "little") + points[5:13] * 20_000,
        points[:1] + lie + points[5:],
    ]


def read_input(data: bytes) -> None:
    """Read and inspect a bag with a valid message and the input behind it, of one kind."""
    kind = KINDS[data[0] % len(KINDS)] if data else CLOUD
    path = folder() / "sweeps.bag"
    path.unlink(missing_ok=True)
    bag = _bag()
    message, begin = next((message, stamp) for _, name, message, stamp in bag.messages if name == kind)
    with bag_tests().rosbag1.Writer(path) as writer:
        connection = writer.add_connection(f"/{kind}", kind, typestore=bag.store)
        writer.write(connection, begin, bag.store.serialize_ros1(message, kind))
        writer.write(connection, begin + 10**8, data[1:])
    check_call(lambda: _read(path, kind), len(data), path.name)


def _read(path: Path, kind: str) -> None:
    for _ in RosBag(str(path), f"/{kind}", fields=FIELDS.get(kind, "")).frames():
        pass
    inspect_recording(path)
