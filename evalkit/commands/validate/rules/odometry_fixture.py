"""An odometry under test: new objects, and the answers to simulated drives."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from evalkit.commands.validate.rules.endurance import LEAK_BYTES, ResourceUse, measure_resource_use
from evalkit.commands.validate.rules.process_state import StateWatch
from evalkit.commands.validate.rules.rule import RuleBroken
from evalkit.commands.validate.rules.scenes import drive
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.odometry.run_odometry import answer_frame, check_estimate
from evalkit.plugins.protocols import NoAnswer, Odometry
from evalkit.plugins.specs import Role, RunsIn


class OdometryFixture:
    """A back end under test; runs each drive with a new object.

    ``elsewhere``, ``note_progress``, ``runs_in``: as for a ``RegistrationFixture``.
    """

    kept_bytes = LEAK_BYTES

    def __init__(
        self,
        make: Callable[[], Odometry],
        role: Role = "",
        seed: int = 0,
        elsewhere: Mapping[str, Any] = {},
        runs_in: RunsIn = "evalkit",
    ) -> None:
        self._make, self.role, self.seed, self.elsewhere = make, role, seed, elsewhere
        self.runs_in: RunsIn = runs_in
        self.watch = StateWatch()
        self.short = drive(8)
        self.asked_s = math.inf
        self.note_progress: Callable[..., object] = lambda *_: None

    def make(self) -> Odometry:
        """A new object."""
        made = self._make()
        self.watch.note_loaded()
        return made

    @cached_property
    def first_answers(self) -> Floats:
        """The answers (N, 3) to a short drive."""
        answers = self.run(self.short.frames)
        self.asked_s = time.monotonic()
        return answers

    @cached_property
    def endurance(self) -> ResourceUse:
        """What many scans of a standing robot do to the process."""
        frame = drive(1, standing=1).frames[0]

        def calls(odometry: Odometry) -> Callable[[], object]:
            stamps = iter(range(frame.scan.stamp_ns, 2**62, 100_000_000))
            return lambda: answer_row(odometry, replace(frame, scan=replace(frame.scan, stamp_ns=next(stamps))))

        found = measure_resource_use(self.make, calls, self.watch, self.kept_bytes)
        return replace(found, question="scan of a standing robot")

    def run(self, frames: Iterable[Frame]) -> Floats:
        """The answers (N, 3) to the frames, nan if there is none."""
        odometry = self.make()
        return np.array([answer_row(odometry, frame) for frame in frames])


def answer_row(odometry: Odometry, frame: Frame) -> Floats:
    """The answer (3,) to one frame, nan if the odometry raises NoAnswer."""
    answer = answer_frame(odometry, frame)
    return np.full(3, np.nan) if isinstance(answer, NoAnswer) else validate_pose(answer).row


def last_pose(answers: Floats) -> Pose:
    """The answer to the last scan."""
    if np.isnan(answers[-1]).any():
        raise RuleBroken("it has no answer to the last scan")
    return Pose.of(answers[-1])


def validate_pose(answer: object) -> Pose:
    """The pose of an estimate; raises RuleBroken if the answer is no finite estimate."""
    try:
        return check_estimate(answer).pose
    except (TypeError, ValueError) as error:
        raise RuleBroken(str(error)) from error
