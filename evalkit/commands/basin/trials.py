"""A back end asked from many wrong guesses about pairs of scans with a known answer: the work behind a basin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypedDict

import numpy as np

from evalkit.commands.basin import convergence, scenes, sequences
from evalkit.commands.basin.scenes import Seen
from evalkit.commands.basin.sequences import Recorded
from evalkit.commands.validate.rules.rule import format_exception
from evalkit.core.arrays import Bools
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.execution.task import Task, make_task
from evalkit.execution.task_runner import OnDone, TaskFailure, TasksFailed, run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.plugins import registry
from evalkit.plugins.address import address_of, spec_at
from evalkit.plugins.code_hash import files_digest, fingerprint
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

AT_ONCE = 512
"""Attempts in one job: a few seconds of a compiled back end."""


@dataclass(frozen=True)
class Trials:
    """What all back ends are asked alike at one place; metres and radians.

    ``offsets``: how many guesses, spread over ``pairs`` pairs of scans with ``beams`` beams and ``noise_m`` of noise.
    ``data``: name and parameters of the data set whose scans these are (beams and noise are then its own, and
    ``noise_m`` what they are taken to be off), empty where the scans are simulated.
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
    def recorded(self) -> Recorded | None:
        """The data set the scans are of, None where they are simulated."""
        return Recorded(self.place, **self.data) if self.data else None

    @property
    def what(self) -> str:
        """The place in words."""
        return self.recorded.what if self.recorded else scenes.place(self.place).what

    def rng(self) -> np.random.Generator:
        """A generator that starts the same for the same trials."""
        number = list(scenes.PLACES).index(scenes.place(self.place).name)
        return np.random.default_rng([self.seed, number])

    def seen(self) -> tuple[Seen, ...]:
        """The pairs of scans, of a data set perhaps fewer; attempt i is about pair i modulo their number."""
        if self.recorded:
            return sequences.seen(self.recorded, self.pairs)
        where, rng = scenes.place(self.place), self.rng()
        return tuple(scenes.seen(where, rng, self.beams, self.noise_m) for _ in range(self.pairs))

    def drawn(self) -> Floats:
        """By how much each guess (N, 3) is off, along the world's axes."""
        rng = np.random.default_rng([self.seed, len(scenes.PLACES)])
        return convergence.on_axes(convergence.offsets(self.offsets, self.reach_m, self.reach_rad, rng))

    def truths(self, seen: tuple[Seen, ...]) -> tuple[Floats, Floats]:
        """For each attempt the true ``target_from_source`` and the ``world_from_target`` (both (N, 3))."""
        of = np.arange(self.offsets) % len(seen)
        rows = np.array([pair.target_from_source.row for pair in seen])
        return rows[of], np.array([pair.world_from_target.row for pair in seen])[of]


class Answers(TypedDict):
    """What a back end answers to attempts [begin, end).

    ``rows`` (N, 3): nan without an answer; ``claimed`` (N,): whether it reports convergence; ``reason``: the first
    exception it raised, or "".
    """

    rows: Floats
    claimed: Bools
    reason: str


def make_tasks(label: str, spec: BackendSpec, values: Mapping[str, Value], trials: Trials) -> tuple[Task[Answers], ...]:
    """The tasks of one back end; together their answers are those of all attempts."""
    modules = (registry.plug_in_of("backends", label).module, *([trials.recorded.module] if trials.recorded else []))
    files = files_digest(trials.recorded.parameters) if trials.recorded else ""
    code = fingerprint(modules, ("numpy", "scipy", *spec.requires)) + spec.digest + files
    return tuple(
        make_task(
            f"{label} {trials.place} {begin}", answers, backend=label, values=dict(values), trials=trials, begin=begin,
            end=min(begin + AT_ONCE, trials.offsets), code=code,
        )
        for begin in range(0, trials.offsets, AT_ONCE)
    )  # fmt: skip


def answers(
    *,
    backend: str,
    values: Mapping[str, Value],
    trials: Trials,
    begin: int,
    end: int,
    code: str,  # noqa: ARG001 - part of the task's key
) -> Answers:
    """Registers attempts [begin, end) with a back end; ``code`` is a digest of the back end's sources."""
    registration: Registration = spec_of(backend).make(**values)
    seen = trials.seen()
    guesses = convergence.guesses(trials.drawn(), *trials.truths(seen))
    rows, claimed, reason = np.full((end - begin, 3), np.nan), np.zeros(end - begin, dtype=np.bool_), ""
    for number in range(begin, end):
        pair = seen[number % len(seen)]
        try:
            match = registration.register(pair.target, pair.source, Pose.of(guesses[number]))
            rows[number - begin] = match.target_from_source.row
            claimed[number - begin] = match.converged
        except Exception as error:  # noqa: BLE001 - a third party's crash is an answer it did not give
            reason = reason or format_exception(error)
    return {"rows": rows, "claimed": claimed, "reason": reason}


@dataclass(frozen=True, eq=False)
class Outcome:
    """What one back end answered at one place: ``rows`` (N, 3) with nan for none, ``claimed`` (N,), or why not at all.

    ``reason``: what it raised first, or why nothing could be asked; "" where all was well.
    """

    backend: str
    trials: Trials
    reason: str
    rows: Floats
    claimed: Bools

    @property
    def answered(self) -> int:
        """How many attempts have an answer."""
        return int(np.isfinite(self.rows).all(axis=1).sum())


@dataclass(frozen=True, eq=False)
class Entrant:
    """A back end to be asked: its label, what makes it, its parameters, and why it cannot be asked ("" if it can)."""

    label: str
    spec: BackendSpec
    values: Mapping[str, Value]
    reason: str = ""


def entrant(label: str, given: Mapping[str, str]) -> Entrant:
    """A back end by registered name or "module:SPEC" with parameters as text; UnknownName and BadParameter as usual."""
    address = address_of(label)
    spec = spec_of(label) if address.module else registry.find_backend(label)
    if missing := spec.missing():
        return Entrant(label, spec, {}, missing)
    if not isinstance(spec, RegistrationSpec):
        return Entrant(label, spec, {}, "follows whole sequences: it cannot be asked about one pair of scans")
    return Entrant(label, spec, resolve_parameters(label, spec.parameters, from_text(label, spec.parameters, given)))


def ask(
    entrants: Sequence[Entrant], trials: Sequence[Trials], store: TaskStore, workers: int, done: OnDone
) -> list[Outcome]:
    """What all answer to the same questions, everywhere; whoever ends its process has no answer there and a reason."""
    planned = {
        (number, one.place): make_tasks(each.label, each.spec, each.values, one)
        for number, each in enumerate(entrants)
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
        for number, each in enumerate(entrants)
    ]


def _outcome(
    each: Entrant,
    one: Trials,
    group: Sequence[Task[Answers]],
    store: TaskStore,
    failures: Mapping[str, TaskFailure],
) -> Outcome:
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
    return Outcome(each.label, one, reason, rows, claimed)


def spec_of(backend: str) -> BackendSpec:
    """The back end of a registered name or of "module:SPEC"."""
    return spec_at(address_of(backend), BackendSpec, registry.backend)
