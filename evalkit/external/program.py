"""A child program that answers lines on its standard input with lines on its standard output."""

from __future__ import annotations

import contextlib
import json
import os
import re
import selectors
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections import deque
from typing import IO, Any

import psutil

from evalkit.core.errors import BackendEnded, BackendFailed, BackendLate, BackendRefused, brief
from evalkit.execution.subprocesses import signal_name
from evalkit.execution.usage import Usage
from evalkit.io import untrusted_io

MAX_ANSWER_BYTES = 1 << 20
"""Limit of one answer."""

NOT_FINITE = re.compile(rb'\s*\{.*?"(\w+)":[^"]*?(-?\b(?:nan|inf|infinity)\b)', re.IGNORECASE)
"""A number as C prints it where it is not finite, behind its key."""

DECIMAL_COMMA = re.compile(rb'"(\w+)":\s*-?\d+,\d')
"""A number as C prints it in some locales, behind its key: in an object, only the next key may follow a comma."""

EXIT_WAIT_S, LATE_POLL_S = 5.0, 0.05
CHUNK_BYTES = 1 << 16


class Program:
    """A started program; its process group is ended when the object is garbage-collected.

    It is no ``ChildProcess``: its pipes are the protocol, and its CPU time is that of one process, without a supervisor
    in between. In a run it is below the run's supervisor, which ends what leaves the group as well.
    """

    def __init__(self, name: str, argv: list[str], answer_timeout_s: float) -> None:
        self._name, self.answer_timeout_s = name, answer_timeout_s
        self._failed: tuple[type[BackendFailed], str, str] | None = None
        try:
            self._process = subprocess.Popen(
                argv,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                bufsize=0,
                process_group=0,
            )
        except OSError as error:
            what = f"cannot be started ({error.strerror or error})"
            raise BackendFailed(name, what, "check that it is a program of this machine") from error
        self._stdin, self._stdout, stderr = (_require_pipe(pipe) for pipe in self._streams())
        os.set_blocking(self._stdin.fileno(), False)
        self._last_messages: deque[bytes] = deque(maxlen=4)
        self._reader = threading.Thread(target=_drain, args=(stderr, self._last_messages), daemon=True)
        self._reader.start()
        weakref.finalize(self, _end, self._process)

    def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """Send a question and return the answer; raises BackendFailed without a readable answer in time."""
        return self.read(self.exchange(self.encode_line(question)))

    def encode_line(self, question: dict[str, Any]) -> bytes:
        """Encode a question as a line of ASCII."""
        return json.dumps(question, separators=(",", ":"), allow_nan=False).encode() + b"\n"

    def exchange(self, question: bytes) -> bytes:
        """Send a line and return the line that the program answers; raises BackendFailed.

        After a failure that ended the program, every further question raises the same.
        """
        if self._failed is not None:
            kind, what, remedy = self._failed
            raise kind(self._name, what, remedy)
        asked, used_ns = time.monotonic(), self.cpu_ns()
        waiting, received = memoryview(question), bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdout, selectors.EVENT_READ)
            if selector.select(0):  # output, or end of file, before the question
                self._receive(received)
                raise self._failure(
                    f"wrote a line without a question: {_printable(received)}", "print messages to stderr"
                )
            selector.register(self._stdin, selectors.EVENT_WRITE)
            while waiting or not received.endswith(b"\n"):
                left_s = asked + self.answer_timeout_s - time.monotonic()
                if left_s < 0.0 and self._is_late(asked, used_ns):
                    raise self._late_error(received)
                for key, _ in selector.select(max(left_s, LATE_POLL_S)):
                    if key.fileobj is self._stdout:
                        self._receive(received)
                    elif not (waiting := waiting[self._write(waiting) :]):
                        selector.unregister(self._stdin)
        return bytes(received)

    def _late_error(self, received: bytearray) -> BackendFailed:
        what = f"no answer within {self.answer_timeout_s:g} s"
        remedy = "see where it hangs, flush the output after every line, or set a larger answer_timeout_s"
        if received:
            what = f"no whole line within {self.answer_timeout_s:g} s: {len(received)} bytes without a newline"
            what, remedy = f"{what}: {_printable(received)}", "end every answer with a newline and flush the output"
        return self._failure(what, remedy, BackendLate)

    def _is_late(self, asked: float, used_ns: int) -> bool:
        """Whether the time of an answer is over; a program that others keep from computing has more: ``Usage``."""
        used = Usage(time.monotonic() - asked, 1e-9 * (self.cpu_ns() - used_ns), resident_bytes=0)
        return used.exceeds(self.answer_timeout_s)

    def read(self, line: bytes) -> dict[str, Any]:
        """Parse the line of an answer; raises BackendRefused with the program's reason, or BackendFailed."""
        try:
            answer = untrusted_io.parse_json(line)
        except ValueError:
            raise self._failure(*_find_mistake(line)) from None
        if not isinstance(answer, dict):
            raise self._failure(f"the answer is {_printable(line)}", "expected a JSON object")
        if "failed" in answer:
            what = f"reports a failure: {str(answer['failed'])[:300]}"
            raise BackendRefused(self._name, what + self._last_message(), "see what it needs")
        return answer

    def malformed(self, key: str, found: object, expected: str) -> BackendFailed:
        """Return the error for an answer with an invalid value."""
        has = f"the answer has no '{key}'" if found is None else f"the answer has '{key}': {brief(found)}"
        return self._failure(f"{has}, expected {expected}", "correct the answer")

    def cpu_ns(self) -> int:
        """Return the CPU time of the program so far, with all its threads, without the programs that it started."""
        if sys.platform == "linux":  # the process clock (clock_getcpuclockid) resolves nanoseconds, psutil only ticks
            with contextlib.suppress(OSError):
                return time.clock_gettime_ns((~self._process.pid << 3) | 2)
        with contextlib.suppress(psutil.Error):
            used = psutil.Process(self._process.pid).cpu_times()
            return int((used.user + used.system) * 1e9)
        return 0

    def _streams(self) -> tuple[IO[bytes] | None, ...]:
        return self._process.stdin, self._process.stdout, self._process.stderr

    def _write(self, waiting: memoryview) -> int:
        try:
            return os.write(self._stdin.fileno(), waiting[:CHUNK_BYTES])
        except BrokenPipeError:
            raise self._end_error() from None

    def _receive(self, received: bytearray) -> None:
        piece = os.read(self._stdout.fileno(), CHUNK_BYTES)
        if not piece:
            raise self._end_error()
        received += piece
        if len(received) > MAX_ANSWER_BYTES:
            raise self._failure(
                f"the answer exceeds {MAX_ANSWER_BYTES} bytes: {_printable(received)}", "answer one line"
            )

    def _end_error(self) -> BackendFailed:
        try:
            code = self._process.wait(EXIT_WAIT_S)
        except subprocess.TimeoutExpired:
            what = "closed its output without an answer"
            return self._failure(what, "answer every line with one line", BackendEnded)
        how = f"code {code}" if code >= 0 else signal_name(-code)
        self._reader.join(EXIT_WAIT_S)  # its last output may still be in the pipe
        return self._failure(f"ended with {how} instead of answering", "see its messages", BackendEnded)

    def _failure(self, what: str, remedy: str, kind: type[BackendFailed] = BackendFailed) -> BackendFailed:
        """Return the error, and end the program: nothing more is read from it."""
        self._kill()
        what += self._last_message()
        self._failed = kind, what, remedy  # not the error itself, whose traceback would keep the process from ending
        return kind(self._name, what, remedy)

    def _kill(self) -> None:
        _kill_group(self._process)

    def _last_message(self) -> str:
        stderr = _printable(b"".join(self._last_messages)[-300:].strip())
        return f"; last message: {stderr}" if stderr else ""


