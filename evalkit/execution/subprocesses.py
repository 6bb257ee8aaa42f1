"""A child process for foreign code: started apart, measured from outside, ended with all it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from evalkit.execution import parent_watch
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.execution.parent_watch import PARENT, signal_name
from evalkit.plugins.registry import MARK

POLL_S = 0.05
"""How often whoever waits for a child looks at it."""

COUNT_S = 0.5
"""How often its children are counted: that means looking at every process there is."""

LAST_WORDS = 4096  # bytes of its output that are looked at for a reason

MAX_OUTPUT = 16 * 2**20
"""Bytes of output that are kept; who says more loses what it said first."""


@dataclass(frozen=True, slots=True)
class Usage:
    """What a child and its descendants hold and have used: resident memory in bytes, CPU time in seconds."""

    resident_bytes: int = 0
    cpu_s: float = 0.0


def started(module: str, folder: Path, output: IO[bytes], threads: int = 1) -> subprocess.Popen[bytes]:
    """``python -m module folder`` in a session of its own; what it says goes to ``output``.

    ``threads``: how many the libraries it uses may start.

    ``output`` must be open for appending: see ``cut``. Whoever an evalkit that was killed left behind in this folder is
    ended first.
    """
    parent_watch.required()
    _end_marked(folder)
    environment = {**os.environ, **dict.fromkeys(SINGLE_THREAD, str(threads))}
    environment |= {MARK: _mark(folder), PARENT: str(os.getpid())}
    return subprocess.Popen(  # -P: modules of the folder we happen to be in must not stand in for others
        [sys.executable, "-P", "-m", module, str(folder)],
        stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
        env=environment,
    )  # fmt: skip


def end_group(process: subprocess.Popen[bytes], folder: Path) -> None:
    """Ends the process and all it started: its children, who shares its session, and who carries its mark."""
    if process.poll() is None:  # its number is still its own
        with contextlib.suppress(psutil.Error):  # ended meanwhile
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
    with contextlib.suppress(ProcessLookupError, PermissionError):  # nobody is left, which macOS calls not permitted
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    _end_marked(folder)


class Family:
    """A child and its descendants, looked at from outside."""

    def __init__(self, pid: int) -> None:
        self._pid, self._members, self._counted_at = pid, [psutil.Process(pid)], time.monotonic()

    def usage(self) -> Usage:
        """What they use now; nothing once they have ended."""
        if time.monotonic() - self._counted_at > COUNT_S:
            self._count()
        memory, cpu = 0, 0.0
        for member in self._members:
            with contextlib.suppress(psutil.Error):  # ended between two looks
                memory += int(member.memory_info().rss)
                times = member.cpu_times()
                cpu += times.user + times.system + times.children_user + times.children_system
        return Usage(memory, cpu)

    def _count(self) -> None:
        self._counted_at = time.monotonic()
        with contextlib.suppress(psutil.Error):  # ended between two looks
            process = psutil.Process(self._pid)
            self._members = [process, *process.children(recursive=True)]


def cut(output: Path) -> None:
    """Leaves of a file of output that has grown too long its last words; the child goes on at its new end."""
    with contextlib.suppress(OSError):  # the child has removed it
        if output.stat().st_size > MAX_OUTPUT:
            with output.open("r+b") as file:
                file.seek(-LAST_WORDS, os.SEEK_END)
                last = file.read()
                file.truncate(0)
            with output.open("ab") as file:
                file.write(last)


def _mark(folder: Path) -> str:
    """A name for all that is started in a folder, the same whoever asks."""
    return str(uuid.uuid5(uuid.NAMESPACE_URL, folder.absolute().as_uri()))


def _end_marked(folder: Path) -> None:
    for stray in _marked(folder):
        with contextlib.suppress(psutil.Error):  # ended meanwhile
            stray.kill()


def _marked(folder: Path) -> Iterator[psutil.Process]:
    """Who carries the mark of a folder, whatever has become of their parents."""
    mark = _mark(folder)
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, OSError):  # somebody else's, or ended meanwhile
            if process.environ().get(MARK) == mark:
                yield process


def last_words(code: int, output: Path) -> str:
    """How a process that ended by itself did so, by its return code, and the last line it wrote."""
    last = _last_line(output)
    if code < 0:
        hint = " (by the system, where memory ran out)" if -code == signal.SIGKILL else ""
        return f"the process was ended by {signal_name(-code)}{hint}{last}"
    return f"the process ended itself with code {code}{last}"


def _last_line(output: Path) -> str:
    """The last line it wrote that can be read, from the end of what may be a very long file."""
    if not output.exists():  # the back end removed it
        return ""
    with output.open("rb") as file:
        file.seek(max(output.stat().st_size - LAST_WORDS, 0))
        text = file.read().decode("utf-8", errors="replace")
    lines = ["".join(char for char in line if char.isprintable()).strip() for line in text.splitlines()]
    said = [line for line in lines if line]
    return f"; it said last: {said[-1][:300]}" if said else ""
