"""A SLAM with correct poses whose answers at the end are wrong in the way set by its parameter."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import SlamSpec

STEP_M, SHIFT_M = 0.1, 0.01


def _without_check(trajectory: Trajectory) -> Trajectory:
    object.__setattr__(trajectory, "poses", np.full_like(trajectory.poses, math.nan))
    return trajectory


def _fail(trajectory: Trajectory) -> Trajectory:
    raise RuntimeError("the graph is torn")


FAULTS: dict[str, Callable[[Trajectory], object]] = {
    "none": lambda found: found,
    "missing": lambda found: Trajectory(np.delete(found.stamps_ns, 3), np.delete(found.poses, 3, axis=0)),
    "nan": _without_check,
    "list": lambda found: found.poses.tolist(),
    "raise": _fail,
    "hang": lambda found: time.sleep(600),
    "stranger": lambda found: found,
}


class FaultySlam:
    """Poses 0.1 m apart; the corrected ones are 1 cm to the left, except the first. The last scan closes a loop."""

    def __init__(self, fault: str) -> None:
        self._fault, self._stamps = fault, list[int]()

    def update(self, frame: Frame) -> OdometryEstimate:
        """Return the pose; the eighth update corrects."""
        self._stamps.append(frame.scan.stamp_ns)
        count = len(self._stamps)
        return OdometryEstimate(Pose((count - 1) * STEP_M, 0.0, 0.0), corrected=count == 8)

    def trajectory(self) -> object:
        """Return the corrected poses, or the faulty answer."""
        poses = np.zeros((len(self._stamps), 3))
        poses[:, 0] = np.arange(len(poses)) * STEP_M
        poses[1:, 1] = SHIFT_M
        return FAULTS[self._fault](Trajectory(self._stamps, poses, "start", "base"))

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return one accepted and one rejected candidate."""
        first, last = self._stamps[0], self._stamps[-1]
        other = first - 1 if self._fault == "stranger" else first
        return (
            LoopClosure(self._stamps[-2], first, Pose(), False, "score 0.2 < 0.6"),
            LoopClosure(last, other, Pose((len(self._stamps) - 1) * STEP_M, 0.0, 0.0), True, "score 0.9"),
        )

    def remarks(self) -> tuple[str, ...]:
        """Return one."""
        return (f"no room after {len(self._stamps)} scans",)


SPEC = SlamSpec(
    make=FaultySlam,
    summary="corrects poses in the way set by its parameter",
    citation="Murphy",
    licence="MIT",
    parameters=(Parameter("fault", "none", "", "what goes wrong", choices=tuple(FAULTS)),),
)
