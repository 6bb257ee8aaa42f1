"""A program that is asked in lines over its standard input and output, and ended when nobody holds it any more."""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import subprocess
import sys
import threading
import time
import weakref
from collections import deque
from typing import IO, Any

import psutil

from evalkit.core.errors import BackendFailed, brief
from evalkit.execution.parent_watch import signal_name
from evalkit.io import untrusted_io

LONGEST_ANSWER = 1 << 20
"""Bytes of one answer; a program that writes more without end of line writes something else."""

FAREWELL_S = 0.5
PIECE = 1 << 16


class Program:
    """A started program; ``ask`` is all that can be done with it."""

    def __init__(self, name: str, argv: list[str], answer_timeout_s: float) -> None:
        self._name, self.answer_timeout_s = name, answer_timeout_s
        try:
            self._process = subprocess.Popen(
                argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0
            )
        except OSError as error:
            what = f"cannot be started ({error.strerror or error})"
            raise BackendFailed(name, what, "is it a program of this machine?") from error
        self._stdin, self._stdout, stderr = (_present(pipe) for pipe in self._streams())
        os.set_blocking(self._stdin.fileno(), False)
        self._last_words: deque[bytes] = deque(maxlen=4)
        self._listener = threading.Thread(target=_drain, args=(stderr, self._last_words), daemon=True)
        self._listener.start()
        weakref.finalize(self, _end, self._process)

    def ask(self, question: dict[str, Any]) -> dict[str, Any]:
        """The program's answer; BackendFailed where it gives none in time, or none that can be read."""
        return self.read(self.told(self.line(question)))

    def line(self, question: dict[str, Any]) -> bytes:
        """A question as a line of ASCII."""
        return json.dumps(question, separators=(",", ":"), allow_nan=False).encode() + b"\n"

    def told(self, question: bytes) -> bytes:
        """The line a program answers to a line."""
        end = time.monotonic() + self.answer_timeout_s
        waiting, received = memoryview(question), bytearray()
        with selectors.DefaultSelector() as selector:
            selector.register(self._stdout, selectors.EVENT_READ)
            if selector.select(0):  # it speaks, or has ended, without being asked
                self._hear(received)
                raise self._failed(f"wrote without being asked: {_shown(received)}", "print messages to stderr")
            selector.register(self._stdin, selectors.EVENT_WRITE)
            while waiting or not received.endswith(b"\n"):
                ready = selector.select(max(end - time.monotonic(), 0.0))
                if not ready or time.monotonic() > end:
                    what = f"no answer within {self.answer_timeout_s:g} s"
                    raise self._failed(what, "see where it hangs, or give it a larger answer_timeout_s")
                for key, _ in ready:
                    if key.fileobj is self._stdout:
                        self._hear(received)
                    elif not (waiting := waiting[self._say(waiting) :]):
                        selector.unregister(self._stdin)
        return bytes(received)

    def read(self, line: bytes) -> dict[str, Any]:
        """The object in an answer's line; BackendFailed with the program's own words where it says it failed."""
        try:
            answer = untrusted_io.parse_json(line)
        except ValueError:
            what = f"answered what is not one line of JSON: {_shown(line)}"
            raise self._failed(what, "print messages to stderr") from None
        if not isinstance(answer, dict):
            raise self._failed(f"answered {_shown(line)}", "expected a JSON object")
        if "failed" in answer:
            raise self._failed(f"says it failed: {str(answer['failed'])[:300]}", "see what it needs")
        return answer

    def malformed(self, key: str, found: object, expected: str) -> BackendFailed:
        """The error of an answer with a value that cannot be."""
        return self._failed(f"answered '{key}': {brief(found)}, expected {expected}", "mend the answer")

    def cpu_ns(self) -> int:
        """The CPU time of the program so far, all its threads; not that of programs it started."""
        if sys.platform == "linux":  # the clock of a process (clock_getcpuclockid): to the nanosecond, not to the tick
            with contextlib.suppress(OSError):
                return time.clock_gettime_ns((~self._process.pid << 3) | 2)
        with contextlib.suppress(psutil.Error):
            used = psutil.Process(self._process.pid).cpu_times()
            return int((used.user + used.system) * 1e9)
        return 0

    def _streams(self) -> tuple[IO[bytes] | None, ...]:
        return self._process.stdin, self._process.stdout, self._process.stderr

    def _say(self, waiting: memoryview) -> int:
        try:
            return os.write(self._stdin.fileno(), waiting[:PIECE])
        except BrokenPipeError:
            raise self._ended() from None

    def _hear(self, received: bytearray) -> None:
        piece = os.read(self._stdout.fileno(), PIECE)
        if not piece:
            raise self._ended()
        received += piece
        if len(received) > LONGEST_ANSWER:
            raise self._failed(f"answers without end: {_shown(received)}", "answer one line")

    def _ended(self) -> BackendFailed:
        try:
            code = self._process.wait(FAREWELL_S)
        except subprocess.TimeoutExpired:
            return self._failed("closed its output without an answer", "answer every line with a line")
        how = f"code {code}" if code >= 0 else signal_name(-code)
        self._listener.join(FAREWELL_S)  # its last words may still be on their way
        return self._failed(f"ended with {how} instead of answering", "see what it says")

    def _failed(self, what: str, remedy: str) -> BackendFailed:
        self._process.kill()  # nothing it could still say is asked for
        said = _shown(b"".join(self._last_words)[-300:].strip())
        return BackendFailed(self._name, what + (f"; it said last: {said}" if said else ""), remedy)


def _present(pipe: IO[bytes] | None) -> IO[bytes]:
    if pipe is None:
        raise ValueError("pipe: not opened")
    return pipe


def _drain(stream: IO[bytes], last_words: deque[bytes]) -> None:
    while piece := os.read(stream.fileno(), PIECE):
        last_words.append(piece[-300:])


def _end(process: subprocess.Popen[bytes]) -> None:
    """Closes its input, which says goodbye; whoever stays nevertheless is ended."""
    if process.stdin is not None:
        process.stdin.close()
    try:
        process.wait(FAREWELL_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _shown(raw: bytes | bytearray) -> str:
    """The text on one line, what cannot be printed left out, cut where it gets long."""
    text = " | ".join(raw[-400:].decode(errors="replace").split("\n")) if raw else ""
    return "".join(char for char in text if char.isprintable())[-200:]
