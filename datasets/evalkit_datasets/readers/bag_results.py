"""Read results of other programs from ROS bags: trajectories of topics and of transforms, and occupancy grids."""

from __future__ import annotations

from array import array
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps, between
from evalkit.core.trajectory import Trajectory
from evalkit.io.map_server import MAX_PIXELS, log_odds_of_percent
from evalkit.io.timestamps import order_stamps
from evalkit.io.tum import TumFile
from evalkit.plugins.result_files import ResultReader
from evalkit_datasets.parsing import bag_file, rosbag_parser, sweeps
from evalkit_datasets.parsing.bag_file import DAMAGED_MESSAGES, MessageDamage, iter_messages
from evalkit_datasets.parsing.transforms import matrix_from_quaternion, planar_pose_from_matrix

POSES = {
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
    "geometry_msgs/msg/TransformStamped": lambda message: message.transform,
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
}
"""Message types with a header and a pose, and where the pose stands."""

PATH = "nav_msgs/msg/Path"
GRID = "nav_msgs/msg/OccupancyGrid"
TRAJECTORIES = (*POSES, PATH)

JUMP_M, JUMP_RAD = 0.1, np.radians(5.0)
"""A larger step of the transform between two frames other than the last is a correction, not a motion."""

MAX_FRAMES = 10_000
"""A bag with more frames is damaged."""

COLUMNS = 7
"""Translation (m) and quaternion (x, y, z, w) of a transform."""


def read_trajectory(path: Path, query: Mapping[str, str]) -> TumFile:
    """Return the poses of a ``topic`` or of the chain of frames ``tf`` ("map,base_link") in a bag.

    A topic holds PoseStamped, PoseWithCovarianceStamped, TransformStamped, Odometry or Path messages; of Path messages
    the last is taken, which holds the corrected poses. Raises BadData with what the bag holds.
    """
    with bag_file.open_bag(path) as reader:
        if "tf" in query:
            return _read_chain(path, reader, query["tf"])
        topic, kind = _select_topic(path, reader, query.get("topic", ""), TRAJECTORIES, "topic")
        return _read_poses(path, reader, topic, kind)


def read_grid(path: Path, topic: str) -> tuple[OccupancyGrid, Pose]:
    """Return the last occupancy grid of a topic of a bag, with its corner at its own origin, and ``map_from_grid``.

    Cells of -1 are not observed; 0 to 100 is the probability in percent, limited to that of map_server's walls.
    """
    with bag_file.open_bag(path) as reader:
        name, _ = _select_topic(path, reader, topic, (GRID,), "map")
        return _parse_grid(path, name, _read_last(path, reader, name, GRID))


READER = ResultReader(bag_file.SUFFIXES, read_trajectory, read_grid)


@dataclass(eq=False)
class _Samples:
    """Transforms ``parent_from_child`` over time, in file order: 64 bytes each."""

    stamps: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def append(self, stamp_ns: int, position: Any, rotation: Any) -> bool:
        """Append one transform; return whether it is valid."""
        matrix_row = (position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)
        try:
            matrix_from_quaternion(matrix_row[:3], matrix_row[3:])
        except ValueError:
            return False
        self.stamps.append(stamp_ns)
        self.values.extend(matrix_row)
        return True

    def in_order(self) -> tuple[Stamps, Floats, dict[str, int]]:
        """Return stamps (N,) strictly increasing, rows (N, 7), and counts of what was corrected."""
        stamps, rows = np.asarray(self.stamps), np.asarray(self.values).reshape(-1, COLUMNS)
        order = order_stamps(stamps)
        counts = {"poses out of order": order.backwards, "poses with a repeated stamp ignored": order.repeated}
        return stamps[order.keep], rows[order.keep], counts


def _read_poses(path: Path, reader: Any, topic: str, kind: str) -> TumFile:
    samples, damaged, damage = _Samples(), 0, MessageDamage()
    for message in _pose_messages(path, reader, topic, kind, damage):
        pose = POSES.get(kind, POSES["geometry_msgs/msg/PoseStamped"])(message)
        position = pose.translation if hasattr(pose, "translation") else pose.position
        rotation = pose.rotation if hasattr(pose, "rotation") else pose.orientation
        damaged += not samples.append(sweeps.parse_stamp_ns(message.header), position, rotation)
    damage.check_share(path)
    stamps, rows, counts = samples.in_order()
    if not len(stamps):
        raise BadData(str(path), topic, f"{damaged} poses, none valid", "give another topic")
    poses = np.array([planar_pose_from_matrix(matrix_from_quaternion(row[:3], row[3:])).row for row in rows.tolist()])
    return _file(stamps, poses, counts | {"invalid poses": damaged, DAMAGED_MESSAGES: damage.damaged.total()})


