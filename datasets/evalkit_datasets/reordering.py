"""Scans put in the order of time while a file is read once, with never more than a few of them in memory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np

from evalkit.core.se2 import Floats

MAX_AHEAD = 256
"""So many scans that came before their turn are kept in memory; the ranges of further ones wait in a temporary file."""

NOTHING = np.zeros(0)


class Ranged(Protocol):
    """A frozen dataclass whose bulk is its ranges."""

    @property
    def ranges(self) -> Floats:
        """What the beams found (B,)."""
        ...


Scan = TypeVar("Scan", bound=Ranged)


def by_rank(scans: Iterable[tuple[int, Scan]], most_ahead: int = MAX_AHEAD) -> Iterator[Scan]:
    """The scans by their rank: 0, 1, 2, ... Ranks come in any order; after one that is missing nothing follows."""
    early: dict[int, Scan] = {}
    waiting = _Aside()
    turn = 0
    for rank, scan in scans:
        if rank != turn:
            early[rank] = scan if len(early) < most_ahead else waiting.put(rank, scan)
            continue
        yield scan
        turn += 1
        while turn in early:
            yield waiting.back(turn, early.pop(turn))
            turn += 1
    waiting.close()


class _Aside:
    """Ranges on disk, by rank."""

    def __init__(self) -> None:
        self._file: Any = None
        self._places: dict[int, tuple[int, int]] = {}

    def put(self, rank: int, scan: Scan) -> Scan:
        """The scan without its ranges."""
        self._file = self._file or tempfile.TemporaryFile()  # noqa: SIM115 - closed when the last scan is out
        self._places[rank] = self._file.seek(0, 2), len(scan.ranges)
        self._file.write(scan.ranges.tobytes())
        return _with(scan, NOTHING)

    def back(self, rank: int, scan: Scan) -> Scan:
        """The scan with its ranges again."""
        if rank not in self._places:
            return scan
        at, count = self._places.pop(rank)
        self._file.seek(at)
        return _with(scan, np.frombuffer(self._file.read(8 * count), dtype=np.float64))

    def close(self) -> None:
        """Nothing waits any more."""
        if self._file is not None:
            self._file.close()


def _with(scan: Scan, ranges: Floats) -> Scan:
    return replace(scan, ranges=ranges)  # type: ignore[type-var]  # every Ranged is a dataclass
