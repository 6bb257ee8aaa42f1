"""A program with evalkit's line protocol (PROTOCOL.md) as a back end, here or on a board: ``exec:./my_icp -x``."""

from __future__ import annotations

import shlex
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.errors import BackendFailed, BadParameter
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Returned, Stopwatch
from evalkit.core.trajectory import Trajectory
from evalkit.external import elf
from evalkit.external.declaration import (
    Declaration,
    broken_spec,
    compute_digest,
    make_spec,
    missing_spec,
    read_declaration,
    undescribed_spec,
)
from evalkit.external.program import Program
from evalkit.external.secrets import fill_in_secrets
from evalkit.odometry.corrections import MAX_CLOSURES, find_unknown_stamp
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, OdometrySpec, RegistrationSpec, SlamSpec
from evalkit.results import descriptions

VERSION = 1
MAX_COUNTED = 2.0**31
"""Limit of iterations and pairs, which are stored in 32 bits."""

HELLO_S = 10.0
"""Time limit for the start of a program and its first answer."""

PART = 1000
"""Number of poses or loop closures in one answer: it has at most 1 MiB."""

TIMEOUT = Parameter(
    "answer_timeout_s", 10.0, "s", "time limit for an answer; on a busy machine up to 3 times as long", 1e-3, 3600.0
)


def scheme(rest: str) -> BackendSpec:
    """Make the spec of ``exec:COMMAND``; the program declares its kind and its parameters."""
    name = f"exec:{rest}"
    words = _split_command(name, rest)
    if shutil.which(words[0]) is None and not Path(words[0]).is_file():
        return missing_spec(name, f"no program found: {words[0]}; correct its path, or install it")
    argv, why = _resolve_command(words)
    digest = compute_digest(*(Path(word) for word in argv if Path(word).is_file()), words=rest)
    if why:
        return broken_spec(name, why, digest)
    description = descriptions.describe(name, digest, partial(_describe_program, name, argv))
    if description is None:
        return undescribed_spec(name, digest)
    try:
        declared = read_declaration(name, description, (TIMEOUT,))
    except BackendFailed as error:
        return broken_spec(name, "; ".join(error.args[1:]), digest)
    parameters = (*declared.parameters, TIMEOUT)
    spec = make_spec(
        declared, parameters, partial(_make, name, argv, declared), compute_digest(words=f"{digest} {description}")
    )
    return replace(spec, runs_in="device" if declared.device else "program", device=declared.device)


class ProgramRegistration:
    """A Registration that sends "register" to a program."""

    def __init__(self, session: ProgramSession) -> None:
        self._session = session

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Register with the program; raises BackendFailed where it gives no valid match."""
        conversion = Stopwatch()
        with conversion:
            question = {
                "ask": "register",
                "guess": guess.row.tolist(),
                "source": source.points.ravel().tolist(),
                "target": target.points.ravel().tolist(),
            }
        match, cost = self._session.ask(question, self._session.match, conversion)
        return replace(match, cost=cost)


class ProgramOdometry:
    """An Odometry that sends "update" to a program."""

    def __init__(self, session: ProgramSession) -> None:
        self._session = session

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one scan with the program; raises BackendFailed where it gives no valid pose."""
        conversion = Stopwatch()
        with conversion:
            scan = frame.scan
            question = {
                "ask": "update",
                "stamp_ns": scan.stamp_ns,
                "time_increment_ns": scan.time_increment_ns,
                "range_min_m": scan.range_min_m,
                "range_max_m": scan.range_max_m,
                "base_from_sensor": frame.base_from_sensor.row.tolist(),
                "odom_from_base": None if frame.odom_from_base is None else frame.odom_from_base.row.tolist(),
                "start_from_end": None if frame.start_from_end is None else frame.start_from_end.row.tolist(),
                "angles": scan.angles.tolist(),
                "ranges": _encode_ranges(scan.ranges),
            }
        (pose, corrected), cost = self._session.ask(question, self._session.estimate, conversion)
        return OdometryEstimate(pose, cost=cost, corrected=corrected)


