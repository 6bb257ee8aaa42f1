"""Cost of the harness: CPU seconds of a run's process beyond the import of the back end, and its share of each scan.

The limits: 0.08 s for a run's process, 20 us around a timed call, 0.3 s for ``evalkit --version`` and ``evalkit list``.
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

START_LIMIT_S = 0.08
AROUND_LIMIT_US = 20.0
COMMAND_LIMIT_S = 0.3
COMMANDS = ("--version", "list")
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


def commands(rounds: int) -> dict[str, list[float]]:
    """Return the CPU seconds of the commands that answer at once, in turns; the first of each is not counted."""
    taken: dict[str, list[float]] = {name: [] for name in COMMANDS}
    for _ in range(rounds + 1):
        for name in COMMANDS:
            before = children_s()
            subprocess.run([Path(sys.executable).with_name("evalkit"), name], check=True, stdout=subprocess.DEVNULL)
            taken[name].append(children_s() - before)
    return {name: each[1:] for name, each in taken.items()}


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
    start = float(np.median(extra))
    print(
        f"a run's process beyond its libraries: {np.median(extra):.3f} s CPU; its watching: {np.median(watching):.3f} s"
    )
    print(f"limit of the process: {START_LIMIT_S} s")
    asked = commands(rounds)
    for name, each in asked.items():
        print(f"evalkit {name}: {np.median(each):.3f} s CPU, limit {COMMAND_LIMIT_S} s")
    series = [
        BenchmarkSeries("a run's process beyond its libraries", "s", tuple(extra.tolist())),
        BenchmarkSeries("watching of a short run", "s", tuple(watching)),
        BenchmarkSeries("interpreter with numpy and scipy", "s", tuple(taken["libraries"])),
        *(BenchmarkSeries(f"evalkit {name}", "s", tuple(each)) for name, each in asked.items()),
    ]
    print(f"{'back end':16} {'around [us]':>12} {'p99':>8} {'own call [us]':>14} {'share':>8}")
    for name in ("wheel-odometry", METHOD):
        steps = execute_run(name).steps
        around, own = steps["harness_ns"][1:] / 1e3, float(np.median(steps["wall_ns"])) / 1e3
        middle = float(np.median(around))
        row = f"{middle:12.1f} {np.percentile(around, 99):8.1f} {own:14.1f} {100 * middle / own:7.2f}%"
        print(f"{name:16} {row}")
        series.append(BenchmarkSeries(f"around a scan of {name}", "us", tuple(around.tolist())))
    print(f"around a scan of {METHOD}: {middle:.1f} us, limit {AROUND_LIMIT_US:g} us")
    print(benchmark.write_benchmark("overhead", series, ran_on))
    slow = any(np.median(each) > COMMAND_LIMIT_S for each in asked.values())
    return int(start > START_LIMIT_S or middle > AROUND_LIMIT_US or slow)


if __name__ == "__main__":
    sys.exit(main())
