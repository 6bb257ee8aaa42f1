"""A rigid motion of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.se2 import Floats

MAX_COORDINATE_M = 1e7
"""Answers and files with a pose farther away are refused: no robot drives so far, and computations overflow."""

TOO_FAR = f"farther away than {MAX_COORDINATE_M:,.0f} m"


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid motion of the plane, ``a_from_b``: x, y in metres, theta in radians within [-pi, pi)."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.theta)):
            raise ValueError(f"pose: not finite: ({self.x}, {self.y}, {self.theta})")
        object.__setattr__(self, "theta", se2.wrap_angle(self.theta))

    @classmethod
    def of(cls, row: ArrayLike) -> Pose:
        """Return the pose of a row (3,) of x, y, theta."""
        x, y, theta = np.asarray(row, dtype=np.float64)
        return cls(float(x), float(y), float(theta))

    @classmethod
    def of_checked(cls, x: float, y: float, theta: float) -> Pose:
        """Return the pose of values that were those of a pose before: neither checked nor wrapped."""
        pose, put = object.__new__(cls), object.__setattr__
        put(pose, "x", x)
        put(pose, "y", y)
        put(pose, "theta", theta)
        return pose

    @property
    def is_too_far(self) -> bool:
        """Whether a coordinate is beyond ``MAX_COORDINATE_M``."""
        return not max(abs(self.x), abs(self.y)) <= MAX_COORDINATE_M

    @property
    def row(self) -> Floats:
        """x, y, theta as an array (3,)."""
        return np.array([self.x, self.y, self.theta])

    def __matmul__(self, other: Pose) -> Pose:
        """Return ``a_from_c`` for ``a_from_b @ b_from_c``."""
        return Pose(*se2.compose_one(self._motion, other._motion))

    def inverse(self) -> Pose:
        """Return ``b_from_a``."""
        return Pose(*se2.invert_one(self._motion))

    def transform(self, points: ArrayLike) -> Floats:
        """Return points (N, 2) of frame b in frame a."""
        return se2.transform(self.row, points)

    @property
    def _motion(self) -> se2.PoseValues:
        return float(self.x), float(self.y), self.theta
