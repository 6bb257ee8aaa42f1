"""Maps of a world made again from given poses, and scored: the jobs behind the trust in metrics."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from evalkit import metrics
from evalkit.commands.metric_validation.perturbation import WAYS
from evalkit.core import se2
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics import evaluate
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Mapper
from evalkit.plugins.protocols import Sequence as Recording

SWIFT: dict[str, Value] = {"rate_hz": 5.0, "speed_mps": 0.6}
"""A drive that takes half as many scans and half the time, where a world has these settings."""

CLEAN = "clean"


def job(world: str, way: str, sizes: Sequence[float], seed: int, mapper: str, scans: int) -> AnyTask:
    """The job of one way to spoil one world's trajectory, with the plug-ins it stands on."""
    plug_ins = (registry.plug_in_of("datasets", world).module, registry.plug_in_of("mappers", mapper).module)
    return make_task(
        f"{world} {way}", spoiled, world=world, way=way, sizes=list(sizes), seed=seed, mapper=mapper, scans=scans
    ).depending_on(*plug_ins)


def spoiled(world: str, way: str, sizes: list[float], seed: int, mapper: str, scans: int) -> dict[str, Any]:
    """Every metric of the maps of a world with its true poses spoiled in one way: a row for each size, in their order.

    "clean" leaves them as they are, whatever the sizes.
    """
    sequence = recording(world, seed)
    poses = true_poses(sequence)
    rows = []
    for number, size in enumerate([0.0] if way == CLEAN else sizes):
        rng = np.random.default_rng([seed, number, zlib.crc32(way.encode())])
        estimate = poses if way == CLEAN else WAYS[way].spoil(poses, size, rng)
        rows.append({"size": size, **scored(run_of(sequence, estimate), sequence, mapper, scans)})
    return {"rows": rows}


def scored(run: RunResult, sequence: Recording, mapper: str, scans: int) -> dict[str, float | None]:
    """The values of every own metric; None where it is not meaningful."""
    evidence = evaluate.add_map(evaluate.collect_evidence(run, sequence), sequence, maker(mapper), scans)
    return {name: score.value for name, score in metrics.compute_scores(evidence).items()}


@cache  # a process is asked for one world again and again, and a simulated one keeps its scans
def recording(world: str, seed: int) -> Recording:
    """The sequence of a name, driven swiftly where it can be."""
    spec = registry.dataset(world)
    known = {parameter.name for parameter in spec.parameters}
    given = {name: value for name, value in {**SWIFT, "seed": seed}.items() if name in known}
    return spec.make(**resolve_parameters(world, spec.parameters, given))


def true_poses(sequence: Recording) -> Floats:
    """The poses (N, 3) of every scan in the truth; ValueError without a true trajectory."""
    truth = sequence.truth().trajectory
    if truth is None:
        raise ValueError("world: its true trajectory is not known, so nothing can be spoiled")
    return truth.at([frame.scan.stamp_ns for frame in sequence.frames()])


def run_of(sequence: Recording, world_from_base: Floats) -> RunResult:
    """A run that answered these poses (N, 3), one a scan, in the frame of the first."""
    steps = np.zeros(len(world_from_base), STEP)
    steps["stamp_ns"] = [frame.scan.stamp_ns for frame in sequence.frames()]
    start_from_base = se2.between(world_from_base[0], world_from_base)
    for column, name in enumerate(("x", "y", "theta")):
        steps[name] = start_from_base[:, column]
    return RunResult(steps, len(steps))


def maker(mapper: str, settings: Mapping[str, Value] | None = None) -> Callable[[], Mapper]:
    """What makes a fresh mapper of a name."""
    spec = registry.mapper(mapper)
    values = resolve_parameters(mapper, spec.parameters, settings or {})
    return lambda: spec.make(**values)
