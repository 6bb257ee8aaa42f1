"""Pairs of scans with what is known of the motion between them: what a registration is asked apart from any path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence.lockstep import DISTURBED, DISTURBED_M, DISTURBED_RAD, Question, Side
from evalkit.core import se2
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.odometry import frontend
from evalkit.plugins.protocols import Odometry, Sequence

STAGE = "pair"
CALM_M, CALM_RAD = 0.05, 0.035
"""How far off the guesses are that all depend on: 5 cm and 2 degrees, what wheels may be off between two scans."""

MAX_APART = 5  # scans from the first to the second of a pair
PERIOD_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class Pair:
    """One question and the motion it asks for, None where that is not exactly known."""

    question: Question
    truth: Pose | None


def pairs(sequence: Sequence, count: int, exact: bool) -> Iterator[Pair]:
    """``count`` pairs spread over a sequence, each asked twice: with a guess little off, and far off (disturbed).

    ``exact``: the truth of the sequence is without error, and a pair's is told. The second scan is one to five after
    the first, where it is known how far that is; else it is the next one.
    """
    frames, truth = list(sequence.frames()), sequence.truth().trajectory
    rng = np.random.default_rng(0)
    for number, first in enumerate(_evenly(len(frames) - 1, count), start=1):
        last = min(first + 1 + number % MAX_APART, len(frames) - 1)
        motion = _motion(frames[first], frames[last], truth)
        if motion is None:
            last = first + 1
            motion = _motion(frames[first], frames[last], truth) or Pose()
        clouds = _cloud(frames[first]), _cloud(frames[last])
        for stage, metres, radians in ((STAGE, CALM_M, CALM_RAD), (STAGE + DISTURBED, DISTURBED_M, DISTURBED_RAD)):
            guess = motion @ _off(rng, metres, radians)
            yield Pair(Question(number, stage, *clouds, guess), motion if exact else None)


class TwoScans:
    """An odometry as a Registration: a fresh one sees both clouds as scans, and wheels that say the guess."""

    def __init__(self, side: Side) -> None:
        self._side = side

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Where the second scan was; neither iterations nor pairs are told."""
        odometry: Odometry = frontend.make_odometry(self._side.spec, self._side.parameters)
        odometry.update(_frame(target, 0, Pose()))
        pose = odometry.update(_frame(source, PERIOD_NS, guess)).pose
        return Match(pose, True, 0, float("nan"), 0)


def residual_m(question: Question, answer: Pose) -> float:
    """The mean distance (m) of the source's points, where an answer puts them, to their nearest neighbours."""
    moved = answer.transform(question.source.points)
    return float(np.mean(cKDTree(question.target.points).query(moved)[0]))


def radius_m(question: Question) -> float:
    """The root mean square distance (m) of the source's points from their centroid."""
    arms = question.source.points - question.source.points.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum(arms**2, axis=1))))


def _motion(first: Frame, last: Frame, truth: Trajectory | None) -> Pose | None:
    """``first_from_last`` by the truth, else by the wheels, else None."""
    stamps = np.array([first.scan.stamp_ns, last.scan.stamp_ns])
    if truth is not None and can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S).all():
        return Pose.of(se2.between(*truth.at(stamps)))
    if first.odom_from_base is None or last.odom_from_base is None:
        return None
    return first.odom_from_base.inverse() @ last.odom_from_base


def _cloud(frame: Frame) -> Cloud:
    scan = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
    return Cloud(frame.base_from_sensor.transform(scan.points()), "base")


def _frame(cloud: Cloud, stamp_ns: int, odom_from_base: Pose) -> Frame:
    """A cloud as one scan of all beams at once, from a sensor in the base's origin."""
    ranges: Floats = np.hypot(*cloud.points.T)
    angles: Floats = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    reach = float(ranges.max(initial=1.0)) + 1.0
    return Frame(Scan(stamp_ns, ranges, angles, 0.0, reach), Pose(), odom_from_base, Pose())


def _off(rng: np.random.Generator, metres: float, radians: float) -> Pose:
    """A motion of that size in a random direction, turning either way."""
    way = rng.uniform(-np.pi, np.pi)
    turn = radians * rng.choice([-1.0, 1.0])
    return Pose(metres * float(np.cos(way)), metres * float(np.sin(way)), turn)


def _evenly(count: int, most: int) -> list[int]:
    return [int(i) for i in np.unique(np.linspace(0, count - 1, min(most, count)).astype(int))] if count > 0 else []
