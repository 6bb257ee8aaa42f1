"""A rigid motion of the plane."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.se2 import Floats


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid motion of the plane, ``a_from_b``: x, y in metres, theta in radians within [-pi, pi)."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.x) and math.isfinite(self.y) and math.isfinite(self.theta)):
            raise ValueError(f"pose: not finite: ({self.x}, {self.y}, {self.theta})")
        object.__setattr__(self, "theta", _wrap(self.theta))

    @classmethod
    def of(cls, row: ArrayLike) -> Pose:
        """Return the pose of a row (3,) of x, y, theta."""
        x, y, theta = np.asarray(row, dtype=np.float64)
        return cls(float(x), float(y), float(theta))

    @property
    def row(self) -> Floats:
        """x, y, theta as an array (3,)."""
        return np.array([self.x, self.y, self.theta])

    def __matmul__(self, other: Pose) -> Pose:
        """Return ``a_from_c`` for ``a_from_b @ b_from_c``."""
        cos, sin = _direction(self.theta)
        x = self.x + cos * other.x - sin * other.y
        y = self.y + sin * other.x + cos * other.y
        return Pose(float(x), float(y), _wrap(self.theta + other.theta))

    def inverse(self) -> Pose:
        """Return ``b_from_a``."""
        cos, sin = _direction(self.theta)
        return Pose(float(-cos * self.x - sin * self.y), float(sin * self.x - cos * self.y), _wrap(-self.theta))

    def transform(self, points: ArrayLike) -> Floats:
        """Return points (N, 2) of frame b in frame a."""
        return se2.transform(self.row, points)


def _wrap(theta: float) -> float:
    """Return what ``se2.wrap`` returns, without arrays: they cost ten times as much for one angle."""
    return (float(theta) + math.pi) % (2.0 * math.pi) - math.pi


def _direction(theta: float) -> tuple[float, float]:
    """Return cosine and sine of NumPy, whose last bits may differ from those of ``math``."""
    return float(np.cos(theta)), float(np.sin(theta))
