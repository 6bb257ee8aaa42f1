"""Call a back end many times and measure what that does to its process: memory, time, open files, state.

Every rule of ``resource_rules`` reads one column of what it measured.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import math
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np
import psutil

from evalkit.commands.validate.rules.process_state import StateWatch, libc, process_state
from evalkit.core.se2 import Floats
from evalkit.execution.usage import count_starts

CALLS, BATCHES, INSTANCES = 10_000, 10, 200
BUDGET_S, PROGRAM_BUDGET_S = 1.5, 3.0
"""Time (s) of the calls of all batches: a slow back end is called less often.

CPU time of this process, which other programs do not lengthen; elapsed time for a program, which runs beside this one.
"""

LEAK_BYTES = 8.0
"""Bytes per call, or per instance, from which steady growth is a leak."""

NOISE_BYTES, CHILD_NOISE_BYTES = 8192, 262_144
"""Growth in all that an allocator may show without a leak: in this process, and in pages of a child process."""

SLOWER, SLOWER_NS = 1.2, 2000.0
"""Ratio and difference of the times of a call in the last and the first batches above which calls become slower."""

AGAIN = 0.75
"""Share of this difference by which the times of a second measurement must rise again."""

RISING = 0.8
"""Share of all pairs of batches in which the later one must have the slower calls; in any order it is a half."""


@dataclass(frozen=True)
class ResourceUse:
    """Growth over batches of ``size`` calls: heap (B + 1,) in bytes, and the CPU time (B,) of a call in ns.

    ``call_again_ns``: the same time in a second measurement, of batches of twice as many calls; () where none was made.
    ``instances``: bytes that each instance leaves behind. ``before``, ``after``: the state of the process by name.
    ``kept_bytes``: bytes from which steady growth per call is a leak. ``question``: what a call is asked.
    ``slowest_ns``: elapsed time of the slowest call, 0 where it is not known. ``filed``: bytes written to files; nan
    where this is not known, as for a program, which is asked over a pipe.
    """

    size: int
    heap: Floats
    call_ns: Floats
    instances: float
    before: Mapping[str, str]
    after: Mapping[str, str]
    kept_bytes: float = LEAK_BYTES
    filed: float = math.nan
    question: str = "question"
    slowest_ns: float = 0.0
    call_again_ns: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def calls(self) -> int:
        """Number of calls of all measurements."""
        return (1 + 2 * bool(len(self.call_again_ns))) * self.size * BATCHES


class _HeapInfo(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in (
        "arena", "ordblks", "smblks", "hblks", "hblkhd", "usmblks", "fsmblks", "uordblks", "fordblks", "keepcost",
    )]  # fmt: skip


def measure_resource_use(
    make: Callable[[], Any],
    calls: Callable[[Any], Callable[[], object]],
    watch: StateWatch,
    kept_bytes: float = LEAK_BYTES,
) -> ResourceUse:
    """Run ``calls(make())`` many times, and make and drop many instances; ``kept_bytes``: see ``ResourceUse``."""
    gc.collect()
    gc.freeze()  # each measurement of the heap then collects only what the calls made, not what the caller holds
    try:
        return _measure(make, calls, watch, kept_bytes)
    finally:
        gc.unfreeze()


def _measure(
    make: Callable[[], Any], calls: Callable[[Any], Callable[[], object]], watch: StateWatch, kept_bytes: float
) -> ResourceUse:
    known = set(psutil.Process().children())
    first = make()
    calls(first)()
    is_program = bool(set(psutil.Process().children()) - known)  # the others are not of this back end
    clock, budget_s = (time.monotonic, PROGRAM_BUDGET_S) if is_program else (time.process_time, BUDGET_S)
    del first
    instances = _measure_instances(make, calls, clock, 0.5 * budget_s)
    call = calls(make())
    started = clock()
    warm_up = 0
    while warm_up < 30 or (warm_up < 500 and clock() - started < 0.1 * budget_s):
        call()
        warm_up += 1
    each_s = max((clock() - started) / warm_up, 1e-6)
    before = watch.expected()  # what earlier objects had open has been closed meanwhile
    size = int(np.clip(budget_s / each_s, 40, CALLS)) // BATCHES
    with _counted_output() as output:
        work_ns = _quick(np.array([_cpu_ns(_work) for _ in range(100)]))
        heap, taken, slowest_ns = _run_batches(call, size, work_ns)
    again = np.zeros(0)
    if leak_bytes(heap, size, kept_bytes) > 0.0 or _rises(taken):  # caches fill: a fault shows a second time
        # twice as many: a table that doubles its size does so again
        heap, again, slowest_again_ns = _run_batches(call, 2 * size, work_ns)
        slowest_ns = max(slowest_ns, slowest_again_ns)
        heap = heap[0] + 0.5 * (heap - heap[0])
    use = ResourceUse(size, heap, taken, instances, before, process_state(), kept_bytes, output.filed)
    return replace(use, slowest_ns=slowest_ns, call_again_ns=again)


class _Output:
    filed = math.nan


@contextlib.contextmanager
def _counted_output() -> Iterator[_Output]:
    """Count the bytes that are written to files meanwhile; messages on the terminal are none, and are dropped."""
    output, process = _Output(), psutil.Process()
    if not hasattr(process, "io_counters") or process.children():
        yield output
        return
    sys.stdout.flush()
    sys.stderr.flush()
    before = process.io_counters().write_chars
    saved = os.dup(1), os.dup(2)
    with tempfile.TemporaryFile() as messages:
        for number in (1, 2):
            os.dup2(messages.fileno(), number)
        try:
            yield output
        finally:
            output.filed = process.io_counters().write_chars - before - os.fstat(messages.fileno()).st_size
            for number, old in enumerate(saved, start=1):
                os.dup2(old, number)
                os.close(old)


def _run_batches(call: Callable[[], object], size: int, work_ns: float) -> tuple[Floats, Floats, float]:
    """The heap (B + 1,) before and after each batch, the CPU time (B,) of a call, the elapsed time of the slowest (ns).

    Calls alternate with work that is always the same, and their times are what they would be if it took ``work_ns``:
    a slow moment of the machine lengthens both.
    """
    heap, taken, slowest_ns = [_heap_bytes()], [], 0.0
    clocks = _child_clocks()
    for _ in range(BATCHES):
        times_ns = np.array([(*_times_ns(call, clocks), _cpu_ns(_work)) for _ in range(size)])
        slowest_ns = max(slowest_ns, float(times_ns[:, 1].max()))
        taken.append(_quick(times_ns[:, 0]) / _quick(times_ns[:, 2]) * work_ns)
        heap.append(_heap_bytes())
    return np.array(heap), np.array(taken), slowest_ns


def _work() -> int:
    """Some microseconds of work, always the same."""
    return sum(number * number for number in range(200))


def _quick(times_ns: Floats) -> float:
    """The lower quartile: the shortest may be too short, because the clock of a virtual machine can leave out time."""
    return float(np.quantile(times_ns, 0.25))


def _rises(taken_ns: Floats) -> bool:
    """Whether the times (B,) of calls end higher than they begin, by more than a clock's noise."""
    begin, end = _ends(taken_ns)
    return end > SLOWER * begin and end - begin > SLOWER_NS


