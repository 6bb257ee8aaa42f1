"""Run short comparisons under random faults and check that nothing is lost or wrong: ``make soak``.

Every round is a comparison of twenty methods, some of them hostile, in a new folder. It is killed, interrupted, short
of disk or damaged at random, then resumed until it ends. Its rows must equal those of the same round without a fault.
"""

from __future__ import annotations

import argparse
import contextlib
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
from pathlib import Path
from typing import Any

import psutil

from evalkit.metrics import runtime

STRANGERS = Path(__file__).resolve().parent.parent / "strangers"
FAULTS = ("none",) * 12 + ("raise", "nan", "segfault", "exit", "far", "no-pose", "garbage", "abort")
"""What the methods of a round do: twelve answer soundly, the others end in eight ways."""

TIMES = {one.name for one in runtime.METRICS}
MAX_RESUMES = 4
Rows = dict[str, tuple[object, ...]]


def main() -> int:
    """Run the soak; returns 1 if a result was lost or wrong, or a process was left."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--runs", type=int, default=2000, help="number of runs (default 2000)")
    options.add_argument("--seed", type=int, default=1, help="seed of the faults (default 1)")
    given = options.parse_args()
    os.environ["PYTHONPATH"] = str(STRANGERS)
    drawn = random.Random(given.seed)
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="evalkit-soak-") as place:
        experiment = _write_experiment(Path(place))
        began = time.monotonic()
        sound = _finish(experiment, Path(place) / "sound")
        duration_s = time.monotonic() - began
        for number in range(max(1, given.runs // len(FAULTS))):
            folder = Path(place) / f"round-{number}"
            fault = drawn.choice(sorted(BY_NAME))
            BY_NAME[fault](experiment, folder, drawn, duration_s)
            counts[fault] += 1
            counts["runs"] += len(FAULTS)
            _check(_finish(experiment, folder), sound, counts, f"{fault}, round {number}")
            counts["processes left"] += _count_processes(folder)
            subprocess.run(["rm", "-rf", folder], check=True)
    for name in sorted(BY_NAME):
        print(f"{name:32} {counts[name]:6} rounds")
    for name in ("runs", "lost", "wrong", "processes left"):
        print(f"{name:32} {counts[name]:6}")
    return int(bool(counts["lost"] or counts["wrong"] or counts["processes left"]))


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


def _finish(experiment: Path, folder: Path) -> Rows:
    """Resume until every run has ended; returns what can be compared of each row, by method."""
    rows: Rows = {}
    for _ in range(MAX_RESUMES):
        out, err = _start(experiment, folder, "--json").communicate(timeout=600.0)
        if "Traceback" in err:
            print(err[-2000:])
        try:
            runs = json.loads(out)["runs"]
        except ValueError:
            continue
        rows = {run["method"]: (run["status"], _plain(run["reason"]), _values(run["scores"])) for run in runs}
        if all(row[0] != "interrupted" for row in rows.values()):
            break
    return rows


def _plain(reason: str) -> str:
    return reason.partition(" (")[0]


def _values(scores: dict[str, object] | None) -> str:
    """Return all scores except times, which differ from run to run."""
    return json.dumps({name: value for name, value in (scores or {}).items() if name not in TIMES}, sort_keys=True)


def _check(found: Rows, sound: Rows, counts: Counter[str], what: str) -> None:
    for method, row in sound.items():
        other = found.get(method)
        kind = "lost" if other is None or other[0] == "interrupted" else "wrong" if other != row else ""
        if kind:
            counts[kind] += 1
            print(f"{kind}: {method} after {what}: {None if other is None else other[:2]}, sound: {row[:2]}")


def _count_processes(folder: Path) -> int:
    """Return the number of processes with the folder on their command line, 5 s after the end at the latest."""
    for _ in range(50):
        left = [one.pid for one in psutil.process_iter(["cmdline"]) if str(folder) in str(one.info["cmdline"])]
        if not left:
            return 0
        time.sleep(0.1)
    return len(left)


# --- faults


def _kill_runner(experiment: Path, folder: Path, drawn: random.Random, duration_s: float) -> None:
    process = _start(experiment, folder)
    time.sleep(drawn.uniform(0.0, duration_s))
    process.kill()
    process.communicate()


def _cut_power(experiment: Path, folder: Path, drawn: random.Random, duration_s: float) -> None:
    """Kill the runner and all processes below it at once."""
    process = _start(experiment, folder)
    time.sleep(drawn.uniform(0.0, duration_s))
    try:
        every = [psutil.Process(process.pid), *psutil.Process(process.pid).children(recursive=True)]
    except psutil.NoSuchProcess:
        every = []
    for one in every:
        with contextlib.suppress(psutil.NoSuchProcess):
            one.kill()
    process.communicate()


def _interrupt(experiment: Path, folder: Path, drawn: random.Random, duration_s: float) -> None:
    process = _start(experiment, folder)
    time.sleep(drawn.uniform(0.0, duration_s))
    process.send_signal(drawn.choice([signal.SIGINT, signal.SIGTERM]))
    process.communicate(timeout=60.0)


def _fill_disk(experiment: Path, folder: Path, drawn: random.Random, _duration_s: float) -> None:
    """Let no file grow beyond a random size, as a quota would."""
    size = drawn.choice([100, 500, 1000, 3000, 10_000])
    _start(experiment, folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))).communicate(
        timeout=600.0
    )


def _damage(experiment: Path, folder: Path, drawn: random.Random, _duration_s: float) -> None:
    """Change stored files: one bit, a block of zeros, a missing tail, another file's content."""
    _start(experiment, folder).communicate(timeout=600.0)
    files = [path for path in sorted((folder / "runs").rglob("*")) if path.is_file() and path.stat().st_size]
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


BY_NAME: dict[str, Callable[[Path, Path, random.Random, float], None]] = {
    "runner killed": _kill_runner,
    "all processes killed": _cut_power,
    "interrupted or terminated": _interrupt,
    "files limited in size": _fill_disk,
    "stored files damaged": _damage,
}

if __name__ == "__main__":
    sys.exit(main())
