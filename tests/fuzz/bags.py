"""Small bags for the fuzz targets: valid ones, and valid ones with one message of arbitrary bytes."""

from __future__ import annotations

import importlib.util
import tempfile
from functools import cache
from pathlib import Path

from evalkit_datasets.readers.rosbag import RosBag

SUFFIXES = {"ros1": ".bag", "sqlite3": ".db3", "mcap": ".mcap"}
KINDS = tuple(SUFFIXES)


@cache
def bag_tests():
    """Return the test module of the bag reader, which makes bags."""
    path = Path(__file__).resolve().parent.parent / "datasets" / "readers" / "test_rosbag.py"
    spec = importlib.util.spec_from_file_location("bag_tests", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@cache
def _bag(kind: str):
    bag = bag_tests().Bag(kind)
    begin = bag_tests().T0
    for k in range(3):
        bag.scan(begin + k * 10**8, [1.0, 2.0, 3.0, 4.0, 5.0]).odom(begin + k * 10**8, 0.1 * k)
        bag.tf(begin + k * 10**8, "odom", "base_link", 0.1 * k, static=False)
    return bag.tf(begin, "base_link", "laser", 0.2)


@cache
def _with_echoes(kind: str):
    bag = bag_tests().Bag(kind)
    bag.store, bag.messages = _bag(kind).store, list(_bag(kind).messages)
    return bag.echoes(bag_tests().T0, [1.0, 2.0], [], [3.0])


@cache
def made(kind: str) -> bytes:
    """Return the file content of a valid bag."""
    with tempfile.TemporaryDirectory() as place:
        path = _bag(kind).write(Path(place))
        return (path if path.is_file() else next(path.glob(f"*{SUFFIXES[kind]}"))).read_bytes()


@cache
def messages(kind: str) -> list[bytes]:
    """Return serialised messages: LaserScan, Odometry, TFMessage twice, and MultiEchoLaserScan."""
    bag = _with_echoes(kind)
    serialize = bag.store.serialize_ros1 if kind == "ros1" else bag.store.serialize_cdr
    found = {topic: bytes(serialize(message, name)) for topic, name, message, _ in bag.messages}
    return [found[topic] for topic in ("/scan", "/odom", "/tf", "/tf_static", "/echoes")]


def written(path: Path, part: tuple[str, str], content: bytes) -> None:
    """Write a ROS 1 bag of valid messages and one message of given topic, type and bytes."""
    bag = _with_echoes("ros1")
    with bag_tests().rosbag1.Writer(path) as writer:
        connections = {}
        for topic, kind, message, recorded in bag.messages:
            if topic == "/echoes" and part[0] != topic:
                continue
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=bag.store)
            raw = content if (topic, kind) == part else bag.store.serialize_ros1(message, kind)
            writer.write(connections[topic], recorded, raw)


def frames_of(path: Path) -> None:
    """Read a bag to its last frame."""
    sequence = RosBag(str(path))
    for _ in sequence.frames():
        pass
    sequence.truth(), sequence.notes()
