"""A sequence with changed frames, and the ground truth and notes of the original."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from typing import TYPE_CHECKING

from evalkit.core.scan import Frame
from evalkit.plugins.protocols import Seekable, Sequence

if TYPE_CHECKING:
    from evalkit.core.ground_truth import Truth


class ChangedSequence:
    """``change(index, frame)`` gives each of ``count`` frames (default: all) from number ``first`` of a sequence on."""

    def __init__(
        self, sequence: Sequence, change: Callable[[int, Frame], Frame], first: int = 0, count: int | None = None
    ) -> None:
        self._sequence, self._change, self._first = sequence, change, first
        self._count = max(len(sequence) - first if count is None else count, 0)

    def __len__(self) -> int:
        return self._count

    def frames(self) -> Iterator[Frame]:
        """Yield the changed frames."""
        if isinstance(self._sequence, Seekable):
            frames = islice(self._sequence.frames_from(self._first), self._count)
        else:
            frames = islice(self._sequence.frames(), self._first, self._first + self._count)
        return (self._change(index, frame) for index, frame in enumerate(frames))

    def truth(self) -> Truth:
        """Return the ground truth of the sequence."""
        return self._sequence.truth()

    def notes(self) -> Mapping[str, int]:
        """Return the notes of the sequence."""
        return self._sequence.notes()
