"""How a run ended and why: every status, and the causes that lead to it.

``evalkit.execution.one_run`` reports what it can see itself (an exception, missing data), ``run_process`` what is seen
from outside (a signal, a limit), ``run_task`` what happens afterwards (a failed scoring). The reason in words is beside
the cause in ``RunResult``.
"""

from __future__ import annotations

from enum import StrEnum


class RunStatus(StrEnum):
    """How a run ended, in one word. The machine ended an interrupted run. A skipped run was not executed."""

    COMPLETE = "complete"
    FAILED = "failed"
    CRASHED = "crashed"
    TIMEOUT = "timeout"
    OUT_OF_MEMORY = "out-of-memory"
    NOT_INSTALLED = "not-installed"
    DATA_MISSING = "data-missing"
    INTERRUPTED = "interrupted"
    SKIPPED = "skipped"


class Cause(StrEnum):
    """Why a run ended. Every cause belongs to one status."""

    COMPLETED = "completed"
    EXCEPTION = "exception"
    EXIT_CODE = "exit code"
    NO_OUTCOME = "no outcome"
    INTERRUPTED = "interrupted"
    SCORING_FAILED = "scoring failed"
    WORKER_FAILED = "worker failed"
    MACHINE_FAULT = "machine fault"
    SIGNAL = "signal"
    QUARANTINED = "quarantined"
    TIME_LIMIT = "time limit"
    CPU_TIME_LIMIT = "CPU time limit"
    MEMORY_LIMIT = "memory limit"
    MEMORY_ERROR = "memory error"
    NOT_INSTALLED = "not installed"
    DATA_MISSING = "data missing"
    NOT_RUN = "not run"
    UNREADABLE = "unreadable"

    @property
    def status(self) -> RunStatus:
        """The status of a run with this cause."""
        return _STATUS_OF_CAUSE[self]


_STATUS_OF_CAUSE = {
    Cause.COMPLETED: RunStatus.COMPLETE,
    Cause.EXCEPTION: RunStatus.FAILED,
    Cause.EXIT_CODE: RunStatus.FAILED,
    Cause.NO_OUTCOME: RunStatus.FAILED,
    Cause.INTERRUPTED: RunStatus.INTERRUPTED,
    Cause.SCORING_FAILED: RunStatus.FAILED,
    Cause.WORKER_FAILED: RunStatus.INTERRUPTED,
    Cause.MACHINE_FAULT: RunStatus.INTERRUPTED,
    Cause.SIGNAL: RunStatus.CRASHED,
    Cause.QUARANTINED: RunStatus.CRASHED,
    Cause.TIME_LIMIT: RunStatus.TIMEOUT,
    Cause.CPU_TIME_LIMIT: RunStatus.TIMEOUT,
    Cause.MEMORY_LIMIT: RunStatus.OUT_OF_MEMORY,
    Cause.MEMORY_ERROR: RunStatus.OUT_OF_MEMORY,
    Cause.NOT_INSTALLED: RunStatus.NOT_INSTALLED,
    Cause.DATA_MISSING: RunStatus.DATA_MISSING,
    Cause.NOT_RUN: RunStatus.SKIPPED,
    Cause.UNREADABLE: RunStatus.SKIPPED,
}

BROKEN = frozenset({RunStatus.FAILED, RunStatus.CRASHED, RunStatus.TIMEOUT, RunStatus.OUT_OF_MEMORY})
"""Statuses of runs that could have completed and did not."""

NOT_EXECUTED = frozenset({RunStatus.NOT_INSTALLED, RunStatus.DATA_MISSING, RunStatus.INTERRUPTED, RunStatus.SKIPPED})
"""Statuses of runs that did not start, or that the machine ended: they say nothing about the method."""