def _find_mistake(line: bytes) -> tuple[str, str]:
    """What is wrong with an answer that is no JSON, and the remedy."""
    if found := NOT_FINITE.match(line):
        what = f"the answer has {found[2].decode()} in '{found[1].decode()}': JSON has no such number"
        return what, "answer finite numbers"
    if found := DECIMAL_COMMA.search(line):
        what = f"the answer has a decimal comma in '{found[1].decode()}': {_printable(line)}"
        return what, 'write numbers with a point, as in the locale "C"'
    return f"the answer is not one line of JSON: {_printable(line)}", "print messages to stderr"


def _require_pipe(pipe: IO[bytes] | None) -> IO[bytes]:
    if pipe is None:
        raise ValueError("pipe: not opened")
    return pipe


def _drain(stream: IO[bytes], last_messages: deque[bytes]) -> None:
    while piece := os.read(stream.fileno(), CHUNK_BYTES):
        last_messages.append(piece[-300:])


def _end(process: subprocess.Popen[bytes]) -> None:
    """Close the program's input and wait for its end, at most ``EXIT_WAIT_S``; kill what is left of its group."""
    if process.stdin is not None:
        process.stdin.close()
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(EXIT_WAIT_S)
    _kill_group(process)
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a program and what it has started: the interpreter of a script that is only a shell's, for one."""
    if os.name != "posix":
        process.kill()
        return
    with contextlib.suppress(ProcessLookupError, PermissionError):  # none left, which macOS calls not permitted
        os.killpg(process.pid, signal.SIGKILL)


def _printable(raw: bytes | bytearray) -> str:
    """Return the text on one line, without unprintable characters, at most 200 characters."""
    text = " | ".join(raw[-400:].decode(errors="replace").split("\n")) if raw else ""
    return "".join(char for char in text if char.isprintable())[-200:]
