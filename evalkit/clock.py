"""The timed region: wall time, CPU time and the share of it spent on converting values.

CPU time is that of the whole process, so a back end that starts threads cannot hide them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

Answer = TypeVar("Answer")

_converted_ns = 0  # CPU time spent inside conversion() in this process; read only by timed()


@dataclass(frozen=True, slots=True)
class Timing:
    """One timed call: nanoseconds of wall clock, of CPU, and of CPU inside ``conversion()`` (part of the CPU time)."""

    wall_ns: int
    cpu_ns: int
    conversion_ns: int


def timed(call: Callable[[], Answer]) -> tuple[Answer, Timing]:
    """The call's answer and what it cost; nothing else happens between the two readings."""
    converted = _converted_ns
    wall, cpu = time.perf_counter_ns(), time.process_time_ns()
    answer = call()
    cpu, wall = time.process_time_ns() - cpu, time.perf_counter_ns() - wall
    return answer, Timing(wall, cpu, _converted_ns - converted)


@contextmanager
def conversion() -> Iterator[None]:
    """Marks work that only turns evalkit's values into a library's and back, so that reports show it apart."""
    global _converted_ns  # noqa: PLW0603 - a clock is the one thing that is the same for everybody in a process
    start = time.process_time_ns()
    try:
        yield
    finally:
        _converted_ns += time.process_time_ns() - start
