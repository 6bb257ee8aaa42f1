"""Cost of the harness: CPU seconds of a run's process beyond the import of the back end, and its share of each scan.

The limits: 0.3 s per run, 1 % of a scan of the paper's method.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np

from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.config.limits import Limits
from evalkit.core.run_result import RunResult
from evalkit.execution import run_process
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.execution.one_run import Request
from evalkit.odometry import frontend
from evalkit.plugins import registry

START_LIMIT_S = 0.3
SHARE_LIMIT = 0.01
METHOD = "paper"

LIBRARIES = "import gc; gc.disable(); import numpy, scipy.spatial"
"""What the paper's method imports by itself: not the isolation's cost. Without garbage collection, as in a run."""

SHORTEST = {"laps": 0.02}


def execute_run(backend: str, **changes: object) -> RunResult:
    """Execute a complete run over the synthetic lab in a separate process."""
    spec, lab = registry.backend(backend), registry.dataset("lab")
    parameters = {p.name: p.default for p in lab.parameters} | changes
    request = Request(backend, frontend.complete_parameters(backend, spec, {}), "lab", parameters)
    with tempfile.TemporaryDirectory() as folder:
        run = run_process.run(request, Path(folder), Limits(), lambda _: None, threading.Event())
    if not run.is_complete:
        sys.exit(f"{backend}: {run.status}: {run.reason}")
    return run


def children_s() -> float:
    """Return the CPU seconds of all terminated children."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def cpu_s(statement: str) -> float:
    """Return the CPU seconds of a new interpreter that runs a statement."""
    before = children_s()
    subprocess.run([sys.executable, "-P", "-c", statement], check=True)
    return children_s() - before


def starts(rounds: int) -> dict[str, list[float]]:
    """Return the CPU seconds, in turns, of an interpreter with a back end's libraries, without and with the worker."""
    bare = LIBRARIES
    worker = (
        f"{LIBRARIES}; import evalkit.execution.one_run as w; from evalkit.plugins import registry as r; "
        f"r.backend('wheel-odometry'); r.dataset('lab')"
    )
    taken: dict[str, list[float]] = {"libraries": [], "worker": []}
    for _ in range(rounds):
        taken["libraries"].append(cpu_s(bare))
        taken["worker"].append(cpu_s(worker))
    return taken


def main() -> int:
    """Print both figures with their limits and store them; returns 1 if one exceeds its limit."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=20)
    rounds = parser.parse_args().rounds
    ran_on = benchmark.describe_environment()
    os.environ.update(SINGLE_THREAD)
    taken = starts(rounds)
    extra = np.array(taken["worker"]) - np.array(taken["libraries"])
    watching = []
    for _ in range(rounds):
        before = resource.getrusage(resource.RUSAGE_SELF)
        execute_run("wheel-odometry", **SHORTEST)
        after = resource.getrusage(resource.RUSAGE_SELF)
        watching.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    start = float(np.median(extra) + np.median(watching))
    print(
        f"a run's process beyond its libraries: {np.median(extra):.3f} s CPU; its watching: {np.median(watching):.3f} s"
    )
    print(f"together {start:.3f} s a run, limit {START_LIMIT_S} s")
    series = [
        BenchmarkSeries("start of the worker beyond its libraries", "s", tuple(extra.tolist())),
        BenchmarkSeries("watching of a short run", "s", tuple(watching)),
        BenchmarkSeries("interpreter with numpy and scipy", "s", tuple(taken["libraries"])),
    ]
    print(f"{'back end':16} {'around [us]':>12} {'p99':>8} {'own call [us]':>14} {'share':>8}")
    share = 0.0
    for name in ("wheel-odometry", METHOD):
        steps = execute_run(name).steps
        around, own = steps["harness_ns"][1:] / 1e3, float(np.median(steps["wall_ns"])) / 1e3
        share = float(np.median(around)) / own
        row = f"{np.median(around):12.1f} {np.percentile(around, 99):8.1f} {own:14.1f} {100 * share:7.2f}%"
        print(f"{name:16} {row}")
        series.append(BenchmarkSeries(f"around a scan of {name}", "us", tuple(around.tolist())))
    print(f"of a scan of {METHOD}: {100 * share:.2f} %, limit {100 * SHARE_LIMIT:g} %")
    print(benchmark.write_benchmark("overhead", series, ran_on))
    return int(start > START_LIMIT_S or share > SHARE_LIMIT)


if __name__ == "__main__":
    sys.exit(main())
