"""The messages of a ROS 1 or ROS 2 recording that matter here, as plain values: laser scans, odometry, transforms."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.errors import BadData, EvalkitError
from evalkit.se2 import Floats
from evalkit_datasets.transforms import Edge, Tree, matrix_of, planar

LASER = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan")
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FETCH_AGAIN = "record or fetch the bag again"

ENDINGS = (".bag", ".db3", ".mcap")


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One laser message as sent. Of several echoes of a beam the first is kept: the nearest; none at all is inf."""

    stamp_ns: int
    frame: str
    ranges: Floats
    angle_min: float
    angle_increment: float
    range_min_m: float
    range_max_m: float
    time_increment_ns: int

    def angles(self) -> Floats:
        """The angles (B,) in the order the beams were fired (rad)."""
        return np.asarray(self.angle_min + self.angle_increment * np.arange(len(self.ranges)), dtype=np.float64)


@dataclass(eq=False)
class Contents:
    """What was read. ``odometry``: stamp, x, y, theta by (topic, parent, child). ``unstamped``: headers without a time.

    ``damaged``: laser messages whose geometry makes no sense, and transforms that are none.
    """

    topics: dict[str, tuple[str, int]]
    sweeps: list[Sweep] = field(default_factory=list)
    odometry: dict[tuple[str, str, str], list[tuple[int, Floats]]] = field(default_factory=dict)
    tree: Tree = field(default_factory=Tree)
    unstamped: int = 0
    damaged: int = 0


def read(path: Path, topic: str) -> Contents:
    """All sweeps of one laser topic ("": the only one), all odometry and all transforms.

    BadData names the known topics where the wanted one is absent, and says how a damaged bag can be mended.
    """
    with opened(path) as reader:
        topics = {name: (str(about.msgtype), int(about.msgcount)) for name, about in reader.topics.items()}
        contents = Contents(topics)
        laser = _laser_topic(path, topics, topic)
        wanted = [c for c in reader.connections if c.topic == laser or c.msgtype in {ODOMETRY, *TRANSFORMS}]
        for connection, recorded_ns, raw in reader.messages(connections=wanted):
            message = reader.deserialize(raw, connection.msgtype)
            _take(contents, connection.topic, connection.msgtype, message, int(recorded_ns))
    return contents


def bag_of(path: Path) -> Path:
    """What to open: a .db3 or .mcap file inside a ROS 2 bag means the bag, if its metadata is there."""
    if path.is_file() and path.suffix in {".db3", ".mcap"} and (path.parent / "metadata.yaml").is_file():
        return path.parent
    return path


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The open reader; whatever goes wrong inside becomes BadData."""
    from rosbags.highlevel import AnyReader  # noqa: PLC0415 - only recordings pay for it
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    _plausible(path)
    try:
        # Bags recorded before Iron carry no type definitions; Humble's are theirs.
        with AnyReader([bag_of(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except EvalkitError:
        raise
    except Exception as error:  # a reader of binary files meets damage in any way it likes
        what = " ".join(str(error).split()) or type(error).__name__
        raise BadData(str(path), "", f"not a readable bag ({what[:160]})", _remedy(path)) from error


def _plausible(path: Path) -> None:
    """Refuses what cannot be a bag, before a library says so less clearly."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        files = sorted(str(file) for file in path.iterdir() if file.suffix in ENDINGS)
        remedy = f"give one of {', '.join(files)}" if files else "give the folder of a ROS 2 bag, or its file"
        raise BadData(str(path), "", "a folder without metadata.yaml", remedy)
    if path.is_file() and path.suffix not in ENDINGS:
        raise BadData(str(path), "", f"no ending of a bag: '{path.suffix}'", "give a .bag, .db3 or .mcap file")
    if path.is_file() and path.stat().st_size == 0:
        raise BadData(str(path), "", "the file is empty", FETCH_AGAIN)


