"""Third-party back ends with one parameter that is best at 1: wheel odometry, stretched for other values."""

from __future__ import annotations

import math

from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import BackendSpec, OdometrySpec


class Stretched:
    """An Odometry: wheel odometry with lengths scaled by 1 + |log10(gain)|."""

    def __init__(self, gain: float) -> None:
        self._stretch = 1.0 + abs(math.log10(gain))
        self._start: Pose | None = None

    def update(self, frame: Frame) -> OdometryEstimate:
        """Return the scaled odometry pose."""
        at = frame.odom_from_base or Pose()
        self._start = self._start or at
        moved = self._start.inverse() @ at
        return OdometryEstimate(Pose(self._stretch * moved.x, self._stretch * moved.y, moved.theta))


class Hopeless(Stretched):
    """An Odometry that always raises."""

    def update(self, frame: Frame) -> OdometryEstimate:
        """Raise."""
        raise RuntimeError("hopeless")


def _spec(make: type[Stretched], default: float) -> BackendSpec:
    gain = Parameter("gain", default, "", "best at 1", low=0.1, high=10.0)
    return OdometrySpec(make, "stretched wheels", "none", "MIT", parameters=(gain,))


MISSET = _spec(Stretched, 4.0)
"""Its default is far from the best."""

PERFECT = _spec(Stretched, 1.0)
"""Its default is the best."""

HOPELESS = _spec(Hopeless, 1.0)
