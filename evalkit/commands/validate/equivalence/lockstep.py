"""The same questions to two back ends, scan by scan, so that an error in one scan does not affect the next.

The first back end runs over the sequence as it would alone; the second then answers the questions the first was given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from evalkit.core.errors import BackendFailed, BackendRefused, format_exception
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import answer_frame, check_estimate
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import NoAnswer, Odometry, Registration, Sequence
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

DISTURBED = "-disturbed"
"""Suffix of the stage of a question with a disturbed guess."""

DISTURBED_M = 0.3
DISTURBED_RAD = 0.15
"""Error of a disturbed guess, well within what the paper's method recovers from."""

MAX_STARTS = 5
"""Of a program: one that hangs takes its time for an answer each time."""

REMEDY = "make sure that it runs alone before comparing it"


@dataclass(frozen=True)
class ComparedBackend:
    """One of the two back ends: its label, its spec and all its parameters, those of the front end included."""

    label: str
    spec: BackendSpec
    parameters: Mapping[str, Value]

    def registrations(self) -> dict[str, Registration]:
        """A new registration for each stage of the front end; raises TypeError if the back end is no registration."""
        if not isinstance(self.spec, RegistrationSpec):
            raise TypeError(f"{self.label}: a {self.spec.kind} has no registrations")
        makers = self.spec.stage_makers(self.parameters)
        is_program = self.spec.runs_in != "evalkit"
        stages = (_RestartedRegistration(make) if is_program else make() for make in makers)
        return dict(zip(("s2s", "s2m"), stages, strict=True))


@dataclass(frozen=True, eq=False)
class Question:
    """The arguments of one registration, with the scan (from 1) and the stage it belongs to."""

    scan: int
    stage: str
    target: Cloud
    source: Cloud
    guess: Pose


@dataclass(frozen=True, eq=False)
class AnswerPair:
    """A question with both answers; ``b`` is None if the second has none, and ``failure`` gives the reason.

    ``reference``: what gave the first answer, to be asked again from it; None if it is no registration.
    """

    question: Question
    a: Match
    b: Match | None
    failure: str = ""
    reference: Registration | None = None

    @property
    def disturbed(self) -> bool:
        """Whether the guess was disturbed instead of the front end's own."""
        return self.question.stage.endswith(DISTURBED)


@dataclass(frozen=True, eq=False)
class PosePair:
    """One scan of two odometries; None if one has no answer, and ``failure`` gives the reason."""

    scan: int
    a: Pose | None
    b: Pose | None
    failure: str = ""


RecordedCall = tuple[Cloud, Cloud, Pose, Match]
"""Target, source, guess and answer of one registration."""


class _RestartedRegistration:
    """A registration by a program, which is started again for the next question after it has ended, a few times."""

    def __init__(self, make: Callable[[], Registration]) -> None:
        self._make, self._starts = make, 1
        self._registration: Registration | None = make()

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        if self._registration is None:
            self._starts += 1
            self._registration = self._make()
        try:
            return self._registration.register(target, source, guess)
        except BackendRefused:
            raise
        except BackendFailed:
            if self._starts < MAX_STARTS:
                self._registration = None
            raise


class _RecordingRegistration:
    """A registration that appends its calls to a list."""

    def __init__(self, registration: Registration, calls: list[RecordedCall]) -> None:
        self._registration, self._calls = registration, calls

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        match = self._registration.register(target, source, guess)
        self._calls.append((target, source, guess, match))
        return match