class ProgramSlam(ProgramOdometry):
    """A Slam that asks a program for "trajectory" and "loop_closures", in parts."""

    def __init__(self, session: ProgramSession) -> None:
        super().__init__(session)
        self._stamps_ns: list[int] = []

    def update(self, frame: Frame) -> OdometryEstimate:
        """As ``ProgramOdometry.update``; the frame is then one of the trajectory."""
        estimate = super().update(frame)
        self._stamps_ns.append(frame.scan.stamp_ns)
        return estimate

    def trajectory(self) -> Trajectory:
        """Return the corrected poses; raises BackendFailed where the program gives no valid ones for all frames."""
        count = len(self._stamps_ns)
        rows = [
            self._session.ask_rows("trajectory", "poses", begin, 3 * min(PART, count - begin))
            for begin in range(0, count, PART)
        ]
        poses = np.array([value for part in rows for value in part], dtype=np.float64).reshape(-1, 3)
        return Trajectory(np.array(self._stamps_ns, dtype=np.int64), poses, "start", "base")

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return the program's loop closures; raises BackendFailed where it gives an invalid one, or too many."""
        closures: list[LoopClosure] = []
        while len(closures) <= MAX_CLOSURES:
            part = self._session.ask_closures(len(closures))
            if unknown := find_unknown_stamp(part, self._stamps_ns):
                index, name, stamp_ns = unknown
                key = f"loop_closures[{len(closures) + index}].{name}"
                raise self._session.program.malformed(key, stamp_ns, "the stamp of an answered scan")
            closures += part
            if len(part) < PART:
                return tuple(closures)
        raise self._session.program.malformed("loop_closures", len(closures), f"at most {MAX_CLOSURES} in all")


class ProgramSession:
    """A started program with its parameters, and the reading of its answers."""

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
        _greet(self.program)
        self.program.answer_timeout_s = answer_timeout_s
        self.program.ask({"ask": "create", "parameters": dict(parameters)})

    def ask(
        self, question: dict[str, Any], parse: Callable[[dict[str, Any]], Returned], conversion: Stopwatch
    ) -> tuple[Returned, Cost]:
        """Send a question; return the parsed answer and its cost. For work on a device, CPU time is withheld."""
        with conversion:
            line = self.program.encode_line(question)
        before_ns = self.program.cpu_ns()
        line = self.program.exchange(line)
        program_cpu_ns = self.program.cpu_ns() - before_ns
        with conversion:
            content = self.program.read(line)
            device_ns = int(self.number(content, "elapsed_ns")) if "elapsed_ns" in content else 0
            answer = parse(content)
        if self._elsewhere:
            return answer, Cost(conversion.cpu_ns, device_ns=device_ns, withheld=frozenset({"cpu"}))
        return answer, Cost(conversion.cpu_ns, program_cpu_ns, device_ns)

    def number(self, answer: dict[str, Any], key: str, *, optional: bool = False, most: float = 2.0**63) -> float:
        """Return a number (or true, false) of an answer, less than ``most``; nan where it is optional and absent."""
        found = answer.get(key)
        if found is None and optional:
            return float("nan")
        if not isinstance(found, (int, float)) or not 0.0 <= found < most:
            raise self.program.malformed(key, found, f"a number from 0, less than {most:g}")
        return found

    def match(self, answer: dict[str, Any]) -> Match:
        """Return the match of an answer; raises BackendFailed."""
        return Match(
            self.pose(answer),
            bool(self.number(answer, "converged")),
            int(self.number(answer, "iterations", most=MAX_COUNTED)),
            self.number(answer, "error_m", optional=True),
            int(self.number(answer, "inliers", most=MAX_COUNTED)),
            tuple(self._iteration(entry) for entry in self._list(answer, "trace")),
        )

    def ask_rows(self, ask: str, key: str, begin: int, count: int) -> list[float]:
        """Ask for a part of a list of finite numbers; raises BackendFailed where it has another length."""
        answer = self.program.ask({"ask": ask, "from": begin, "count": PART})
        found = self._list(answer, key)
        if len(found) != count:
            what = f"{count} ({count // 3} poses from pose {begin} on: one for each answered scan)"
            raise self.program.malformed(key, f"{len(found)} numbers ({len(found) / 3:.4g} poses)", what)
        for index, value in enumerate(found):
            if not _is_finite(value):
                raise self.program.malformed(f"{key}[{index}]", value, "a finite number")
        return found

    def ask_closures(self, begin: int) -> list[LoopClosure]:
        """Ask for the loop closures from an index on, at most ``PART``; raises BackendFailed."""
        answer = self.program.ask({"ask": "loop_closures", "from": begin, "count": PART})
        found = self._list(answer, "loop_closures")
        if len(found) > PART:
            raise self.program.malformed("loop_closures", f"{len(found)} entries", f"at most {PART}")
        return [self._closure(entry) for entry in found]

    def _closure(self, entry: Any) -> LoopClosure:
        expected = "objects with stamp_ns, other_stamp_ns, pose, accepted (true or false) and reason"
        if not isinstance(entry, dict):
            raise self.program.malformed("loop_closures", entry, expected)
        later, earlier = entry.get("stamp_ns"), entry.get("other_stamp_ns")
        accepted, reason, found_again = entry.get("accepted"), entry.get("reason"), entry.get("found_again")
        if not isinstance(later, int) or not isinstance(earlier, int) or max(abs(later), abs(earlier)) >= 2**63:
            raise self.program.malformed("loop_closures", entry, expected)
        if not isinstance(accepted, bool) or not isinstance(reason, str):
            raise self.program.malformed("loop_closures", entry, expected)
        if found_again is not None and not isinstance(found_again, bool):
            raise self.program.malformed("found_again", found_again, "true or false")
        try:
            return LoopClosure(later, earlier, self.pose(entry), accepted, reason, found_again=found_again)
        except ValueError as error:
            raise self.program.malformed("loop_closures", entry, str(error)) from None

    def estimate(self, answer: dict[str, Any]) -> tuple[Pose, bool | None]:
        """Return the pose of an answer, and whether it corrected earlier ones (None: not told); BackendFailed."""
        corrected = answer.get("corrected")
        if corrected is not None and not isinstance(corrected, bool):
            raise self.program.malformed("corrected", corrected, "true or false")
        return self.pose(answer), corrected

    def _iteration(self, entry: Any) -> Iteration:
        """Return one entry of a trace; raises BackendFailed."""
        if not isinstance(entry, dict):
            raise self.program.malformed("trace", entry, "a list of objects")
        numbers = self._list(entry, "pairs")
        if len(numbers) % 2 or not all(type(value) is int and 0 <= value < MAX_COUNTED for value in numbers):
            raise self.program.malformed("pairs", numbers, "indices of source and target in turns")
        pairs = np.array(numbers, dtype=np.int64).reshape(-1, 2) if "pairs" in entry else None
        error, inliers = self.number(entry, "error_m", optional=True), self.number(entry, "inliers", most=MAX_COUNTED)
        return Iteration(error, int(inliers), self.pose(entry), pairs)

    def _list(self, answer: dict[str, Any], key: str) -> list[Any]:
        found = answer.get(key, [])
        if not isinstance(found, list):
            raise self.program.malformed(key, found, "a list")
        return found

    def pose(self, answer: dict[str, Any]) -> Pose:
        """Return the pose of an answer; raises BackendFailed."""
        found = answer.get("pose")
        if not isinstance(found, list) or len(found) != 3 or not all(type(value) in (int, float) for value in found):
            raise self.program.malformed("pose", found, "three numbers: x, y, theta")
        if not all(_is_finite(value) for value in found):
            raise self.program.malformed("pose", found, "finite numbers; without a better pose, the guess")
        return Pose.of(found)


