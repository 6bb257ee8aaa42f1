"""What else the machine did during a run: load, stolen and foreign CPU time, frequency; and threads of the run."""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from evalkit.core.run_result import RunConditions
from evalkit.execution.usage import read_waited_ns

SAMPLE_S = 0.5
"""Interval between two readings of the counters of the system."""

BUSY_SHARE = 0.01
"""A thread is busy if it took at least this share of the CPU time of its process."""

_TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass(frozen=True, slots=True)
class _Counters:
    """CPU time in s that a core has spent on all processes, and that the hypervisor took from it."""

    busy_s: float
    stolen_s: float


class ConditionsMeter:
    """Measures the machine during a run, from its construction on; ``core``: the run's core, None if not pinned."""

    def __init__(self, core: int | None) -> None:
        self._core = core
        self._loads, self._mhz = _read_load(), list[float]()
        self._begin = _read_counters(core)
        self._begun_at = self._read_at = time.monotonic()
        self._last: tuple[float, float, _Counters] | None = None

    def update(self, cpu_s: float) -> None:
        """Read the counters if ``SAMPLE_S`` have passed; ``cpu_s``: CPU time of the run so far."""
        now = time.monotonic()
        if now - self._read_at < SAMPLE_S or self._begin is None:
            return
        self._read_at = now
        if (counters := _read_counters(self._core)) is not None:
            self._last = now - self._begun_at, cpu_s, counters
        if len(self._mhz) < 2:
            self._mhz += _read_mhz()

    def conclude(self, reported: dict[str, Any]) -> RunConditions:
        """The conditions of the run that has ended. ``reported``: what its process measured about itself, untrusted."""
        mhz, loads = [*self._mhz, *_read_mhz()], [*self._loads, *_read_load()]
        try:
            own = RunConditions(**reported)
        except (TypeError, ValueError):  # a back end can write to the file
            own = RunConditions()
        own = replace(own, load=sum(loads) / len(loads) if loads else None, mhz=sum(mhz) / len(mhz) if mhz else None)
        if self._begin is None or self._last is None:
            return own
        wall_s, cpu_s, last = self._last
        other_s = max(last.busy_s - self._begin.busy_s - cpu_s, 0.0)
        stolen_s = max(last.stolen_s - self._begin.stolen_s, 0.0)
        return replace(own, other_percent=100.0 * other_s / wall_s, steal_percent=100.0 * stolen_s / wall_s)


def measure_own_threads(waited_percent: float | None) -> RunConditions:
    """What this process knows about its threads; ``waited_percent``: of its main thread."""
    times_s, least_s = _read_thread_times_s(), max(BUSY_SHARE * time.process_time(), 0.01)
    busy = sum(1 for used_s in times_s if used_s >= least_s)
    return RunConditions(
        waited_percent=waited_percent, threads=len(times_s), busy_threads=max(busy, 1), pools=_describe_pools()
    )


def _read_thread_times_s() -> list[float]:
    """The CPU time in s of each thread of this process."""
    threads = Path("/proc/self/task")
    if not threads.exists():
        import psutil  # noqa: PLC0415 - the process of a run starts sooner without

        return [thread.user_time + thread.system_time for thread in psutil.Process().threads()]
    found = []
    for thread in threads.iterdir():
        with contextlib.suppress(OSError):  # ended meanwhile
            after_name = (thread / "stat").read_bytes().rpartition(b")")[2].split()  # state, parent, ...
            found.append((int(after_name[11]) + int(after_name[12])) / _TICKS_PER_S)
    return found


class WaitingMeter:
    """Measures how long the main thread of this process is ready but not running, from its construction on."""

    def __init__(self) -> None:
        self._begun_ns, self._waited_ns = time.perf_counter_ns(), read_waited_ns(os.getpid())

    def percent(self) -> float | None:
        """The share of the wall time; None where the system does not count it."""
        waited_ns = read_waited_ns(os.getpid())
        if waited_ns is None or self._waited_ns is None:
            return None
        return 100.0 * (waited_ns - self._waited_ns) / (time.perf_counter_ns() - self._begun_ns)


def _describe_pools() -> str:
    """The thread pools of the loaded libraries with their sizes, "" where threadpoolctl is not installed."""
    try:
        pools = import_module("threadpoolctl").threadpool_info()
    except ImportError:
        return ""
    return ", ".join(f"{pool['internal_api']} {pool['num_threads']}" for pool in pools)


def _read_counters(core: int | None) -> _Counters | None:
    """The counters of a core, None where the run is not pinned or the system does not count."""
    try:
        lines = Path("/proc/stat").read_text(encoding="ascii").splitlines() if core is not None else []
    except OSError:
        return None
    for line in lines:
        name, *words = line.split()
        if name == f"cpu{core}" and len(words) >= 8:
            user, nice, system, _, _, irq, soft_irq, stolen = (int(word) / _TICKS_PER_S for word in words[:8])
            return _Counters(user + nice + system + irq + soft_irq, stolen)
    return None


def _read_load() -> list[float]:
    return [os.getloadavg()[0]] if hasattr(os, "getloadavg") else []


def _read_mhz() -> list[float]:
    """The present frequency of the processor, nothing where it is not known."""
    import psutil  # noqa: PLC0415 - only the process that watches a run needs it

    try:
        known = psutil.cpu_freq()
    except (OSError, NotImplementedError, AttributeError):
        return []
    return [float(known.current)] if known and known.current > 0.0 else []
