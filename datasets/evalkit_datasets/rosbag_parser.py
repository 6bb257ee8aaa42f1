"""Parse the laser scans, odometry and transforms of a ROS 1 or ROS 2 bag into plain values."""

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

SUFFIXES = (".bag", ".db3", ".mcap")

ODOMETRY_FRAME = "odom"

MAX_SWEEP_S = 3600.0
"""A message with a longer sweep is damaged."""

COLUMNS = {"stamps_ns": "q", "durations_ns": "q", "messages": "i", "invalid": "i", "frames": "i"}
"""Values kept of every scan and their array type codes: 28 bytes."""


@dataclass(frozen=True, slots=True, eq=False)
class Sweep:
    """One laser message as sent. Of several echoes of a beam the first, which is the nearest, is kept; none is inf."""

    stamp_ns: int
    frame: str
    ranges: Floats
    angle_min: float
    angle_increment: float
    range_min_m: float
    range_max_m: float
    time_increment_ns: int

    def angles(self) -> Floats:
        """Return the angles (B,) in firing order (rad)."""
        return np.asarray(self.angle_min + self.angle_increment * np.arange(len(self.ranges)), dtype=np.float64)

    @property
    def duration_ns(self) -> int:
        """Time from the first beam to the last."""
        return self.time_increment_ns * (len(self.ranges) - 1)

    @property
    def is_invalid(self) -> Bools:
        """Mask (B,) of invalid ranges: nan, zero, negative or below the minimum."""
        return np.asarray(~(self.ranges >= max(self.range_min_m, 1e-9)))


@dataclass(eq=False)
class Contents:
    """Odometry and transforms of a bag. ``odometry``: poses by (topic, parent, child).

    ``unstamped``: number of headers without a time. ``damaged``: number of laser messages with implausible geometry and
    of invalid transforms.
    """

    odometry: dict[tuple[str, str, str], PoseBuffer] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    unstamped: int = 0
    damaged: int = 0


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans of one topic without their ranges, in order of time; of scans with equal stamps the first is kept.

    ``messages`` (N,): index of each scan among the topic's messages. ``invalid`` (N,): number of invalid ranges.
    ``frames`` (N,): index of its frame in ``names``. ``backwards``, ``repeated``: how often the stamp decreased or
    was repeated.
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

    def select(self, which: slice) -> Scans:
        """Return a slice of the scans."""
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
        """Frame of the first scan."""
        return self.names[int(self.frames[0])]


def read_bag(path: Path, topic: str, which: slice) -> tuple[Scans, Contents]:
    """Return all scans of one laser topic ("": the only one), all odometry and the transforms.

    Of moving transforms those nearest to the first scan taken (``which``) are kept, and all that may be odometry.
    Raises BadData if the topic is absent (with the known topics) or the bag is damaged (with how to repair it).
    """
    with open_bag(path) as reader:
        topics = {name: (str(about.msgtype), int(about.msgcount)) for name, about in reader.topics.items()}
        contents = Contents()
        scans = _read_scans(reader, _select_laser_topic(path, topics, topic), contents)
        for connection, message, _ in iter_messages(reader, (ODOMETRY,)):
            add_odometry(contents, connection.topic, message)
        taken = scans.stamps_ns[which]
        contents.tree.near_ns = int(taken[0]) if len(taken) else 0
        contents.tree.odometry_parents = frozenset({ODOMETRY_FRAME, *(parent for _, parent, _ in contents.odometry)})
        for connection, message, _ in iter_messages(reader, TRANSFORMS):
            add_transforms(contents, message, connection.topic.endswith("tf_static"))
    return scans, contents


