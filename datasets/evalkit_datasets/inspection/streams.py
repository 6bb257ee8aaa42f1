"""Everything a recording holds, as arrays: what the doctor looks at, whatever the format it came in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.transforms import TransformTree


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag, or a kind of line in a log: its messages, and those a second (nan: untold)."""

    name: str
    kind: str
    count: int
    rate_hz: float


@dataclass(frozen=True, eq=False)
class LaserStream:
    """All scans of one lidar in the order of the file, as sent.

    ``stamps_ns`` (N,): the headers' times; ``recorded_ns`` (N,): when each was written down, None where untold.
    ``angles`` (B,): of the first scan (rad). Limits are nan where the format does not tell. ``damaged``: messages left
    out; ``unstamped``: those that carry no time of their own.
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
    """One odometry in the order of the file: poses (N, 3) ``parent_from_child``, twists (N, 2) in m/s, rad/s."""

    topic: str
    parent: str
    child: str
    stamps_ns: Stamps
    poses: Floats
    twists: Floats | None = None
    recorded_ns: Stamps | None = None


@dataclass(frozen=True, eq=False)
class RecordingStreams:
    """A recording. ``poses_from``: who made the poses inside where they are corrected ones, "" else.

    ``digits``: the most significant digits any scan's stamp is written with, 0 where stamps are binary. ``remarks``:
    what the file says of itself.
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
