"""Find out that a lidar turns once a scan where its scans have no times of beams.

Many drivers, and points of 3D lidars that were projected to a plane, leave them out. The scan of a robot that turns is
then bent, by 10 deg and more, and the map with it. What a turning robot sees shows it: where the first beams lie on the
map as they should, the last ones do not. The residuals of a matched scan tell which share of the period the sweep took,
and in which order; but the map consists of scans that are bent alike, so that they tell a small part of it only, with
the right sign. So they are summed up until they are clear.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit_baselines.slam.observability import Pairs

FULL_RAD = math.radians(300.0)
"""A lidar whose beams span less is thought to measure all at once: it may sweep during any part of its period."""

TURNED_RAD = math.radians(2.0)
"""Scans between which the robot turned by less tell nothing."""

MIN_PAIRS = 20
SURE_M2 = 1.0
"""The sum of squared displacements after which the share is moved: with range noise of 3 cm it is known to 0.03."""

GAIN = 2.0
"""The share is moved by so many times what the residuals tell; simulated lidars show 0.2 of it at first, then 0.05."""

FORGOTTEN = 0.1
"""And by this part towards what is assumed now: noise alone does not reach ``SWEEPS``."""

SWEEPS, STANDS = 0.6, 0.3
"""From this share on the lidar is thought to turn once a scan, below the other one not any more."""

_CAUCHY_M = 0.1
_RIDGE = 1e-6


class SweepTimes:
    """Finds the order of the beams, and undoes the motion within the scans; one scan after the other."""

    def __init__(self) -> None:
        self._order = 0
        self._share = 0.0
        self._squared_m2 = self._moved_m2 = 0.0
        self._stamps_ns: tuple[int, ...] = ()  # of the last two scans, the latest first
        self._period_ns = 0

    def take(self, frame: Frame) -> int:
        """Take the next scan; return how long it took (ns), negative where beams are fired in the opposite order.

        0: all beams are fired at once, or have times, or nothing is known yet.
        """
        before = (frame.scan.stamp_ns, *self._stamps_ns)
        self._stamps_ns = before[:2]
        self._period_ns = min(later - earlier for earlier, later in pairwise(before[::-1])) if len(before) > 2 else 0
        return self._order * self._period_ns if is_full_circle(frame) else 0

    def is_informative(self, frame: Frame, step: Pose) -> bool:
        """Return whether a scan, as it came, would tell something; ``step``: motion since the last one."""
        return self._period_ns > 0 and abs(step.theta) >= TURNED_RAD and is_full_circle(frame)

    def observe(self, angles: Floats, base_from_sensor: Pose, step: Pose, pairs: Pairs) -> None:
        """Take a matched scan that ``is_informative``: its angles (B,) as they came, and its pairs with the map."""
        if len(pairs.points) < MIN_PAIRS:
            return
        share = self._period_ns / (self._stamps_ns[0] - self._stamps_ns[1])
        points, normals = pairs.points, pairs.normals
        residual = ((pairs.targets - points) * normals).sum(axis=1)
        across = points[:, 0] * normals[:, 1] - points[:, 1] * normals[:, 0]
        seen = base_from_sensor.inverse().transform(points)
        moved = (step.x * normals[:, 0] + step.y * normals[:, 1] + step.theta * across) * share
        moved *= _find_times(angles, np.arctan2(seen[:, 1], seen[:, 0]))
        weights = 1.0 / (1.0 + (residual / _CAUCHY_M) ** 2)
        free = np.column_stack([normals, across])  # the pose of the scan
        left, right = (free.T @ (weights * each) for each in (moved, residual))
        along = np.linalg.solve(free.T @ (weights[:, None] * free) + _RIDGE * np.eye(3), left)
        self._squared_m2 += float(weights @ (moved * moved) - left @ along)
        self._moved_m2 += float(weights @ (moved * residual) - right @ along)
        if self._squared_m2 >= SURE_M2:
            self._decide(self._moved_m2 / self._squared_m2)
            self._squared_m2 = self._moved_m2 = 0.0

    def _decide(self, more: float) -> None:
        share = self._share + GAIN * more + FORGOTTEN * (self._order - self._share)
        self._share = min(max(share, -1.0), 1.0)
        if abs(self._share) >= SWEEPS:
            self._order = 1 if self._share > 0.0 else -1
        elif abs(self._share) < STANDS:
            self._order = 0


def is_full_circle(frame: Frame) -> bool:
    """Return whether a scan without times of beams spans a full circle."""
    angles = frame.scan.angles
    untimed = frame.scan.time_increment_ns == 0 and len(angles) > 1
    return untimed and abs(float(angles[-1] - angles[0])) >= FULL_RAD


def deskew(frame: Frame, first_from_last: Pose) -> Frame:
    """Return a frame without times of beams with the motion within its scan undone; its stamp is in the middle.

    So the scan lies where it lay, bent, and no answer depends on what its stamp is the time of.
    """
    swept = replace(frame.scan, time_increment_ns=1)
    return replace(frame, scan=swept.deskewed(frame.base_from_sensor, first_from_last, at=0.5))


def _find_times(angles: Floats, bearings: Floats) -> Floats:
    """Return when points at bearings (K,) were seen, as shares of the sweep from its middle, -0.5 to 0.5."""
    span = float(angles[-1] - angles[0])
    ahead = (bearings - angles[0]) * (1.0 if span > 0.0 else -1.0)
    half_beam = 0.5 * abs(span) / (len(angles) - 1)  # no beam lies at the border, where rounding would decide
    return np.asarray(np.mod((ahead + half_beam) / (2.0 * math.pi), 1.0) - 0.5)
