"""Run an odometry over a sequence and record the final error of both stages, in every reading of "error"."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from evalkit.core import se2
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Unmatched
from evalkit.metrics.trajectory import match_trajectories
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Registration, Sequence
from evalkit_baselines.paper.icp import Icp

READINGS = (
    "mean distance", "root mean square", "mean square",
    "mean distance, every pair", "root mean square, every pair", "mean square, every pair",
)  # fmt: skip
"""Readings of "error" (m; squares m^2): over the one-to-one pairs of the stop rule, and over every nearest pair."""

STAGES = ("s2s", "s2m")


@dataclass(frozen=True, eq=False)
class StageErrors:
    """Result of a run: ``poses`` (N, 3) ``start_from_base``; per stage ``errors`` (N, 6) in the order of ``READINGS``
    and ``iterations`` (N,), nan where the stage did not run.
    """

    frames: tuple[Frame, ...]
    poses: Floats
    errors: Mapping[str, Floats]
    iterations: Mapping[str, Floats]

    @property
    def stamps_ns(self) -> Stamps:
        """Time (N,) of the first beam of each scan."""
        return np.array([frame.scan.stamp_ns for frame in self.frames], dtype=np.int64)

    @property
    def estimate(self) -> Trajectory:
        """The poses as a trajectory."""
        return Trajectory(self.stamps_ns, self.poses, "start", "base")


class RecordingRegistration:
    """A registration that records the errors of its last match in every reading."""

    def __init__(self, inner: Icp, every_pair: bool) -> None:
        self._inner, self._every_pair = inner, every_pair
        self.errors = np.full(len(READINGS), np.nan)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Register with the inner registration."""
        found = self._inner.register(target, source, guess)
        self.errors = np.full(len(READINGS), np.nan)
        pairs = found.history[-1].pairs if found.history else None
        if pairs is not None and len(pairs):
            moved = found.target_from_source.transform(source.points)
            self.errors[:3] = compute_readings(np.hypot(*(moved[pairs[:, 0]] - target.points[pairs[:, 1]]).T))
            if self._every_pair:
                nearest, _ = cKDTree(target.points).query(moved)
                limit = self._inner.max_correspondence_m or np.inf
                self.errors[3:] = compute_readings(np.asarray(nearest)[np.asarray(nearest) <= limit])
        return found


def compute_readings(distances: Floats) -> tuple[float, float, float]:
    """Mean, root mean square and mean square of distances (K,), K > 0."""
    square = float(np.mean(distances**2))
    return float(distances.mean()), float(np.sqrt(square)), square


def run_with_errors(
    sequence: Sequence, backend: str, parameters: Mapping[str, Value], every_pair: bool = False
) -> StageErrors:  # fmt: skip
    """Run one of the paper's readings over a sequence, with evalkit's front end."""
    spec = registry.backend(backend)
    made: list[RecordingRegistration] = []  # the front end creates the first stage first

    def make(**own: Value) -> Registration:
        made.append(RecordingRegistration(spec.make(**{**own, "trace": True}), every_pair))
        return made[-1]

    odometry = frontend.make_odometry(
        replace(spec, make=make),
        frontend.complete_parameters(backend, spec, parameters),
    )
    frames = tuple(sequence.frames())
    poses = np.zeros((len(frames), 3))
    errors = {stage: np.full((len(frames), len(READINGS)), np.nan) for stage in STAGES}
    iterations = {stage: np.full(len(frames), np.nan) for stage in STAGES}
    for index, frame in enumerate(frames):
        estimate = odometry.update(frame)
        poses[index] = estimate.pose.row
        stages = {str(name): stage for name, stage in estimate.stages.items()}
        for stage, watched in zip(STAGES, made, strict=True):
            if reported := stages.get(stage):
                errors[stage][index], iterations[stage][index] = watched.errors, reported.iterations
    return StageErrors(frames, poses, errors, iterations)


def true_trajectory(sequence: Sequence) -> Trajectory:
    """True trajectory of a sequence. Raises ValueError if it has none."""
    truth = sequence.truth().trajectory
    if truth is None:
        raise ValueError("truth: the sequence has no true trajectory")
    return truth


def position_errors_m(estimate: Trajectory, truth: Trajectory) -> Floats:
    """Position errors (N,) (m) at the same stamps after least-squares alignment."""
    return np.asarray(np.hypot(*(align(estimate, truth).poses - truth.poses)[:, :2].T))


def align(estimate: Trajectory, truth: Trajectory) -> Trajectory:
    """Align the estimate to the ground truth by least squares over all positions. Raises ValueError if impossible."""
    matched = match_trajectories(estimate, truth)
    if isinstance(matched, Unmatched):
        raise ValueError(matched.reason)
    return estimate.moved(matched.world_from_start, "world")


def final_percent(estimate: Trajectory, truth: Trajectory) -> float:
    """Error of the last pose in percent of the path, with the first poses aligned."""
    ours, theirs = (se2.between(each.poses[0], each.poses[-1]) for each in (estimate, truth))
    return float(100.0 * np.hypot(*(ours - theirs)[:2]) / truth.path_m)


def yaw_rates_dps(stamps_ns: Stamps, poses: Floats) -> Floats:
    """Yaw rates (N,) in deg/s: the larger of the steps before and after each stamp."""
    steps = np.abs(np.degrees(se2.between(poses[:-1], poses[1:])[:, 2])) / (np.diff(stamps_ns) * 1e-9)
    return np.asarray(np.maximum(np.append(steps, 0.0), np.append(0.0, steps)), dtype=np.float64)
