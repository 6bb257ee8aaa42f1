"""Motion prior: the motion of the base since the previous scan, and within the current one."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame


class _Step(NamedTuple):
    """A motion of the base and its duration."""

    motion: Pose
    duration_ns: int


class _Time(NamedTuple):
    """A pose of the base and its time."""

    start_from_base: Pose
    stamp_ns: int


class MotionPrior:
    """The motion by wheel odometry or, without it, at a constant velocity; ``prior`` as in ``FrontEndSettings``.

    A scan that is deskewed at a wrong velocity is bent, but half of its beams are displaced to one side and half to the
    other: where it is matched, the base is right in the middle of the sweep. So where the motion within the scan is not
    measured, the velocity is that from the middle of the last sweep to the middle of this one, and going back from the
    middle at that velocity gives the pose at the first beam. Where beams have times, stamps less than half a sweep
    apart (the same scan twice, or stamps of arrival) tell no velocity: it stays, and the next one is measured from the
    sweep before them.
    """

    def __init__(self, prior: str, deskew: bool = True) -> None:
        self._prior, self._deskew = prior, deskew
        self._step = _Step(Pose(), 0)
        self._last: _Time | None = None  # at the first beam
        self._last_middle = _Time(Pose(), 0)  # of a sweep, from where the next velocity is measured
        self._start_from_points = Pose()
        self._points_from_base: Pose | None = None  # at the first beam of the last scan; None: the identity
        self._odom_from_base: Pose | None = None

    def predict(self, frame: Frame) -> tuple[Pose, Pose]:
        """Return the pose of the last scan's points, ``start_from_last``, and the guess ``last_from_base``."""
        step = self._wheel_step(frame)
        if step is None:
            elapsed = 0 if self._last is None else frame.scan.stamp_ns - self._last.stamp_ns
            step = self._constant_velocity(self._step, elapsed)
        return self._start_from_points, step if self._points_from_base is None else self._points_from_base @ step

    def extrapolate(self, elapsed_ns: int) -> Pose:
        """Return the motion over a time, which may be negative, at the velocity of the last step."""
        return self._constant_velocity(self._step, elapsed_ns)

    def is_measured(self, frame: Frame) -> bool:
        """Return whether wheel odometry measured the motion since the previous scan."""
        return self._wheel_step(frame) is not None

    def within_scan(self, frame: Frame) -> Pose | None:
        """Return ``start_from_end``, the base's motion from this scan's first beam to its last."""
        if self._is_measured_within(frame):
            return frame.start_from_end
        return self._constant_velocity(self._step, frame.scan.duration_ns)

    def find_first_beam(self, frame: Frame, start_from_points: Pose) -> Pose:
        """Return the pose at the first beam of a scan whose points, deskewed, were matched at a pose."""
        return self._settle(frame, start_from_points, self._half_ns(frame))[0]

    def store(self, frame: Frame, pose: Pose, matched: bool = True) -> None:
        """Store the pose of this scan: that of its points, or where they were not ``matched``, at the first beam."""
        first, self._last_middle, self._step = self._settle(frame, pose, self._half_ns(frame) if matched else 0)
        self._last = _Time(first, frame.scan.stamp_ns)
        self._start_from_points, self._points_from_base = pose, None if first is pose else pose.inverse() @ first
        self._odom_from_base = frame.odom_from_base

    def _is_measured_within(self, frame: Frame) -> bool:
        return self._prior == "odometry" and frame.start_from_end is not None

    def _half_ns(self, frame: Frame) -> int:
        """Return the time from the first beam to the middle of the sweep; 0 where the scan was not bent by a guess."""
        bent = self._deskew and self._prior != "none" and not self._is_measured_within(frame)
        return frame.scan.duration_ns // 2 if bent else 0

    def _settle(self, frame: Frame, pose: Pose, half_ns: int) -> tuple[Pose, _Time, _Step]:
        """Return the pose at the first beam, the middle from where the next velocity is measured, and the step to it.

        A sweep that was taken less than half a sweep after the last one tells no velocity: both stay.
        """
        half = self._constant_velocity(self._step, half_ns) if half_ns else None
        middle = _Time(pose if half is None else pose @ half, frame.scan.stamp_ns + half_ns)
        kept, step, before = middle, self._step, self._last_middle
        elapsed_ns = middle.stamp_ns - before.stamp_ns
        if self._last is not None and max(elapsed_ns, 0) < half_ns:
            kept = before
        elif self._last is not None:
            step = _Step(before.start_from_base.inverse() @ middle.start_from_base, elapsed_ns)
        first = middle.start_from_base @ self._constant_velocity(step, half_ns).inverse() if half_ns else pose
        return first, kept, step

    def _wheel_step(self, frame: Frame) -> Pose | None:
        if self._prior != "odometry" or frame.odom_from_base is None or self._odom_from_base is None:
            return None
        return self._odom_from_base.inverse() @ frame.odom_from_base

    def _constant_velocity(self, step: _Step, elapsed_ns: int) -> Pose:
        if self._prior == "none" or step.duration_ns <= 0:
            return Pose()
        share = min(elapsed_ns / step.duration_ns, 2.0)  # after a long gap the last speed has no meaning
        return Pose.of(se2.fraction(step.motion.row, np.array([share]))[0])
