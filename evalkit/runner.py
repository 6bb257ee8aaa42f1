"""One run in a process of its own: a crash, a hang, an exception and an absent library are results."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import psutil

from evalkit.environment import SINGLE_THREAD
from evalkit.experiment import Limits
from evalkit.store import read_steps
from evalkit.types import STEP, Run, Status
from evalkit.worker import Request

POLL_S = 0.05


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
    (folder / "request.json").write_text(json.dumps(asdict(request), indent=1), encoding="utf-8")
    with (folder / "output.txt").open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "evalkit.worker", str(folder)],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
            env={**os.environ, **SINGLE_THREAD},
        )  # fmt: skip
        try:
            ended, peak = _watched(process, folder / "steps.bin", limits, heard, stop)
        finally:
            _end_group(process)
    return _result(labels, folder, ended, process.returncode, peak)


def _watched(
    process: subprocess.Popen[bytes],
    steps: Path,
    limits: Limits,
    heard: Callable[[int], None],
    stop: threading.Event,
) -> tuple[tuple[Status, str] | None, int]:
    """Waits for the process's end, or says which limit it broke; and its highest memory as seen from outside."""
    begun = last_answer = time.monotonic()
    answered = peak = 0
    while process.poll() is None:
        time.sleep(POLL_S)
        now, size = time.monotonic(), _size(steps)
        if size > answered:
            answered, last_answer = size, now
            heard(size // STEP.itemsize)
        peak = max(peak, _resident_bytes(process.pid))
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
    outcome = begun | _read(folder / "outcome.json")
    if "status" not in outcome:
        ended = ended or _how_it_died(code, folder)
    if ended is not None:
        outcome["status"], outcome["reason"] = ended
    return Run(backend=labels[0], sequence=labels[1], steps=steps, **outcome)


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def _how_it_died(code: int, folder: Path) -> tuple[Status, str]:
    last = _last_line(folder / "output.txt")
    if code < 0:
        return "crashed", f"the process was ended by {signal.Signals(-code).name}{last}"
    return "failed", f"the process ended itself with code {code}{last}"


def _last_line(output: Path) -> str:
    lines = [line.strip() for line in output.read_text(encoding="utf-8", errors="replace").splitlines() if line.strip()]
    return f"; it said last: {lines[-1][:300]}" if lines else ""


def _end_group(process: subprocess.Popen[bytes]) -> None:
    """Ends the process and all it started: they share its session."""
    with contextlib.suppress(ProcessLookupError):  # nobody is left, as it should be
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _size(path: Path) -> int:
    return path.stat().st_size if path.exists() else 0


def _resident_bytes(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:  # ended between two looks
        return 0
