"""Registrations compared: one call on the same clouds from the same guess, interleaved, CPU time, one thread."""

from __future__ import annotations

import argparse
import os
from functools import partial

import numpy as np

from evalkit import Cloud, Pose
from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.core.timing import timed
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import RegistrationSpec

REFERENCE = "paper-tight"


def clouds(targets: int) -> tuple[Cloud, Cloud, Pose]:
    """Return a local map of the synthetic lab with about ``targets`` points, a scan, and a guess 5 cm, 2 deg off."""
    frames = list(registry.dataset("lab").make(**_defaults("lab")).frames())
    points = np.concatenate([frame.base_from_sensor.transform(frame.scan.points()) for frame in frames[:80:10]])
    generator = np.random.default_rng(0)
    local_map = points[generator.permutation(len(points))[:targets]]
    source = frames[4].base_from_sensor.transform(frames[4].scan.points())
    return Cloud(local_map, "start"), Cloud(source, "base"), Pose(0.05, 0.02, np.radians(2.0))


def registrations(question: tuple[Cloud, Cloud, Pose]) -> tuple[dict[str, Registration], dict[str, str]]:
    """Return every installed registration that answers, with its default parameters, and why another one does not."""
    made: dict[str, Registration] = {}
    broken: dict[str, str] = {}
    for name in registry.names("backends"):
        try:
            spec = registry.backend(name)
            if isinstance(spec, RegistrationSpec) and not spec.missing():
                parameters = frontend.complete_parameters(name, spec, {})
                one = spec.make(**{p.name: parameters[p.name] for p in spec.parameters})
                one.register(*question)
                made[name] = one
        except Exception as error:  # noqa: BLE001 - a broken library takes away its own rows only
            broken[name] = f"broken: {type(error).__name__}: {error}"
    return made, broken


def main() -> None:
    """Print the median CPU time of each registration and its ratio to the reference, paired round by round."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=40)
    parser.add_argument("--targets", type=int, default=5000)
    arguments = parser.parse_args()
    ran_on = benchmark.describe_environment()
    os.environ.update(SINGLE_THREAD)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    target, source, guess = clouds(arguments.targets)
    made, broken = registrations((target, source, guess))
    for name, why in broken.items():
        print(f"{name}: {why}")
        ran_on[f"absent peer {name}"] = why
    times: dict[str, list[int]] = {name: [] for name in made}
    for round_ in range(arguments.rounds + 3):
        fresh = Cloud(target.points, "start")  # a new local map in each round, so that building an index over it counts
        order = list(made) if round_ % 2 else list(reversed(made))
        for name in order:
            match, timing = timed(partial(made[name].register, fresh, source, guess))
            timing = timing.including(match.cost)
            if round_ >= 3:
                times[name].append(timing.cpu_ns)
    print(f"{len(source)} points against {len(target)}, index and normals built in the call, {arguments.rounds} rounds")
    print(f"{'back end':18} {'ms':>8} {'x ' + REFERENCE:>16}")
    for name, ns in times.items():
        ratio = np.median(np.array(ns) / np.array(times[REFERENCE]))
        print(f"{name:18} {np.median(ns) / 1e6:8.2f} {ratio:16.2f}")
    series = [BenchmarkSeries(name, "ms", tuple((np.array(ns) / 1e6).tolist())) for name, ns in times.items()]
    print(benchmark.write_benchmark("backends", series, ran_on))


def _defaults(dataset: str) -> dict[str, object]:
    return {p.name: p.default for p in registry.dataset(dataset).parameters}


if __name__ == "__main__":
    main()
