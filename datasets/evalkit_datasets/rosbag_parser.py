"""The messages of a ROS 1 or ROS 2 recording that matter here, as plain values: laser scans, odometry, transforms."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BadData, EvalkitError
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.timestamps import order_stamps
from evalkit_datasets.buffers import PoseBuffer
from evalkit_datasets.transforms import Transform, TransformTree, matrix_from_quaternion, planar_pose_from_matrix

LASER = ("sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan")
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FETCH_AGAIN = "record or fetch the bag again"

ENDINGS = (".bag", ".db3", ".mcap")

ODOMETRY_FRAME = "odom"

LONGEST_S = 3600.0
"""No sweep takes longer: a message that says so is damaged."""

COLUMNS = {"stamps_ns": "q", "durations_ns": "q", "messages": "i", "invalid": "i", "frames": "i"}
"""What is kept of every scan, and as which type: 28 bytes."""


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

    @property
    def duration_ns(self) -> int:
        """From the first beam to the last."""
        return self.time_increment_ns * (len(self.ranges) - 1)

    @property
    def near(self) -> Bools:
        """Which ranges (B,) are invalid: nan, zero, negative or under the minimum."""
        return np.asarray(~(self.ranges >= max(self.range_min_m, 1e-9)))


@dataclass(eq=False)
class Contents:
    """What was read of a bag's messages. ``odometry``: poses by (topic, parent, child).

    ``unstamped``: headers without a time. ``damaged``: laser messages whose geometry makes no sense, and transforms
    that are none.
    """

    odometry: dict[tuple[str, str, str], PoseBuffer] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    unstamped: int = 0
    damaged: int = 0


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of one topic in order of time, the first of equal times kept: what is known of each without its ranges.

    ``messages`` (N,): which of the topic's messages each is. ``invalid`` (N,): how many of its ranges are. ``frames``
    (N,): its frame's place among ``names``. ``backwards``, ``repeated``: how often the time went back or stood still.
    """

    topic: str
    stamps_ns: Stamps
    durations_ns: Ints
    messages: NDArray[np.int32]
    invalid: NDArray[np.int32]
    frames: NDArray[np.int32]
    names: tuple[str, ...]
    backwards: int
    repeated: int

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def chosen(self, which: slice) -> Scans:
        """Some of them."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[which],
            durations_ns=self.durations_ns[which],
            messages=self.messages[which],
            invalid=self.invalid[which],
            frames=self.frames[which],
        )

    @property
    def first_frame(self) -> str:
        """The frame of the first scan."""
        return self.names[int(self.frames[0])]


def read(path: Path, topic: str, which: slice) -> tuple[Scans, Contents]:
    """All scans of one laser topic ("": the only one), all odometry, and the transforms.

    Of transforms that move, those nearest to the first scan taken (``which``), and the whole way of what may be
    odometry. BadData names the known topics where the wanted one is absent, and says how a damaged bag can be mended.
    """
    with opened(path) as reader:
        topics = {name: (str(about.msgtype), int(about.msgcount)) for name, about in reader.topics.items()}
        contents = Contents()
        scans = _scans(reader, _laser_topic(path, topics, topic), contents)
        for connection, message, _ in _messages(reader, (ODOMETRY,)):
            take_odometry(contents, connection.topic, message)
        taken = scans.stamps_ns[which]
        contents.tree.near_ns = int(taken[0]) if len(taken) else 0
        contents.tree.followed = frozenset({ODOMETRY_FRAME, *(parent for _, parent, _ in contents.odometry)})
        for connection, message, _ in _messages(reader, TRANSFORMS):
            take_transforms(contents, message, connection.topic.endswith("tf_static"))
    return scans, contents


def sweeps(path: Path, scans: Scans) -> Iterator[tuple[int, Sweep]]:
    """The scans in the order of the file, each with its rank among ``scans``."""
    if not len(scans):
        return
    ranks = np.full(int(scans.messages.max()) + 1, -1, dtype=np.int64)
    ranks[scans.messages] = np.arange(len(scans))
    with opened(path) as reader:
        messages = _laser_messages(reader, scans.topic)
        for rank in ranks.tolist():
            message = next(messages, None)
            if rank >= 0:
                yield rank, _known(reader, message, int(scans.stamps_ns[rank]), path)


def _known(reader: Any, message: tuple[Any, int, bytes] | None, stamp_ns: int, path: Path) -> Sweep:
    """The sweep of a message that was a scan of this time when the bag was first read; BadData where it is none now."""
    if message is not None:
        connection, recorded_ns, raw = message
        sweep = _sweep(reader.deserialize(raw, connection.msgtype), connection.msgtype == LASER[1], int(recorded_ns))
        if sweep is not None and sweep.stamp_ns == stamp_ns:
            return sweep
    raise BadData(str(path), "", "the bag has changed since it was first read", "leave it alone while it is in use")


def _scans(reader: Any, topic: str, contents: Contents) -> Scans:
    """What is known of a topic's scans, its damaged messages counted in the contents."""
    columns = {name: array(kind) for name, kind in COLUMNS.items()}
    names: dict[str, int] = {}
    for number, (connection, recorded_ns, raw) in enumerate(_laser_messages(reader, topic)):
        message = reader.deserialize(raw, connection.msgtype)
        sweep = take_sweep(contents, message, connection.msgtype == LASER[1], int(recorded_ns))
        if sweep is not None:
            frame = names.setdefault(sweep.frame, len(names))
            row = sweep.stamp_ns, sweep.duration_ns, number, int(sweep.near.sum()), frame
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    found = {name: np.asarray(column) for name, column in columns.items()}
    order = order_stamps(found["stamps_ns"])
    in_order = not (order.backwards or order.repeated)
    kept = found if in_order else {name: column[order.keep] for name, column in found.items()}
    return Scans(topic, **kept, names=tuple(names), backwards=order.backwards, repeated=order.repeated)


