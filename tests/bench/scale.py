"""Costs of scale: planning, storing a run, a task on a cluster, and two workers compared with one.

Prints a table::

    python tests/bench/scale.py [planning store tasks workers]
"""

from __future__ import annotations

import os
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from statistics import median

import psutil

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.run_result import NO_STEPS, RunResult
from evalkit.execution import run_archive
from evalkit.execution.dask_cluster import Call, Cluster, Slot, _local
from evalkit.execution.executors import DaskExecutor, Executor, LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.results.store import Store


class NoProgress:
    """Progress that measures how long runs take, in seconds from start to end."""

    def __init__(self) -> None:
        self._started: dict[str, float] = {}
        self.seconds = 0.0

    def started(self, spec: RunSpec) -> None:
        """Record the start time."""
        self._started[spec.key] = time.perf_counter()

    def answered(self, spec: RunSpec, scans: int) -> None:
        """Do nothing."""

    def finished(self, spec: RunSpec, result: RunResult) -> None:
        """Add the duration of the run."""
        self.seconds += time.perf_counter() - self._started.pop(spec.key, time.perf_counter())


def run(
    experiment: Experiment, store: Store, executor: Executor | None = None, collect: bool = False
) -> tuple[list[RunResult], float]:
    """Return the results of all runs and their duration in seconds."""
    progress = NoProgress()
    results = [
        replace(result, steps=NO_STEPS)
        for _, result in Scheduler(store, progress, collect=collect).run(experiment, executor or LocalExecutor())
    ]
    return results, progress.seconds


def plan(methods: int, sequences: int, seeds: int, laps: float = 0.3) -> Experiment:
    """Return an experiment with the paper's method under a number of labels on a number of drives through a room."""
    content = {
        "timed": False,
        "method": [{"use": "paper", "label": f"paper {k}", "keyframes": 10 + k} for k in range(methods)],
        "sequence": [
            {"use": "room", "label": f"room {k}", "laps": laps + 1e-3 * k, "seeds": list(range(seeds))}
            for k in range(sequences)
        ],
    }
    return experiment_from_tables(content, "scale.toml", "scale", "compare scale.toml")


@contextmanager
def measure_time(what: str, count: int, unit: str = "run") -> Iterator[None]:
    """Context manager that prints the CPU and the wall time of its block."""
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    print(f"{what}: {cpu:.2f} s CPU, {wall:.2f} s wall; {1e3 * cpu / count:.3f} ms CPU a {unit}", flush=True)


def planning(folder: Path) -> None:
    """Measure 10,000 runs: reading, checking, keys, and finding stored results, with none and with all stored."""
    store = Store(folder / "empty")
    with measure_time("plan 10,000 runs", 10_000):
        big = plan(10, 10, 100)
        runs = list(big.runs())
    with measure_time("what is done of 10,000, none made", 10_000):
        assert len(run(big, store, collect=True)[0]) == 10_000
    full = Store(folder / "full")
    one = big.select(["room 0"], ["paper 0"], [0])
    run(one, full)
    made = full.run_folder(next(one.runs()).key)
    with measure_time("copy a run 10,000 times", 10_000):
        for spec in runs:
            if not full.run_folder(spec.key).exists():
                shutil.copytree(made, full.run_folder(spec.key), copy_function=os.link)
    with measure_time("what is done of 10,000, all made", 10_000):
        ended, _ = run(big, full, collect=True)
    print("  statuses:", {one.status for one in ended})
    print(f"  peak of this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


def store(folder: Path) -> None:
    """Measure the bytes and files of a run, and the time to pack and unpack one."""
    kept = Store(folder / "one")
    one = plan(1, 1, 1, laps=1.0)
    run(one, kept)
    key = next(one.runs()).key
    files = [path for path in (folder / "one").rglob("*") if path.is_file() and not path.name.startswith(".")]
    scans = kept.load_result(key).steps.size
    print(f"a run of {scans} scans: {len(files)} files, {sum(path.stat().st_size for path in files):,} bytes")
    body = run_archive.pack_run(kept, key)
    print(f"  packed for the way: {len(body):,} bytes")
    other = Store(folder / "other")
    with measure_time("pack", 100):
        for _ in range(100):
            run_archive.pack_run(kept, key)
    with measure_time("unpack", 100):
        for _ in range(100):
            run_archive.unpack_run(other, key, body)


def return_bytes(size: int, _slot: Slot) -> bytes:
    """Return the given number of bytes."""
    return bytes(size)


def tasks(_folder: Path) -> None:
    """Measure the cost of an empty task: client, scheduler and worker together on this machine."""
    with _local(2) as local:
        cluster = Cluster(local.scheduler_address, security=local.security)
        for size in (0, 100_000):
            count = 500
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            with measure_time(f"{count} empty tasks that answer {size:,} bytes", count, "task"):
                found = sum(1 for _ in cluster.answers(Call(f"n{k}", return_bytes, (size,)) for k in range(count)))
            after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            print(f"  {found} answered; client and scheduler grew by {(after - before) / 1024:.1f} MiB")


def workers(folder: Path) -> None:
    """Run the same experiment with one and with two workers, in turns.

    On a shared machine the wall clock says little. The gain of a second worker follows from the share of time in which
    a worker executes a run, and from the additional CPU time of a run next to another one.
    """
    busy: dict[int, list[float]] = {1: [], 2: []}
    cpu: dict[int, list[float]] = {1: [], 2: []}
    many = plan(2, 2, 1)
    for turn in range(3):
        for count in (1, 2) if turn % 2 == 0 else (2, 1):
            with _local(count) as local:
                executor = DaskExecutor(Cluster(local.scheduler_address, security=local.security))
                warm = plan(count, 1, 1, laps=0.05)
                run(warm, Store(folder / f"warm {turn} {count}"), executor)
                begun, used = time.perf_counter(), _cpu_s()
                ended, in_hand_s = run(many, Store(folder / f"{turn} {count}"), executor)
                wall, used = time.perf_counter() - begun, _cpu_s() - used
            assert {one.status for one in ended} == {"complete"}, {one.reason for one in ended}
            busy[count].append(in_hand_s / (wall * count))
            cpu[count].append(used / len(ended))
            print(
                f"{count} workers: {len(ended)} runs in {wall:.1f} s wall; a run in hand {busy[count][-1]:.0%} of the "
                f"time; {cpu[count][-1]:.2f} s CPU a run",
                flush=True,
            )
    in_hand, dearer = median(busy[2]) / median(busy[1]), median(cpu[1]) / median(cpu[2])
    print(f"efficiency of two workers beside one: {in_hand * dearer:.0%} ({in_hand:.0%} in hand, {dearer:.0%} in CPU)")


def _cpu_s() -> float:
    """Return the CPU time of this process and its children, including terminated ones."""
    ours = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return sum(sum(process.cpu_times()[:4]) for process in ours)


PARTS: dict[str, Callable[[Path], None]] = {"planning": planning, "store": store, "tasks": tasks, "workers": workers}

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        print(f"-- {name}; load {os.getloadavg()[0]:.1f}", flush=True)
        with tempfile.TemporaryDirectory() as scratch:
            PARTS[name](Path(scratch))
