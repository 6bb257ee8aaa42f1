"""The state of the process that a call may not change: files, threads, floating point, signals, locale, folder."""

from __future__ import annotations

import contextlib
import ctypes
import locale
import os
import platform
import resource
import signal
from functools import cache
from pathlib import Path

import psutil

COUNTED = ("open files", "threads", "processes")
"""What a first call may open for good: compared with the state before the endurance run."""

CREATED = ("rounding", "locale", "working folder", "file mode mask")
"""What even the loading of a library may not change."""


class StateWatch:
    """The state of the process before a back end is loaded, and after its first object was made."""

    def __init__(self) -> None:
        self._pristine = process_state()
        self._loaded: dict[str, str] = {}

    def note_loaded(self) -> None:
        """Keep the state after the first object was made."""
        self._loaded = self._loaded or process_state()

    def expected(self) -> dict[str, str]:
        """The state that later calls must leave."""
        now = process_state()
        pristine = {name: self._pristine[name] for name in CREATED}
        if self._loaded.get("processes") == self._pristine["processes"]:  # no program: it starts none
            pristine["processes"] = self._pristine["processes"]
        return {**now, **self._loaded, **{name: now[name] for name in COUNTED}, **pristine}


def process_state() -> dict[str, str]:
    """What a call may not change, by name, in words."""
    process = psutil.Process()
    children = process.children(recursive=True)
    files, threads = [process.num_fds()], process.num_threads()
    for child in children:
        with contextlib.suppress(psutil.Error):
            files.append(child.num_fds())
            threads += child.num_threads()
    mask = os.umask(0)
    os.umask(mask)
    blocked = signal.pthread_sigmask(signal.SIG_BLOCK, ())
    limits = [resource.getrlimit(number) for number in range(10)]
    timers = [signal.getitimer(kind) != (0.0, 0.0) for kind in (0, 1, 2)]
    rounding, controls = _float_controls()
    return {
        "open files": str(sum(files)), "threads": str(threads), "processes": str(len(children)), "rounding": rounding,
        "floating-point controls": controls, "signal handlers": _handlers(), "blocked signals": str(sorted(blocked)),
        "timers": f"{sum(timers)} running", "locale": locale.setlocale(locale.LC_ALL), "working folder": _folder(),
        "environment variables": _environment(), "file mode mask": oct(mask), "limits": str(limits),
        "priority": str(os.nice(0)), "cores": str(_cores()),
    }  # fmt: skip


def _folder() -> str:
    try:
        return str(Path.cwd())
    except FileNotFoundError:
        return "none: it was removed"


def _cores() -> list[int]:
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []


@cache
def libc() -> ctypes.CDLL:
    """The C library of this process."""
    return ctypes.CDLL(None)


def _environment() -> str:
    """The environment as C code sees it: number of variables, and a number that changes with their values."""
    try:
        table = ctypes.POINTER(ctypes.c_char_p).in_dll(libc(), "environ")
    except ValueError:
        return ""
    values: list[bytes] = []
    while table and (entry := table[len(values)]) is not None:
        values.append(entry)
    return f"{len(values)} ({hash(tuple(values)) & 0xFFFF:04x})"


def _handlers() -> str:
    """The handlers of all signals, as addresses: signals that are not at their default."""
    entries = []
    for number in range(1, 32):
        old = (ctypes.c_void_p * 32)()
        if libc().sigaction(number, None, ctypes.byref(old)) == 0 and old[0]:
            entries.append(f"{number}:{'ignored' if old[0] == 1 else hex(old[0])}")
    return " ".join(entries)


def _float_controls() -> tuple[str, str]:
    """The rounding mode in words, "" if unknown, and the control bits beside the flags of past exceptions."""
    modes = {
        "x86_64": {0: "to nearest", 0x400: "downward", 0x800: "upward", 0xC00: "towards zero"},
        "aarch64": {0: "to nearest", 0x400000: "upward", 0x800000: "downward", 0xC00000: "towards zero"},
    }
    machine, environment = platform.machine(), (ctypes.c_uint32 * 16)()
    try:
        math_library = ctypes.CDLL("libm.so.6")
    except OSError:
        return "", ""
    if machine not in modes or math_library.fegetenv(ctypes.byref(environment)):
        return "", ""
    mode = modes[machine].get(math_library.fegetround(), "unknown")
    if machine == "aarch64":
        return mode, f"{environment[0]:x}"
    return mode, f"{environment[0] & 0xFFFF:x} {environment[7] & ~0x3F:x}"  # x87 control word, MXCSR without flags
