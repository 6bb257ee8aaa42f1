"""Terminate this process when its parent dies. Imports little: every run begins with it."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time

from evalkit.execution.supervisor import PARENT

_PR_SET_PDEATHSIG = 1  # of Linux's prctl


def end_with_parent() -> None:
    """Terminate this process when its parent dies; for processes that run foreign code.

    On Linux the kernel does it, whatever foreign code does here; the thread that started this process must stay alive.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    else:
        poll_parent()
    if os.environ.get(PARENT, str(os.getppid())) != str(os.getppid()):  # dead already
        os._exit(1)


def poll_parent() -> None:
    """Terminate this process when its parent dies, by polling in a thread; for processes without foreign code."""
    from multiprocessing import parent_process  # noqa: PLC0415 - a process that does not poll starts sooner without

    started_by = parent_process()  # its process id is known even if it is dead already
    parent = started_by.pid if started_by else os.getppid()

    def poll() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=poll, daemon=True).start()
