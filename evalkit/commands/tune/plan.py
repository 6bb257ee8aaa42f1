"""A tuning: who is searched with how much, on which training sequences, and what it is judged on afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.plan import Response
from evalkit.commands.tune.space import Candidate, Space
from evalkit.commands.tune.trial import run_trial
from evalkit.config.experiment import Limits, MapperChoice, Method, SequenceSpec
from evalkit.execution.task import Task, make_task
from evalkit.plugins import registry
from evalkit.plugins.code_hash import of_files

COST = "cpu_median_ms"
"""What accuracy is held against: CPU time a scan."""

TUNED = " tuned"
"""What the label of a tuned row ends in."""


@dataclass(frozen=True)
class Entrant:
    """A back end to be tuned: its own settings, its space, and why other parameters are not searched, by name."""

    method: Method
    space: Space
    left: Mapping[str, str]

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
    """A sequence to be tuned on: the seeds of its sequence are searched with, ``confirm`` are for the best alone."""

    sequence: SequenceSpec
    confirm: tuple[int, ...]


@dataclass(frozen=True)
class Run:
    """One repetition of a sequence."""

    sequence: SequenceSpec
    seed: int | None

    @property
    def label(self) -> str:
        """The sequence and the seed in words."""
        return self.sequence.label if self.seed is None else f"{self.sequence.label} seed {self.seed}"


@dataclass(frozen=True, eq=False)
class Tuning:
    """A whole tuning, ready to run. ``command``: what runs it; ``points``: the budget of every back end.

    ``objective``: what is made small on the training runs. ``run_cpu_s``: a training run that takes more CPU time is
    lost. ``limits`` are those of the held-out runs. ``backends``: named on the command line, not in a file.
    """

    name: str
    title: str
    description: str
    command: str
    points: int
    seed: int
    objective: Response
    run_cpu_s: float
    entrants: tuple[Entrant, ...]
    training: tuple[Training, ...]
    held_out: tuple[SequenceSpec, ...]
    mapper: MapperChoice
    limits: Limits

    @cached_property
    def search_runs(self) -> tuple[Run, ...]:
        """The runs every point is scored on."""
        return tuple(Run(one.sequence, seed) for one in self.training for seed in one.sequence.seeds)

    @cached_property
    def confirm_runs(self) -> tuple[Run, ...]:
        """The runs that default and best point are compared on: nothing was chosen by them."""
        return tuple(Run(one.sequence, seed) for one in self.training for seed in one.confirm)

    def task(self, entrant: Entrant, candidate: Candidate, run: Run) -> Task[RunScores]:
        """One run of one point."""
        return make_task(
            f"{entrant.label} | {run.label} | {candidate.name}", run_trial, cpu_s=self.run_cpu_s,
            backend=entrant.method.backend, parameters=dict(candidate.values), dataset=run.sequence.dataset,
            sequence=run.sequence.seeded(run.seed), metrics=[self.objective.name, COST],
            code=self._code(entrant.method.backend, run.sequence.dataset) + of_files(run.sequence.parameters),
        ).limited(self.limits.run_s)  # fmt: skip

    def _code(self, backend: str, dataset: str) -> str:
        known = (backend, dataset)
        if known not in self._codes:
            self._codes[known] = registry.run_fingerprint(backend, dataset)
        return self._codes[known]

    @cached_property
    def _codes(self) -> dict[tuple[str, str], str]:
        return {}
