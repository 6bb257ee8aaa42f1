"""Faults of the answer of a registration, to mix into a class that answers correctly: ``class Mine(Degrees, Icp)``."""

from __future__ import annotations

import math
from dataclasses import replace

from evalkit.core.match import Match
from evalkit.core.pose import Pose


class Changed:
    """Changes the motion of every answer."""

    def register(self, target, source, guess) -> Match:
        match = super().register(target, source, guess)
        return replace(match, target_from_source=self.change(match.target_from_source))


class Degrees(Changed):
    def change(self, pose: Pose) -> Pose:
        return Pose(pose.x, pose.y, math.degrees(pose.theta))


class Clockwise(Changed):
    def change(self, pose: Pose) -> Pose:
        return Pose(pose.x, pose.y, -pose.theta)


class Inverse(Changed):
    def change(self, pose: Pose) -> Pose:
        return pose.inverse()


class Millimetres(Changed):
    def change(self, pose: Pose) -> Pose:
        return Pose(1000.0 * pose.x, 1000.0 * pose.y, pose.theta)


class Biased(Changed):
    """Adds an error of 3 cm, always in the same direction in the target's frame."""

    def change(self, pose: Pose) -> Pose:
        return Pose(0.03) @ pose
