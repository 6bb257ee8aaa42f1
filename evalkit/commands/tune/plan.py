"""A tuning: methods and their search spaces, budget, training sequences and held-out sequences."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from evalkit.commands.tune.space import Space, TuningCandidate
from evalkit.commands.tune.trial import run_trial
from evalkit.config.experiment import MapperChoice, Method, SequenceSpec
from evalkit.config.limits import Limits
from evalkit.design.responses import Response
from evalkit.design.run_points import RunScores
from evalkit.execution.task import Task, make_task
from evalkit.metrics.runtime import COST
from evalkit.plugins import registry
from evalkit.plugins.code_hash import hash_files

TUNED = " tuned"
"""The end of a tuned method's label."""


@dataclass(frozen=True)
class TunableMethod:
    """A method to tune and its search space; ``excluded``: why a parameter is not searched, by name."""

    method: Method
    space: Space
    excluded: Mapping[str, str]

    @property
    def label(self) -> str:
        """The label of its method."""
        return self.method.label

    @property
    def missing(self) -> str:
        """Why it cannot run here, or ""."""
        return self.method.missing


@dataclass(frozen=True)
class Training:
    """A training sequence: its own seeds are for the search, ``confirm`` for the best point and the default."""

    sequence: SequenceSpec
    confirm: tuple[int, ...]


@dataclass(frozen=True)
class TrainingRun:
    """One repetition of a training sequence."""

    sequence: SequenceSpec
    seed: int | None

    @property
    def label(self) -> str:
        """The sequence and the seed in words."""
        return self.sequence.label if self.seed is None else f"{self.sequence.label} seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Tuning:
    """A whole tuning, ready to run. ``command`` runs it; ``points``: the budget of every back end.

    ``objective``: the error to minimise on the training runs; ``run_cpu_s``: a training run that takes more CPU time
    is lost; ``limits``: of the held-out runs.
    """

    name: str
    title: str
    description: str
    command: str
    points: int
    seed: int
    objective: Response
    run_cpu_s: float
    methods: tuple[TunableMethod, ...]
    training: tuple[Training, ...]
    held_out: tuple[SequenceSpec, ...]
    mapper: MapperChoice
    limits: Limits

    @cached_property
    def search_runs(self) -> tuple[TrainingRun, ...]:
        """The runs on which every point is scored."""
        return tuple(TrainingRun(one.sequence, seed) for one in self.training for seed in one.sequence.seeds)

    @cached_property
    def confirm_runs(self) -> tuple[TrainingRun, ...]:
        """The runs on which default and best point are compared; the search does not use them."""
        return tuple(TrainingRun(one.sequence, seed) for one in self.training for seed in one.confirm)

    def task(self, tunable: TunableMethod, candidate: TuningCandidate, run: TrainingRun) -> Task[RunScores]:
        """One run of one point."""
        return make_task(
            f"{tunable.label} | {run.label} | {candidate.name}", run_trial, cpu_s=self.run_cpu_s,
            backend=tunable.method.backend, parameters=dict(candidate.values), dataset=run.sequence.dataset,
            sequence=run.sequence.parameters_with_seed(run.seed), mapper=self.mapper.name,
            metrics=[self.objective.name, COST],
            code=self._code(tunable.method.backend, run.sequence.dataset) + hash_files(run.sequence.parameters),
        ).with_limit(self.limits.run_s)  # fmt: skip

    def _code(self, backend: str, dataset: str) -> str:
        known = (backend, dataset)
        if known not in self._codes:
            self._codes[known] = registry.hash_run_code(backend, dataset)
        return self._codes[known]

    @cached_property
    def _codes(self) -> dict[tuple[str, str], str]:
        return {}
