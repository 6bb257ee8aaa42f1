"""Measurement of the cost of each scan, and scores of runs on slower virtual devices."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, TypedDict

import numpy as np

from evalkit import metrics
from evalkit.commands.realtime import virtual_clock
from evalkit.commands.realtime.virtual_clock import (
    CostProfile,
    LinearCost,
    Policy,
    Schedule,
    headroom,
    linear_cost,
    schedule,
)
from evalkit.core.arrays import Ints
from evalkit.core.errors import BackendFailed, NotInstalled
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.metrics.table import Evidence
from evalkit.metrics.trajectory import match_trajectories
from evalkit.odometry import frontend
from evalkit.odometry.run_odometry import run_odometry
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Odometry

WARM_UP_SCANS = 5
GAPS = (1, 2, 4, 8, 16)
MEASURES = ("ate_rmse_m", "rpe_1m_m", "heading_rmse_deg")


@dataclass(frozen=True)
class Method:
    """A back end by name with complete parameters; ``fresh`` makes one for a sequence."""

    name: str
    parameters: Mapping[str, Value]

    @classmethod
    def of(cls, name: str, given: Mapping[str, object]) -> Method:
        """The back end of a name; raises NotInstalled where it cannot run here."""
        spec = registry.backend(name)
        if why := spec.missing():
            raise NotInstalled(name, "not installed", why)
        return cls(name, frontend.complete_parameters(name, spec, given))

    def fresh(self) -> Odometry:
        """A new odometry."""
        return frontend.make_odometry(registry.backend(self.name), self.parameters)


@dataclass(frozen=True, eq=False)
class LoadedSequence:
    """A sequence in memory. ``bridged``: dropped scans are bridged by its wheel odometry, where it has any."""

    frames: tuple[Frame, ...]
    truth: Truth
    bridged: bool = True

    @property
    def stamps_ns(self) -> Ints:
        """When each scan (N,) begins."""
        return np.array([frame.scan.stamp_ns for frame in self.frames], dtype=np.int64)

    @property
    def odometry(self) -> Floats | None:
        """``odom_from_base`` (N, 3) at the stamps; None where a scan has none, or it is not to be used."""
        poses = [frame.odom_from_base.row for frame in self.frames if frame.odom_from_base is not None]
        return np.array(poses) if self.bridged and len(poses) == len(self.frames) else None


@dataclass(frozen=True, eq=False)
class Measured:
    """A cost profile with what it was measured on. ``work`` (N,): iterations times points; ``linear``: fitted to it."""

    profile: CostProfile
    work: Ints
    linear: LinearCost | None


@dataclass(frozen=True, slots=True)
class Rung:
    """One device factor: what was dropped and how good the rest was.

    ``late``: share of the answers that came after the next scan; ``age_ms``: from scan to answer, median and 95 %.
    ``of_answers``, ``at_hand``: metrics by name, None where there is none, of the poses answered, and of what the robot
    goes by at every scan, dropped ones included. ``lost``: why there is none, or "".
    ``predicted``: cost by the linear model from the iterations really done, in units of the cost the clock assumed
    (median over the answers); None where there is no such model.
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


