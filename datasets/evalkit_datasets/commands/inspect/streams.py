"""The content of a recording as arrays, independent of its format: input of the inspection."""

from __future__ import annotations

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats, Stamps
from evalkit_datasets.parsing.bag_file import BagDamage
from evalkit_datasets.parsing.transforms import TransformTree


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag or a type of line in a log, with the number of messages and their rate (nan: unknown)."""

    name: str
    kind: str
    count: int
    rate_hz: float


MAX_RANGES = 4_000_000
"""Ranges kept of one lidar (32 MB): of a longer recording, windows of scans spread evenly over it."""

WINDOW = 256
"""Successive scans that are kept together: pairs of scans a second apart are compared."""


class ScanSample:
    """The ranges of a recording within bounded memory: all scans, or windows of successive scans spread evenly.

    ``rows``: ranges (B,) of the scans kept; ``numbers`` (K,): their indices among all. ``beams``: the numbers of beams
    that occur. ``repeated``: number of scans equal to the previous one. Both are of all scans.
    """

    def __init__(self, rows: Iterable[Floats] = (), max_ranges: int = MAX_RANGES) -> None:
        self.rows: list[Floats] = []
        self.beams: set[int] = set()
        self.repeated = 0
        self._numbers = array("q")
        self._max_ranges, self._count, self._kept_ranges, self._stride = max_ranges, 0, 0, 1
        self._last: Floats | None = None
        for row in rows:
            self.append(row)

    def __len__(self) -> int:
        return self._count

    @property
    def numbers(self) -> Ints:
        """Indices (K,) of the scans kept, increasing."""
        return np.asarray(self._numbers)

    def append(self, row: Floats) -> None:
        """Take the next scan."""
        last = self._last
        self.repeated += last is not None and len(last) == len(row) and bool(np.array_equal(last, row, equal_nan=True))
        self.beams.add(len(row))
        self._last = row
        if self._is_kept(self._count):
            self.rows.append(row)
            self._numbers.append(self._count)
            self._kept_ranges += len(row)
        self._count += 1
        while self._kept_ranges > self._max_ranges and self._count > WINDOW * self._stride:
            self._stride *= 2
            kept = [at for at, number in enumerate(self._numbers) if self._is_kept(number)]
            self.rows = [self.rows[at] for at in kept]
            self._numbers = array("q", [self._numbers[at] for at in kept])
            self._kept_ranges = sum(map(len, self.rows))

    def _is_kept(self, number: int) -> bool:
        return number // WINDOW % self._stride == 0


@dataclass(frozen=True, eq=False)
class LaserStream:
    """The scans of one lidar as sent, in file order.

    ``stamps_ns`` (N,): times in the headers; ``recorded_ns`` (N,): times of recording, None if unknown. ``scans``: the
    ranges, of a long recording a sample. ``angles`` (B,): those of the first scan (rad). Range limits are nan if the
    format does not contain them. ``damaged``: number of messages dropped; ``unstamped``: number of messages without a
    stamp. ``fields``: the parameter of the reader for messages of another type, "" for laser scans and point clouds.
    """

    topic: str
    kind: str
    frame: str
    stamps_ns: Stamps
    recorded_ns: Stamps | None
    scans: ScanSample
    angles: Floats
    range_min_m: float
    range_max_m: float
    time_increment_ns: int = 0
    damaged: int = 0
    unstamped: int = 0
    fields: str = ""

    @property
    def ranges(self) -> Sequence[Floats]:
        """Ranges (B,) of the scans in the sample."""
        return self.scans.rows

    @property
    def sample_stamps_ns(self) -> Stamps:
        """Times (K,) of the scans in the sample."""
        return self.stamps_ns[self.scans.numbers]


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
    """Return stamps (K,) of the sampled scans within the odometry's time, each once, with their indices and poses.

    Indices (K,) are those in the sample. Poses (K, 3) are ``parent_from_child``; none with fewer than two stamps of
    the odometry.
    """
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    times, order = np.unique(laser.sample_stamps_ns, return_index=True)
    inside = (times >= stamps[0]) & (times <= stamps[-1]) if len(stamps) > 1 else np.zeros(len(times), np.bool_)
    times, order = times[inside], order[inside]
    poses = se2.interpolate(stamps, wheels.poses[first], times) if len(times) else np.zeros((0, 3))
    return times, order, poses


@dataclass(frozen=True, eq=False)
class RecordingStreams:
    """All streams of a recording. ``reader``: the name of the data set that reads it.

    ``poses_from``: program that computed the poses ("gmapping" or "graph"), "" if they are not corrected ones.
    ``digits``: largest number of significant digits of a scan's stamp, 0 for binary stamps. ``first_damage``: the
    first line that was dropped, or the first message that cannot be decoded, and why. ``remarks``: comments in the
    file. ``damage``: None for a bag with its index; else its records were read up to the damage. ``missing``: number of
    messages that the index of a bag lists, and that are not in it. ``left_out``: topics of other robots than that of
    the chosen lidar. ``defects``: other defects that the reader handled, by name.
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
    first_damage: str = ""
    remarks: Sequence[str] = ()
    damage: BagDamage | None = None
    missing: int = 0
    defects: Mapping[str, int] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
