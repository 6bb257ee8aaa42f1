"""The content of a recording as arrays, independent of its format: input of the inspection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

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
    of messages dropped; ``unstamped``: number of messages without a stamp.
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


@dataclass(frozen=True, eq=False)
class RecordingStreams:
    """All streams of a recording.

    ``poses_from``: program that computed the poses ("gmapping" or "graph"), "" if they are not corrected ones.
    ``digits``: largest number of significant digits of a scan's stamp, 0 for binary stamps. ``remarks``: comments in
    the file.
    """

    path: Path
    kind: str
    topics: Sequence[Topic]
    lasers: Sequence[LaserStream]
    wheels: Sequence[OdometryStream]
    tree: TransformTree = field(default_factory=TransformTree)
    poses_from: str = ""
    digits: int = 0
    damaged: int = 0
    remarks: Sequence[str] = ()
