"""Measurement of a memory leak, inside the process that makes the calls."""

from __future__ import annotations

from collections.abc import Callable

import psutil

from evalkit.commands.validate.rules.rule import RuleBroken

WARM_UP_CALLS = 30
CALLS = 40


def check_memory_growth(call: Callable[[], object], allowed: int) -> str:
    """The observed growth of the resident memory; raises RuleBroken for more than ``allowed`` bytes per call."""
    process = psutil.Process()
    for _ in range(WARM_UP_CALLS):
        call()
    before_bytes = process.memory_info().rss
    for _ in range(CALLS):
        call()
    each = (process.memory_info().rss - before_bytes) / CALLS
    observed = f"{CALLS} calls after {WARM_UP_CALLS} to warm up: {max(each, 0.0) / 1000:.0f} kB more per call"
    if each > allowed:
        raise RuleBroken(f"{observed}, at most {allowed / 1000:.0f} kB are allowed")
    return observed