def iter_sweeps(path: Path, scans: Scans) -> Iterator[tuple[int, Sweep]]:
    """Yield the scans in file order, each with its index in ``scans``; raises BadData if the bag has changed."""
    if not len(scans):
        return
    ranks = np.full(int(scans.messages.max()) + 1, -1, dtype=np.int64)
    ranks[scans.messages] = np.arange(len(scans))
    with open_bag(path) as reader:
        messages = _iter_laser_messages(reader, scans.topic)
        for rank in ranks.tolist():
            message = next(messages, None)
            if rank >= 0:
                yield rank, _reread_sweep(reader, message, int(scans.stamps_ns[rank]), path)


def _reread_sweep(reader: Any, message: tuple[Any, int, bytes] | None, stamp_ns: int, path: Path) -> Sweep:
    """Return the sweep of a message; raises BadData if it is not a scan with the stamp of the first reading."""
    if message is not None:
        connection, recorded_ns, raw = message
        sweep = _parse_sweep(
            reader.deserialize(raw, connection.msgtype), connection.msgtype == LASER[1], int(recorded_ns)
        )
        if sweep is not None and sweep.stamp_ns == stamp_ns:
            return sweep
    raise BadData(str(path), "", "the bag has changed since it was first read", "do not modify it during a run")


def _read_scans(reader: Any, topic: str, contents: Contents) -> Scans:
    """Return the scans of a topic; damaged messages are counted in ``contents``."""
    columns = {name: array(kind) for name, kind in COLUMNS.items()}
    names: dict[str, int] = {}
    for number, (connection, recorded_ns, raw) in enumerate(_iter_laser_messages(reader, topic)):
        message = reader.deserialize(raw, connection.msgtype)
        sweep = read_sweep(contents, message, connection.msgtype == LASER[1], int(recorded_ns))
        if sweep is not None:
            frame = names.setdefault(sweep.frame, len(names))
            row = sweep.stamp_ns, sweep.duration_ns, number, int(sweep.is_invalid.sum()), frame
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    order = order_stamps(arrays["stamps_ns"])
    in_order = not (order.backwards or order.repeated)
    kept = arrays if in_order else {name: column[order.keep] for name, column in arrays.items()}
    return Scans(topic, **kept, names=tuple(names), backwards=order.backwards, repeated=order.repeated)


def _iter_laser_messages(reader: Any, topic: str) -> Iterator[tuple[Any, int, bytes]]:
    wanted = [one for one in reader.connections if one.topic == topic and one.msgtype in LASER]
    yield from reader.messages(connections=wanted)


def iter_messages(reader: Any, kinds: tuple[str, ...]) -> Iterator[tuple[Any, Any, int]]:
    """Yield connection, message and time of recording of all messages of given types."""
    wanted = [connection for connection in reader.connections if connection.msgtype in kinds]
    if wanted:  # the reader treats an empty list as all
        for connection, recorded_ns, raw in reader.messages(connections=wanted):
            yield connection, reader.deserialize(raw, connection.msgtype), int(recorded_ns)


def _find_bag(path: Path) -> Path:
    """Return the path to open: the folder, for a .db3 or .mcap file of a ROS 2 bag with metadata."""
    if path.is_file() and path.suffix in {".db3", ".mcap"} and (path.parent / "metadata.yaml").is_file():
        return path.parent
    return path


@contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """Open a bag for reading; raises BadData for every error of the reader, also inside the ``with`` block."""
    from rosbags.highlevel import AnyReader  # noqa: PLC0415 - heavy, and used for bags only
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    _check_path(path)
    try:
        # bags recorded before Iron contain no type definitions: use those of Humble
        with AnyReader([_find_bag(path)], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            yield reader
    except EvalkitError:
        raise
    except Exception as error:  # a damaged binary file can raise any exception
        cause = " ".join(str(error).split()) or type(error).__name__
        raise BadData(str(path), "", f"not a readable bag ({cause[:160]})", _suggest_repair(path)) from error


def _check_path(path: Path) -> None:
    """Raise BadData for a path that cannot be a bag, with a clearer message than the library's."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        files = sorted(str(file) for file in path.iterdir() if file.suffix in SUFFIXES)
        remedy = f"give one of {', '.join(files)}" if files else "give the folder of a ROS 2 bag, or its file"
        raise BadData(str(path), "", "a folder without metadata.yaml", remedy)
    if path.is_file() and path.suffix not in SUFFIXES:
        raise BadData(str(path), "", f"'{path.suffix}' is not the suffix of a bag", "give a .bag, .db3 or .mcap file")
    if path.is_file() and path.stat().st_size == 0:
        raise BadData(str(path), "", "the file is empty", FETCH_AGAIN)


def _suggest_repair(path: Path) -> str:
    return f"{FETCH_AGAIN}, or try 'rosbag reindex'" if path.suffix == ".bag" else FETCH_AGAIN


def _select_laser_topic(path: Path, topics: dict[str, tuple[str, int]], wanted: str) -> str:
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


def read_sweep(contents: Contents, message: Any, echoes: bool, recorded_ns: int) -> Sweep | None:
    """Return a laser message as a sweep, or None if it is damaged, which is counted in ``contents``."""
    contents.unstamped += parse_stamp_ns(message.header) == 0
    sweep = _parse_sweep(message, echoes, recorded_ns)
    contents.damaged += sweep is None
    return sweep


def _parse_sweep(message: Any, echoes: bool, recorded_ns: int) -> Sweep | None:
    with np.errstate(invalid="ignore"):  # widening some nan patterns raises a warning
        ranges = _select_first_echoes(message.ranges) if echoes else np.asarray(message.ranges, dtype=np.float64)
    geometry = [message.angle_min, message.angle_increment, message.range_min, message.range_max]
    plausible = np.isfinite(geometry).all() and 0.0 <= geometry[2] < geometry[3] and geometry[1] != 0.0
    increment = float(message.time_increment)
    increment = increment if np.isfinite(increment) and increment > 0.0 else 0.0
    if len(ranges) < 2 or not plausible or increment * len(ranges) > MAX_SWEEP_S:
        return None
    return Sweep(
        parse_stamp_ns(message.header) or int(recorded_ns),
        normalise_frame(message.header.frame_id),
        ranges,
        float(geometry[0]),
        float(geometry[1]),
        float(geometry[2]),
        float(geometry[3]),
        round(increment * 1e9),
    )


def _select_first_echoes(beams: Any) -> Floats:
    return np.array([beam.echoes[0] if len(beam.echoes) else np.inf for beam in beams], dtype=np.float64)


def add_odometry(contents: Contents, topic: str, message: Any) -> None:
    """Add the pose of an odometry message to ``contents``, or count it as damaged."""
    matrix = _parse_matrix(contents, message.pose.pose.position, message.pose.pose.orientation)
    if matrix is not None:
        key = topic, normalise_frame(message.header.frame_id), normalise_frame(message.child_frame_id)
        contents.odometry.setdefault(key, PoseBuffer()).append(
            parse_stamp_ns(message.header), planar_pose_from_matrix(matrix).row
        )


def add_transforms(contents: Contents, message: Any, static: bool) -> None:
    """Add the transforms of a message to the tree; invalid ones are counted as damaged."""
    for stamped in message.transforms:
        matrix = _parse_matrix(contents, stamped.transform.translation, stamped.transform.rotation)
        if matrix is not None:
            parent, child = normalise_frame(stamped.header.frame_id), normalise_frame(stamped.child_frame_id)
            contents.tree.add(Transform(parse_stamp_ns(stamped.header), parent, child, matrix), static)


def _parse_matrix(contents: Contents, position: Any, rotation: Any) -> Floats | None:
    try:
        return matrix_from_quaternion(
            (position.x, position.y, position.z), (rotation.x, rotation.y, rotation.z, rotation.w)
        )
    except ValueError:
        contents.damaged += 1
        return None


def parse_stamp_ns(header: Any) -> int:
    """Return the time of a header in ns."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def normalise_frame(frame: str) -> str:
    """Return the name of a frame without the leading slash that ROS 1 may write."""
    return frame.lstrip("/")
