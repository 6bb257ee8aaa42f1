"""From scan to pose: CPU time of one scan of the lab (790 points), one thread, the methods in turn at each scan."""

from __future__ import annotations

import argparse
import os
from functools import partial
from itertools import islice

import numpy as np

from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.core.timing import timed
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value

METHODS: dict[str, tuple[str, dict[str, Value]]] = {
    "embedded-pipeline, epsilon 1e-6": ("embedded-pipeline", {"epsilon": 1e-6}),
    "embedded-pipeline-line": ("embedded-pipeline-line", {}),
    "paper-map-line": ("paper-map-line", {}),
    "paper-tight": ("paper-tight", {}),
}
WARM_UP = 5


def main() -> None:
    """Print the median and the 99th percentile of the CPU time of a scan."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=300)
    scans = parser.parse_args().scans
    ran_on = benchmark.describe_environment()
    os.environ.update(SINGLE_THREAD)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    made = {}
    for label, (name, given) in METHODS.items():
        spec = registry.backend(name)
        if why := spec.missing():
            print(f"{label}: {why}")
            continue
        made[label] = frontend.make_odometry(spec, frontend.complete_parameters(name, spec, given))
    lab = registry.dataset("lab")
    frames = lab.make(**{p.name: p.default for p in lab.parameters}).frames()
    times: dict[str, list[int]] = {label: [] for label in made}
    points = []
    for number, frame in enumerate(islice(frames, scans + WARM_UP)):
        points.append(int(frame.scan.hits.sum()))
        for label in list(made) if number % 2 else reversed(made):
            estimate, timing = timed(partial(made[label].update, frame))
            if number >= WARM_UP:
                times[label].append(timing.including(estimate.cost).cpu_ns)
    print(f"{scans} scans of the lab, {np.median(points):.0f} points")
    print(f"{'method':34} {'median ms':>10} {'99 %':>8}")
    for label, ns in times.items():
        print(f"{label:34} {np.median(ns) / 1e6:10.3f} {np.percentile(ns, 99) / 1e6:8.3f}")
    series = [BenchmarkSeries(label, "ms", tuple((np.array(ns) / 1e6).tolist())) for label, ns in times.items()]
    print(benchmark.write_benchmark("pipeline", series, ran_on))


if __name__ == "__main__":
    main()