def _remedy(path: Path) -> str:
    return f"{FETCH_AGAIN}, or try 'rosbag reindex'" if path.suffix == ".bag" else FETCH_AGAIN


def _laser_topic(path: Path, topics: dict[str, tuple[str, int]], wanted: str) -> str:
    lasers = sorted(name for name, (kind, count) in topics.items() if kind in LASER and count)
    if wanted:
        match = next((name for name in lasers if name.lstrip("/") == wanted.lstrip("/")), None)
        if match is not None:
            return match
        problem = f"no laser scans on topic '{wanted}'"
    elif len(lasers) == 1:
        return lasers[0]
    else:
        problem = f"{len(lasers)} topics with laser scans"
    known = ", ".join(f"{name} ({kind.split('/')[-1]}, {count})" for name, (kind, count) in sorted(topics.items()))
    remedy = f"choose one with topic: {', '.join(lasers)}" if lasers else "give a bag with LaserScan messages"
    raise BadData(str(path), "", f"{problem}; topics: {known or 'none'}", remedy)


def _take(contents: Contents, topic: str, kind: str, message: Any, recorded_ns: int) -> None:
    if kind in LASER:
        take_sweep(contents, message, kind == LASER[1], recorded_ns)
    elif kind == ODOMETRY:
        take_odometry(contents, topic, message)
    else:
        take_transforms(contents, message, topic.endswith("tf_static"))


def take_sweep(contents: Contents, message: Any, echoes: bool, recorded_ns: int) -> None:
    """Adds a laser message to the sweeps, or counts it as damaged."""
    stamp = _stamp(message.header)
    contents.unstamped += stamp == 0
    with np.errstate(invalid="ignore"):  # some nan patterns complain when they are widened
        ranges = _first_echoes(message.ranges) if echoes else np.asarray(message.ranges, dtype=np.float64)
    geometry = [message.angle_min, message.angle_increment, message.range_min, message.range_max]
    plausible = np.isfinite(geometry).all() and 0.0 <= geometry[2] < geometry[3] and geometry[1] != 0.0
    if len(ranges) < 2 or not plausible:
        contents.damaged += 1
        return
    increment = float(message.time_increment)
    contents.sweeps.append(
        Sweep(
            stamp or recorded_ns,
            _name(message.header.frame_id),
            ranges,
            float(geometry[0]),
            float(geometry[1]),
            float(geometry[2]),
            float(geometry[3]),
            round(increment * 1e9) if np.isfinite(increment) and increment > 0.0 else 0,
        )
    )


def _first_echoes(beams: Any) -> Floats:
    return np.array([beam.echoes[0] if len(beam.echoes) else np.inf for beam in beams], dtype=np.float64)


def take_odometry(contents: Contents, topic: str, message: Any) -> None:
    """Adds the pose of an odometry message, or counts it as damaged."""
    matrix = _matrix(contents, message.pose.pose.position, message.pose.pose.orientation)
    if matrix is not None:
        key = topic, _name(message.header.frame_id), _name(message.child_frame_id)
        contents.odometry.setdefault(key, []).append((_stamp(message.header), planar(matrix).row))


def take_transforms(contents: Contents, message: Any, static: bool) -> None:
    """Adds the transforms of a message to the tree; counts those that are none."""
    for said in message.transforms:
        matrix = _matrix(contents, said.transform.translation, said.transform.rotation)
        if matrix is not None:
            parent, child = _name(said.header.frame_id), _name(said.child_frame_id)
            contents.tree.add(Edge(_stamp(said.header), parent, child, matrix), static)


def _matrix(contents: Contents, position: Any, rotation: Any) -> Floats | None:
    try:
        return matrix_of((position.x, position.y, position.z), (rotation.x, rotation.y, rotation.z, rotation.w))
    except ValueError:
        contents.damaged += 1
        return None


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _name(frame: str) -> str:
    """A frame's name without the slash that ROS 1 may write before it."""
    return frame.lstrip("/")
