"""A trajectory: poses over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.arrays import freeze
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses (N, 3) ``parent_from_child`` at strictly increasing ``stamps_ns`` (N,)."""

    stamps_ns: Stamps
    poses: Floats
    parent: str = "world"
    child: str = "base"

    def __post_init__(self) -> None:
        stamps = np.array(self.stamps_ns, dtype=np.int64)
        if stamps.ndim != 1:
            raise ValueError(f"stamps_ns: expected shape (N,), got {stamps.shape}")
        if (backwards := np.flatnonzero(np.diff(stamps) <= 0)).size:
            raise ValueError(f"stamps_ns: not increasing at index {int(backwards[0]) + 1}")
        stamps.flags.writeable = False
        object.__setattr__(self, "stamps_ns", stamps)
        freeze(self, "poses", np.reshape(self.poses, (0, 3)) if len(stamps) == 0 else self.poses, (len(stamps), 3))
        if not np.isfinite(self.poses).all():
            raise ValueError(f"poses: not finite at index {int(np.argmax(~np.isfinite(self.poses).all(axis=1)))}")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def duration_s(self) -> float:
        """Time from the first pose to the last in s."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9 if len(self) else 0.0

    @property
    def path_m(self) -> float:
        """Path length in m, summed from pose to pose."""
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())

    def at(self, stamps_ns: ArrayLike) -> Floats:
        """Return the interpolated poses (K, 3) at times (K,); raises ValueError outside the trajectory."""
        return se2.interpolate(self.stamps_ns, self.poses, stamps_ns)

    def moved(self, new_from_parent: Pose, parent: str | None = None) -> Trajectory:
        """Return the trajectory in another parent frame."""
        return Trajectory(
            self.stamps_ns, se2.compose(new_from_parent.row, self.poses), parent or self.parent, self.child
        )
