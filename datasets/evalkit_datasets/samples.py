"""Poses as they come out of a file, 32 bytes each, however many there are."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats, Stamps


class Samples:
    """Poses with their times in the order of the file; complete once they are looked at."""

    def __init__(self) -> None:
        self._stamps, self._rows = array("q"), array("d")

    def __len__(self) -> int:
        return len(self._stamps)

    def append(self, stamp_ns: int, row: ArrayLike) -> None:
        """Takes in x, y, theta (3,) at a time."""
        self._stamps.append(stamp_ns)
        self._rows.extend(np.asarray(row, dtype=np.float64).tolist())

    @property
    def stamps_ns(self) -> Stamps:
        """The times (N,)."""
        return np.asarray(self._stamps)

    @property
    def poses(self) -> Floats:
        """The poses (N, 3)."""
        return np.asarray(self._rows).reshape(-1, 3)