def _pose_messages(path: Path, reader: Any, topic: str, kind: str, damage: MessageDamage) -> Iterator[Any]:
    """Yield the messages with a header and a pose: those of the topic, or those inside its last Path."""
    if kind == PATH:
        yield from _read_last(path, reader, topic, PATH).poses
    else:
        for _, message, _ in iter_messages(reader, _find_connections(reader, topic, kind), damage):
            yield message


def _read_last(path: Path, reader: Any, topic: str, kind: str) -> Any:
    """Return the last message of a topic; raises BadData if there is none, or if it cannot be decoded."""
    damage = MessageDamage()
    last: tuple[Any, int, bytes] | None = None
    for one in reader.messages(connections=_find_connections(reader, topic, kind)):
        damage.taken[topic] += last is not None  # those before it
        last = one
    if last is None:
        raise BadData(str(path), topic, "no message", "give another topic")
    message = damage.decode(reader, *last)
    if message is None:
        what = f"its last message cannot be decoded: {damage.describe_first()}"
        raise BadData(str(path), topic, what, bag_file.FETCH_AGAIN)
    return message


def _read_chain(path: Path, reader: Any, words: str) -> TumFile:
    """Return ``parent_from_child`` through the tree of transforms, at the stamps of its most frequent edge."""
    names = [name.strip().lstrip("/") for name in words.split(",")]
    if len(names) != 2 or not all(names):
        raise BadData(str(path), "tf", f"'{words[:80]}'", "expected two frames, such as tf=map,base_link")
    edges = _find_chain(path, reader, *names)
    samples: dict[tuple[str, str], _Samples] = {edge: _Samples() for edge, _ in edges}
    static: set[tuple[str, str]] = set()
    damaged, damage = 0, MessageDamage()
    for topic, stamped in _transforms(reader, damage):
        edge = _edge(stamped)
        if edge in samples:
            if topic.endswith("tf_static"):  # a static transform replaces earlier ones, as in tf2
                static.add(edge)
                samples[edge] = _Samples()
            elif edge in static:
                continue
            stamp = sweeps.parse_stamp_ns(stamped.header)
            damaged += not samples[edge].append(stamp, stamped.transform.translation, stamped.transform.rotation)
    counts = {"invalid transforms": damaged, DAMAGED_MESSAGES: damage.damaged.total()}
    return _compose_chain(path, words, edges, samples, static, counts)


def _compose_chain(
    path: Path, words: str, edges: list[tuple[tuple[str, str], bool]], samples: dict[tuple[str, str], _Samples],
    static: set[tuple[str, str]], counts: Mapping[str, int],
) -> TumFile:  # fmt: skip
    rows = {edge: each.in_order() for edge, each in samples.items()}
    moving = [edge for edge in rows if edge not in static]
    if any(len(stamps) == 0 for stamps, _, _ in rows.values()) or not moving:
        raise BadData(str(path), f"tf={words}", "no moving transform between these frames", "give other frames")
    stamps = max((rows[edge][0] for edge in moving), key=len)
    first, last = max(rows[edge][0][0] for edge in moving), min(rows[edge][0][-1] for edge in moving)
    inside = stamps[(stamps >= first) & (stamps <= last)]
    if not len(inside):
        raise BadData(str(path), f"tf={words}", "the transforms of the chain have no time in common", "record them all")
    total = np.broadcast_to(np.eye(4), (len(inside), 4, 4))
    corrections = 0
    for edge, forward in edges:
        each = _interpolate(*rows[edge][:2], inside)
        total = total @ (each if forward else np.linalg.inv(each))
    for edge in moving[:-1]:
        corrections += _count_jumps(rows[edge][1])
    poses = np.stack([total[:, 0, 3], total[:, 1, 3], np.arctan2(total[:, 1, 0], total[:, 0, 0])], axis=-1)
    counts = {
        **counts,
        "transforms outside the time of the others": len(stamps) - len(inside),
        "corrections above 0.1 m or 5 deg": corrections,
    }
    return _file(inside, poses, counts)


def _find_chain(path: Path, reader: Any, parent: str, child: str) -> list[tuple[tuple[str, str], bool]]:
    """Return the edges from parent to child, and whether each is taken forward; breadth first."""
    neighbours: dict[str, dict[str, tuple[tuple[str, str], bool]]] = {}
    damage = MessageDamage()
    for _, stamped in _transforms(reader, damage):
        edge = _edge(stamped)
        neighbours.setdefault(edge[0], {})[edge[1]] = edge, True
        neighbours.setdefault(edge[1], {})[edge[0]] = edge, False
        if len(neighbours) > MAX_FRAMES:
            raise BadData(str(path), "tf", f"more than {MAX_FRAMES} frames", "record the bag again")
    damage.check_share(path)
    came_by: dict[str, list[tuple[tuple[str, str], bool]]] = {parent: []}
    waiting = deque([parent])
    while waiting and child not in came_by:
        frame = waiting.popleft()
        for other, step in neighbours.get(frame, {}).items():
            if other not in came_by:
                came_by[other] = [*came_by[frame], step]
                waiting.append(other)
    if child not in came_by or parent == child:
        known = ", ".join(sorted(neighbours)[:40]) or "none"
        raise BadData(str(path), f"tf={parent},{child}", "no transforms connect them", f"frames of the bag: {known}")
    return came_by[child]


