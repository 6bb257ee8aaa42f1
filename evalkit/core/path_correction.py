"""PathCorrection: the path of a SLAM just before and just after it moved earlier poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import freeze
from evalkit.core.se2 import Floats, Stamps


@dataclass(frozen=True, eq=False)
class PathCorrection:
    """One correction: at frame ``stamp_ns`` the poses ``before`` became the poses ``after``.

    ``stamps_ns`` (N,): some of the frames answered before, evenly spread, strictly increasing; the last is the frame
    just before, and the one whose position moved most is among them. ``before``, ``after`` (N, 3): ``start_from_base``.
    """

    stamp_ns: int
    stamps_ns: Stamps
    before: Floats
    after: Floats

    def __post_init__(self) -> None:
        freeze(self, "stamps_ns", self.stamps_ns, (None,), np.int64)
        count = len(self.stamps_ns)
        freeze(self, "before", self.before, (count, 3))
        freeze(self, "after", self.after, (count, 3))
        if count == 0 or (np.diff([*self.stamps_ns, self.stamp_ns]) <= 0).any():
            raise ValueError("stamps_ns: expected at least one, strictly increasing, all before stamp_ns")
        if not (np.isfinite(self.before).all() and np.isfinite(self.after).all()):
            raise ValueError("before, after: expected finite poses")

    @property
    def moved_m(self) -> Floats:
        """How far each position moved (N,), in metres."""
        return np.asarray(np.linalg.norm(self.after[:, :2] - self.before[:, :2], axis=1))
