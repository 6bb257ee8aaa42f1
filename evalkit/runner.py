"""One run in a process of its own: a crash, a hang, an exception and an absent library are results."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from evalkit import child
from evalkit.errors import StoreError
from evalkit.experiment import Limits
from evalkit.store import REMEDY, read_steps
from evalkit.types import STEP, Run, Status
from evalkit.worker import Request

OUTCOME = "outcome.json"


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
        output = (folder / "output.txt").open("wb")
    except OSError as error:
        raise StoreError(str(folder), f"cannot be written ({error.strerror or error})", REMEDY) from error
    with output:
        process = child.started("evalkit.worker", folder, output)
        try:
            ended, peak = _watched(process, folder, limits, heard, stop)
        finally:
            child.end_group(process)
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
    begun = last_answer = time.monotonic()
    answered = peak = 0
    while process.poll() is None and not (folder / OUTCOME).exists():
        time.sleep(child.POLL_S)
        now, size = time.monotonic(), _size(folder / "steps.bin")
        if size > answered:
            answered, last_answer = size, now
            heard(size // STEP.itemsize)
        peak = max(peak, child.resident_bytes(process.pid))
        if peak > limits.memory_mib * 2**20:
            return ("out-of-memory", f"used more than {limits.memory_mib} MiB"), peak
        if now - begun > limits.run_s:
            return ("timeout", f"not finished after {limits.run_s:g} s"), peak
        if stop.is_set():
            return ("failed", "interrupted"), peak
        if now - last_answer > limits.scan_s:
            return ("timeout", f"no answer for {limits.scan_s:g} s after scan {answered // STEP.itemsize}"), peak
    return None, peak


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
    return "crashed" if code < 0 else "failed", child.last_words(code, folder / "output.txt")


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # not yet begun, or the back end removed it
        return 0
