"""The answer of an odometry to one scan: pose, stages, acceptance and cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from evalkit.core.pose import Pose
from evalkit.core.timing import NO_COST, Cost

Stage = Literal["s2s", "s2m"]
"""Scan-to-scan and scan-to-map."""


@dataclass(frozen=True, slots=True)
class StageEstimate:
    """Result of the registration of one stage.

    ``accepted``: False where the stage kept its initial guess. ``residual_m``: final error in metres, nan where there
    is none. ``inliers``: number of pairs.
    """

    accepted: bool
    converged: bool
    iterations: int
    residual_m: float
    inliers: int


@dataclass(frozen=True, slots=True)
class OdometryEstimate:
    """Answer of an odometry to one scan.

    ``pose``: ``start_from_base`` at the scan's first beam. ``stages``: the registrations behind it, in the order in
    which they ran, as far as the odometry reports them. ``accepted``: whether the pose comes from a registration (True)
    or is only the initial guess (False); None: not reported. ``cost``: what only the odometry itself can measure.
    ``corrected``: of a SLAM, whether this update moved poses of earlier frames by more than 1 cm or 0.5 deg; None: not
    reported, then the frames of its accepted loop closures count as corrections.
    """

    pose: Pose
    stages: Mapping[Stage, StageEstimate] = field(default_factory=dict)
    accepted: bool | None = None
    cost: Cost = NO_COST
    corrected: bool | None = None