def rises_twice(taken_ns: Floats, again_ns: Floats) -> bool:
    """Whether calls become slower in a measurement, and again in the next one, of twice as many calls.

    What happens once is no fault: another program begins and slows the machine down, or a cache fills. Where each call
    costs more than the one before, the second rise is twice the first one. With the square root of the number of calls
    it is as large. Where it is half the first one, as with the logarithm of the number, the calls count as steady.
    """
    if not len(again_ns) or not _rises(taken_ns):
        return False
    (begin, end), (begin_again, end_again) = _ends(taken_ns), _ends(again_ns)
    rises_again = end_again - begin_again > AGAIN * (end - begin)
    return rises_again and _rising_share(np.concatenate([taken_ns, again_ns])) > RISING


def _ends(taken_ns: Floats) -> tuple[float, float]:
    """The medians of the first and of the last three times (B,): one slow moment is neither of them."""
    return float(np.median(taken_ns[:3])), float(np.median(taken_ns[-3:]))


def _rising_share(values: Floats) -> float:
    """The share of the pairs of values (N,) in which the later one is larger."""
    earlier, later = np.triu_indices(len(values), 1)
    return float((values[later] > values[earlier]).mean())


def leak_bytes(heap: Floats, size: int, kept_bytes: float) -> float:
    """Bytes per call by which the heap (B + 1,) grows, steadily or in steps; 0 if it does not, or less than it may."""
    growth = float(heap[-1] - heap[0])
    each = growth / (size * BATCHES)
    return each if each >= kept_bytes and growth > _noise_bytes() else 0.0


