"""A sequence whose frames stay in memory after the first reading."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from evalkit.core.scan import Frame
from evalkit.plugins.protocols import Sequence

if TYPE_CHECKING:
    from evalkit.core.ground_truth import Truth

MAX_BYTES = 64 * 2**20
"""Sequences with more ranges and angles are read again every time."""


class KeptSequence:
    """The same frames, truth and notes as ``sequence``; for data that are read several times."""

    def __init__(self, sequence: Sequence, max_bytes: int = MAX_BYTES) -> None:
        self._sequence, self._max_bytes = sequence, max_bytes
        self._kept: tuple[Frame, ...] | None = None

    def __len__(self) -> int:
        return len(self._sequence)

    def frames(self) -> Iterator[Frame]:
        """Yield the frames; keep them once all are read, if they are few enough."""
        if self._kept is not None:
            yield from self._kept
            return
        read, size = list[Frame](), 0
        for frame in self._sequence.frames():
            size += frame.scan.ranges.nbytes + frame.scan.angles.nbytes
            if size <= self._max_bytes:
                read.append(frame)
            else:
                read.clear()
            yield frame
        if size <= self._max_bytes:
            self._kept = tuple(read)

    def truth(self) -> Truth:
        """Return the ground truth of the sequence."""
        return self._sequence.truth()

    def notes(self) -> Mapping[str, int]:
        """Return the notes of the sequence."""
        return self._sequence.notes()
