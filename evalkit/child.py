"""A child process for foreign code: started apart, measured from outside, ended with all it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import IO

import psutil

from evalkit.environment import SINGLE_THREAD

POLL_S = 0.05
"""How often whoever waits for a child looks at it."""

LAST_WORDS = 4096  # bytes of its output that are looked at for a reason


def started(module: str, folder: Path, output: IO[bytes]) -> subprocess.Popen[bytes]:
    """``python -m module folder`` in a session of its own, with one thread; what it says goes to ``output``."""
    return subprocess.Popen(  # -P: modules of the folder we happen to be in must not stand in for others
        [sys.executable, "-P", "-m", module, str(folder)],
        stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
        env={**os.environ, **SINGLE_THREAD},
    )  # fmt: skip


def end_group(process: subprocess.Popen[bytes]) -> None:
    """Ends the process and all it started: they share its session, or are still known as its children."""
    if process.poll() is None:  # its number is still its own
        with contextlib.suppress(psutil.Error):  # ended meanwhile
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
    with contextlib.suppress(ProcessLookupError):  # nobody is left, as it should be
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def resident_bytes(pid: int) -> int:
    """Its resident memory now; 0 once it has ended."""
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:  # ended between two looks
        return 0


def last_words(code: int, output: Path) -> str:
    """How a process that ended by itself did so, by its return code, and the last line it wrote."""
    last = _last_line(output)
    if code < 0:
        hint = " (by the system, where memory ran out)" if -code == signal.SIGKILL else ""
        return f"the process was ended by {_signal(-code)}{hint}{last}"
    return f"the process ended itself with code {code}{last}"


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # most real-time signals have no name
        return f"signal {number}"


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
