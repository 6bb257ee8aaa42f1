"""Parse the laser scans, odometry and transforms of a ROS 1 or ROS 2 bag into plain values."""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Ints
from evalkit.core.errors import BadData, suggest
from evalkit.core.se2 import Floats, Stamps
from evalkit.io.timestamps import order_stamps
from evalkit_datasets.parsing import sweeps
from evalkit_datasets.parsing.bag_file import (
    FETCH_AGAIN,
    BagDamage,
    MessageDamage,
    find_damage,
    iter_messages,
    open_bag,
)
from evalkit_datasets.parsing.buffers import PoseBuffer
from evalkit_datasets.parsing.robots import find_foreign_topics
from evalkit_datasets.parsing.sweeps import Sweep, SweepOptions, normalise_frame, parse_stamp_ns
from evalkit_datasets.parsing.transforms import (
    Transform,
    TransformTree,
    matrix_from_quaternion,
    planar_pose_from_matrix,
)

LASER = (sweeps.LASER_SCAN, sweeps.ECHOES)
ODOMETRY = "nav_msgs/msg/Odometry"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY_FRAME = "odom"

MAX_LISTED = 40
"""Topics named in a message."""

NO_LASER = (
    "give a bag with LaserScan messages or point clouds (PointCloud2), or name topic and fields of other messages: "
    "--set topic=/scan --set 'fields=ranges=distances angles=angles angle_unit=deg'"
)

COLUMNS = {"stamps_ns": "q", "durations_ns": "q", "messages": "i", "invalid": "i", "frames": "i"}
"""Values kept of every scan and their array type codes: 28 bytes."""


@dataclass(eq=False)
class Contents:
    """Odometry and transforms of a bag. ``odometry``: poses by (topic, parent, child).

    ``damage``: None for a bag with its index; else its records were read up to the damage.

    ``unstamped``: number of headers without a time. ``damaged``: number of laser messages with implausible geometry and
    of invalid transforms. ``missing``: number of laser messages that the index lists, and that are not in the bag.
    ``messages``: messages that cannot be decoded.
    """

    odometry: dict[tuple[str, str, str], PoseBuffer] = field(default_factory=dict)
    tree: TransformTree = field(default_factory=TransformTree)
    unstamped: int = 0
    damaged: int = 0
    missing: int = 0
    damage: BagDamage | None = None
    messages: MessageDamage = field(default_factory=MessageDamage)


@dataclass(frozen=True, eq=False)
class BagScans:
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

    def select(self, which: slice) -> BagScans:
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


def read_bag(
    path: Path, topic: str, which: slice, options: SweepOptions, odometry: str = ""
) -> tuple[BagScans, Contents]:
    """Return all scans of one laser topic ("": the only one), odometry and transforms of its robot.

    ``odometry``: the topic that the user names, which is read whatever robot it is of.

    Of moving transforms those nearest to the first scan taken (``which``) are kept, and all that may be odometry.
    Raises BadData if the topic is absent (with the known topics) or the bag is damaged (with how to repair it).
    """
    with open_bag(path) as reader:
        topics = {name: (str(about.msgtype), int(about.msgcount)) for name, about in reader.topics.items()}
        contents = Contents(damage=find_damage(reader))
        laser = _select_laser_topic(path, topics, topic, options, contents.damage)
        scans = _read_scans(reader, laser, contents, options)
        foreign = find_foreign_topics(laser, *_list_topics(topics, options), odometry)
        own = [one for one in reader.connections if one.topic not in foreign]
        wheels = [one for one in own if one.msgtype == ODOMETRY]
        for connection, message, recorded_ns in iter_messages(reader, wheels, contents.messages):
            add_odometry(contents, connection.topic, message, recorded_ns)
        taken = scans.stamps_ns[which]
        contents.tree.near_ns = int(taken[0]) if len(taken) else 0
        contents.tree.odometry_parents = frozenset({ODOMETRY_FRAME, *(parent for _, parent, _ in contents.odometry)})
        transforms = [one for one in own if one.msgtype in TRANSFORMS]
        for connection, message, _ in iter_messages(reader, transforms, contents.messages):
            add_transforms(contents, message, connection.topic.endswith("tf_static"))
    contents.messages.check_share(path)
    return scans, contents


def _list_topics(topics: dict[str, tuple[str, int]], options: SweepOptions) -> tuple[list[str], list[str]]:
    """Return the topics with sweeps, and those with odometry or transforms."""
    filled = {name: kind for name, (kind, count) in topics.items() if count}
    motions = [name for name, kind in filled.items() if kind in (ODOMETRY, *TRANSFORMS)]
    return [name for name, kind in filled.items() if name not in motions and _holds_sweeps(kind, options)], motions


def iter_sweeps(path: Path, scans: BagScans, options: SweepOptions) -> Iterator[tuple[int, Sweep]]:
    """Yield the scans in file order, each with its index in ``scans``; raises BadData if the bag has changed."""
    if not len(scans):
        return
    ranks = np.full(int(scans.messages.max()) + 1, -1, dtype=np.int64)
    ranks[scans.messages] = np.arange(len(scans))
    damage = MessageDamage()
    with open_bag(path) as reader:
        messages = reader.messages(connections=_find_laser_connections(reader, scans.topic, options))
        for rank in ranks.tolist():
            message = next(messages, None)
            if rank >= 0:
                yield rank, _reread_sweep(reader, message, int(scans.stamps_ns[rank]), path, options, damage)


