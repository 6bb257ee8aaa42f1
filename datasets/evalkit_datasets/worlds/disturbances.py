"""Periodic disturbances of a simulated drive, such as wheel slip and lost scans."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Bools


@dataclass(frozen=True)
class Episodes:
    """Episodes of ``lasts_s`` that begin every ``every_s``, the first after half a period; ``every_s`` 0: none."""

    every_s: float = 0.0
    lasts_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("every_s", "lasts_s"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}: negative: {getattr(self, name)}")

    def contains(self, stamps_ns: ArrayLike) -> Bools:
        """Return which of the times (N,) lie within an episode, its end excluded."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        if not self.every_s:
            return np.zeros(stamps.shape, dtype=np.bool_)
        every_ns = round(self.every_s * 1e9)
        since = (stamps - every_ns // 2) % every_ns
        return np.asarray((stamps >= every_ns // 2) & (since < round(self.lasts_s * 1e9)))


NEVER = Episodes()
