"""What befalls a drive again and again, at times known in advance: wheels that slip, scans that are lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.arrays import Bools


@dataclass(frozen=True)
class Episodes:
    """Episodes of ``lasts_s`` that begin once in ``every_s``, the first after half of that; 0: never."""

    every_s: float = 0.0
    lasts_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("every_s", "lasts_s"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name}: negative: {getattr(self, name)}")

    def at(self, stamps_ns: ArrayLike) -> Bools:
        """Which of the times (N,) lie within an episode: from its beginning until before its end."""
        stamps = np.asarray(stamps_ns, dtype=np.int64)
        if not self.every_s:
            return np.zeros(stamps.shape, dtype=np.bool_)
        every_ns = round(self.every_s * 1e9)
        since = (stamps - every_ns // 2) % every_ns
        return np.asarray((stamps >= every_ns // 2) & (since < round(self.lasts_s * 1e9)))


NEVER = Episodes()