def _reread_sweep(
    reader: Any,
    message: tuple[Any, int, bytes] | None,
    stamp_ns: int,
    path: Path,
    options: SweepOptions,
    damage: MessageDamage,
) -> Sweep:
    """Return the sweep of a message; raises BadData if it is not a scan with the stamp of the first reading."""
    if message is not None:
        connection, recorded_ns, raw = message
        decoded, kind = damage.decode(reader, connection, recorded_ns, raw), connection.msgtype
        sweep = None if decoded is None else sweeps.parse_sweep(decoded, kind, int(recorded_ns), options)
        if sweep is not None and sweep.stamp_ns == stamp_ns:
            return sweep
    raise BadData(str(path), "", "the bag has changed since it was first read", "do not modify it during a run")


def _read_scans(reader: Any, topic: str, contents: Contents, options: SweepOptions) -> BagScans:
    """Return the scans of a topic; messages that are damaged, or missing, are counted in ``contents``."""
    columns = {name: array(kind) for name, kind in COLUMNS.items()}
    names: dict[str, int] = {}
    connections, taken = _find_laser_connections(reader, topic, options), contents.messages.taken
    for connection, message, recorded_ns in iter_messages(reader, connections, contents.messages):
        sweep = read_sweep(contents, message, connection.msgtype, recorded_ns, options)
        if sweep is not None:
            frame = names.setdefault(sweep.frame, len(names))
            row = sweep.stamp_ns, sweep.duration_ns, taken[topic] - 1, int(sweep.is_invalid.sum()), frame
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    contents.missing = max(sum(one.msgcount for one in connections) - taken[topic], 0)
    arrays = {name: np.asarray(column) for name, column in columns.items()}
    order = order_stamps(arrays["stamps_ns"])
    in_order = not (order.backwards or order.repeated)
    kept = arrays if in_order else {name: column[order.keep] for name, column in arrays.items()}
    return BagScans(topic, **kept, names=tuple(names), backwards=order.backwards, repeated=order.repeated)


def _find_laser_connections(reader: Any, topic: str, options: SweepOptions) -> list[Any]:
    return [one for one in reader.connections if one.topic == topic and _holds_sweeps(one.msgtype, options)]


def _holds_sweeps(kind: str, options: SweepOptions) -> bool:
    return kind in (*LASER, sweeps.CLOUD) or options.fields is not None


def _select_laser_topic(
    path: Path, topics: dict[str, tuple[str, int]], wanted: str, options: SweepOptions, damage: BagDamage | None
) -> str:
    """Return the topic of the sweeps: the wanted one, else the only one of laser scans, else of point clouds."""
    usable = {name: kind for name, (kind, count) in topics.items() if count and _holds_sweeps(kind, options)}
    lasers = sorted(name for name, kind in usable.items() if kind in LASER) or sorted(
        name for name, kind in usable.items() if kind == sweeps.CLOUD
    )
    if wanted:
        match = next((name for name in usable if name.lstrip("/") == wanted.lstrip("/")), None)
        if match is not None:
            return match
        problem = f"no laser scans on topic '{wanted}'{suggest(wanted, usable)}"
    elif len(lasers) == 1:
        return lasers[0]
    else:
        problem = f"{len(lasers)} topics with laser scans"
    listed = sorted(topics.items())[:MAX_LISTED]
    known = ", ".join(f"{name} ({kind.split('/')[-1]}, {count})" for name, (kind, count) in listed)
    known += f" and {len(topics) - MAX_LISTED} more" if len(topics) > MAX_LISTED else ""
    remedy = f"choose one with topic: {', '.join(lasers[:MAX_LISTED])}" if lasers else NO_LASER
    if not lasers and damage is not None and damage.lost_bytes:
        problem, remedy = f"{damage.describe()}; before the damage, {problem}", FETCH_AGAIN
    raise BadData(str(path), "", f"{problem}; topics: {known or 'none'}", remedy)


def read_sweep(contents: Contents, message: Any, kind: str, recorded_ns: int, options: SweepOptions) -> Sweep | None:
    """Return a laser message as a sweep, or None if it is damaged, which is counted in ``contents``."""
    header = getattr(message, "header", None)
    contents.unstamped += header is None or parse_stamp_ns(header) == 0
    sweep = sweeps.parse_sweep(message, kind, recorded_ns, options)
    contents.damaged += sweep is None
    return sweep


def add_odometry(contents: Contents, topic: str, message: Any, recorded_ns: int) -> bool:
    """Add the pose of an odometry message to ``contents``, or count it as damaged; return whether it was added."""
    matrix = _parse_matrix(contents, message.pose.pose.position, message.pose.pose.orientation)
    if matrix is None:
        return False
    key = topic, normalise_frame(message.header.frame_id), normalise_frame(message.child_frame_id)
    contents.odometry.setdefault(key, PoseBuffer()).append(
        parse_stamp_ns(message.header), planar_pose_from_matrix(matrix).row, recorded_ns
    )
    return True


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
