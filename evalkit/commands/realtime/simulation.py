"""Measurement of the cost of each scan, and simulation of runs on slower devices."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypedDict

import numpy as np

from evalkit import metrics
from evalkit.commands.realtime import virtual_clock
from evalkit.commands.realtime.virtual_clock import CostProfile, LinearCost, Policy, Schedule
from evalkit.core.arrays import Ints
from evalkit.core.errors import BackendFailed, NotInstalled
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.execution.one_run import WARM_UP_SCANS
from evalkit.execution.usage import read_waited_ns
from evalkit.metrics.metric import Evidence
from evalkit.metrics.trajectory import match_trajectories
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import run_odometry
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Odometry

GAPS = (1, 2, 4, 8, 16)
"""Distances between processed scans at which the cost is measured: 2 is every second scan."""

MEASURES = ("ate_rmse_m", "rpe_1m_m", "heading_rmse_deg")


@dataclass(frozen=True)
class ProfiledMethod:
    """A back end by name with complete parameters."""

    name: str
    parameters: Mapping[str, Value]

    @classmethod
    def load(cls, name: str, given: Mapping[str, object]) -> ProfiledMethod:
        """Load a registered back end; raises NotInstalled if it cannot run here."""
        spec = registry.backend(name)
        if why := spec.missing():
            raise NotInstalled(name, "not installed", why)
        return cls(name, frontend.complete_parameters(name, spec, given))

    def make_odometry(self) -> Odometry:
        """Make a new odometry for one run."""
        return frontend.make_odometry(registry.backend(self.name), self.parameters)


@dataclass(frozen=True, eq=False)
class LoadedSequence:
    """A sequence in memory. ``bridged``: use its wheel odometry, if it has any, between two answers."""

    frames: tuple[Frame, ...]
    truth: Truth
    bridged: bool = True

    @property
    def stamps_ns(self) -> Ints:
        """The start of each scan (N,)."""
        return np.array([frame.scan.stamp_ns for frame in self.frames], dtype=np.int64)

    @property
    def arrivals_ns(self) -> Ints:
        """The time (N,) at which each scan is complete: its last beam."""
        return self.stamps_ns + np.array([frame.scan.duration_ns for frame in self.frames], dtype=np.int64)

    @property
    def odometry(self) -> Floats | None:
        """``odom_from_base`` (N, 3) at the stamps; None if a scan has none, or if it is not ``bridged``."""
        poses = [frame.odom_from_base.row for frame in self.frames if frame.odom_from_base is not None]
        return np.array(poses) if self.bridged and len(poses) == len(self.frames) else None


@dataclass(frozen=True, eq=False)
class MeasuredCosts:
    """The measured costs of a back end. ``work`` (N,): iterations times points; ``linear``: the cost fitted to it.

    ``waits_ns`` (N,): wall time of each scan beyond its CPU time, the smallest over the repetitions; without the time
    in which this process was ready to run and got no core.
    """

    profile: CostProfile
    work: Ints
    linear: LinearCost | None
    waits_ns: Ints


@dataclass(frozen=True, slots=True)
class SimulatedDevice:
    """The result of a run on a device that is slower by ``factor``.

    ``answered``: number of scans; ``dropped``: share of the scans; ``late``: share of the answers that are complete
    only after the next scan; ``age_ms``: time from scan to answer, median and 95 % quantile. ``of_answers``: metrics by
    name of the answered poses; ``at_hand``: of the newest pose known at every scan, dropped scans included; None if
    a metric has no value. ``lost``: why the back end lost track, or "". ``predicted``: cost by the linear model from
    the iterations of this run, divided by the cost that the clock assumed (median); None without such a model.
    """

    policy: str
    factor: float
    answered: int
    dropped: float
    late: float
    age_ms: tuple[float, float]
    of_answers: Mapping[str, float | None]
    at_hand: Mapping[str, float | None]
    lost: str
    predicted: float | None


def measure_costs(method: ProfiledMethod, frames: Sequence[Frame], repetitions: int = 3) -> MeasuredCosts:
    """Measure the cost of every scan, the median CPU time over the repetitions, and its growth with gaps.

    If a back end computes on another device, the time that the device reports is used. Raises BackendFailed if no time
    was measured.
    """
    _run(method, frames[:WARM_UP_SCANS])
    full, work, waits = _measure_repeatedly(method, frames, repetitions)
    growth = [1.0]
    unseen_work: list[Ints] = []
    unseen_ns: list[Ints] = []
    gaps = [gap for gap in GAPS if len(frames) // gap >= WARM_UP_SCANS]
    for gap in gaps[1:]:
        gap_costs, gap_work, _ = _measure_repeatedly(method, frames[::gap], 1)
        growth.append(float(gap_costs[1:].sum() / full[::gap][1:].sum()))
        unseen_work.append(gap_work[1:])
        unseen_ns.append(gap_costs[1:])
    linear = virtual_clock.fit_linear_cost(
        work[1:], full[1:], np.concatenate([[], *unseen_work]), np.concatenate([[], *unseen_ns])
    )
    return MeasuredCosts(CostProfile(full, np.array(gaps), np.array(growth)), work, linear, waits)


def simulate_devices(
    method: ProfiledMethod, sequence: LoadedSequence, costs: MeasuredCosts, factors: Iterable[float], policy: Policy
) -> tuple[SimulatedDevice, ...]:
    """Simulate one device per factor; factor 0 is a device that takes no time and drops nothing."""
    runs: dict[bytes, _OdometryRun] = {}
    devices = []
    for factor in factors:
        schedule = virtual_clock.compute_schedule(sequence.arrivals_ns, costs.profile.slow_down(factor), policy)
        key = schedule.answered.tobytes()
        if key not in runs:
            runs[key] = _run_or_fail(method, [sequence.frames[index] for index in schedule.answered])
        devices.append(_evaluate(sequence, costs, factor, policy, schedule, runs[key]))
    return tuple(devices)


class RealtimeResult(TypedDict):
    """The measured costs and the simulated devices of one back end on one sequence.

    ``costs_ns``, ``work`` and ``waits_ns`` (N,) of every scan, see ``MeasuredCosts``; ``headroom`` is limited by the
    scan with the number ``slowest_scan``, the next one is complete ``slowest_period_ns`` after it; ``linear``: None if
    the back end does not report iterations; ``devices``: ``SimulatedDevice`` as dictionaries, policy by policy, in
    increasing order of the factor from 0 on.
    """

    costs_ns: Ints
    work: Ints
    waits_ns: Ints
    gaps: Ints
    growth: Floats
    period_ns: float
    headroom: float
    slowest_scan: int
    slowest_period_ns: float
    linear: dict[str, Any] | None
    devices: list[dict[str, Any]]


def simulate_realtime(
    backend: str,
    parameters: Mapping[str, Value],
    dataset: str,
    dataset_parameters: Mapping[str, Value],
    factors: Sequence[float],
    policies: Sequence[Policy] = ("queue-of-one",),
    repetitions: int = 3,
    bridged: bool = True,
    code: str = "",  # noqa: ARG001 - part of the task's key
) -> RealtimeResult:
    """Measure the costs of a back end on a sequence and simulate slower devices.

    ``code``: a digest of the sources of back end and data set (``registry.hash_run_code``), for the task's key.
    """
    method = ProfiledMethod.load(backend, parameters)
    spec = registry.dataset(dataset)
    opened = spec.make(**resolve_parameters(dataset, spec.parameters, dataset_parameters))
    sequence = LoadedSequence(tuple(opened.frames()), opened.truth(), bridged)
    costs = measure_costs(method, sequence.frames, repetitions)
    headroom, slowest, period_ns = virtual_clock.compute_headroom(sequence.arrivals_ns, costs.profile)
    devices = [
        asdict(device)
        for policy in policies
        for device in simulate_devices(method, sequence, costs, sorted({0.0, *factors}), policy)
    ]
    return {
        "costs_ns": costs.profile.scans_ns,
        "work": costs.work,
        "waits_ns": costs.waits_ns,
        "gaps": costs.profile.gaps,
        "growth": costs.profile.growth,
        "period_ns": float(np.median(np.diff(sequence.arrivals_ns))),
        "headroom": headroom,
        "slowest_scan": slowest + 1,
        "slowest_period_ns": period_ns,
        "linear": None if costs.linear is None else asdict(costs.linear),
        "devices": devices,
    }


def _measure_repeatedly(method: ProfiledMethod, frames: Sequence[Frame], repetitions: int) -> tuple[Ints, Ints, Ints]:
    """Cost in ns, median over repetitions, work, and wait in ns, least over repetitions, (N,) of every scan."""
    runs = [_run(method, frames) for _ in range(repetitions)]
    costs = np.median([run.costs_ns for run in runs], axis=0)
    if not (costs > 0).all():
        scan = int(np.argmin(costs > 0))
        raise BackendFailed(method.name, f"no time was measured for scan {scan + 1}", "measure where it runs")
    return costs.astype(np.int64), runs[0].work, np.min([run.waits_ns for run in runs], axis=0)


@dataclass(frozen=True, eq=False)
class _OdometryRun:
    """Answers (K, 3) to K scans, nan if there is none, with cost, work and wait (K,); ``failure``: why it failed."""

    answers: Floats
    costs_ns: Ints
    work: Ints
    waits_ns: Ints
    failure: str = ""


def _run(method: ProfiledMethod, frames: Sequence[Frame]) -> _OdometryRun:
    answers, costs = np.full((len(frames), 3), np.nan), np.zeros(len(frames), dtype=np.int64)
    work, waits = np.zeros((2, len(frames)), dtype=np.int64)
    is_own_process = registry.backend(method.name).runs_in == "evalkit"
    without_core_ns = read_waited_ns(os.getpid()) or 0
    for index, step in enumerate(run_odometry(method.make_odometry(), frames)):
        costs[index] = step.timing.cpu_ns or step.timing.device_ns
        before_ns, without_core_ns = without_core_ns, read_waited_ns(os.getpid()) or 0
        if step.timing.cpu_ns and is_own_process:  # else a device, with its own time, or a process with its own waits
            waits[index] = max(step.timing.wall_ns - step.timing.cpu_ns - (without_core_ns - before_ns), 0)
        if step.estimate is not None:
            iterations = sum(stage.iterations for stage in step.estimate.stages.values())
            work[index] = iterations * int(step.frame.scan.hits.sum())
            answers[index] = step.estimate.pose.row
    return _OdometryRun(answers, costs, work, waits)


def _run_or_fail(method: ProfiledMethod, frames: Sequence[Frame]) -> _OdometryRun:
    """Run a back end; an exception becomes a run without answers and with a ``failure``."""
    try:
        return _run(method, frames)
    except Exception as error:  # noqa: BLE001 - any exception of a third party's code is a result to report
        none = np.zeros(0, dtype=np.int64)
        return _OdometryRun(np.zeros((0, 3)), none, none, none, f"{type(error).__name__}: {error}")


def _evaluate(
    sequence: LoadedSequence, costs: MeasuredCosts, factor: float, policy: Policy, schedule: Schedule, run: _OdometryRun
) -> SimulatedDevice:
    of_answers: dict[str, float | None] = dict.fromkeys(MEASURES)
    at_hand = dict(of_answers)
    lost, predicted = run.failure, None
    if not run.failure:
        known = np.isfinite(run.answers[:, 0])
        answers = run.answers[known]
        answered = replace(
            schedule,
            answered=schedule.answered[known],
            begun_ns=schedule.begun_ns[known],
            done_ns=schedule.done_ns[known],
        )
        lost = "fewer than two answers" if len(answers) < 2 else ""
        of_answers = _score(sequence, sequence.stamps_ns[answered.answered], answers)
        if len(answers):
            live = virtual_clock.compute_live_poses(sequence.stamps_ns, answered, answers, sequence.odometry)
            at_hand = _score(sequence, sequence.stamps_ns, live)
        predicted = _predict_cost_ratio(costs, schedule.answered, run.work)
    age = np.percentile(schedule.age_ns * 1e-6, [50, 95])
    return SimulatedDevice(
        policy, float(factor), len(schedule.answered), schedule.dropped_share, float(schedule.late.mean()),
        (float(age[0]), float(age[1])), of_answers, at_hand, lost, predicted,
    )  # fmt: skip


def _score(sequence: LoadedSequence, stamps_ns: Ints, poses: Floats) -> dict[str, float | None]:
    """The metrics by name of poses (K, 3) at stamps (K,)."""
    steps = np.zeros(len(stamps_ns), dtype=STEP)
    steps["stamp_ns"] = stamps_ns
    steps["x"], steps["y"], steps["theta"] = poses.T
    run = RunResult(steps, len(sequence.frames))
    evidence = Evidence(run, sequence.truth, match_trajectories(run.estimate, sequence.truth.trajectory))
    scores = metrics.compute_scores(evidence, (metric for metric in metrics.METRICS if metric.name in MEASURES))
    return {name: scores[name].value for name in MEASURES}


def _predict_cost_ratio(costs: MeasuredCosts, answered: Ints, work: Ints) -> float | None:
    """The median of the cost by the linear model over the cost that the clock assumed."""
    if costs.linear is None or len(answered) < 2:
        return None
    gaps = np.diff(answered)
    assumed = [costs.profile.ns(i, g) for i, g in zip(answered[1:].tolist(), gaps.tolist(), strict=True)]
    return float(np.median(costs.linear.ns(work[1:]) / assumed))
