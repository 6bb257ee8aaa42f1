"""One training run of one point, in this process and within a limit of CPU time."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from evalkit.commands.study.evaluate import RunScores, evaluate, prepared
from evalkit.plugins.parameters import Value

NO_MAP = "log-odds"
"""The mapper a point is asked to name; no map is drawn for errors of a trajectory and for CPU time."""

LOOK_EVERY_S = 0.5


class TookTooLong(Exception):
    """A run that has used up its CPU time; told as the reason why it failed."""


def run_trial(
    cpu_s: float,
    backend: str,
    parameters: Mapping[str, Value],
    dataset: str,
    sequence: Mapping[str, Value],
    metrics: Sequence[str],
    code: str,
) -> RunScores:
    """The scores of a run, as of a study's point; one that takes more than ``cpu_s`` seconds of CPU time has failed.

    The simulation of the sequence is on nobody's account: of all who are tried on it, the first would pay for it.
    """
    prepared(dataset, sequence)
    with _limited(cpu_s):
        return evaluate(backend, parameters, dataset, sequence, NO_MAP, {}, 2, metrics, code)


@contextmanager
def _limited(cpu_s: float) -> Iterator[None]:
    """Raises TookTooLong in the main thread once this process has used so much CPU time, between two calls of C code.

    The clock is looked at now and then: a timer of CPU time would make some systems count it in ticks of milliseconds,
    and the time a scan takes is one of the results. Where the system has no such timer there is no limit.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return
    end_s = time.process_time() + cpu_s

    def look(_signal: int, _frame: object) -> None:
        nonlocal end_s
        if time.process_time() > end_s:
            end_s += cpu_s  # for the scores, and for a back end that goes on whatever is raised
            raise TookTooLong(f"more than {cpu_s:g} s of CPU time")

    before = signal.signal(signal.SIGALRM, look)
    signal.setitimer(signal.ITIMER_REAL, LOOK_EVERY_S, LOOK_EVERY_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
