"""Run an odometry over frames: order check, timing, scans without an answer, check of each answer."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from functools import partial
from typing import NamedTuple, get_args

import numpy as np

from evalkit.core.errors import BadData, brief
from evalkit.core.odometry_estimate import OdometryEstimate, Stage, StageEstimate
from evalkit.core.pose import TOO_FAR, Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import CallTiming, timed
from evalkit.plugins.protocols import NoAnswer, Odometry

STAGES = get_args(Stage)


class OdometryStep(NamedTuple):
    """One scan: its frame, the estimate and the time of the call.

    ``estimate`` is None where the odometry raised ``NoAnswer``; ``reason`` then holds the text.
    """

    frame: Frame
    estimate: OdometryEstimate | None
    timing: CallTiming
    reason: str = ""


def run_odometry(odometry: Odometry, frames: Iterable[Frame], source: str = "frames") -> Iterator[OdometryStep]:
    """Yield one step per frame; the odometry is called when the step is requested.

    ``source`` names the frames in errors. Raises BadData where stamps do not increase, TypeError or ValueError where
    ``update`` returns something else than a finite ``OdometryEstimate``, and whatever ``update`` raises.
    """
    for frame in check_order(frames, source):
        answer, timing = timed(partial(answer_frame, odometry, frame))
        if isinstance(answer, NoAnswer):
            yield OdometryStep(frame, None, timing, str(answer))
        else:
            estimate = check_estimate(answer)
            yield OdometryStep(frame, estimate, timing.including(estimate.cost))


def answer_frame(odometry: Odometry, frame: Frame) -> OdometryEstimate | NoAnswer:
    """Return what ``update`` returns, unchecked (``check_estimate``), or the ``NoAnswer`` that it raises.

    The step of ``run_odometry``, for callers that give several odometries each frame in turn or time the call
    themselves. Raises whatever else ``update`` raises.
    """
    try:
        return odometry.update(frame)
    except NoAnswer as reason:
        return reason


def estimate_poses(odometry: Odometry, frames: Iterable[Frame]) -> Floats:
    """Return ``start_from_base`` (N, 3) for every frame, nan where the odometry has no answer.

    Raises the exceptions of ``run_odometry``.
    """
    estimates = (step.estimate for step in run_odometry(odometry, frames))
    return np.array([np.full(3, np.nan) if found is None else found.pose.row for found in estimates]).reshape(-1, 3)


def check_order(frames: Iterable[Frame], source: str) -> Iterator[Frame]:
    """Yield the frames; raises BadData where their stamps do not increase."""
    last_ns: int | None = None
    for index, frame in enumerate(frames):
        if last_ns is not None and frame.scan.stamp_ns <= last_ns:
            found = f"stamp {frame.scan.stamp_ns} ns is not later than the one before, {last_ns} ns"
            raise BadData(source, f"scan {index + 1}", found, "give the scans in the order of time")
        last_ns = frame.scan.stamp_ns
        yield frame


def check_estimate(answer: object) -> OdometryEstimate:
    """Return the answer of ``update``; raises TypeError for another type, of the answer or of its parts.

    Raises ValueError for a pose that is not finite, or farther away than ``MAX_COORDINATE_M``.
    """
    if not isinstance(answer, OdometryEstimate):
        raise TypeError(f"update() returned a {type(answer).__name__}, expected an evalkit.OdometryEstimate")
    pose: object = answer.pose
    if not isinstance(pose, Pose):
        raise TypeError(f"update() returned a pose of type {type(pose).__name__}, expected an evalkit.Pose")
    if not all(map(math.isfinite, (pose.x, pose.y, pose.theta))):  # a subclass of Pose may skip the check
        raise ValueError(f"update() returned a pose that is not finite: ({pose.x}, {pose.y}, {pose.theta})")
    if pose.is_too_far:
        raise ValueError(f"update() returned a pose {TOO_FAR}: ({pose.x}, {pose.y})")
    for name, stage in answer.stages.items():
        if name not in STAGES or not isinstance(stage, StageEstimate):
            what = f"{brief(name)}: a {type(stage).__name__}"
            raise TypeError(
                f"update() returned stages with {what}, expected an evalkit.StageEstimate by 's2s' or 's2m'"
            )
    return answer
