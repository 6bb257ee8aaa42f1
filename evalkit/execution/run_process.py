"""Execute one run in a process of its own: a crash, a hang, an exception and a missing library are results."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from evalkit.config.limits import Limits
from evalkit.core.errors import MachineFault, plain
from evalkit.core.map_start import MapStart
from evalkit.core.run_result import NO_STEPS, STEP, RunResult
from evalkit.core.run_status import Cause
from evalkit.execution.conditions import ConditionsMeter
from evalkit.execution.one_run import OUTCOME, REQUEST, STARTED, WARM_UP_SCANS, Request
from evalkit.execution.subprocesses import OUTPUT, ChildProcess
from evalkit.execution.supervisor import MACHINE_FAULT_CODE
from evalkit.execution.usage import Usage
from evalkit.io import untrusted_io
from evalkit.io.output_files import as_store_error, write_text
from evalkit.odometry.corrections import MAX_REMARKS
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, parse_final, parse_paths
from evalkit.results.store import STEPS, count_sound, whole_records

KNOWN = {"cause": str, "reason": str, "expected": int, "peak_memory_bytes": int, "warm_up_scans": int, "notes": dict,
         "every": int, "reading": bool, "conditions": dict, "final_cpu_ns": int, "start": dict,
         "remarks": list, "paths_left_out": str}  # fmt: skip
"""Keys and types accepted from ``STARTED`` and ``OUTCOME``, because a back end can write to the folder of its run."""

COUNTS = {"expected": (0, 2**31), "peak_memory_bytes": (0, 2**50), "warm_up_scans": (0, 2**31), "every": (1, 2**31),
          "final_cpu_ns": (0, 2**63)}  # fmt: skip
"""The smallest value of each number accepted, and a bound above the largest."""

REPORTED = frozenset(
    {Cause.COMPLETED, Cause.EXCEPTION, Cause.MEMORY_ERROR, Cause.MACHINE_FAULT, Cause.NOT_INSTALLED, Cause.DATA_MISSING}
)
"""Causes that the process of a run may report itself; the others are seen from outside."""

PLACED = frozenset(
    {Cause.SIGNAL, Cause.EXIT_CODE, Cause.TIME_LIMIT, Cause.CPU_TIME_LIMIT, Cause.MEMORY_LIMIT, Cause.MEMORY_ERROR}
)
"""Causes that end a run at some scan, which its reason names."""

MAX_REPORT_BYTES = 2**20
"""Size of ``STARTED`` and ``OUTCOME``; beyond it they are not read."""

Ending = tuple[Cause, str]
"""A cause and its reason."""


def run(
    request: Request,
    folder: Path,
    limits: Limits,
    report_answers: Callable[[int], None],
    stop: threading.Event,
    threads: int = 1,
) -> RunResult:
    """Execute a request in a folder; returns how the run went.

    ``report_answers``: called with the number of answered scans. ``stop``: ends the run early when set. ``threads``:
    number of threads that libraries may start. Raises StoreError if the folder cannot be written.
    """
    with as_store_error(folder):
        (folder / OUTPUT).touch()
        answers = (folder / STEPS).open("w+b")
    write_text(folder / REQUEST, json.dumps(asdict(request), indent=1))
    with answers:
        meter = ConditionsMeter(request.core)
        try:
            process = ChildProcess("evalkit.execution.one_run", folder, threads)
        except OSError as error:
            if (fault := MachineFault.of("its process", error)) is None:
                raise
            return RunResult(NO_STEPS, 0, Cause.MACHINE_FAULT, str(fault))
        with process as child:
            supervision = _Supervision(child, folder, limits, answers, meter)
            ending = supervision.wait(report_answers, stop)
        return supervision.result(ending)


class _Supervision:
    """Supervision of a run from outside.

    ``answers``: the file that the run appends to, open for reading: answers survive a removed folder.
    """

    def __init__(
        self, child: ChildProcess, folder: Path, limits: Limits, answers: BinaryIO, meter: ConditionsMeter
    ) -> None:
        self._child, self._folder, self._limits, self._answers, self._meter = child, folder, limits, answers, meter
        self._started: dict[str, Any] = {}
        self._peak_bytes = 0

    def wait(self, report_answers: Callable[[int], None], stop: threading.Event) -> Ending | None:
        """Wait for the end of the process or its outcome; returns the limit that it broke, if one.

        A process that has written its outcome has finished, whatever keeps it from ending.
        """
        size = 0
        last_answer = Usage(0.0, 0.0, 0)
        for used in self._child.watch():
            self._started = _read(self._folder / STARTED) | self._started_for_good()
            self._peak_bytes = max(self._peak_bytes, used.resident_bytes)
            self._meter.update(used.cpu_s)
            grown = os.fstat(self._answers.fileno()).st_size
            if grown > size or self._started.get("reading"):  # indexing a recording of a day may take minutes
                last_answer = used
            if grown > size:
                size = grown
                report_answers(size // STEP.itemsize)
            if grown > untrusted_io.MAX_BYTES:
                return Cause.NO_OUTCOME, f"{STEPS} grew beyond {untrusted_io.MAX_BYTES} bytes"
            if stop.is_set():
                return Cause.INTERRUPTED, "interrupted"
            if (self._folder / OUTCOME).exists():
                return None
            if broken := _broken_limit(self._limits, used, last_answer, self._peak_bytes, size // STEP.itemsize):
                return broken
        return None

    def result(self, ending: Ending | None) -> RunResult:
        """How the run went, once its process has ended. ``ending``: what ended it from outside, if anything did."""
        values: dict[str, Any] = {"expected": 0, "peak_memory_bytes": 0}
        values |= _read(self._folder / STARTED) | _read(self._folder / OUTCOME) | self._started_for_good()
        values.pop("reading", None)
        values["remarks"] = tuple(values.get("remarks", ()))
        self._answers.seek(0)  # a file that something else has made huge is not read whole
        most = 2 * (values["expected"] + 1) * STEP.itemsize if values["expected"] else untrusted_io.MAX_BYTES
        steps = whole_records(self._answers.read(min(most, untrusted_io.MAX_BYTES)))
        values["peak_memory_bytes"] = max(values["peak_memory_bytes"], self._peak_bytes)
        cause, reason = values.pop("cause", None), values.pop("reason", "")
        if cause not in REPORTED or (cause != Cause.COMPLETED and not reason):
            ending = ending or _ending_without_outcome(self._child, self._folder)
        cause, reason = ending or (Cause(cause), plain(reason))
        sound = count_sound(steps)
        if sound < len(steps):
            cause, reason = Cause.NO_OUTCOME, f"{STEPS} is damaged after {sound} answers: something else wrote to it"
            steps = steps[:sound]
        if cause in PLACED and (place := _describe_place(values, steps)) and "after scan" not in reason:
            reason = f"{reason}; {place}"
        values["conditions"] = self._meter.conclude(values.get("conditions", {}))
        try:
            values["start"] = MapStart.of(values["start"]) if "start" in values else None
        except (TypeError, KeyError, ValueError) as error:
            values["start"] = None
            cause, reason = Cause.NO_OUTCOME, f"the start in the map cannot be read: {error}"
        if cause == Cause.COMPLETED and (self._folder / FINAL).exists():
            try:
                files = {name: untrusted_io.read_bytes(self._folder / name) for name in (FINAL, CLOSURES)}
                values["final"], values["loop_closures"] = parse_final(files, steps["stamp_ns"])
                if (self._folder / PATHS).exists():
                    paths = untrusted_io.read_bytes(self._folder / PATHS)
                    values["path_corrections"] = parse_paths(paths, steps["stamp_ns"])
            except (OSError, ValueError) as error:
                cause, reason = Cause.NO_OUTCOME, f"the corrected poses cannot be read: {error}"
        return RunResult(steps, cause=cause, reason=reason, **values)

    def _started_for_good(self) -> dict[str, Any]:
        """What was read before the first answer, and so before a back end could write it in most runs."""
        return self._started if "warm_up_scans" in self._started else {}


def _broken_limit(limits: Limits, used: Usage, last_answer: Usage, peak_bytes: int, answered: int) -> Ending | None:
    """The first limit that a run broke. ``last_answer``: what it had used at its last answer."""
    if peak_bytes > limits.memory_mib * 2**20:
        return Cause.MEMORY_LIMIT, f"used more than {limits.memory_mib} MiB"
    if used.exceeds_wall(limits.run_s):
        return Cause.TIME_LIMIT, f"not finished after {limits.run_s:g} s"
    if used.exceeds_wall(limits.scan_s, last_answer):
        return Cause.TIME_LIMIT, f"no answer for {limits.scan_s:g} s after scan {answered}"
    if used.cpu_s > limits.run_cpu_s:
        return Cause.CPU_TIME_LIMIT, f"not finished after {limits.run_cpu_s:g} s of CPU time"
    if used.cpu_s - last_answer.cpu_s > limits.scan_cpu_s:
        return Cause.CPU_TIME_LIMIT, f"no answer for {limits.scan_cpu_s:g} s of CPU time after scan {answered}"
    return None


def _describe_place(started: Mapping[str, Any], steps: NDArray[np.void]) -> str:
    """Where in its sequence a run ended that could not tell; "" before its first scan."""
    if not started["expected"]:
        return ""
    if "warm_up_scans" not in started:
        return f"in the warm-up with the first {min(WARM_UP_SCANS, started['expected'])} scans"
    if not len(steps):
        return "at the first scan"
    last = "all" if len(steps) == started["expected"] else str(len(steps))
    return f"after {last} answers, the last to the scan with stamp {steps['stamp_ns'][-1]} ns"


def _read(path: Path) -> dict[str, Any]:
    try:
        content = untrusted_io.parse_json(untrusted_io.read_bytes(path, MAX_REPORT_BYTES))
    except (OSError, ValueError):  # not written yet, or removed or overwritten by the back end
        return {}
    known = content if isinstance(content, dict) else {}
    return {name: value for name, value in known.items() if _is_sound(name, value)}


def _is_sound(name: str, value: object) -> bool:
    """Whether a value has the type and the range of its key."""
    if type(value) is not KNOWN.get(name):
        return False
    if isinstance(value, int) and name in COUNTS:
        low, above = COUNTS[name]
        return low <= value < above
    if name == "notes" and isinstance(value, dict):
        return all(key.isprintable() and type(count) is int for key, count in value.items())
    if name == "remarks" and isinstance(value, list):
        return len(value) <= MAX_REMARKS and all(isinstance(one, str) and one.isprintable() for one in value)
    return True


def _ending_without_outcome(child: ChildProcess, folder: Path) -> Ending:
    if not (folder / REQUEST).exists():
        return Cause.NO_OUTCOME, "the run's folder was removed while it ran"
    if child.returncode == MACHINE_FAULT_CODE:
        what = "its outcome could not be written" if (folder / STARTED).exists() else "its process could not be started"
        return Cause.MACHINE_FAULT, f"{what}; {MachineFault.REMEDY}"
    if (folder / OUTCOME).exists():
        return Cause.NO_OUTCOME, f"{OUTCOME} contains no valid outcome"
    return Cause.SIGNAL if child.returncode < 0 else Cause.EXIT_CODE, child.describe_end()
