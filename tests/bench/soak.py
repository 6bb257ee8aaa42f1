"""Run short comparisons under random faults and check that nothing is lost or wrong: ``make soak``.

Every round is a comparison of twenty methods, most of them hostile, in a new folder. It is killed, interrupted, short
of disk or of open files, under a clock that jumps, or damaged at random, then resumed until it ends. Its rows must
equal those of the same round without a fault, and no process may be left.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from evalkit.metrics import runtime

STRANGERS = Path(__file__).resolve().parent.parent / "strangers"
FAULTS = ("none",) * 8 + (
    "raise", "nan", "segfault", "exit", "far", "no-pose", "garbage", "abort", "hidden", "hidden-exit", "remove-folder",
    "links",
)  # fmt: skip
"""What the methods of a round do: eight answer soundly, the others end in twelve ways."""

JUMPING_CLOCK = """
import random, time
time.time_ns = lambda now=time.time_ns: now() + random.randrange(-10**15, 10**15)
time.time = lambda: time.time_ns() / 1e9
"""
"""A module that every Python process imports first: each question for the time jumps by up to eleven days."""

PR_SET_CHILD_SUBREAPER = 36  # of Linux's prctl: orphans become children of this process

TIMES = {one.name for one in runtime.METRICS}
ENDS = ("lost", "wrong", "tracebacks", "links followed", "processes left")
"""What is counted beside the runs; each must be 0."""

MAX_RESUMES = 4
Rows = dict[str, tuple[object, ...]]


@dataclass(frozen=True)
class Round:
    """One round. ``duration_s``: of a round without a fault."""

    experiment: Path
    folder: Path
    drawn: random.Random
    duration_s: float
    counts: Counter[str]


def main() -> int:
    """Run the soak; returns 1 if a result was lost or wrong, or a process was left."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--runs", type=int, default=2000, help="number of runs (default 2000)")
    options.add_argument("--only", choices=sorted(BY_NAME), help="one fault (default: all, at random)")
    options.add_argument("--seed", type=int, default=1, help="seed of the faults (default 1)")
    given = options.parse_args()
    os.environ["PYTHONPATH"] = str(STRANGERS)
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    drawn = random.Random(given.seed)
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="evalkit-soak-") as place:
        experiment = _write_experiment(Path(place))
        began = time.monotonic()
        sound = _finish(experiment, Path(place) / "sound", counts)
        duration_s = time.monotonic() - began
        for number in range(max(1, given.runs // len(FAULTS))):
            folder = Path(place) / f"round-{number}"
            fault = given.only or drawn.choice(sorted(BY_NAME))
            BY_NAME[fault](Round(experiment, folder, drawn, duration_s, counts))
            counts[fault] += 1
            counts["runs"] += len(FAULTS)
            _check(_finish(experiment, folder, counts), sound, counts, f"{fault}, round {number}")
            counts["processes left"] += _end_processes()
            counts["links followed"] += (folder / "runs" / "victim.txt").exists()
            _unmount(folder)
            subprocess.run(["rm", "-rf", folder], check=True)
    for name in sorted(BY_NAME):
        print(f"{name:32} {counts[name]:6} rounds")
    for name in ("runs", *ENDS):
        print(f"{name:32} {counts[name]:6}")
    return int(any(counts[name] for name in ENDS))


def _write_experiment(folder: Path) -> Path:
    path = folder / "soak.toml"
    methods = (
        f'[[method]]\nuse = "faulty"\nlabel = "m{index:02}-{fault}"\nfault = "{fault}"\nat = {4 + index % 5}\n'
        for index, fault in enumerate(FAULTS)
    )
    mapper = '[mapper]\nuse = "log-odds"\nresolution_m = 0.25\n'
    path.write_text("".join(methods) + mapper + '[[sequence]]\nuse = "straight"\nscans = 12\n')
    return path


def _start(experiment: Path, folder: Path, *words: str, **how: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", "from evalkit.cli import main; main()", "compare", "--no-page", str(experiment)]
    return subprocess.Popen(
        [*command, "--out", str(folder), "--resume", "-j", "2", *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, **how,
    )  # fmt: skip


def _finish(experiment: Path, folder: Path, counts: Counter[str]) -> Rows:
    """Resume until every run has ended; returns what can be compared of each row, by method."""
    rows: Rows = {}
    for _ in range(MAX_RESUMES):
        out = _communicate(_start(experiment, folder, "--json"), counts)
        try:
            runs = json.loads(out)["runs"]
        except ValueError:
            continue
        rows = {run["method"]: _row(run) for run in runs}
        if all(row[0] != "interrupted" for row in rows.values()):
            break
    return rows


def _communicate(process: subprocess.Popen[str], counts: Counter[str]) -> str:
    """Wait for the end of a command; returns what it printed."""
    out, err = process.communicate(timeout=600.0)
    if "Traceback" in err and process.returncode >= 0:
        counts["tracebacks"] += 1
        print(err[-2000:])
    return out


def _row(run: dict[str, Any]) -> tuple[object, ...]:
    """Status, reason without its details, and all scores except times, which differ from run to run."""
    scores = {name: value for name, value in (run["scores"] or {}).items() if name not in TIMES}
    if run["method"].endswith("remove-folder"):  # how many answers were read before it was removed is chance
        scores = {}
    return run["status"], run["reason"].partition(" (")[0], json.dumps(scores, sort_keys=True)


def _check(found: Rows, sound: Rows, counts: Counter[str], what: str) -> None:
    for method, row in sound.items():
        other = found.get(method)
        kind = "lost" if other is None or other[0] == "interrupted" else "wrong" if other != row else ""
        if kind:
            counts[kind] += 1
            print(f"{kind}: {method} after {what}: {None if other is None else other[:2]}, sound: {row[:2]}")


def _end_processes() -> int:
    """Return the number of processes that a round left, 5 s after its end at the latest, and end them."""
    left: list[psutil.Process] = []
    for _ in range(50):
        with contextlib.suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                pass
        left = psutil.Process().children(recursive=True)
        if not left:
            return 0
        time.sleep(0.1)
    for one in left:
        print(f"left: {one}")
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    return len(left)


def _unmount(folder: Path) -> None:
    if folder.is_mount():
        subprocess.run(["umount", folder], check=True)


# --- faults


def _kill_runner(round_: Round) -> None:
    process = _start(round_.experiment, round_.folder)
    time.sleep(round_.drawn.uniform(0.0, round_.duration_s))
    process.kill()
    process.communicate()


def _cut_power(round_: Round) -> None:
    """Kill the runner and all processes below it at once."""
    process = _start(round_.experiment, round_.folder)
    time.sleep(round_.drawn.uniform(0.0, round_.duration_s))
    try:
        every = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        every = []
    for one in every:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    process.communicate()


def _interrupt(round_: Round) -> None:
    process = _start(round_.experiment, round_.folder)
    time.sleep(round_.drawn.uniform(0.0, round_.duration_s))
    process.send_signal(round_.drawn.choice([signal.SIGINT, signal.SIGTERM]))
    process.communicate(timeout=60.0)


def _limit_files(round_: Round) -> None:
    """Let no file grow beyond a random size, as a quota would."""
    _run_limited(round_, resource.RLIMIT_FSIZE, round_.drawn.choice([100, 500, 1000, 3000, 10_000]))


def _limit_descriptors(round_: Round) -> None:
    """Let every process open only a few files at once."""
    _run_limited(round_, resource.RLIMIT_NOFILE, round_.drawn.randrange(6, 48))


def _run_limited(round_: Round, what: int, limit: int) -> None:
    limited = _start(
        round_.experiment, round_.folder, preexec_fn=lambda: resource.setrlimit(what, (limit, limit))
    )  # fmt: skip
    _communicate(limited, round_.counts)


def _fill_disk(round_: Round) -> None:
    """Run on a disk that is full soon, then make room; without an administrator's rights as a limit of sizes."""
    round_.folder.mkdir()
    size = f"size={round_.drawn.randrange(20, 600)}k"
    made = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", size, "tmpfs", round_.folder], check=False, capture_output=True
    )  # fmt: skip
    if made.returncode:
        _limit_files(round_)
        return
    _communicate(_start(round_.experiment, round_.folder), round_.counts)
    subprocess.run(["mount", "-o", "remount,size=100m", round_.folder], check=True)


def _jump_clock(round_: Round) -> None:
    """Set the clock of all processes at every look at it, and kill the runner now and then."""
    place = round_.experiment.parent / "clock"
    place.mkdir(exist_ok=True)
    (place / "sitecustomize.py").write_text(JUMPING_CLOCK)
    process = _start(
        round_.experiment, round_.folder, env={**os.environ, "PYTHONPATH": f"{place}:{STRANGERS}"}
    )  # fmt: skip
    if round_.drawn.random() < 0.5:
        time.sleep(round_.drawn.uniform(0.0, round_.duration_s))
        process.kill()
    _communicate(process, round_.counts)


def _damage(round_: Round) -> None:
    """Change stored files: one bit, a block of zeros, a missing tail, another file's content."""
    _communicate(_start(round_.experiment, round_.folder), round_.counts)
    drawn = round_.drawn
    files = [
        path
        for path in sorted((round_.folder / "runs").rglob("*"))
        if path.is_file() and not path.is_symlink() and path.stat().st_size
    ]
    for path in drawn.sample(files, min(6, len(files))):
        content = bytearray(path.read_bytes())
        place = drawn.randrange(len(content))
        how = drawn.randrange(4)
        if how == 0:
            content[place] ^= 1 << drawn.randrange(8)
        elif how == 1:
            content[place : place + 512] = bytes(len(content[place : place + 512]))
        elif how == 2:
            del content[place:]
        else:
            content = bytearray(drawn.choice(files).read_bytes())
        path.write_bytes(content)


BY_NAME: dict[str, Callable[[Round], None]] = {
    "runner killed": _kill_runner,
    "all processes killed": _cut_power,
    "interrupted or terminated": _interrupt,
    "files limited in size": _limit_files,
    "open files limited": _limit_descriptors,
    "disk full": _fill_disk,
    "clock jumping": _jump_clock,
    "stored files damaged": _damage,
}

if __name__ == "__main__":
    sys.exit(main())
