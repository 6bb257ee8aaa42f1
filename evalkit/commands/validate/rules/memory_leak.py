"""How much memory calls leave behind, seen from inside the process that makes them."""

from __future__ import annotations

from collections.abc import Callable

import psutil

from evalkit.commands.validate.rules.rule import Broken

WARM_UP_CALLS = 30
CALLS = 40


def grown_bytes(call: Callable[[], object], allowed: int) -> str:
    """What was observed of the resident memory; Broken where a call leaves more than ``allowed`` bytes behind."""
    process = psutil.Process()
    for _ in range(WARM_UP_CALLS):
        call()
    before = process.memory_info().rss
    for _ in range(CALLS):
        call()
    each = (process.memory_info().rss - before) / CALLS
    observed = f"{CALLS} calls after {WARM_UP_CALLS} to warm up: {max(each, 0.0) / 1000:.0f} kB more per call"
    if each > allowed:
        raise Broken(f"{observed}, at most {allowed / 1000:.0f} kB are allowed")
    return observed
