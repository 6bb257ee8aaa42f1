"""The rules on resources and on the state of the process: memory, time, files, threads, floating point, signals.

One endurance run makes up to ``CALLS`` calls in this process; each rule reads one column of what it measured.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import locale
import os
import platform
import resource
import signal
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import psutil

from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable
from evalkit.core.se2 import Floats

CALLS, BATCHES, INSTANCES = 10_000, 10, 200
BUDGET_S = 1.5
"""CPU time (s) of the calls of a batch in all: a slow back end is called less often."""

LEAK_BYTES = 8.0
"""Bytes per call, or per instance, from which steady growth is a leak."""

NOISE_BYTES, CHILD_NOISE_BYTES = 8192, 262_144
"""Growth in all that an allocator may show without a leak: in this process, and in pages of a child process."""

SLOWER = 1.3
"""Ratio of the shortest call of the last batch to that of the first one from which calls become slower."""


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
        return {**now, **self._loaded, **pristine, **{name: now[name] for name in COUNTED}}


class Endurance(Protocol):
    """A fixture that can be called many times."""

    @property
    def endurance(self) -> Measured:
        """What a run of many calls measured."""
        ...


@dataclass(frozen=True)
class Measured:
    """Growth over batches of ``size`` calls: heap (B + 1,) in bytes, and the shortest CPU time (B,) of a call in ns.

    ``instances``: bytes that each instance leaves behind. ``before``, ``after``: the state of the process by name.
    """

    size: int
    heap: Floats
    shortest_ns: Floats
    instances: float
    before: Mapping[str, str]
    after: Mapping[str, str]


class _HeapInfo(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
    )]  # fmt: skip


def measure(make: Callable[[], Any], calls: Callable[[Any], Callable[[], object]], watch: StateWatch) -> Measured:
    """Run ``calls(make())`` many times, and make and drop many instances."""
    before_instances = _heap_bytes()
    started = time.process_time()
    made = 0
    while made < INSTANCES and (made < 20 or time.process_time() - started < 0.5 * BUDGET_S):
        calls(make())()
        made += 1
        if made == 10:
            before_instances = _heap_bytes()  # after the first ones, which fill caches
    growth = _heap_bytes() - before_instances
    noise = CHILD_NOISE_BYTES if psutil.Process().children() else NOISE_BYTES
    instances = growth / (made - 10) if growth > noise else 0.0
    call = calls(make())
    before = watch.expected()
    started = time.process_time()
    warm_up = 0
    while warm_up < 30 or (warm_up < 500 and time.process_time() - started < 0.1 * BUDGET_S):
        call()
        warm_up += 1
    each_s = max((time.process_time() - started) / warm_up, 1e-6)
    size = int(np.clip(BUDGET_S / each_s, 40, CALLS)) // BATCHES
    heap, shortest = _run_batches(call, size)
    if _leak_bytes(heap, size) or _is_slower(shortest):  # caches fill, clocks change: a fault shows a second time
        heap, again = _run_batches(call, size)
        shortest = np.concatenate([shortest[:1], again])
    return Measured(size, heap, shortest, instances, before, process_state())


def _run_batches(call: Callable[[], object], size: int) -> tuple[Floats, Floats]:
    """The heap (B + 1,) before and after each batch of calls, and the shortest CPU time (B,) of a call."""
    heap, shortest = [_heap_bytes()], []
    for _ in range(BATCHES):
        shortest.append(min(_cpu_ns(call) for _ in range(size)))
        heap.append(_heap_bytes())
    return np.array(heap), np.array(shortest, dtype=np.float64)


def _is_slower(shortest_ns: Floats) -> bool:
    """Whether the shortest CPU times (B,) of calls rise steadily, by more than a clock's noise."""
    first, last = shortest_ns[0], shortest_ns[-1]
    return bool(last > SLOWER * max(first, 1.0) and last - first > 2000.0 and (np.diff(shortest_ns) > 0).mean() > 0.6)


def _leak_bytes(heap: Floats, size: int) -> float:
    """Bytes per call by which the heap (B + 1,) grows steadily, 0 if it does not."""
    growth = np.diff(heap)
    each = float(np.median(growth)) / size
    noise = CHILD_NOISE_BYTES if psutil.Process().children() else NOISE_BYTES
    return each if each >= LEAK_BYTES and (growth > 0).mean() >= 0.8 and growth.sum() > noise else 0.0


