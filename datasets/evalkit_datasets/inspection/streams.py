"""The content of a recording as arrays, independent of its format: input of the inspection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.transforms import TransformTree


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag or a type of line in a log, with the number of messages and their rate (nan: unknown)."""

    name: str
    kind: str
    count: int
    rate_hz: float


@dataclass(frozen=True, eq=False)
class LaserStream:
    """All scans of one lidar as sent, in file order.

    ``stamps_ns`` (N,): times in the headers; ``recorded_ns`` (N,): times of recording, None if unknown. ``angles``
    (B,): those of the first scan (rad). Range limits are nan if the format does not contain them. ``damaged``: number
    of messages dropped; ``unstamped``: number of messages without a stamp. ``fields``: the parameter of the reader for
    messages of another type, "" for laser scans and point clouds.
    """

    topic: str
    kind: str
    frame: str
    stamps_ns: Stamps
    recorded_ns: Stamps | None
    ranges: Sequence[Floats]
    angles: Floats
    range_min_m: float
    range_max_m: float
    time_increment_ns: int = 0
    damaged: int = 0
    unstamped: int = 0
    fields: str = ""


@dataclass(frozen=True, eq=False)
class OdometryStream:
    """One odometry in file order: poses (N, 3) ``parent_from_child``, twists (N, 2) in m/s and rad/s."""

    topic: str
    parent: str
    child: str
    stamps_ns: Stamps
    poses: Floats
    twists: Floats | None = None
    recorded_ns: Stamps | None = None


def interpolate_odometry(wheels: OdometryStream, laser: LaserStream) -> tuple[Stamps, Ints, Floats]:
    """Return stamps (K,) of the scans within the odometry's time, each once; their indices (K,) and the poses (K, 3).

    Poses are ``parent_from_child``; none with fewer than two stamps of the odometry.
    """
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    times, order = np.unique(laser.stamps_ns, return_index=True)
    inside = (times >= stamps[0]) & (times <= stamps[-1]) if len(stamps) > 1 else np.zeros(len(times), np.bool_)
    times, order = times[inside], order[inside]
    poses = se2.interpolate(stamps, wheels.poses[first], times) if len(times) else np.zeros((0, 3))
    return times, order, poses


@dataclass(frozen=True, eq=False)
class RecordingStreams:
    """All streams of a recording. ``reader``: the name of the data set that reads it.

    ``poses_from``: program that computed the poses ("gmapping" or "graph"), "" if they are not corrected ones.
    ``digits``: largest number of significant digits of a scan's stamp, 0 for binary stamps. ``remarks``: comments in
    the file. ``unindexed``: the index of a bag is damaged, and its records were read up to the damage.
    """

    path: Path
    kind: str
    reader: str
    topics: Sequence[Topic]
    lasers: Sequence[LaserStream]
    wheels: Sequence[OdometryStream]
    tree: TransformTree = field(default_factory=TransformTree)
    poses_from: str = ""
    digits: int = 0
    damaged: int = 0
    remarks: Sequence[str] = ()
    unindexed: bool = False
