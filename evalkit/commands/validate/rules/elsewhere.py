"""Ask for an answer in another thread, in another process, and in copies of a process."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from typing import Any

import psutil

from evalkit.commands.validate.rules.rule import RuleBroken
from evalkit.execution import sandbox
from evalkit.execution.task import Result

FORKS = 8
"""Copies of a process, with other process numbers."""

ELSEWHERE_S, ELSEWHERE_MIB = 60.0, 2048
"""Limits of another process: time in s and memory."""


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


def run_elsewhere(function: Callable[..., Result], arguments: Mapping[str, Any]) -> Result:
    """The result of a function in another process whose fresh memory has other values; RuleBroken if it ends early."""
    os.environ["MALLOC_PERTURB_"] = "165"  # of the child: glibc fills memory with it when it is allocated and freed
    try:
        found = sandbox.run(function, dict(arguments), ELSEWHERE_S, ELSEWHERE_MIB)
    finally:
        del os.environ["MALLOC_PERTURB_"]
    if sandbox.ENDED in found:
        raise RuleBroken(f"in another process with other values in fresh memory: {found[sandbox.ENDED]}")
    return found


def count_other_copies(repeats: Callable[[], bool]) -> int:
    """The number of copies of this process in which a call returns False; 0 where threads would be lost in a copy."""
    if psutil.Process().num_threads() > 1:
        return 0
    other = 0
    for _ in range(FORKS):
        if (child := os.fork()) == 0:
            os._exit(0 if repeats() else 1)
        other += os.waitpid(child, 0)[1] != 0
    return other
