"""Whole numbers drawn from a seed, the same on every machine and with every version of numpy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

_STREAM = 4  # of the seed; those before are for noise, drop-outs, odometry and people

_T = TypeVar("_T")


class Draws:
    """Whole numbers from a seed.

    They are taken from the raw output of the bit generator, which numpy keeps in all versions, unlike the distributions
    of ``np.random.Generator``.
    """

    def __init__(self, seed: int) -> None:
        self._source = np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(_STREAM,)))

    def between(self, low: int, high: int) -> int:
        """Return a number from low to high, both included."""
        return low + int(self._source.random_raw()) % (high - low + 1)

    def pick(self, options: Sequence[_T]) -> _T:
        """Return one of the options."""
        return options[self.between(0, len(options) - 1)]
