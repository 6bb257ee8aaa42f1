"""Two back ends asked the same questions, scan by scan, so that no error of one scan reaches the next.

The first runs over the sequence as it would alone; the second is then asked what the first was asked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from evalkit.commands.validate.rules.rule import raised
from evalkit.core.errors import BackendFailed
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import NoAnswer, Odometry, Registration, Sequence
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

DISTURBED = "-disturbed"
"""Ending of the stage of a question whose guess is off."""

DISTURBED_M = 0.3
DISTURBED_RAD = 0.15
"""How far off a disturbed guess is: well within what the paper's method recovers from."""

REMEDY = "make sure that it runs alone before comparing it"


@dataclass(frozen=True)
class Side:
    """One of the two: its label, its spec and all its parameters, the front end's included."""

    label: str
    spec: BackendSpec
    parameters: Mapping[str, Value]

    def registrations(self) -> dict[str, Registration]:
        """A fresh registration for each stage of the front end; raises TypeError where the side is no registration."""
        if not isinstance(self.spec, RegistrationSpec):
            raise TypeError(f"{self.label}: a {self.spec.kind} has no registrations")
        return dict(zip(("s2s", "s2m"), self.spec.make_stages(self.parameters), strict=True))


@dataclass(frozen=True, eq=False)
class Question:
    """What a registration is asked, and where in the sequence; scans count from 1."""

    scan: int
    stage: str
    target: Cloud
    source: Cloud
    guess: Pose


@dataclass(frozen=True, eq=False)
class Exchange:
    """One question with both answers; ``b`` is None where the second has none, and ``failure`` says why."""

    question: Question
    a: Match
    b: Match | None
    failure: str = ""

    @property
    def disturbed(self) -> bool:
        """Whether the guess was not the front end's but one that is off."""
        return self.question.stage.endswith(DISTURBED)


@dataclass(frozen=True, eq=False)
class Step:
    """One scan of two odometries; None where one had no answer, and ``failure`` says why."""

    scan: int
    a: Pose | None
    b: Pose | None
    failure: str = ""


Call = tuple[Cloud, Cloud, Pose, Match]
"""Target, source, guess and answer of one registration."""


class _RecordingRegistration:
    """A registration that appends its calls to a list."""

    def __init__(self, registration: Registration, calls: list[Call]) -> None:
        self._registration, self._calls = registration, calls

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        match = self._registration.register(target, source, guess)
        self._calls.append((target, source, guess, match))
        return match


def exchanges(a: Side, b: Side, sequence: Sequence, scans: int, disturbed: bool = True) -> Iterator[Exchange]:
    """Every question of the first ``scans`` scans, from running ``a`` through the front end, with both answers.

    ``disturbed``: each scan's last question is asked again with a guess that is off, since rules about outliers and
    limits show only on a long way; its stage ends in "-disturbed".
    """
    calls: list[Call] = []

    def make(**parameters: Value) -> _RecordingRegistration:
        return _RecordingRegistration(a.spec.make(**parameters), calls)

    runner = frontend.make_odometry(replace(a.spec, make=make), a.parameters)
    others, again = b.registrations(), a.registrations()
    rng = np.random.default_rng(0)
    for scan, frame in enumerate(islice(sequence.frames(), scans), start=1):
        calls.clear()
        estimate = _update(a.label, runner, frame, scan)
        answered = [
            (Question(scan, stage, target, source, guess), match)
            for stage, (target, source, guess, match) in (zip(estimate.stages, calls, strict=True) if estimate else ())
        ]
        for question, match in answered:
            yield asked(others[question.stage], question, match)
        if disturbed and answered:
            stage = answered[-1][0].stage
            question = _disturbed(answered[-1][0], rng)
            try:
                match = again[stage].register(question.target, question.source, question.guess)
            except Exception as error:  # a third party's code: what it raises is not ours to let through
                raise BackendFailed(a.label, f"scan {scan}, disturbed: {raised(error)}", REMEDY) from error
            yield asked(others[stage], question, match)


def _disturbed(question: Question, rng: np.random.Generator) -> Question:
    """The same question with a guess that is off in a random direction, by as much every time."""
    way = rng.uniform(-np.pi, np.pi)
    turn = DISTURBED_RAD * rng.choice([-1.0, 1.0])
    off = Pose(DISTURBED_M * float(np.cos(way)), DISTURBED_M * float(np.sin(way)), turn)
    return replace(question, stage=question.stage + DISTURBED, guess=question.guess @ off)


def asked(registration: Registration, question: Question, a: Match) -> Exchange:
    """What a registration says to a question that has been answered by another."""
    try:
        b: Any = registration.register(question.target, question.source, question.guess)
    except Exception as error:  # noqa: BLE001 - a third party's crash is a difference to report
        return Exchange(question, a, None, raised(error))
    if not isinstance(b, Match):
        return Exchange(question, a, None, f"answers a {type(b).__name__}, expected an evalkit.Match")
    return Exchange(question, a, b)


def steps(a: Side, b: Side, sequence: Sequence, scans: int) -> Iterator[Step]:
    """The poses of two odometries, each following the first ``scans`` scans by itself."""
    first, second = (frontend.make_odometry(side.spec, side.parameters) for side in (a, b))
    for scan, frame in enumerate(islice(sequence.frames(), scans), start=1):
        estimate = _update(a.label, first, frame, scan)
        pose = None if estimate is None else estimate.pose
        try:
            yield Step(scan, pose, second.update(frame).pose)
        except NoAnswer as reason:
            yield Step(scan, pose, None, f"no answer: {reason}")
        except Exception as error:  # noqa: BLE001 - a third party's crash is a difference to report
            yield Step(scan, pose, None, raised(error))
            return


def _update(label: str, odometry: Odometry, frame: Frame, scan: int) -> OdometryEstimate | None:
    try:
        return odometry.update(frame)
    except NoAnswer:
        return None
    except Exception as error:  # a third party's code: what it raises is not ours to let through
        raise BackendFailed(label, f"scan {scan}: {raised(error)}", REMEDY) from error
