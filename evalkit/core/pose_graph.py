"""A pose graph of the plane: poses, and measured motions between pairs of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, freeze
from evalkit.core.se2 import Floats


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Poses ``world_from_node`` (N, 3) and M edges: measured motions ``first_from_second`` (M, 3) with their weights.

    ``first``, ``second`` (M,): rows of the two poses of an edge. ``information`` (M, 3, 3): symmetric, in the order x,
    y, theta of the residual (1/m^2, 1/(m rad), 1/rad^2). The residual of an edge is (x, y, wrapped theta) of
    ``measured^-1 @ (first^-1 @ second)``, in the frame of the *measured second pose*. Its translation in another frame
    (Ceres: that of the first pose) has another sum of squares where the information is not isotropic.
    """

    poses: Floats
    first: Ints
    second: Ints
    first_from_second: Floats
    information: Floats

    def __post_init__(self) -> None:
        freeze(self, "poses", np.reshape(self.poses, (-1, 3)), (None, 3))
        freeze(self, "first", self.first, (None,), np.int64)
        edges = len(self.first)
        freeze(self, "second", self.second, (edges,), np.int64)
        freeze(self, "first_from_second", np.reshape(self.first_from_second, (-1, 3)), (edges, 3))
        freeze(self, "information", np.reshape(self.information, (-1, 3, 3)), (edges, 3, 3))
        for name in ("poses", "first_from_second", "information"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"{name}: not finite")
        for name in ("first", "second"):
            rows = getattr(self, name)
            if edges and not (rows.min() >= 0 and rows.max() < len(self.poses)):
                raise ValueError(f"{name}: expected rows of {len(self.poses)} poses, got {rows.min()} to {rows.max()}")
        if (loops := np.flatnonzero(self.first == self.second)).size:
            raise ValueError(f"second: edge {loops[0]} connects pose {self.first[loops[0]]} with itself")
        if not np.array_equal(self.information, self.information.transpose(0, 2, 1)):
            raise ValueError("information: not symmetric")

    def __len__(self) -> int:
        return len(self.poses)

    def residuals(self) -> Floats:
        """Return the residuals (M, 3) in m, m, rad."""
        expected = se2.between(self.poses[self.first], self.poses[self.second])
        return se2.between(self.first_from_second, expected)

    def chi_squares(self) -> Floats:
        """Return the squared Mahalanobis distance (M,) of each edge; the sum is the graph's chi-square."""
        residuals = self.residuals()
        return np.asarray(np.einsum("mi,mij,mj->m", residuals, self.information, residuals))

    def moved(self, poses: Floats) -> PoseGraph:
        """Return the graph with other poses (N, 3)."""
        return replace(self, poses=poses)
