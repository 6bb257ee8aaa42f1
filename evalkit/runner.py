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
from evalkit.errors import StoreError
from evalkit.experiment import Limits
from evalkit.store import REMEDY, read_steps
from evalkit.types import STEP, Run, Status
from evalkit.worker import Request

POLL_S = 0.05
OUTCOME = "outcome.json"
LAST_WORDS = 4096  # bytes of its output that are looked at for a reason


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
        process = subprocess.Popen(  # -P: modules of the folder we happen to be in must not stand in for others
            [sys.executable, "-P", "-m", "evalkit.worker", str(folder)],
            stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
            env={**os.environ, **SINGLE_THREAD},
        )  # fmt: skip
        try:
            ended, peak = _watched(process, folder, limits, heard, stop)
        finally:
            _end_group(process)
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
        time.sleep(POLL_S)
        now, size = time.monotonic(), _size(folder / "steps.bin")
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
    last = _last_line(folder / "output.txt")
    if code < 0:
        hint = " (by the system, where memory ran out)" if -code == signal.SIGKILL else ""
        return "crashed", f"the process was ended by {_signal(-code)}{hint}{last}"
    return "failed", f"the process ended itself with code {code}{last}"


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # most real-time signals have no name
        return f"signal {number}"


def _last_line(output: Path) -> str:
    """The last line it wrote that can be read, from the end of what may be a very long file."""
    if not output.exists():  # the back end removed it
        return ""
    with output.open("rb") as file:
        file.seek(max(output.stat().st_size - LAST_WORDS, 0))
        text = file.read().decode("utf-8", errors="replace")
    lines = ["".join(char for char in line if char.isprintable()).strip() for line in text.splitlines()]
    said = [line for line in lines if line]
    return f"; it said last: {said[-1][:300]}" if said else ""


def _end_group(process: subprocess.Popen[bytes]) -> None:
    """Ends the process and all it started: they share its session, or are still known as its children."""
    if process.poll() is None:  # its number is still its own
        with contextlib.suppress(psutil.Error):  # ended meanwhile
            for child in psutil.Process(process.pid).children(recursive=True):
                child.kill()
    with contextlib.suppress(ProcessLookupError):  # nobody is left, as it should be
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:  # not yet begun, or the back end removed it
        return 0


def _resident_bytes(pid: int) -> int:
    try:
        return int(psutil.Process(pid).memory_info().rss)
    except psutil.Error:  # ended between two looks
        return 0
