"""A program that speaks evalkit's protocol (PROTOCOL.md) as a back end, here or on a board: ``exec:./my_icp -x``."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.errors import BackendFailed, BadParameter
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.external import elf
from evalkit.external.declaration import Declaration, absent, broken, declaration, digest_of, spec
from evalkit.external.program import Program
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

VERSION = 1
MAX_COUNTED = 2.0**31
"""Iterations and pairs are kept in 32 bits."""

HELLO_S = 10.0
"""How long starting a program and its first answer may take."""

TIMEOUT = Parameter(
    "answer_timeout_s", 10.0, "s", "longest wait for an answer; who needs longer has failed", low=1e-3, high=3600.0
)


def scheme(rest: str) -> BackendSpec:
    """The back end ``exec:COMMAND``: a program of a kind and with parameters of its own telling."""
    name = f"exec:{rest}"
    words = _words(name, rest)
    if shutil.which(words[0]) is None and not Path(words[0]).is_file():
        return absent(name, f"{words[0]} is no program found here; mend its path, or install it")
    argv, why = _command(words)
    digest = digest_of(*(Path(word) for word in argv if Path(word).is_file()), words=rest)
    if why:
        return broken(name, why, digest)
    said = _introduced(name, tuple(argv), digest)
    try:
        declared = declaration(name, said)
    except BackendFailed as error:
        return broken(name, "; ".join(error.args[1:]), digest)
    parameters = (*declared.parameters, TIMEOUT)
    return spec(declared, parameters, partial(_make, name, argv, declared), digest_of(words=f"{digest} {said}"))


class ProgramRegistration:
    """A Registration: the question "register" to a program."""

    def __init__(self, talk: Talk) -> None:
        self._talk = talk

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """The program's answer; BackendFailed where there is none or it is no match."""
        conversion = Stopwatch()
        with conversion:
            question = self._talk.program.line(
                {
                    "ask": "register",
                    "guess": guess.row.tolist(),
                    "source": source.points.ravel().tolist(),
                    "target": target.points.ravel().tolist(),
                }
            )
        line, program_cpu_ns = self._talk.timed(question)
        with conversion:
            answer = self._talk.program.read(line)
            device_ns = self._talk.device_ns(answer)
            match = self._talk.match(answer)
        return replace(match, cost=self._talk.cost(conversion.cpu_ns, program_cpu_ns, device_ns))


class ProgramOdometry:
    """An Odometry: the question "update" to a program."""

    def __init__(self, talk: Talk) -> None:
        self._talk = talk

    def update(self, frame: Frame) -> OdometryEstimate:
        """The program's answer; BackendFailed where there is none or it is no pose."""
        conversion = Stopwatch()
        with conversion:
            scan = frame.scan
            question = self._talk.program.line(
                {
                    "ask": "update",
                    "stamp_ns": scan.stamp_ns,
                    "time_increment_ns": scan.time_increment_ns,
                    "range_min_m": scan.range_min_m,
                    "range_max_m": scan.range_max_m,
                    "base_from_sensor": frame.base_from_sensor.row.tolist(),
                    "odom_from_base": None if frame.odom_from_base is None else frame.odom_from_base.row.tolist(),
                    "start_from_end": None if frame.start_from_end is None else frame.start_from_end.row.tolist(),
                    "angles": scan.angles.tolist(),
                    "ranges": _ranges(scan.ranges),
                }
            )
        line, program_cpu_ns = self._talk.timed(question)
        with conversion:
            answer = self._talk.program.read(line)
            device_ns = self._talk.device_ns(answer)
            pose = self._talk.pose(answer)
        return OdometryEstimate(pose, cost=self._talk.cost(conversion.cpu_ns, program_cpu_ns, device_ns))