def _interpolate(stamps: Stamps, rows: Floats, at: Stamps) -> Floats:
    """Return the transforms (K, 4, 4) at times (K,): positions linear, rotations along the shortest arc, as tf2."""
    from scipy.spatial.transform import Rotation, Slerp  # noqa: PLC0415 - slow to load

    matrices = np.broadcast_to(np.eye(4), (len(at), 4, 4)).copy()
    rotations = Rotation.from_quat(rows[:, 3:])
    if len(stamps) == 1:
        matrices[:, :3, 3], matrices[:, :3, :3] = rows[0, :3], rotations[0].as_matrix()
        return matrices
    seconds, wanted = (stamps - stamps[0]) * 1e-9, (at - stamps[0]) * 1e-9
    for column in range(3):
        matrices[:, column, 3] = np.interp(wanted, seconds, rows[:, column])
    matrices[:, :3, :3] = Slerp(seconds, rotations)(np.clip(wanted, seconds[0], seconds[-1])).as_matrix()
    return matrices


def _count_jumps(rows: Floats) -> int:
    poses = np.array([planar_pose_from_matrix(matrix_from_quaternion(row[:3], row[3:])).row for row in rows.tolist()])
    steps = between(poses[:-1], poses[1:])
    return int(((np.hypot(steps[:, 0], steps[:, 1]) > JUMP_M) | (abs(steps[:, 2]) > JUMP_RAD)).sum())


def _parse_grid(path: Path, topic: str, message: Any) -> tuple[OccupancyGrid, Pose]:
    info, cells = message.info, np.asarray(message.data, dtype=np.int16)
    rows, columns, size = int(info.height), int(info.width), float(info.resolution)
    if rows * columns != len(cells) or not len(cells) or len(cells) > MAX_PIXELS:
        raise BadData(str(path), topic, f"{len(cells)} cells for {columns} x {rows}", "save the map again")
    if not (np.isfinite(size) and size > 0.0):
        raise BadData(str(path), topic, f"resolution {size}", "expected metres per cell, more than 0")
    origin = info.origin
    try:
        matrix = matrix_from_quaternion(
            (origin.position.x, origin.position.y, origin.position.z),
            (origin.orientation.x, origin.orientation.y, origin.orientation.z, origin.orientation.w),
        )
    except ValueError as error:
        raise BadData(str(path), topic, f"its origin: {error}", "save the map again") from None
    observed = ((cells >= 0) & (cells <= 100)).reshape(rows, columns)
    log_odds = np.where(observed, log_odds_of_percent(cells.reshape(rows, columns)), np.float32(0.0))
    return OccupancyGrid(log_odds, observed, size, 0.0, 0.0), planar_pose_from_matrix(matrix)


def _select_topic(path: Path, reader: Any, wanted: str, kinds: tuple[str, ...], key: str) -> tuple[str, str]:
    """Return the topic with one of the message types and its type: the wanted one, or the only one."""
    known = {name: str(about.msgtype) for name, about in reader.topics.items() if about.msgtype in kinds}
    fitting = [name for name in known if not wanted or name.lstrip("/") == wanted.lstrip("/")]
    if len(fitting) != 1:
        listed = ", ".join(f"{name} ({kind.split('/')[-1]})" for name, kind in sorted(known.items())[:40])
        what = f"no topic '{wanted[:80]}' with results" if wanted else f"{len(known)} topics with results"
        types = ", ".join(kind.split("/")[-1] for kind in kinds)
        remedy = f"choose one with ?{key}=...: {listed}" if known else f"give a bag with {types}"
        raise BadData(str(path), "", what, remedy)
    return fitting[0], known[fitting[0]]


def _find_connections(reader: Any, topic: str, kind: str) -> list[Any]:
    return [one for one in reader.connections if one.topic == topic and one.msgtype == kind]


def _transforms(reader: Any, damage: MessageDamage) -> Iterator[tuple[str, Any]]:
    """Yield every transform with its topic; ``damage`` counts the messages that cannot be decoded."""
    connections = [one for one in reader.connections if one.msgtype in rosbag_parser.TRANSFORMS]
    for connection, message, _ in iter_messages(reader, connections, damage):
        for stamped in message.transforms:
            yield connection.topic, stamped


def _edge(stamped: Any) -> tuple[str, str]:
    normalise = sweeps.normalise_frame
    return normalise(stamped.header.frame_id), normalise(stamped.child_frame_id)


def _file(stamps: Stamps, poses: Floats, counts: Mapping[str, int]) -> TumFile:
    return TumFile(Trajectory(stamps, poses), {name: count for name, count in counts.items() if count})
