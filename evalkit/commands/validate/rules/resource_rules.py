"""The rules on resources and on the state of the process: memory, time, files, threads, floating point, signals.

One endurance run of many calls in this process is measured (``endurance``); each rule reads one column of it.
"""

from __future__ import annotations

import math
from typing import Protocol

from evalkit.commands.validate.rules.endurance import (
    BATCHES,
    INSTANCES,
    LEAK_BYTES,
    ResourceUse,
    leak_bytes,
    rises_twice,
)
from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable, require_no_device, require_own_process
from evalkit.plugins.specs import RunsIn

FILED_NOISE = 256
"""Bytes that a process may write in the meantime without a call: the interpreter's own."""


class Endurance(Protocol):
    """A fixture that can be called many times; ``runs_in``: where the back end computes."""

    runs_in: RunsIn

    @property
    def endurance(self) -> ResourceUse:
        """What a run of many calls measured."""
        ...


def check_memory(fixture: Endurance) -> str:
    """Calls and instances leave no memory behind."""
    require_no_device(fixture.runs_in)
    found = fixture.endurance
    calls = found.size * BATCHES
    if leak := leak_bytes(found.heap, found.size, found.kept_bytes):
        raise RuleBroken(
            f"one object grows by {leak:.0f} bytes with each {found.question}, in {calls} calls and again in twice as "
            "many: free what a call allocates, and bound what the object keeps"
        )
    if found.instances >= LEAK_BYTES:
        raise RuleBroken(f"each instance leaves {found.instances:.0f} bytes behind when it is destroyed")
    if found.kept_bytes > LEAK_BYTES:
        return f"{calls} calls leave less than {found.kept_bytes:.0f} bytes each, {INSTANCES} instances nothing"
    return f"{calls} calls and {INSTANCES} instances leave nothing behind"


def check_slowdown(fixture: Endurance) -> str:
    """Calls do not become slower the more there were."""
    require_no_device(fixture.runs_in)
    found = fixture.endurance
    first, last = found.call_ns[0], [*found.call_ns, *found.call_again_ns][-1]
    observed = f"a call takes {1e-3 * first:.3g} us at first, {1e-3 * last:.3g} us after {found.calls} calls"
    observed += f"; the slowest took {1e-6 * found.slowest_ns:.3g} ms, waiting included" if found.slowest_ns else ""
    if rises_twice(found.call_ns, found.call_again_ns):
        raise RuleBroken(f"{observed}: every call costs more than the one before")
    return observed


def _check_unchanged(fixture: Endurance, names: tuple[str, ...], what: str) -> str:
    found = fixture.endurance
    for name in names:
        if found.before.get(name) != found.after.get(name):
            raise RuleBroken(f"{name}: {found.before.get(name)} before, {found.after.get(name)} after the calls")
    return f"{what} unchanged after {found.size * BATCHES} calls"


def check_open_files(fixture: Endurance) -> str:
    """Calls leave no file open."""
    require_no_device(fixture.runs_in)
    return _check_unchanged(fixture, ("open files",), "open files")


def check_files(fixture: Endurance) -> str:
    """Calls write no file."""
    found = fixture.endurance
    if math.isnan(found.filed):
        raise RuleNotApplicable("the bytes that it writes to files are not known here")
    if found.filed > FILED_NOISE:
        raise RuleBroken(f"{found.size * BATCHES} calls write {found.filed:.0f} bytes to files")
    return f"{found.size * BATCHES} calls write nothing to files"


def check_threads(fixture: Endurance) -> str:
    """Calls leave no thread or process behind."""
    require_no_device(fixture.runs_in)
    return _check_unchanged(fixture, ("threads", "processes"), "threads and processes")


def check_floating_point(fixture: Endurance) -> str:
    """The rounding mode and the other controls of floating-point arithmetic stay as they are."""
    require_own_process(fixture.runs_in)
    found = fixture.endurance
    if not found.after["rounding"]:
        raise RuleNotApplicable("the floating-point controls of this machine are not known")
    return _check_unchanged(fixture, ("rounding", "floating-point controls"), "rounding mode and controls")


def check_signals(fixture: Endurance) -> str:
    """Signal handlers, blocked signals and timers stay as they are."""
    require_own_process(fixture.runs_in)
    return _check_unchanged(fixture, ("signal handlers", "blocked signals", "timers"), "handlers, masks and timers")


def check_locale(fixture: Endurance) -> str:
    """The locale stays as it is."""
    require_own_process(fixture.runs_in)
    return _check_unchanged(fixture, ("locale",), "the locale")


def check_folder(fixture: Endurance) -> str:
    """Working folder, environment, file mode mask, limits, priority and cores stay as they are."""
    require_own_process(fixture.runs_in)
    names = ("working folder", "environment variables", "file mode mask", "limits", "priority", "cores")
    return _check_unchanged(fixture, names, "working folder, environment and limits")


RESOURCE_RULES = (
    check_memory, check_slowdown, check_open_files, check_files, check_threads, check_floating_point, check_signals,
    check_locale, check_folder,
)  # fmt: skip
