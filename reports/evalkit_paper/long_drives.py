"""Error of a back end on long drives and among walking people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.commands.study.evaluate import RunScores, evaluate
from evalkit.core import se2
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value


def error_over_path(
    backend: str, parameters: Mapping[str, Value], world: str, seed: int, laps: float, marks: int
) -> dict[str, Any]:
    """Error of one long drive at ``marks`` evenly spaced points of its path, with the first pose aligned.

    ``path_m`` (K,): path length so far; ``end_m`` (K,): position error there; ``rmse_m`` (K,): RMS error so far.
    """
    sequence = registry.dataset(world).make(seed=seed, laps=laps)
    spec = registry.backend(backend)
    odometry = frontend.make_odometry(spec, frontend.complete_parameters(backend, spec, parameters))
    poses = estimate_poses(odometry, sequence.frames())
    trajectory = sequence.truth().trajectory
    if trajectory is None:
        raise ValueError(f"{world}: has no true trajectory")
    off = np.linalg.norm(se2.compose(trajectory.poses[0], poses)[:, :2] - trajectory.poses[:, :2], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trajectory.poses[:, :2], axis=0).T))])
    shares = way[-1] * np.arange(1, marks + 1) / marks
    ends = np.minimum(np.searchsorted(way, shares), len(way) - 1)
    means = np.sqrt(np.cumsum(off**2) / np.arange(1, len(off) + 1))
    return {"path_m": way[ends], "end_m": off[ends], "rmse_m": means[ends]}


def metrics_among_people(
    backend: str, parameters: Mapping[str, Value], world: str, seed: int, laps: float, people: int, scans: int,
    wanted: Sequence[str],
) -> RunScores:  # fmt: skip
    """Metrics of a drive among walking people."""
    spec, sequence, mapper = registry.backend(backend), registry.dataset(world), registry.mapper("embedded-log-odds")
    drive: dict[str, Value] = {p.name: p.default for p in sequence.parameters}
    drive |= {"seed": seed, "laps": laps, "people": people}
    drawn: dict[str, Value] = {p.name: p.default for p in mapper.parameters}
    complete = frontend.complete_parameters(backend, spec, parameters)
    return evaluate(backend, complete, world, drive, "embedded-log-odds", drawn, scans, wanted, "")
