"""A process that ends when the one that started it does: nobody goes on working for somebody who was killed."""

from __future__ import annotations

import ctypes
import os
import platform
import signal
import sys
import threading
import time
from multiprocessing import parent_process

from evalkit.core.errors import NotInstalled

PARENT = "EVALKIT_PARENT"
"""Environment variable that tells a child its parent's number: the parent may be gone before the child can look."""

_PR_SET_PDEATHSIG = 1  # of Linux's prctl


def signal_name(number: int) -> str:
    """What a signal is called, in words where the system has no name for it."""
    try:
        return signal.Signals(number).name
    except ValueError:  # most real-time signals have none
        return f"signal {number}"


def required() -> None:
    """Refuses to start foreign code where nothing can be ended with all it has started: NotInstalled says what to do.

    Half of an isolation would be none: a run that hangs, or leaves others behind, would spoil the numbers of the next.
    """
    if os.name != "posix":
        what = f"runs are not supported on {platform.system()}: it has no process groups to end a back end with"
        raise NotInstalled("evalkit", what, "use Linux, macOS, or Linux within Windows (WSL)")


def end_with_parent() -> None:
    """From now on this process ends when the one that started it does, however that comes about.

    On Linux the system sees to it, whatever foreign code does here; the thread that started us must live as long.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    else:
        watch_parent()
    if os.environ.get(PARENT, str(os.getppid())) != str(os.getppid()):  # gone already
        os._exit(1)


def serve_parent() -> None:
    """Start a pool process: leave keyboard interrupts to the parent, and terminate when the parent dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    watch_parent()


def watch_parent() -> None:
    """The same by looking now and then: for processes that run no foreign code."""
    started_by = parent_process()  # whose number is known even if it is gone already
    parent = started_by.pid if started_by else os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