def answer_pairs(
    a: ComparedBackend, b: ComparedBackend, sequence: Sequence, scans: int, disturbed: bool = True
) -> Iterator[AnswerPair]:
    """Every question from running ``a`` through the front end over the first ``scans`` scans, with both answers.

    ``disturbed``: repeats the last question of each scan with a disturbed guess, because outlier rules and limits show
    only far from the answer; its stage ends in "-disturbed". Raises BackendFailed if ``a`` raises.
    """
    calls: list[RecordedCall] = []

    def make(**parameters: Value) -> _RecordingRegistration:
        return _RecordingRegistration(a.spec.make(**parameters), calls)

    odometry = frontend.make_odometry(replace(a.spec, make=make), a.parameters)
    registrations_b, registrations_a = b.registrations(), a.registrations()
    rng = np.random.default_rng(0)
    for scan, frame in enumerate(islice(sequence.frames(), scans), start=1):
        calls.clear()
        estimate = _ask_reference(a.label, odometry, frame, scan)
        answered = [
            (Question(scan, stage, target, source, guess), match)
            for stage, (target, source, guess, match) in (zip(estimate.stages, calls, strict=True) if estimate else ())
        ]
        for question, match in answered:
            yield answer(registrations_b[question.stage], question, match, registrations_a[question.stage])
        if disturbed and answered:
            stage = answered[-1][0].stage
            question = _disturb(answered[-1][0], rng)
            try:
                match = registrations_a[stage].register(question.target, question.source, question.guess)
            except Exception as error:  # a third party's code
                raise BackendFailed(a.label, f"scan {scan}, disturbed: {format_exception(error)}", REMEDY) from error
            yield answer(registrations_b[stage], question, match, registrations_a[stage])


def _disturb(question: Question, rng: np.random.Generator) -> Question:
    """The same question with an error of fixed size and random direction in its guess."""
    error = draw_motion(rng, DISTURBED_M, DISTURBED_RAD)
    return replace(question, stage=question.stage + DISTURBED, guess=question.guess @ error)


def draw_motion(rng: np.random.Generator, metres: float, radians: float) -> Pose:
    """A motion of the given size in a random direction, with a turn to a random side."""
    bearing = rng.uniform(-np.pi, np.pi)
    turn = radians * rng.choice([-1.0, 1.0])
    return Pose(metres * float(np.cos(bearing)), metres * float(np.sin(bearing)), turn)


def answer(
    registration: Registration, question: Question, a: Match, reference: Registration | None = None
) -> AnswerPair:
    """The answer of a registration to a question that has been answered by another one, the reference."""
    try:
        b: Any = registration.register(question.target, question.source, question.guess)
    except Exception as error:  # noqa: BLE001 - a third party's exception is a difference to report
        return AnswerPair(question, a, None, format_exception(error), reference)
    if not isinstance(b, Match):
        return AnswerPair(question, a, None, f"returns a {type(b).__name__}, expected an evalkit.Match", reference)
    return AnswerPair(question, a, b, reference=reference)


def pose_pairs(a: ComparedBackend, b: ComparedBackend, sequence: Sequence, scans: int) -> Iterator[PosePair]:
    """The poses of two odometries, separately over the first ``scans`` scans. Raises BackendFailed if ``a`` raises.

    Ends after a scan in which ``b`` raises.
    """
    first, second = (frontend.make_odometry(side.spec, side.parameters) for side in (a, b))
    for scan, frame in enumerate(islice(sequence.frames(), scans), start=1):
        estimate = _ask_reference(a.label, first, frame, scan)
        pose = None if estimate is None else estimate.pose
        try:
            answer = answer_frame(second, frame)
            own = None if isinstance(answer, NoAnswer) else check_estimate(answer).pose
        except Exception as error:  # noqa: BLE001 - a third party's exception is a difference to report
            yield PosePair(scan, pose, None, format_exception(error))
            return
        yield PosePair(scan, pose, own, f"no answer: {answer}" if isinstance(answer, NoAnswer) else "")


def _ask_reference(label: str, odometry: Odometry, frame: Frame, scan: int) -> OdometryEstimate | None:
    """Return the reference's estimate, None without one. Raises BackendFailed if it raises."""
    try:
        answer = answer_frame(odometry, frame)
        return None if isinstance(answer, NoAnswer) else check_estimate(answer)
    except Exception as error:  # a third party's code
        raise BackendFailed(label, f"scan {scan}: {format_exception(error)}", REMEDY) from error
