"""A study: its responses, factors, designs and their points, ready to run."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

from evalkit.config.experiment import Experiment, MapperChoice, Method, SequenceSpec
from evalkit.config.limits import Limits
from evalkit.core.se2 import Floats
from evalkit.design.designs import Model
from evalkit.design.factors import Factor, FactorLevel
from evalkit.design.responses import Response
from evalkit.design.run_points import RunScores, evaluate
from evalkit.execution.task import Task, make_task
from evalkit.plugins import registry
from evalkit.plugins.code_hash import hash_files
from evalkit.plugins.parameters import Value

DesignKind = Literal["optimal", "fractional", "sobol", "latin", "curves", "grid"]


@dataclass(frozen=True)
class Point:
    """One point: its levels by factor and all settings in full."""

    levels: Mapping[str, FactorLevel]
    method: Mapping[str, Value]
    sequence: Mapping[str, Value]
    mapper: Mapping[str, Value]

    @cached_property
    def key(self) -> str:
        """Eight hexadecimal digits that change with every setting."""
        whole = [dict(self.method), dict(self.sequence), dict(self.mapper)]
        return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()[:8]

    @property
    def label(self) -> str:
        """The levels as text."""
        return ", ".join(f"{name} {level.label}" for name, level in self.levels.items()) or "the study's own settings"


@dataclass(frozen=True, eq=False)
class Design:
    """The points of one design: ``positions`` (N, K) over ``factors``, and the points in the same order.

    Curves have no positions: the levels of one factor after the other, all others at the study's own settings.
    """

    name: str
    kind: DesignKind
    factors: tuple[Factor, ...]
    positions: Floats
    points: tuple[Point, ...]
    seeds: tuple[int | None, ...]
    resolution: int = 5
    dealt: bool = False

    def factor(self, name: str) -> Factor:
        """A factor by its name."""
        return next(factor for factor in self.factors if factor.name == name)

    def runs(self, point: Point) -> tuple[int | None, ...]:
        """The seeds of a point: all, or one in turn if they are dealt out over the points."""
        return (self.seeds[self._turns[point.key] % len(self.seeds)],) if self.dealt else self.seeds

    @cached_property
    def _turns(self) -> Mapping[str, int]:
        return {point.key: number for number, point in enumerate(self.points)}

    @property
    def model(self) -> Model:
        """The model whose effects are computed."""
        return Model(tuple(factor.axis for factor in self.factors), self.kind != "fractional" or self.resolution >= 5)


@dataclass(frozen=True)
class EnvelopeChoice:
    """An operating envelope to find: a grid design, its two axes, a response and its limit."""

    design: str
    x: str
    y: str
    response: Response
    limit: float


@dataclass(frozen=True, eq=False)
class Study:
    """A whole study, ready to run. ``command`` runs it; ``limit_s``: wall clock time of one run."""

    title: str
    description: str
    command: str
    backend: str
    dataset: str
    mapper: str
    scans: int
    missing: str
    responses: tuple[Response, ...]
    factors: tuple[Factor, ...]
    designs: tuple[Design, ...]
    envelopes: tuple[EnvelopeChoice, ...]
    limit_s: float = Limits.run_s

    @cached_property
    def points(self) -> Mapping[str, Point]:
        """All points by key, each once, even if several designs share it."""
        return {point.key: point for design in self.designs for point in design.points}

    def design(self, name: str) -> Design:
        """A design by its name."""
        return next(design for design in self.designs if design.name == name)

    def seeds(self, key: str) -> tuple[int | None, ...]:
        """The seeds of a point in all designs that share it."""
        return self._seeds[key]

    @cached_property
    def _seeds(self) -> Mapping[str, tuple[int | None, ...]]:
        seeds_by_key: dict[str, dict[int | None, None]] = {}
        for design in self.designs:
            for point in design.points:
                seeds_by_key.setdefault(point.key, {}).update(dict.fromkeys(design.runs(point)))
        return {key: tuple(seeds) for key, seeds in seeds_by_key.items()}

    def tasks(self) -> tuple[Task[RunScores], ...]:
        """Every run of the study; runs on one sequence are neighbours, so that it is simulated once."""
        tasks = [self.task(point, seed) for key, point in self.points.items() for seed in self.seeds(key)]
        return tuple(sorted(tasks, key=lambda task: json.dumps(task.arguments["sequence"], sort_keys=True)))

    def task(self, point: Point, seed: int | None) -> Task[RunScores]:
        """One run: a point with one seed."""
        sequence = dict(point.sequence) if seed is None else {**point.sequence, "seed": seed}
        return make_task(
            format_task_name(point.key, seed), evaluate, backend=self.backend, parameters=dict(point.method),
            dataset=self.dataset, sequence=sequence, mapper=self.mapper, mapper_parameters=dict(point.mapper),
            scans=self.scans, metrics=[response.name for response in self.responses],
            code=self.code + hash_files(sequence),
        ).with_limit(self.limit_s)  # fmt: skip

    def point_experiment(self, key: str) -> Experiment:
        """The experiment that runs one point with all its seeds."""
        point = self.points[key]
        return Experiment(
            key, f"{self.title}: {key}", "", self.command, (Method(self.backend, self.backend, point.method),),
            (SequenceSpec(self.dataset, self.dataset, point.sequence, self.seeds(key)),),
            MapperChoice(self.mapper, point.mapper, self.scans), replace(Limits(), run_s=self.limit_s),
        )  # fmt: skip

    @cached_property
    def code(self) -> str:
        """A digest of the sources of the plug-ins."""
        return registry.hash_run_code(self.backend, self.dataset) + registry.hash_scoring_code(self.mapper)


def format_task_name(key: str, seed: int | None) -> str:
    """The name of a run's task: the point's key and the seed."""
    return key if seed is None else f"{key} seed {seed}"
