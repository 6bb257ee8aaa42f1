"""Trials of a basin: a back end registers pairs of scans with a known motion from many disturbed guesses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np

from evalkit.commands.basin import convergence, scenes, sequences
from evalkit.commands.basin.scenes import KnownPair
from evalkit.commands.basin.sequences import PairSource
from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import format_exception
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.execution.task import Task, make_task
from evalkit.execution.task_runner import OnDone, TaskFailure, TasksFailed, run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.plugins import registry
from evalkit.plugins.address import address_of, backend_at
from evalkit.plugins.code_hash import hash_code, hash_files
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

TRIALS_PER_TASK = 512
"""Trials in one task: a few seconds of a compiled back end."""


@dataclass(frozen=True)
class TrialPlan:
    """The trials of all back ends in one scene; metres and radians.

    ``offsets``: how many guesses, spread over ``pairs`` pairs of scans with ``beams`` beams and ``noise_m`` of noise.
    ``data``: name and parameters of the data set of the scans (then beams and noise are its own, and ``noise_m`` is the
    assumed noise), empty if the scans are simulated.
    """

    place: str
    offsets: int
    pairs: int
    beams: int
    noise_m: float
    reach_m: float
    reach_rad: float
    seed: int
    data: Mapping[str, Any] = field(default_factory=dict)

    @property
    def recorded(self) -> PairSource | None:
        """The data set of the scans, None if they are simulated."""
        return PairSource(self.place, **self.data) if self.data else None

    @property
    def what(self) -> str:
        """A description of the scene."""
        return self.recorded.what if self.recorded else scenes.find_scene(self.place).what

    def rng(self) -> np.random.Generator:
        """A random generator with a seed that depends on the trials only."""
        number = list(scenes.SCENES).index(scenes.find_scene(self.place).name)
        return np.random.default_rng([self.seed, number])

    def pairs_of_scans(self) -> tuple[KnownPair, ...]:
        """The pairs of scans, possibly fewer for a data set."""
        if self.recorded:
            return sequences.load_pairs(self.recorded, self.pairs)
        where, rng = scenes.find_scene(self.place), self.rng()
        return tuple(scenes.draw_pair(where, rng, self.beams, self.noise_m) for _ in range(self.pairs))

    def offsets_drawn(self) -> Floats:
        """The errors of the guesses (N, 3), along the axes of the world."""
        rng = np.random.default_rng([self.seed, len(scenes.SCENES)])
        return convergence.with_axes(convergence.draw_offsets(self.offsets, self.reach_m, self.reach_rad, rng))

    def pair_numbers(self, pairs: int) -> Ints:
        """For each trial the number (N,) of its pair of scans.

        Every kind of trial takes all pairs in turn: one in four is only shifted, one in four only turned.
        """
        block, kind = np.divmod(np.arange(self.offsets), convergence.KINDS)
        return np.asarray((block + kind * (pairs // convergence.KINDS)) % pairs)

    def truths(self, seen: tuple[KnownPair, ...]) -> tuple[Floats, Floats]:
        """For each trial the true ``target_from_source`` and the ``world_from_target`` (both (N, 3))."""
        of = self.pair_numbers(len(seen))
        rows = np.array([pair.target_from_source.row for pair in seen])
        return rows[of], np.array([pair.world_from_target.row for pair in seen])[of]


class Answers(TypedDict):
    """The answers of a back end to trials [begin, end).

    ``rows`` (N, 3): nan without an answer; ``claimed`` (N,): whether it reports convergence; ``reason``: the first
    exception it raised, or "".
    """

    rows: Floats
    claimed: Bools
    reason: str


def make_tasks(
    label: str, spec: BackendSpec, values: Mapping[str, Value], trials: TrialPlan
) -> tuple[Task[Answers], ...]:
    """The tasks of one back end; together they cover all trials."""
    modules = (registry.plug_in_of("backends", label).module, *([trials.recorded.module] if trials.recorded else []))
    files = hash_files(trials.recorded.parameters) if trials.recorded else ""
    code = hash_code(modules, ("numpy", "scipy", *spec.requires)) + spec.digest + files
    return tuple(
        make_task(
            f"{label} {trials.place} {begin}", answers, backend=label, values=dict(values), trials=trials, begin=begin,
            end=min(begin + TRIALS_PER_TASK, trials.offsets), code=code,
        )
        for begin in range(0, trials.offsets, TRIALS_PER_TASK)
    )  # fmt: skip


def answers(
    *,
    backend: str,
    values: Mapping[str, Value],
    trials: TrialPlan,
    begin: int,
    end: int,
    code: str,  # noqa: ARG001 - part of the task's key
) -> Answers:
    """Run trials [begin, end) with a back end; ``code`` is a digest of the back end's sources."""
    registration: Registration = backend_at(backend).make(**values)
    seen = trials.pairs_of_scans()
    guesses = convergence.make_guesses(trials.offsets_drawn(), *trials.truths(seen))
    rows, claimed, reason = np.full((end - begin, 3), np.nan), np.zeros(end - begin, dtype=np.bool_), ""
    numbers = trials.pair_numbers(len(seen))
    for number in range(begin, end):
        pair = seen[numbers[number]]
        try:
            match = registration.register(pair.target, pair.source, Pose.of(guesses[number]))
            rows[number - begin] = match.target_from_source.row
            claimed[number - begin] = match.converged
        except Exception as error:  # noqa: BLE001 - a third party's exception counts as no answer
            reason = reason or format_exception(error)
    return {"rows": rows, "claimed": claimed, "reason": reason}


