"""Rebuild the map of a world from perturbed poses and compute its metrics: the tasks behind the rank agreement."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any

import numpy as np

from evalkit import metrics
from evalkit.commands.metric_validation.perturbation import PERTURBATIONS
from evalkit.core import se2
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics import evaluate
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Mapper
from evalkit.plugins.protocols import Sequence as Recording

REDUCED_DRIVE: dict[str, Value] = {"rate_hz": 5.0, "speed_mps": 0.6}
"""A drive with half as many scans in half the time, for worlds with these parameters."""

CLEAN = "clean"


def make_perturbation_task(
    world: str, perturbation: str, sizes: Sequence[float], seed: int, mapper: str, scans: int
) -> AnyTask:
    """Return the task of one perturbation of one world."""
    return make_task(
        f"{world} {perturbation}",
        score_perturbed_maps,
        world=world,
        perturbation=perturbation,
        sizes=list(sizes),
        seed=seed,
        mapper=mapper,
        scans=scans,
    ).depending_on(*find_plugin_modules(world, mapper))


def find_plugin_modules(world: str, mapper: str) -> tuple[str, str]:
    """Return the modules of a data set and a mapper, on which the result of a task depends."""
    return registry.plug_in_of("datasets", world).module, registry.plug_in_of("mappers", mapper).module


def score_perturbed_maps(
    world: str, perturbation: str, sizes: list[float], seed: int, mapper: str, scans: int
) -> dict[str, Any]:
    """Compute all metrics of the maps of a world with perturbed true poses: ``rows``, one per size.

    "clean" leaves the poses unchanged and yields one row.
    """
    sequence = load_world(world, seed)
    poses = find_true_poses(sequence)
    rows = []
    for number, size in enumerate([0.0] if perturbation == CLEAN else sizes):
        rng = np.random.default_rng([seed, number, zlib.crc32(perturbation.encode())])
        estimate = poses if perturbation == CLEAN else PERTURBATIONS[perturbation].perturb(poses, size, rng)
        rows.append({"size": size, **compute_values(make_run(sequence, estimate), sequence, mapper, scans)})
    return {"rows": rows}


def compute_values(run: RunResult, sequence: Recording, mapper: str, scans: int) -> dict[str, float | None]:
    """Compute the values of all metrics of evalkit; None where a metric has no value."""
    evidence = evaluate.add_map(evaluate.collect_evidence(run, sequence), sequence, make_mapper_factory(mapper), scans)
    return {name: score.value for name, score in metrics.compute_scores(evidence).items()}


@cache  # tasks in one process share the scans of a simulated sequence
def load_world(world: str, seed: int) -> Recording:
    """Return the sequence of a data set, with the reduced drive where it has these parameters."""
    spec = registry.dataset(world)
    known = {parameter.name for parameter in spec.parameters}
    values = {name: value for name, value in {**REDUCED_DRIVE, "seed": seed}.items() if name in known}
    return spec.make(**resolve_parameters(world, spec.parameters, values))


def find_true_poses(sequence: Recording) -> Floats:
    """Return the true poses (N, 3) of all scans. Raises ValueError without a ground-truth trajectory."""
    truth = sequence.truth().trajectory
    if truth is None:
        raise ValueError("world: no ground-truth trajectory; choose a data set that has one")
    return truth.at([frame.scan.stamp_ns for frame in sequence.frames()])


def make_run(sequence: Recording, world_from_base: Floats) -> RunResult:
    """Return a completed run with these poses (N, 3), one per scan, relative to the first pose."""
    steps = np.zeros(len(world_from_base), STEP)
    steps["stamp_ns"] = [frame.scan.stamp_ns for frame in sequence.frames()]
    start_from_base = se2.between(world_from_base[0], world_from_base)
    for column, name in enumerate(("x", "y", "theta")):
        steps[name] = start_from_base[:, column]
    return RunResult(steps, len(steps))


def make_mapper_factory(mapper: str) -> Callable[[], Mapper]:
    """Return a function that makes a new mapper of this name."""
    spec = registry.mapper(mapper)
    values = resolve_parameters(mapper, spec.parameters, {})
    return lambda: spec.make(**values)
