"""Run one training run of a point in this process, within a limit of CPU time."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from evalkit.design.run_points import RunScores, evaluate, prepare_sequence
from evalkit.plugins.parameters import Value

MAP_SCANS = 2
"""Fewest scans of a map: errors of a trajectory and CPU time do not depend on it."""

CHECK_EVERY_S = 0.5


class CpuTimeExceeded(Exception):
    """A run has used up its CPU time; the message is the reason of its failure."""


def run_trial(
    cpu_s: float,
    backend: str,
    parameters: Mapping[str, Value],
    dataset: str,
    sequence: Mapping[str, Value],
    mapper: str,
    metrics: Sequence[str],
    code: str,
) -> RunScores:
    """The scores of a run as for a study's point; a run that takes more than ``cpu_s`` seconds of CPU time has failed.

    The time to simulate the sequence does not count: it would be charged only to the first run on the sequence.
    """
    prepare_sequence(dataset, sequence)
    with _limit_cpu_time(cpu_s):
        return evaluate(backend, parameters, dataset, sequence, mapper, {}, MAP_SCANS, metrics, code)


@contextmanager
def _limit_cpu_time(cpu_s: float) -> Iterator[None]:
    """Raise CpuTimeExceeded in the main thread, between two calls of C code, when this process has used ``cpu_s``.

    A wall-clock timer checks the CPU time: with a CPU timer, some systems count CPU time in ticks of milliseconds, and
    the time of a scan is one of the results. No limit on systems without such a timer.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return
    end_s = time.process_time() + cpu_s

    def check(_signal: int, _frame: object) -> None:
        nonlocal end_s
        if time.process_time() > end_s:
            end_s += cpu_s  # for the scoring, and for a back end that catches the exception
            raise CpuTimeExceeded(f"more than {cpu_s:g} s of CPU time")

    before = signal.signal(signal.SIGALRM, check)
    signal.setitimer(signal.ITIMER_REAL, CHECK_EVERY_S, CHECK_EVERY_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