@dataclass(frozen=True, eq=False)
class TrialAnswers:
    """The answers of one back end in one scene: ``rows`` (N, 3), nan without an answer, and ``claimed`` (N,).

    ``reason``: its first exception, or why it could not run; "" if there was no problem.
    """

    backend: str
    trials: TrialPlan
    reason: str
    rows: Floats
    claimed: Bools

    @property
    def answered(self) -> int:
        """The number of trials with an answer."""
        return int(np.isfinite(self.rows).all(axis=1).sum())


@dataclass(frozen=True, eq=False)
class BasinMethod:
    """A back end: its label, spec and parameters, and why it cannot run ("" if it can)."""

    label: str
    spec: BackendSpec
    values: Mapping[str, Value]
    reason: str = ""


def find_method(label: str, given: Mapping[str, str]) -> BasinMethod:
    """A back end by registered name or "module:SPEC", with parameters as texts; raises UnknownName or BadParameter."""
    address = address_of(label)
    spec = backend_at(label) if address.module else registry.find_backend(label)
    if missing := spec.missing():
        return BasinMethod(label, spec, {}, missing)
    if not isinstance(spec, RegistrationSpec):
        return BasinMethod(label, spec, {}, "is an odometry of whole sequences: it cannot register one pair of scans")
    return BasinMethod(
        label, spec, resolve_parameters(label, spec.parameters, from_text(label, spec.parameters, given))
    )


def run_trials(
    methods: Sequence[BasinMethod], trials: Sequence[TrialPlan], store: TaskStore, workers: int, done: OnDone
) -> list[TrialAnswers]:
    """The answers of all back ends in all scenes; a back end that ends its process has a reason instead."""
    planned = {
        (number, one.place): make_tasks(each.label, each.spec, each.values, one)
        for number, each in enumerate(methods)
        for one in trials
        if not each.reason
    }
    failures: Mapping[str, TaskFailure] = {}
    every = [task for group in planned.values() for task in group]
    try:
        run_tasks(store, every, workers, done)
    except TasksFailed as failed:
        failures = failed.failures
    return [
        _outcome(each, one, planned.get((number, one.place), ()), store, failures)
        for one in trials
        for number, each in enumerate(methods)
    ]


def _outcome(
    each: BasinMethod,
    one: TrialPlan,
    group: Sequence[Task[Answers]],
    store: TaskStore,
    failures: Mapping[str, TaskFailure],
) -> TrialAnswers:
    rows, claimed, reason = np.full((one.offsets, 3), np.nan), np.zeros(one.offsets, dtype=np.bool_), each.reason
    for task in group:
        part = np.s_[task.arguments["begin"] : task.arguments["end"]]
        answered = store.load(task)
        if answered is None:
            failure = failures.get(task.name, TaskFailure("no result was stored"))
            reason = reason or failure.reason
        else:
            rows[part], claimed[part] = answered["rows"], answered["claimed"]
            reason = reason or answered["reason"]
    return TrialAnswers(each.label, one, reason, rows, claimed)