def _measure_instances(
    make: Callable[[], Any], calls: Callable[[Any], Callable[[], object]], clock: Callable[[], float], budget_s: float
) -> float:
    """Bytes that each instance leaves behind. A leak leaves them in a second series as well, a cache does not."""

    def measure() -> float:
        started, made, before = clock(), 0, math.nan
        while made < INSTANCES and (made < 20 or clock() - started < budget_s):
            if made == 10:
                before = _heap_bytes()  # after the first ones, which fill caches
            calls(make())()
            made += 1
        growth = _heap_bytes() - before
        return growth / (made - 10) if growth > _noise_bytes() else 0.0

    left = measure()
    return min(left, measure()) if left >= LEAK_BYTES else left


def _noise_bytes() -> int:
    return CHILD_NOISE_BYTES if _children() else NOISE_BYTES


def _heap_bytes() -> float:
    """Bytes in use of the heaps of this process, by the heap's own count where there is one, and of its children."""
    gc.collect()
    children = 0
    for child in _children():
        with contextlib.suppress(psutil.Error):
            children += child.memory_info().rss
    if not hasattr(libc(), "mallinfo2"):
        return float(psutil.Process().memory_info().rss + children)
    count = libc().mallinfo2
    count.restype = _HeapInfo
    info = count()
    return float(info.uordblks + info.hblkhd + children)


def _children() -> list[psutil.Process]:
    """The programs that this process has started, with theirs.

    The search inspects every process, and is made only if the system has started one since the last search.
    """
    found = _find_children(count_starts() or time.monotonic_ns())  # each time where this is not known
    return [child for child in found if child.is_running()]


@lru_cache(maxsize=1)
def _find_children(_starts: int) -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)


def _child_clocks() -> list[int]:
    """The clocks of the CPU time of the programs that this process has started; none where they are not known."""
    if sys.platform != "linux":
        return []
    return [(~child.pid << 3) | 2 for child in _children()]


def _times_ns(call: Callable[[], object], clocks: Sequence[int]) -> tuple[int, int]:
    """CPU time, with that of other clocks, and elapsed time of a call."""
    begun_ns = time.perf_counter_ns()
    cpu_ns = _cpu_ns(call, clocks)
    return cpu_ns, time.perf_counter_ns() - begun_ns


def _cpu_ns(call: Callable[[], object], clocks: Sequence[int] = ()) -> int:
    before = _read_ns(clocks)
    call()
    return _read_ns(clocks) - before


def _read_ns(clocks: Sequence[int]) -> int:
    """The CPU time of this thread and of other clocks; nothing of one whose process has ended."""
    now_ns = time.thread_time_ns()
    for clock in clocks:
        with contextlib.suppress(OSError):
            now_ns += time.clock_gettime_ns(clock)
    return now_ns
