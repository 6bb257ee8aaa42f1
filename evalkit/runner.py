"""One run in a process of its own: a crash, a hang, an exception and an absent library are results."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from evalkit import child
from evalkit.errors import StoreError
from evalkit.experiment import Limits
from evalkit.store import REMEDY, read_steps
from evalkit.types import STEP, Run, Status
from evalkit.worker import Request

OUTCOME = "outcome.json"
OUTPUT = "output.txt"


def run(
    request: Request,
    labels: tuple[str, str],
    folder: Path,
    limits: Limits,
    heard: Callable[[int], None],
    stop: threading.Event,
) -> Run:
    """What became of a request; ``labels``: contestant and sequence.

    ``heard`` is told how many scans are answered; ``stop`` ends the run early.
    """
    try:
        (folder / "request.json").write_text(json.dumps(asdict(request), indent=1), encoding="utf-8")
        output = (folder / OUTPUT).open("ab")
    except OSError as error:
        raise StoreError(str(folder), f"cannot be written ({error.strerror or error})", REMEDY) from error
    with output:
        process = child.started("evalkit.worker", folder, output)
        try:
            ended, peak = _watched(process, folder, limits, heard, stop)
        finally:
            child.end_group(process, folder)
    return _result(labels, folder, ended, process.returncode, peak)


def _watched(
    process: subprocess.Popen[bytes],
    folder: Path,
    limits: Limits,
    heard: Callable[[int], None],
    stop: threading.Event,
) -> tuple[tuple[Status, str] | None, int]:
    """Waits for the process's end or its outcome, or says which limit it broke; and its highest memory from outside.

    A process that has left its outcome has nothing to do any more, whatever still keeps it from ending.
    """
    family = child.Family(process.pid)
    begun = last_answer = time.monotonic()
    answered = peak = 0
    cpu_s = cpu_at_answer_s = 0.0
    while process.poll() is None and not (folder / OUTCOME).exists():
        time.sleep(child.POLL_S)
        child.cut(folder / OUTPUT)
        now, size, used = time.monotonic(), _size(folder / "steps.bin"), family.usage()
        peak, cpu_s = max(peak, used.resident_bytes), max(cpu_s, used.cpu_s)
        if size > answered:
            answered, last_answer, cpu_at_answer_s = size, now, cpu_s
            heard(size // STEP.itemsize)
        if stop.is_set():
            return ("failed", "interrupted"), peak
        spent = Spent(now - begun, now - last_answer, cpu_s, cpu_s - cpu_at_answer_s, peak)
        if broken := _broken(limits, spent, answered // STEP.itemsize):
            return broken, peak
    return None, peak


@dataclass(frozen=True, slots=True)
class Spent:
    """What a run has used up to now: seconds of wall clock and of CPU, in all and since its last answer; bytes."""

    run_s: float
    scan_s: float
    run_cpu_s: float
    scan_cpu_s: float
    peak_bytes: int


def _broken(limits: Limits, spent: Spent, answered: int) -> tuple[Status, str] | None:
    """The status and the reason of the first limit that is broken."""
    if spent.peak_bytes > limits.memory_mib * 2**20:
        return "out-of-memory", f"used more than {limits.memory_mib} MiB"
    if spent.run_s > limits.run_s:
        return "timeout", f"not finished after {limits.run_s:g} s"
    if spent.scan_s > limits.scan_s:
        return "timeout", f"no answer for {limits.scan_s:g} s after scan {answered}"
    if spent.run_cpu_s > limits.run_cpu_s:
        return "timeout", f"not finished after {limits.run_cpu_s:g} s of CPU time"
    if spent.scan_cpu_s > limits.scan_cpu_s:
        return "timeout", f"no answer for {limits.scan_cpu_s:g} s of CPU time after scan {answered}"
    return None


def _result(labels: tuple[str, str], folder: Path, ended: tuple[Status, str] | None, code: int, peak: int) -> Run:
    steps = read_steps(folder / "steps.bin")
    begun: dict[str, Any] = {"expected": 0, "warm_up_scans": 0, "notes": {}, "peak_memory_bytes": peak} | _read(
        folder / "begun.json"
    )
    outcome = begun | _read(folder / OUTCOME)
    if "status" not in outcome:
        ended = ended or _how_it_died(code, folder)
    if ended is not None:
        outcome["status"], outcome["reason"] = ended
    return Run(backend=labels[0], sequence=labels[1], steps=steps, **outcome)


def _read(path: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:  # it did not come so far, or the back end removed it
        return {}
    return content


def _how_it_died(code: int, folder: Path) -> tuple[Status, str]:
    if not (folder / "request.json").exists():
        return "failed", "the run's folder was removed while it ran, and its answers with it"
    return "crashed" if code < 0 else "failed", child.last_words(code, folder / OUTPUT)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # not yet begun, or the back end removed it
        return 0
