"""The timed region: wall time, CPU time and the share of it spent on converting values.

CPU time is that of the whole process, so a back end that starts threads cannot hide them. A back end whose work is
done outside this process tells here what that work cost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, TypeVar

Answer = TypeVar("Answer")
Clock = Literal["wall", "cpu"]


@dataclass(frozen=True, slots=True)
class Timing:
    """One timed call: nanoseconds of wall clock, of CPU, and of CPU inside ``conversion()`` (part of the CPU time).

    ``device_ns``: what the back end itself says it took. 0: not measured.
    """

    wall_ns: int
    cpu_ns: int
    conversion_ns: int
    device_ns: int = 0


@dataclass(slots=True)
class _Told:
    """What was told during the present call; read only by timed()."""

    conversion_ns: int = 0
    program_ns: int = 0
    device_ns: int = 0
    withheld: tuple[Clock, ...] = ()


_told = _Told()


def timed(call: Callable[[], Answer]) -> tuple[Answer, Timing]:
    """The call's answer and what it cost; nothing else happens between the two readings."""
    global _told  # noqa: PLW0603 - a clock is the one thing that is the same for everybody in a process
    _told = told = _Told()
    wall, cpu = time.perf_counter_ns(), time.process_time_ns()
    answer = call()
    cpu, wall = time.process_time_ns() - cpu, time.perf_counter_ns() - wall
    return answer, Timing(
        0 if "wall" in told.withheld else wall,
        0 if "cpu" in told.withheld else cpu + told.program_ns,
        told.conversion_ns,
        told.device_ns,
    )


@contextmanager
def conversion() -> Iterator[None]:
    """Marks work that only turns evalkit's values into a library's and back, so that reports show it apart."""
    start = time.process_time_ns()
    try:
        yield
    finally:
        _told.conversion_ns += time.process_time_ns() - start


def program(cpu_ns: int) -> None:
    """Adds the CPU time that a program of this machine spent on the present answer."""
    _told.program_ns += cpu_ns


def device(elapsed_ns: int) -> None:
    """Adds the time the back end itself says it took for the present answer, measured where it runs."""
    _told.device_ns += elapsed_ns


def withhold(*clocks: Clock) -> None:
    """Says of which clocks the present call's time tells nothing: its answer was computed elsewhere."""
    _told.withheld = clocks
