"""Error of a back end on long drives, metrics of a drive and its map, and time of map updates."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.design.run_points import RunScores, evaluate
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit_paper import stage_errors


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
    trajectory = stage_errors.true_trajectory(sequence)
    off = np.linalg.norm(se2.compose(trajectory.poses[0], poses)[:, :2] - trajectory.poses[:, :2], axis=1)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(trajectory.poses[:, :2], axis=0).T))])
    shares = way[-1] * np.arange(1, marks + 1) / marks
    ends = np.minimum(np.searchsorted(way, shares), len(way) - 1)
    means = np.sqrt(np.cumsum(off**2) / np.arange(1, len(off) + 1))
    return {"path_m": way[ends], "end_m": off[ends], "rmse_m": means[ends]}


def score_drive(
    backend: str, parameters: Mapping[str, Value], world: str, drive: Mapping[str, Value], scans: int,
    wanted: Sequence[str],
) -> RunScores:  # fmt: skip
    """Metrics of a drive and of its map; ``drive``: parameters of the sequence."""
    spec, sequence, mapper = registry.backend(backend), registry.dataset(world), registry.mapper("embedded-log-odds")
    complete = frontend.complete_parameters(backend, spec, parameters)
    return evaluate(
        backend, complete, world, resolve_parameters(world, sequence.parameters, drive), "embedded-log-odds",
        resolve_parameters("mapper", mapper.parameters, {}), scans, wanted, "",
    )  # fmt: skip


def time_map_updates(mappers: Sequence[str]) -> dict[str, float]:
    """Median CPU time (ms) of an update by a scan of the laboratory at true poses, by mapper."""
    sequence = registry.dataset("lab").make(laps=0.1)
    frames = list(zip(sequence.frames(), stage_errors.true_trajectory(sequence).poses, strict=True))
    found = {}
    for name in mappers:
        spec = registry.mapper(name)
        mapper, times = spec.make(**resolve_parameters(name, spec.parameters, {})), []
        for frame, pose in frames:
            begun = time.process_time_ns()
            mapper.update(frame.scan, Pose.of(pose) @ frame.base_from_sensor)
            times.append(time.process_time_ns() - begun)
        found[name] = float(np.median(times)) * 1e-6
    return found
