"""Pairs of scans of a sequence with their known motion: questions to a single registration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence.lockstep import (
    DISTURBED,
    DISTURBED_M,
    DISTURBED_RAD,
    ComparedBackend,
    Question,
    draw_motion,
)
from evalkit.core import se2
from evalkit.core.arrays import spread_indices
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.odometry import frontend
from evalkit.plugins.protocols import Odometry, Sequence

STAGE = "pair"
NEAR_M, NEAR_RAD = 0.05, 0.035
"""Error of a near guess: 5 cm and 2 degrees, a typical error of wheel odometry between two scans."""

MAX_SCANS_APART = 5
PERIOD_NS = 100_000_000


@dataclass(frozen=True, eq=False)
class ScanPair:
    """A question and the true motion, None if that is not exactly known."""

    question: Question
    truth: Pose | None


def scan_pairs(sequence: Sequence, count: int, exact: bool) -> Iterator[ScanPair]:
    """``count`` pairs spread over a sequence, each with a near guess and with a disturbed guess.

    ``exact``: the truth of the sequence has no error, so the pairs include it. The second scan is one to five scans
    after the first if the motion between them is known, else the next one.
    """
    frames, truth = list(sequence.frames()), sequence.truth().trajectory
    rng = np.random.default_rng(0)
    for number, first in enumerate(spread_indices(len(frames) - 1, count).tolist(), start=1):
        last = min(first + 1 + number % MAX_SCANS_APART, len(frames) - 1)
        motion = _motion(frames[first], frames[last], truth)
        if motion is None:
            last = first + 1
            motion = _motion(frames[first], frames[last], truth) or Pose()
        target, source = (Cloud(each.points_in_base(each.start_from_end)) for each in (frames[first], frames[last]))
        for stage, metres, radians in ((STAGE, NEAR_M, NEAR_RAD), (STAGE + DISTURBED, DISTURBED_M, DISTURBED_RAD)):
            guess = motion @ draw_motion(rng, metres, radians)
            yield ScanPair(Question(number, stage, target, source, guess), motion if exact else None)


class TwoScans:
    """An odometry as a Registration: a new one processes both clouds as scans, with the guess as wheel odometry."""

    def __init__(self, side: ComparedBackend) -> None:
        self._side = side

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """The pose of the second scan; iterations and pairs are unknown."""
        odometry: Odometry = frontend.make_odometry(self._side.spec, self._side.parameters)
        odometry.update(_frame(target, 0, Pose()))
        pose = odometry.update(_frame(source, PERIOD_NS, guess)).pose
        return Match(pose, True, 0, float("nan"), 0)


def residual_m(question: Question, answer: Pose) -> float:
    """The mean distance (m) of the source points, moved by an answer, to their nearest neighbours in the target."""
    moved = answer.transform(question.source.points)
    return float(np.mean(cKDTree(question.target.points).query(moved)[0]))


def _motion(first: Frame, last: Frame, truth: Trajectory | None) -> Pose | None:
    """``first_from_last`` by the truth, else by wheel odometry, else None."""
    stamps = np.array([first.scan.stamp_ns, last.scan.stamp_ns])
    if truth is not None and can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S).all():
        return Pose.of(se2.between(*truth.at(stamps)))
    if first.odom_from_base is None or last.odom_from_base is None:
        return None
    return first.odom_from_base.inverse() @ last.odom_from_base


def _frame(cloud: Cloud, stamp_ns: int, odom_from_base: Pose) -> Frame:
    """A cloud as a scan with simultaneous beams, from a sensor at the origin of the base."""
    ranges: Floats = np.hypot(*cloud.points.T)
    angles: Floats = np.arctan2(cloud.points[:, 1], cloud.points[:, 0])
    reach = float(ranges.max(initial=1.0)) + 1.0
    return Frame(Scan(stamp_ns, ranges, angles, 0.0, reach), Pose(), odom_from_base, Pose())
