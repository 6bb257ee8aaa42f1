"""One run in a process of its own: a crash, a hang, an exception and an absent library are results."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, BinaryIO

from evalkit.config.experiment import Limits
from evalkit.core.run_result import STEP, Cause, RunResult
from evalkit.execution import subprocesses
from evalkit.execution.worker import Request
from evalkit.io import untrusted_io
from evalkit.results.store import STEPS, as_store_error, whole_records

OUTCOME = "outcome.json"
KNOWN = {"cause": str, "reason": str, "expected": int, "peak_memory_bytes": int, "warm_up_scans": int, "notes": dict,
         "every": int, "reading": bool}  # fmt: skip
"""What a run may tell of itself, and of what type: its folder is open to the back end."""

OUTPUT = "output.txt"
BEGUN = "begun.json"


def run(
    request: Request,
    folder: Path,
    limits: Limits,
    heard: Callable[[int], None],
    stop: threading.Event,
    threads: int = 1,
) -> RunResult:
    """The result of a request.

    ``heard`` is told how many scans are answered; ``stop`` ends the run early; ``threads`` may be started by libraries.
    """
    with as_store_error(folder):
        (folder / "request.json").write_text(json.dumps(asdict(request), indent=1), encoding="utf-8")
        output, answers = (folder / OUTPUT).open("ab"), (folder / STEPS).open("w+b")
    with output, answers:
        process = subprocesses.started("evalkit.execution.worker", folder, output, threads)
        watch = _Watch(process, folder, limits, answers)
        try:
            ended = watch.until_the_end(heard, stop)
        finally:
            subprocesses.end_group(process, folder)
            subprocesses.cut(folder / OUTPUT)  # it may have said much since the last look
        return watch.result(ended)


class _Watch:
    """A run from outside. Its answers are read through a file of our own: they are there even if their folder is not.

    ``answers``: the file the run appends to, open for reading.
    """

    def __init__(self, process: subprocess.Popen[bytes], folder: Path, limits: Limits, answers: BinaryIO) -> None:
        self._process, self._folder, self._limits, self._answers = process, folder, limits, answers
        self._begun: dict[str, Any] = {}
        self._peak = 0

    def until_the_end(self, heard: Callable[[int], None], stop: threading.Event) -> tuple[Cause, str] | None:
        """Waits for the process's end or its outcome, or says which limit it broke.

        A process that has left its outcome has nothing to do any more, whatever still keeps it from ending.
        """
        family = subprocesses.Family(self._process.pid)
        begun = last_answer = time.monotonic()
        answered = 0
        cpu_s = cpu_at_answer_s = 0.0
        while self._process.poll() is None and not (self._folder / OUTCOME).exists():
            time.sleep(subprocesses.POLL_S)
            subprocesses.cut(self._folder / OUTPUT)
            self._begun = _read(self._folder / BEGUN) or self._begun
            now, size, used = time.monotonic(), os.fstat(self._answers.fileno()).st_size, family.usage()
            self._peak, cpu_s = max(self._peak, used.resident_bytes), max(cpu_s, used.cpu_s)
            if size > answered or self._begun.get("reading"):  # a day's recording may take minutes to look through
                last_answer, cpu_at_answer_s = now, cpu_s
            if size > answered:
                answered = size
                heard(size // STEP.itemsize)
            if stop.is_set():
                return Cause.INTERRUPTED, "interrupted"
            spent = Spent(now - begun, now - last_answer, cpu_s, cpu_s - cpu_at_answer_s, self._peak)
            if broken := _broken(self._limits, spent, answered // STEP.itemsize):
                return broken
        return None

    def result(self, ended: tuple[Cause, str] | None) -> RunResult:
        """How the run went, once its process has ended. ``ended``: the limit that ended it, if one did."""
        self._answers.seek(0)
        steps = whole_records(self._answers.read())
        values: dict[str, Any] = {"expected": 0, "peak_memory_bytes": 0}
        values |= self._begun | _read(self._folder / BEGUN) | _read(self._folder / OUTCOME)
        values.pop("reading", None)
        values["peak_memory_bytes"] = max(values["peak_memory_bytes"], self._peak)
        cause, reason = values.pop("cause", None), values.pop("reason", "")
        if cause not in set(Cause) or (cause != Cause.COMPLETED and not reason):
            ended = ended or _how_it_died(self._process.returncode, self._folder)
        cause, reason = ended or (Cause(cause), reason)
        return RunResult(steps, cause=cause, reason=reason, **values)


@dataclass(frozen=True, slots=True)
class Spent:
    """What a run has used up to now: seconds of wall clock and of CPU, in all and since its last answer; bytes."""

    run_s: float
    scan_s: float
    run_cpu_s: float
    scan_cpu_s: float
    peak_bytes: int


def _broken(limits: Limits, spent: Spent, answered: int) -> tuple[Cause, str] | None:
    """The cause and the reason of the first limit that is broken."""
    if spent.peak_bytes > limits.memory_mib * 2**20:
        return Cause.MEMORY_LIMIT, f"used more than {limits.memory_mib} MiB"
    if spent.run_s > limits.run_s:
        return Cause.TIME_LIMIT, f"not finished after {limits.run_s:g} s"
    if spent.scan_s > limits.scan_s:
        return Cause.TIME_LIMIT, f"no answer for {limits.scan_s:g} s after scan {answered}"
    if spent.run_cpu_s > limits.run_cpu_s:
        return Cause.CPU_TIME_LIMIT, f"not finished after {limits.run_cpu_s:g} s of CPU time"
    if spent.scan_cpu_s > limits.scan_cpu_s:
        return Cause.CPU_TIME_LIMIT, f"no answer for {limits.scan_cpu_s:g} s of CPU time after scan {answered}"
    return None


def _read(path: Path) -> dict[str, Any]:
    try:
        content = untrusted_io.parse_json(path.read_bytes())
    except (OSError, ValueError):  # it did not come so far, or the back end removed it or wrote into it
        return {}
    known = content if isinstance(content, dict) else {}
    return {name: value for name, value in known.items() if type(value) is KNOWN.get(name)}


def _how_it_died(code: int, folder: Path) -> tuple[Cause, str]:
    if not (folder / "request.json").exists():
        return Cause.NO_OUTCOME, "the run's folder was removed while it ran"
    if (folder / OUTCOME).exists():
        return Cause.NO_OUTCOME, f"what it left in {OUTCOME} tells no outcome"
    return Cause.SIGNAL if code < 0 else Cause.EXIT_CODE, subprocesses.last_words(code, folder / OUTPUT)