def profile(method: Method, frames: Sequence[Frame], repetitions: int = 3) -> Measured:
    """The cost of every scan, median CPU time over the repetitions, and its growth with gaps.

    For a back end that computes on another device, the time it reports counts. Raises BackendFailed without any time.
    """
    _follow(method, frames[:WARM_UP_SCANS])
    full, work = _costs(method, frames, repetitions)
    growth = [1.0]
    unseen_work: list[Ints] = []
    unseen_ns: list[Ints] = []
    gaps = [gap for gap in GAPS if len(frames) // gap >= WARM_UP_SCANS]
    for gap in gaps[1:]:
        costs, their_work = _costs(method, frames[::gap], 1)
        growth.append(float(costs[1:].sum() / full[::gap][1:].sum()))
        unseen_work.append(their_work[1:])
        unseen_ns.append(costs[1:])
    linear = linear_cost(work[1:], full[1:], np.concatenate([[], *unseen_work]), np.concatenate([[], *unseen_ns]))
    return Measured(CostProfile(full, np.array(gaps), np.array(growth)), work, linear)


def arrivals_ns(frames: Iterable[Frame]) -> Ints:
    """When each scan (N,) is complete: at its last beam."""
    return np.array([frame.scan.stamp_ns + frame.scan.duration_ns for frame in frames], dtype=np.int64)


def ladder(
    method: Method, sequence: LoadedSequence, measured: Measured, factors: Iterable[float], policy: Policy
) -> tuple[Rung, ...]:
    """One rung for every factor; 0 is a device that takes no time: nothing is dropped."""
    arrivals = arrivals_ns(sequence.frames)
    known: dict[bytes, _Followed | str] = {}
    rungs = []
    for factor in factors:
        made = schedule(arrivals, measured.profile.slowed(factor), policy)
        key = made.answered.tobytes()
        if key not in known:
            known[key] = _driven(method, [sequence.frames[index] for index in made.answered])
        rungs.append(_rung(sequence, measured, factor, policy, made, known[key]))
    return tuple(rungs)


class PacedResult(TypedDict):
    """A cost profile and its ladder, as a task's result.

    ``costs_ns`` and ``work`` (N,) of every scan; ``linear``: None if the back end does not report iterations;
    ``rungs``: ``Rung`` as dictionaries, for every policy from factor 0 up.
    """

    costs_ns: Ints
    work: Ints
    gaps: Ints
    growth: Floats
    period_ns: float
    headroom: float
    linear: dict[str, Any] | None
    rungs: list[dict[str, Any]]


def paced(
    backend: str,
    parameters: Mapping[str, Value],
    dataset: str,
    dataset_parameters: Mapping[str, Value],
    factors: Sequence[float],
    policies: Sequence[Policy] = ("queue-of-one",),
    repetitions: int = 3,
    bridged: bool = True,
    code: str = "",  # noqa: ARG001 - part of the task's key
) -> PacedResult:
    """Measures a back end's cost profile on a sequence and simulates its ladder of device factors.

    ``code``: a digest of the sources of back end and data set (``registry.run_fingerprint``), for the task's key.
    """
    method = Method.of(backend, parameters)
    spec = registry.dataset(dataset)
    recorded = spec.make(**resolve_parameters(dataset, spec.parameters, dataset_parameters))
    sequence = LoadedSequence(tuple(recorded.frames()), recorded.truth(), bridged)
    measured = profile(method, sequence.frames, repetitions)
    rungs = [
        asdict(rung)
        for policy in policies
        for rung in ladder(method, sequence, measured, sorted({0.0, *factors}), policy)
    ]
    arrivals = arrivals_ns(sequence.frames)
    return {
        "costs_ns": measured.profile.scans_ns,
        "work": measured.work,
        "gaps": measured.profile.gaps,
        "growth": measured.profile.growth,
        "period_ns": float(np.median(np.diff(arrivals))),
        "headroom": headroom(arrivals, measured.profile),
        "linear": None if measured.linear is None else asdict(measured.linear),
        "rungs": rungs,
    }


def _costs(method: Method, frames: Sequence[Frame], repetitions: int) -> tuple[Ints, Ints]:
    """Cost in ns, median over repetitions, and work (N,) of every scan."""
    told = [_follow(method, frames) for _ in range(repetitions)]
    costs = np.median([row.costs_ns for row in told], axis=0)
    if not (costs > 0).all():
        scan = int(np.argmin(costs > 0))
        raise BackendFailed(method.name, f"no time was measured for scan {scan + 1}", "measure where it runs")
    return costs.astype(np.int64), told[0].work


@dataclass(frozen=True, eq=False)
class _Followed:
    """What a back end made of frames: answers (K, 3), nan where it gave none; cost and work (K,) of each."""

    answers: Floats
    costs_ns: Ints
    work: Ints


def _follow(method: Method, frames: Sequence[Frame]) -> _Followed:
    answers, costs = np.full((len(frames), 3), np.nan), np.zeros(len(frames), dtype=np.int64)
    work = np.zeros(len(frames), dtype=np.int64)
    for index, step in enumerate(run_odometry(method.fresh(), frames)):
        costs[index] = step.timing.cpu_ns or step.timing.device_ns
        if step.estimate is not None:
            iterations = sum(stage.iterations for stage in step.estimate.stages.values())
            work[index] = iterations * int(step.frame.scan.hits.sum())
            answers[index] = step.estimate.pose.row
    return _Followed(answers, costs, work)


def _driven(method: Method, frames: Sequence[Frame]) -> _Followed | str:
    """The answers of the back end to these frames, or why there are none."""
    try:
        return _follow(method, frames)
    except Exception as error:  # noqa: BLE001 - whatever a third party's code raises is a result to report
        return f"{type(error).__name__}: {error}"


def _rung(
    sequence: LoadedSequence,
    measured: Measured,
    factor: float,
    policy: Policy,
    made: Schedule,
    followed: _Followed | str,
) -> Rung:
    of_answers: dict[str, float | None] = dict.fromkeys(MEASURES)
    at_hand = dict(of_answers)
    lost, predicted = "", None
    if isinstance(followed, str):
        lost = followed
    else:
        given = np.isfinite(followed.answers[:, 0])
        answers = followed.answers[given]
        theirs = replace(
            made, answered=made.answered[given], begun_ns=made.begun_ns[given], done_ns=made.done_ns[given]
        )
        lost = "fewer than two answers" if len(answers) < 2 else ""
        of_answers = _measured(sequence, sequence.stamps_ns[theirs.answered], answers)
        if len(answers):
            live = virtual_clock.at_hand(sequence.stamps_ns, theirs, answers, sequence.odometry)
            at_hand = _measured(sequence, sequence.stamps_ns, live)
        predicted = _predicted(measured, made.answered, followed.work)
    age = np.percentile(made.age_ns * 1e-6, [50, 95])
    return Rung(
        policy, float(factor), len(made.answered), made.dropped_share, float(made.late.mean()),
        (float(age[0]), float(age[1])), of_answers, at_hand, lost, predicted,
    )  # fmt: skip


def _measured(sequence: LoadedSequence, stamps_ns: Ints, poses: Floats) -> dict[str, float | None]:
    """The measures by name of poses (K, 3) at stamps (K,)."""
    steps = np.zeros(len(stamps_ns), dtype=STEP)
    steps["stamp_ns"] = stamps_ns
    steps["x"], steps["y"], steps["theta"] = poses.T
    run = RunResult(steps, len(sequence.frames))
    evidence = Evidence(run, sequence.truth, match_trajectories(run.estimate, sequence.truth.trajectory))
    found = metrics.compute_scores(evidence, (metric for metric in metrics.METRICS if metric.name in MEASURES))
    return {name: found[name].value for name in MEASURES}


def _predicted(measured: Measured, answered: Ints, work: Ints) -> float | None:
    if measured.linear is None or len(answered) < 2:
        return None
    gaps = np.diff(answered)
    assumed = [measured.profile.ns(i, g) for i, g in zip(answered[1:].tolist(), gaps.tolist(), strict=True)]
    return float(np.median(measured.linear.ns(work[1:]) / assumed))
