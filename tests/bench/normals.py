"""CPU time of 2D normals from 8 neighbours: the compiled core, and NumPy with a cKDTree, interleaved."""

from __future__ import annotations

import argparse

import registration
from scipy.spatial import cKDTree

from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit_baselines.embedded import normals_2d
from evalkit_baselines.paper.icp import line_normals

NEIGHBOURS = 8


def main() -> None:
    """Print and store the CPU times for local maps of 5,000 and 50,000 points."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--targets", type=int, nargs="+", default=[5000, 50_000])
    arguments = parser.parse_args()
    ran_on, series = benchmark.describe_environment(), []
    for targets in arguments.targets:
        points = registration.questions(targets).target
        calls: registration.Calls = {
            "core": lambda _scan, points=points: normals_2d(points, NEIGHBOURS),
            "NumPy": lambda _scan, points=points: line_normals(cKDTree(points), NEIGHBOURS),
        }
        for call in calls.values():
            call(0)  # the first one is not counted
        times = registration.measure_ns(calls, arguments.rounds)
        series += [BenchmarkSeries(f"{name}, {targets} points", "ms", tuple(ns / 1e6)) for name, ns in times.items()]
    for one in series:
        print(f"{one.name:22} {one.median:8.2f} ms")
    print(benchmark.write_benchmark("normals", series, ran_on))


if __name__ == "__main__":
    main()