class Talk:
    """A program that was greeted and given its parameters, and the reading of its answers."""

    def __init__(
        self,
        name: str,
        argv: list[str],
        declared: Declaration,
        answer_timeout_s: float,
        parameters: Mapping[str, Value],
    ) -> None:
        self.program = Program(name, argv, HELLO_S)
        self._elsewhere = bool(declared.device)
        _greeted(self.program)
        self.program.answer_timeout_s = answer_timeout_s
        self.program.ask({"ask": "create", "parameters": dict(parameters)})

    def timed(self, question: bytes) -> tuple[bytes, int]:
        """The line answered to a line, and the CPU time (ns) that the program spent on it."""
        before = self.program.cpu_ns()
        line = self.program.told(question)
        return line, self.program.cpu_ns() - before

    def device_ns(self, answer: dict[str, Any]) -> int:
        """The time that the program itself reports with an answer, 0 where it reports none."""
        return int(self.number(answer, "elapsed_ns")) if "elapsed_ns" in answer else 0

    def cost(self, conversion_ns: int, program_cpu_ns: int, device_ns: int) -> Cost:
        """The cost of one answer; the CPU time of this machine has no meaning for work done on a device."""
        if self._elsewhere:
            return Cost(conversion_ns, device_ns=device_ns, withheld=frozenset({"cpu"}))
        return Cost(conversion_ns, program_cpu_ns, device_ns)

    def number(self, answer: dict[str, Any], key: str, *, optional: bool = False, most: float = 2.0**63) -> float:
        """A number (or true, false) of an answer, less than ``most``; nan where it is optional and not told."""
        found = answer.get(key)
        if found is None and optional:
            return float("nan")
        if not isinstance(found, (int, float)) or not 0.0 <= found < most:
            raise self.program.malformed(key, found, f"a number from 0, less than {most:g}")
        return found

    def match(self, answer: dict[str, Any]) -> Match:
        """The match of an answer."""
        return Match(
            self.pose(answer),
            bool(self.number(answer, "converged")),
            int(self.number(answer, "iterations", most=MAX_COUNTED)),
            self.number(answer, "error_m", optional=True),
            int(self.number(answer, "inliers", most=MAX_COUNTED)),
        )

    def pose(self, answer: dict[str, Any]) -> Pose:
        """The pose of an answer."""
        found = answer.get("pose")
        if not isinstance(found, list) or len(found) != 3 or not all(type(value) in (int, float) for value in found):
            raise self.program.malformed("pose", found, "three numbers: x, y, theta")
        if not all(abs(value) <= sys.float_info.max for value in found):  # JSON's whole numbers have no end
            raise self.program.malformed("pose", found, "finite numbers; where there is none better, the guess")
        return Pose.of(found)


def _make(
    name: str, argv: list[str], declared: Declaration, *, answer_timeout_s: float, **parameters: Value
) -> ProgramRegistration | ProgramOdometry:
    talk = Talk(name, argv, declared, answer_timeout_s, parameters)
    return ProgramRegistration(talk) if declared.spec_type is RegistrationSpec else ProgramOdometry(talk)


def _greeted(program: Program) -> dict[str, Any]:
    said = program.ask({"ask": "hello", "protocol": VERSION})
    if said.get("protocol") != VERSION:
        raise program.malformed("protocol", said.get("protocol"), f"{VERSION}, which this evalkit speaks")
    return said


@cache
def _introduced(name: str, argv: tuple[str, ...], _digest: str) -> dict[str, Any]:
    """What a program says of itself, or why it does not; the digest tells one build from the next."""
    try:
        return _greeted(Program(name, list(argv), HELLO_S))
    except BackendFailed as error:
        return {"failed": error.args[1:]}


def _words(name: str, rest: str) -> list[str]:
    try:
        words = shlex.split(rest)
    except ValueError as error:
        raise BadParameter(name, "command", rest, f"a command line ({error}: mend the quotation marks)") from None
    if not words:
        raise BadParameter(name, "command", rest, "exec:PROGRAM ARGUMENTS")
    return words


def _command(words: list[str]) -> tuple[list[str], str]:
    """The words with the program's whole path, and why it cannot be started, or ""."""
    found = shutil.which(words[0])
    if found is None:
        return words, f"{words[0]} may not be executed; chmod +x it"
    path = Path(found).absolute()
    why = elf.unfit(path, library=False)
    remedy = "build it here, or run it there: exec:ssh HOST PROGRAM"
    return [str(path), *words[1:]], f"{words[0]} {why}; {remedy}" if why else ""


def _ranges(ranges: Floats) -> list[float | str | None]:
    """Ranges in JSON, which knows neither: null for no return, "nan" for invalid."""
    if np.isfinite(ranges).all():
        return list(ranges.tolist())
    return [value if np.isfinite(value) else "nan" if np.isnan(value) else None for value in ranges.tolist()]