def _laser_messages(reader: Any, topic: str) -> Iterator[tuple[Any, int, bytes]]:
    wanted = [one for one in reader.connections if one.topic == topic and one.msgtype in LASER]
    yield from reader.messages(connections=wanted)


def _messages(reader: Any, kinds: tuple[str, ...]) -> Iterator[tuple[Any, Any, int]]:
    """Connection, message and time of recording of all messages of some types."""
    wanted = [connection for connection in reader.connections if connection.msgtype in kinds]
    if wanted:  # the reader takes none for all
        for connection, recorded_ns, raw in reader.messages(connections=wanted):
            yield connection, reader.deserialize(raw, connection.msgtype), int(recorded_ns)


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


def take_sweep(contents: Contents, message: Any, echoes: bool, recorded_ns: int) -> Sweep | None:
    """A laser message as a sweep, or None, and counted as damaged."""
    contents.unstamped += _stamp(message.header) == 0
    sweep = _sweep(message, echoes, recorded_ns)
    contents.damaged += sweep is None
    return sweep


def _sweep(message: Any, echoes: bool, recorded_ns: int) -> Sweep | None:
    with np.errstate(invalid="ignore"):  # some nan patterns complain when they are widened
        ranges = _first_echoes(message.ranges) if echoes else np.asarray(message.ranges, dtype=np.float64)
    geometry = [message.angle_min, message.angle_increment, message.range_min, message.range_max]
    plausible = np.isfinite(geometry).all() and 0.0 <= geometry[2] < geometry[3] and geometry[1] != 0.0
    increment = float(message.time_increment)
    increment = increment if np.isfinite(increment) and increment > 0.0 else 0.0
    if len(ranges) < 2 or not plausible or increment * len(ranges) > LONGEST_S:
        return None
    return Sweep(
        _stamp(message.header) or int(recorded_ns),
        _name(message.header.frame_id),
        ranges,
        float(geometry[0]),
        float(geometry[1]),
        float(geometry[2]),
        float(geometry[3]),
        round(increment * 1e9),
    )


def _first_echoes(beams: Any) -> Floats:
    return np.array([beam.echoes[0] if len(beam.echoes) else np.inf for beam in beams], dtype=np.float64)


def take_odometry(contents: Contents, topic: str, message: Any) -> None:
    """Adds the pose of an odometry message, or counts it as damaged."""
    matrix = _matrix(contents, message.pose.pose.position, message.pose.pose.orientation)
    if matrix is not None:
        key = topic, _name(message.header.frame_id), _name(message.child_frame_id)
        contents.odometry.setdefault(key, PoseBuffer()).append(
            _stamp(message.header), planar_pose_from_matrix(matrix).row
        )


def take_transforms(contents: Contents, message: Any, static: bool) -> None:
    """Adds the transforms of a message to the tree; counts those that are none."""
    for said in message.transforms:
        matrix = _matrix(contents, said.transform.translation, said.transform.rotation)
        if matrix is not None:
            parent, child = _name(said.header.frame_id), _name(said.child_frame_id)
            contents.tree.add(Transform(_stamp(said.header), parent, child, matrix), static)


def _matrix(contents: Contents, position: Any, rotation: Any) -> Floats | None:
    try:
        return matrix_from_quaternion(
            (position.x, position.y, position.z), (rotation.x, rotation.y, rotation.z, rotation.w)
        )
    except ValueError:
        contents.damaged += 1
        return None


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def _name(frame: str) -> str:
    """A frame's name without the slash that ROS 1 may write before it."""
    return frame.lstrip("/")