_CLASS_OF_SPEC: dict[type[BackendSpec], Callable[[ProgramSession], ProgramRegistration | ProgramOdometry]] = {
    RegistrationSpec: ProgramRegistration,
    OdometrySpec: ProgramOdometry,
    SlamSpec: ProgramSlam,
}


def _make(
    name: str, argv: list[str], declared: Declaration, /, *, answer_timeout_s: float, **parameters: Value
) -> ProgramRegistration | ProgramOdometry:
    session = ProgramSession(name, argv, declared, answer_timeout_s, parameters)
    return _CLASS_OF_SPEC[declared.spec_type](session)


def _is_finite(value: object) -> bool:
    """Whether a value of JSON is a number that a float can hold; its whole numbers are unbounded."""
    return isinstance(value, (int, float)) and type(value) is not bool and abs(value) <= sys.float_info.max


def _greet(program: Program) -> dict[str, Any]:
    answer = program.ask({"ask": "hello", "protocol": VERSION})
    if answer.get("protocol") != VERSION:
        raise program.malformed("protocol", answer.get("protocol"), f"{VERSION}, the version of this evalkit")
    return answer


def _describe_program(name: str, argv: list[str]) -> dict[str, Any]:
    """Start a program; return its description, or why it gives none."""
    try:
        return _greet(Program(name, argv, HELLO_S))
    except BackendFailed as error:
        return {"failed": list(error.args[1:])}


def _split_command(name: str, rest: str) -> list[str]:
    try:
        words = shlex.split(rest)
    except ValueError as error:
        raise BadParameter(name, "command", rest, f"a command line ({error}: correct the quotation marks)") from None
    if not words:
        raise BadParameter(name, "command", rest, "exec:PROGRAM ARGUMENTS")
    return fill_in_secrets(words)


def _resolve_command(words: list[str]) -> tuple[list[str], str]:
    """Return the words with the program's full path, and why it cannot be started, or ""."""
    found = shutil.which(words[0])
    if found is None:
        return words, f"{words[0]} is not executable; chmod +x it"
    path = Path(found).absolute()
    why = elf.find_unusable_reason(path, library=False)
    remedy = "build it here, or run it there: exec:ssh HOST PROGRAM"
    return [str(path), *words[1:]], f"{words[0]} {why}; {remedy}" if why else ""


def _encode_ranges(ranges: Floats) -> list[float | str | None]:
    """Encode ranges for JSON, which has neither infinity nor nan: null for no return, "nan" for invalid."""
    if np.isfinite(ranges).all():
        return list(ranges.tolist())
    return [value if np.isfinite(value) else "nan" if np.isnan(value) else None for value in ranges.tolist()]
