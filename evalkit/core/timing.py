"""Time of one call to a back end: wall time, CPU time, and the part of it spent on converting values.

CPU time is the time of the whole process, so it includes the threads that a back end starts. What the harness cannot
measure from outside (conversions, work in another process or on a device) the back end reports as the ``Cost`` of its
answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeVar

Returned = TypeVar("Returned")
Clock = Literal["wall", "cpu"]


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one answer, as reported by the back end.

    ``conversion_ns``: CPU time spent on converting evalkit's values to a library's types and back (see ``Stopwatch``).
    ``program_cpu_ns``: CPU time of another process of this machine. ``device_ns``: time that the implementation itself
    measured where it runs. ``withheld``: clocks whose reading has no meaning because the answer was computed elsewhere.
    ``preparation_ns``: CPU time in which an adapter computes what its library needs (normals, covariances).
    """

    conversion_ns: int = 0
    program_cpu_ns: int = 0
    device_ns: int = 0
    withheld: frozenset[Clock] = frozenset()
    preparation_ns: int = 0

    def __add__(self, other: Cost) -> Cost:
        if other is NO_COST:
            return self
        return Cost(
            self.conversion_ns + other.conversion_ns,
            self.program_cpu_ns + other.program_cpu_ns,
            self.device_ns + other.device_ns,
            self.withheld | other.withheld,
            self.preparation_ns + other.preparation_ns,
        )


NO_COST = Cost()


class CallTiming(NamedTuple):
    """Time of one call in nanoseconds; 0 where not measured.

    ``conversion_ns`` and ``preparation_ns`` are parts of ``cpu_ns``. ``device_ns``: time that the back end reports.
    """

    wall_ns: int
    cpu_ns: int
    conversion_ns: int = 0
    device_ns: int = 0
    preparation_ns: int = 0

    def including(self, cost: Cost) -> CallTiming:
        """Return this timing with the cost that the back end reports."""
        if cost is NO_COST:
            return self
        return CallTiming(
            0 if "wall" in cost.withheld else self.wall_ns,
            0 if "cpu" in cost.withheld else self.cpu_ns + cost.program_cpu_ns,
            cost.conversion_ns,
            cost.device_ns,
            cost.preparation_ns,
        )


class Stopwatch:
    """Sum of the process's CPU time over ``with`` blocks; ``with stopwatch:`` must not be nested.

    A back end measures its conversions with a fresh stopwatch per call and reports ``Cost(stopwatch.cpu_ns)``.
    """

    def __init__(self) -> None:
        self.cpu_ns = 0
        self._start_ns = 0

    def __enter__(self) -> None:
        self._start_ns = time.process_time_ns()

    def __exit__(self, *_error: object) -> None:
        self.cpu_ns += time.process_time_ns() - self._start_ns


def timed(call: Callable[[], Returned]) -> tuple[Returned, CallTiming]:
    """Call a function and measure it; return its answer and the time. Nothing else runs between the two readings."""
    wall, cpu = time.perf_counter_ns(), time.process_time_ns()
    answer = call()
    cpu, wall = time.process_time_ns() - cpu, time.perf_counter_ns() - wall
    return answer, CallTiming(wall, cpu)