def check_memory(fixture: Endurance) -> str:
    """Calls and instances leave no memory behind."""
    found = fixture.endurance
    calls = found.size * BATCHES
    if leak := _leak_bytes(found.heap, found.size):
        raise RuleBroken(f"{calls} calls: {leak:.0f} bytes more per call, twice")
    if found.instances >= LEAK_BYTES:
        raise RuleBroken(f"each instance leaves {found.instances:.0f} bytes behind when it is destroyed")
    return f"{calls} calls and {INSTANCES} instances leave nothing behind"


def check_slowdown(fixture: Endurance) -> str:
    """Calls do not become slower the more there were."""
    found = fixture.endurance
    first, last = found.shortest_ns[0], found.shortest_ns[-1]
    observed = f"shortest call {1e-3 * first:.3g} us at first, {1e-3 * last:.3g} us after {found.size * BATCHES} calls"
    if _is_slower(found.shortest_ns):
        raise RuleBroken(f"{observed}: every call costs more than the one before")
    return observed


def _unchanged(fixture: Endurance, names: tuple[str, ...], what: str) -> str:
    found = fixture.endurance
    for name in names:
        if found.before.get(name) != found.after.get(name):
            raise RuleBroken(f"{name}: {found.before.get(name)} before, {found.after.get(name)} after the calls")
    return f"{what} unchanged after {found.size * BATCHES} calls"


def check_open_files(fixture: Endurance) -> str:
    """Calls leave no file open."""
    return _unchanged(fixture, ("open files",), "open files")


def check_threads(fixture: Endurance) -> str:
    """Calls leave no thread or process behind."""
    return _unchanged(fixture, ("threads", "processes"), "threads and processes")


def check_floating_point(fixture: Endurance) -> str:
    """The rounding mode and the other controls of floating-point arithmetic stay as they are."""
    found = fixture.endurance
    if not found.after["rounding"]:
        raise RuleNotApplicable("the floating-point controls of this machine are not known")
    return _unchanged(fixture, ("rounding", "floating-point controls"), "rounding mode and controls")


def check_signals(fixture: Endurance) -> str:
    """Signal handlers, blocked signals and timers stay as they are."""
    return _unchanged(fixture, ("signal handlers", "blocked signals", "timers"), "handlers, masks and timers")


def check_locale(fixture: Endurance) -> str:
    """The locale stays as it is."""
    return _unchanged(fixture, ("locale",), "the locale")


def check_folder(fixture: Endurance) -> str:
    """Working folder, environment, file mode mask, limits, priority and cores stay as they are."""
    names = ("working folder", "environment variables", "file mode mask", "limits", "priority", "cores")
    return _unchanged(fixture, names, "working folder, environment and limits")


RESOURCE_RULES = (
    check_memory, check_slowdown, check_open_files, check_threads, check_floating_point, check_signals, check_locale,
    check_folder,
)  # fmt: skip


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
def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None)


def _environment() -> str:
    """The environment as C code sees it: number of variables, and a number that changes with their values."""
    try:
        table = ctypes.POINTER(ctypes.c_char_p).in_dll(_libc(), "environ")
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
        if _libc().sigaction(number, None, ctypes.byref(old)) == 0 and old[0]:
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


def _heap_bytes() -> float:
    """Bytes in use of the heaps of this process, by the heap's own count where there is one, and of its children."""
    gc.collect()
    process = psutil.Process()
    children = 0
    for child in process.children(recursive=True):
        with contextlib.suppress(psutil.Error):
            children += child.memory_info().rss
    if not hasattr(_libc(), "mallinfo2"):
        return float(process.memory_info().rss + children)
    count = _libc().mallinfo2
    count.restype = _HeapInfo
    info = count()
    return float(info.uordblks + info.hblkhd + children)


def _cpu_ns(call: Callable[[], object]) -> int:
    before = time.thread_time_ns()
    call()
    return time.thread_time_ns() - before


def in_another_thread(call: Callable[[], Any]) -> Any:
    """The result of a call in a new thread; raises what it raises."""
    results: list[Any] = []

    def run() -> None:
        try:
            results.append(call())
        except Exception as error:  # noqa: BLE001 - raised again in the calling thread
            results.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if isinstance(results[0], Exception):
        raise results[0]
    return results[0]
