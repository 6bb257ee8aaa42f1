"""Cost of the harness: CPU seconds of a run's process beyond the import of the back end, and its share of each scan.

The limits: 0.08 s for a run's process, 20 us around a timed call, 0.3 s for ``evalkit --version`` and ``evalkit list``.
As in a comparison, the parent names the module of the back end and the frames are in a file. 20 us are asked around a
method that does nothing. Around a method that works, the same instructions take longer, because its own work, and other
processes while it works, take the caches: how much is shown by a method that reads 32 MB, and by two back ends.
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
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Frame
from evalkit.execution import run_process
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.execution.one_run import Request, record_run
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.stored_frames import FramesFile, StoredFrames, write_frames

START_LIMIT_S = 0.08
AROUND_LIMIT_US = 20.0
COMMAND_LIMIT_S = 0.3
COMMANDS = ("--version", "list")
BACKENDS = ("wheel-odometry", "paper")
SWEPT_MB = 32

LIBRARIES = "import gc; gc.disable(); import numpy, scipy.spatial"
"""What the paper's method imports by itself: not the isolation's cost. Without garbage collection, as in a run."""

SHORTEST = {"laps": 0.02}


class IdleMethod:
    """Answers each scan at once, after it has read and written some megabytes."""

    def __init__(self, megabytes: int) -> None:
        self._values = np.zeros(megabytes * 2**20 // 8)

    def update(self, frame: Frame) -> OdometryEstimate:
        """Return the identity."""
        self._values += 1.0
        return OdometryEstimate(Pose())


def open_lab(**changes: Value) -> tuple[Sequence, dict[str, Value]]:
    """Return the synthetic lab and its parameters."""
    lab = registry.dataset("lab")
    parameters = {p.name: p.default for p in lab.parameters} | changes
    return lab.open(parameters), parameters


def store_frames(sequence: Sequence, folder: Path) -> FramesFile:
    """Write the frames of a sequence, as a comparison does for the runs of all methods."""
    path = folder / "lab.frames"
    digest = write_frames(sequence, path, folder)
    if digest is None:
        sys.exit("the frames of the lab fit no file")
    return FramesFile(str(path), digest)


def execute_run(backend: str, **changes: Value) -> tuple[RunResult, float]:
    """Execute a complete run over the synthetic lab in a separate process; also returns the CPU seconds of watching."""
    spec, (lab, parameters) = registry.backend(backend), open_lab(**changes)
    address = registry.find_address("backends", backend)
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as shared:
        frames = store_frames(lab, Path(shared))
        own = frontend.complete_parameters(backend, spec, {})
        request = Request(backend, own, "lab", parameters, frames=frames, plug_in=address)
        begin = resource.getrusage(resource.RUSAGE_SELF)
        run = run_process.run(request, Path(folder), Limits(), lambda _: None, threading.Event())
        end = resource.getrusage(resource.RUSAGE_SELF)
    if not run.is_complete:
        sys.exit(f"{backend}: {run.status}: {run.reason}")
    return run, end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime


def time_around(rounds: int) -> dict[int, list[float]]:
    """Return the microseconds around each call of idle methods over the stored frames of the lab, in turns, by the
    megabytes that they sweep."""
    around: dict[int, list[float]] = {0: [], SWEPT_MB: []}
    with tempfile.TemporaryDirectory() as folder:
        frames, path = StoredFrames(store_frames(open_lab()[0], Path(folder))), Path(folder) / "steps.bin"
        for _ in range(rounds):
            for megabytes, found in around.items():
                with path.open("wb", buffering=0) as file:
                    record_run(IdleMethod(megabytes), frames.frames(), Request("idle", {}, "lab", {}), file)
                found.extend((np.fromfile(path, STEP)["harness_ns"][1:] / 1e3).tolist())
    return around


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
    address = registry.find_address("backends", "wheel-odometry")
    worker = (
        f"{LIBRARIES}; import evalkit.execution.one_run as w; from evalkit.plugins import registry as r; "
        f"r.backend('wheel-odometry', {address!r})"
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
    """Print all figures with their limits and store them; returns 1 if one exceeds its limit."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=20)
    rounds = parser.parse_args().rounds
    ran_on = benchmark.describe_environment()
    os.environ.update(SINGLE_THREAD)
    taken = starts(rounds)
    extra = np.array(taken["worker"]) - np.array(taken["libraries"])
    watching = [execute_run("wheel-odometry", **SHORTEST)[1] for _ in range(rounds)]
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
    for name in BACKENDS:
        steps = execute_run(name)[0].steps
        around, own = steps["harness_ns"][1:] / 1e3, float(np.median(steps["wall_ns"])) / 1e3
        middle = float(np.median(around))
        row = f"{middle:12.1f} {np.percentile(around, 99):8.1f} {own:14.1f} {100 * middle / own:7.2f}%"
        print(f"{name:16} {row}")
        series.append(BenchmarkSeries(f"around a scan of {name}", "us", tuple(around.tolist())))
    idle, swept = time_around(rounds).values()
    series += [
        BenchmarkSeries("around an idle method", "us", tuple(idle)),
        BenchmarkSeries(f"around an idle method that sweeps {SWEPT_MB} MB", "us", tuple(swept)),
    ]
    print(f"around an idle method: {np.median(idle):.1f} us, limit {AROUND_LIMIT_US:g} us; ", end="")
    print(f"after it has swept {SWEPT_MB} MB: {np.median(swept):.1f} us")
    print(benchmark.write_benchmark("overhead", series, ran_on))
    slow = any(np.median(each) > COMMAND_LIMIT_S for each in asked.values())
    return int(start > START_LIMIT_S or np.median(idle) > AROUND_LIMIT_US or slow)


if __name__ == "__main__":
    sys.exit(main())
