"""``python -m evalkit.execution.supervisor MODULE FOLDER``: run a module, and end all that it leaves behind.

This process runs no foreign code. It forks, and the child runs the module, which enables the collection of garbage. On
Linux this process becomes the parent of all processes below it whose own parents end, so that none escapes by a double
fork, a new session or an empty environment. It exits as the module did, by the same code or signal, once no process is
left. It imports little: it costs a fork.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import resource
import runpy
import signal
import sys
import time
from pathlib import Path

PARENT = "EVALKIT_PARENT"
"""Environment variable with the process id of the parent, which may die before the child can read its process id."""

CLEANING_S = 5.0
"""Time limit for ending what the module left behind."""

MACHINE_FAULT_CODE = 75
"""Exit code (EX_TEMPFAIL) where the machine failed, so that a child could not be started or an outcome not written."""

_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # of Linux's prctl


def main() -> None:
    """Run the module on the command line in a child."""
    sys.argv = sys.argv[1:]
    expected_parent = os.environ.get(PARENT, str(os.getppid()))
    if sys.platform == "linux":
        prctl = ctypes.CDLL(None).prctl
        prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
        prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
    if expected_parent != str(os.getppid()):  # dead already
        return
    os.environ[PARENT] = str(os.getpid())
    try:
        child = os.fork()
    except OSError as error:  # a limit of processes, or no memory
        sys.stderr.write(f"no process can be started ({error.strerror})\n")
        sys.exit(MACHINE_FAULT_CODE)
    if child:
        _supervise(child)
    gc.disable()  # enabled by the module once it has imported what it needs: a tenth of the time of a short run
    runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)


def _supervise(child: int) -> None:
    """Wait for the child, end what it left behind, and exit as it did."""
    signal.signal(signal.SIGTERM, lambda *_: _clean_and_exit())
    while True:
        ended, status = os.waitpid(-1, 0)  # also the orphans that end on their own
        if ended == child:
            break
    _end_children()
    code = os.waitstatus_to_exitcode(status)
    if code < 0:
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # the child has written its own, if any
        with contextlib.suppress(OSError, ValueError):  # SIGKILL has no handler
            signal.signal(-code, signal.SIG_DFL)
        os.kill(os.getpid(), -code)
    os._exit(code if code >= 0 else 128 - code)


def _clean_and_exit() -> None:
    _end_children()
    os._exit(128 + signal.SIGTERM)


def _end_children() -> None:
    """Kill all children; the children of these become children of this process, and are killed next."""
    until = time.monotonic() + CLEANING_S
    while time.monotonic() < until:
        try:
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        except ChildProcessError:  # none is left
            return
        for child in _list_children():
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.kill(child, signal.SIGKILL)
        time.sleep(0.002)


def _list_children() -> list[int]:
    """The process ids of the children; on systems without /proc none, where a killed process leaves its group to us."""
    own, found = str(os.getpid()), []
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, IndexError):  # ended meanwhile
            after_name = (folder / "stat").read_bytes().rpartition(b")")[2].split()  # state, parent, ...
            if after_name[1].decode() == own:
                found.append(int(folder.name))
    return found


if __name__ == "__main__":
    main()
