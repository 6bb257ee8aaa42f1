"""Lines of a program with evalkit's protocol: its declaration and its answers."""

from __future__ import annotations

from collections import deque

from bounds import check_call

from evalkit.external.declaration import override_defaults, read_declaration
from evalkit.external.process import ProgramSession
from evalkit.external.program import Program


class _UnstartedProgram(Program):
    """A program whose process was not started."""

    def __init__(self, last_message: bytes) -> None:
        self._name, self._last_messages = "exec:fuzz", deque([last_message])

    def _kill(self) -> None:
        """Do nothing."""


def seeds() -> list[bytes]:
    """Return declarations and answers, and settings after a line."""
    return [
        b'{"protocol": 1, "kind": "registration", "summary": "s", "device": "board", "parameters": '
        b'[{"name": "radius", "default": 0.5, "unit": "m", "meaning": "how far"}, {"name": "n", "default": 3}]}',
        b'{"pose": [1.0, 2.0, 0.5], "converged": true, "iterations": 12, "error_m": 0.01, "inliers": 300}',
        b'{"failed": "no licence"}',
        b'{"kind": "odometry", "failed": ["a", "b"]}',
    ]


def swollen() -> list[bytes]:
    """Return deep nesting, long numbers and long texts."""
    return [
        b"[" * 1_000_000,
        b'{"pose": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
        b'{"a":' * 200_000,
        b'{"pose": [1' + b"0" * 400 + b', 0, 0], "inliers": 1' + b"0" * 4_000 + b"}",
        b'{"pose": [' + b"9" * 900_000 + b", 0, 0]}",
        b'{"pose": [NaN, Infinity, 0], "inliers": NaN, "iterations": -Infinity}',
        b'{"failed": "' + b"\\u001b[2J" * 100_000 + b'"}',
        b'{"failed": ' + b"[1, " * 900 + b"]" * 900 + b"}",
        b'{"kind": "' + b"x" * 1_000_000 + b'"}',
        b'{"kind": "odometry", "parameters": [' + b'{"name": "a", "default": 1},' * 20_000 + b'{"name": "b"}]}',
        b'{"kind": "odometry", "parameters": [{"name": "a", "default": 1' + b"0" * 400 + b"}]}",
        b'{"iterations": 1e308, "inliers": 100000000000000000000, "pose": [1e308, -1e308, 1e308]}',
        b"\x1b[2J\x1b[31m" * 100_000,
    ]


def read_input(data: bytes) -> None:
    """Parse a line as every type of answer."""
    program = _UnstartedProgram(data[-200:])
    for hear in (_describe_program, _make_registration, _make_odometry):
        check_call(lambda hear=hear: hear(program, data), len(data), "exec:fuzz")


def _describe_program(program: Program, line: bytes) -> None:
    declared = read_declaration("exec:fuzz", program.read(line))
    override_defaults("exec:fuzz", declared.parameters, [])
    for parameter in declared.parameters:
        parameter.check("exec:fuzz", parameter.default)


def _make_registration(program: Program, line: bytes) -> None:
    _talk(program).match(program.read(line))


def _make_odometry(program: Program, line: bytes) -> None:
    session = _talk(program)
    answer = program.read(line)
    session.pose(answer)
    session.number(answer, "elapsed_ns", optional=True)


def _talk(program: Program) -> ProgramSession:
    session = ProgramSession.__new__(ProgramSession)
    session.program = program
    return session
