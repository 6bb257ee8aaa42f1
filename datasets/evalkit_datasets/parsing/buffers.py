"""Bounded buffers for reading recordings: compact poses, and scans that are put in order of time while read once."""

from __future__ import annotations

import tempfile
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats, Stamps

MAX_AHEAD = 256
"""Number of early scans kept in memory; the ranges of further ones are moved to a temporary file."""

_NO_RANGES = np.zeros(0)


class PoseBuffer:
    """Poses and their times in file order, 32 bytes each. Do not append after the arrays have been read."""

    def __init__(self) -> None:
        self._stamps, self._rows = array("q"), array("d")
        self.unstamped = 0

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, stamp_ns: int, row: ArrayLike, recorded_ns: int = 0) -> None:
        """Append a pose x, y, theta (3,).

        Where no pose has a stamp, each is given its time of recording; a single one at 0 is the start of a simulation.
        """
        if not stamp_ns and self.unstamped == len(self):
            self.unstamped += 1
            stamp_ns = recorded_ns
        elif self.unstamped == len(self) == 1:
            self.unstamped, self._stamps[0] = 0, 0
        self._stamps.append(stamp_ns)
        self._rows.extend(np.asarray(row, dtype=np.float64).tolist())

    @property
    def stamps_ns(self) -> Stamps:
        """Times (N,) in ns."""
        return np.asarray(self._stamps)

    @property
    def poses(self) -> Floats:
        """Poses (N, 3)."""
        return np.asarray(self._rows).reshape(-1, 3)


class HasRanges(Protocol):
    """A frozen dataclass with a large array of ranges."""

    @property
    def ranges(self) -> Floats:
        """Ranges of the beams (B,)."""
        ...


AnyScan = TypeVar("AnyScan", bound=HasRanges)


def sort_by_rank(ranked_scans: Iterable[tuple[int, AnyScan]], max_ahead: int = MAX_AHEAD) -> Iterator[AnyScan]:
    """Yield scans in the order of their ranks 0, 1, 2, ..., given in any order; stops before a missing rank."""
    early: dict[int, AnyScan] = {}
    on_disk = _RangesOnDisk()
    next_rank = 0
    for rank, scan in ranked_scans:
        if rank != next_rank:
            early[rank] = scan if len(early) < max_ahead else on_disk.store(rank, scan)
            continue
        yield scan
        next_rank += 1
        while next_rank in early:
            yield on_disk.restore(next_rank, early.pop(next_rank))
            next_rank += 1
    on_disk.close()


class _RangesOnDisk:
    """Ranges of scans in a temporary file, by rank."""

    def __init__(self) -> None:
        self._file: Any = None
        self._places: dict[int, tuple[int, int]] = {}

    def store(self, rank: int, scan: AnyScan) -> AnyScan:
        """Write the ranges of a scan to the file and return the scan without them."""
        self._file = self._file or tempfile.TemporaryFile()  # noqa: SIM115 - closed after the last scan
        self._places[rank] = self._file.seek(0, 2), len(scan.ranges)
        self._file.write(scan.ranges.tobytes())
        return _with_ranges(scan, _NO_RANGES)

    def restore(self, rank: int, scan: AnyScan) -> AnyScan:
        """Return the scan with its ranges; a scan that was not stored is returned as it is."""
        if rank not in self._places:
            return scan
        at, count = self._places.pop(rank)
        self._file.seek(at)
        return _with_ranges(scan, np.frombuffer(self._file.read(8 * count), dtype=np.float64))

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


def _with_ranges(scan: AnyScan, ranges: Floats) -> AnyScan:
    return replace(scan, ranges=ranges)  # type: ignore[type-var]  # every HasRanges is a dataclass
