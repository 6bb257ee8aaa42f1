"""A plan's runs made, or taken from the store: what is done, what is missing, and in the end every row."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import Status, Trial
from evalkit.execution import run_task
from evalkit.execution.executors import Here, Place, Progress
from evalkit.execution.run_task import Ended, Recipe
from evalkit.plugins import registry
from evalkit.results.store import REMEDY, Store

__all__ = ["Engine", "Progress"]


@dataclass(frozen=True)
class Engine:
    """Makes what is missing, ``jobs`` runs at a time on this machine or wherever ``place`` says.

    ``resume`` keeps what is done, but makes runs that ended in one of ``rerun`` again. ``collect`` makes none: what is
    not there is skipped. ``ran_on``: what the environment says, kept with every run that is made.
    """

    plan: Experiment
    store: Store
    progress: Progress
    jobs: int = 1
    resume: bool = False
    ran_on: Mapping[str, str] = field(default_factory=dict)
    rerun: frozenset[Status] = frozenset()
    collect: bool = False
    place: Place | None = None

    @cached_property
    def planned(self) -> tuple[RunSpec, ...]:
        """Every run, in the plan's order."""
        return tuple(self.plan.runs())

    def ended(self) -> Generator[Ended]:
        """Every run as it ends, made, scored and stored; what is done already comes first. None stays in memory.

        A run that fails is a row with a reason; only a results folder that cannot be written stops the whole.
        """
        with nullcontext() if self.collect else self.store.writer():
            yield from self._ended(self.planned, self.progress)

    def trials(self) -> tuple[Trial, ...]:
        """Every run of the plan with all its answers, maps and scores, in the plan's order: what a report draws."""
        truths: dict[str, Truth] = {}
        rows: dict[str, Trial] = {}
        with nullcontext() if self.collect else self.store.writer():
            for progress in (self.progress, _Unheard()):  # what turns out to be damaged is made once more
                missing = [item for item in self.planned if item.key not in rows]
                with closing(self._ended(missing, progress)) as all_ended:
                    for ended in all_ended:
                        if (trial := self._trial(ended, truths)) is not None:
                            rows[trial.key] = trial
        if unread := [item.key for item in self.planned if item.key not in rows]:
            raise StoreError(str(self.store.run_folder(unread[0])), "was written but cannot be read back", REMEDY)
        return tuple(rows[item.key] for item in self.planned)

    def _ended(self, planned: Sequence[RunSpec], progress: Progress) -> Generator[Ended]:
        recipe = Recipe.of(self.plan, self.resume, self.rerun, self.collect, self.ran_on)
        todo = []
        for item in planned:
            if (ended := run_task.settled(self.store, recipe, item)) is None:
                todo.append(item)
                continue
            progress.finished(ended)
            yield ended
        if not todo:
            return
        place = self.place or Here(self.jobs)
        with closing(place.ended(self.store, recipe, todo, progress)) as made:  # whatever happens meanwhile ends them
            for ended in made:
                progress.finished(ended)
                yield ended

    def _trial(self, ended: Ended, truths: dict[str, Truth]) -> Trial | None:
        """A row, read from the store; None where that is damaged, which is then forgotten."""
        planned = ended.planned
        content = self._content(ended)
        if content is None:
            return None
        return Trial(
            key=planned.key,
            method=planned.method.label,
            backend=planned.method.backend,
            backend_parameters=planned.method.parameters,
            sequence=planned.sequence.label,
            dataset=planned.sequence.dataset,
            dataset_parameters=planned.sequence.seeded(planned.seed),
            seed=planned.seed,
            command=self.plan.command(planned),
            truth=_truth(planned, truths),
            **content,
        )

    def _content(self, ended: Ended) -> Mapping[str, Any] | None:
        """What the store keeps of a run."""
        key = ended.planned.key
        if not ended.stored:
            return {"scores": {}, "run": run_task.unmade(ended.planned, ended.status, ended.reason)}
        run = self.store.load_run(key)
        if run is None:
            self.store.forget(key, "run.json", "scores.json")
            return None
        scores: Mapping[str, Any] | None = {"scores": {}}
        if (run.status, run.reason) != (ended.status, ended.reason):  # it could not be scored
            run = replace(run, status=ended.status, reason=ended.reason)
        elif run_task.scorable(run.status, run.reason, len(run.steps)):
            scores = self.store.load_scores(key)
        if scores is None:
            self.store.forget(key, "scores.json")
            return None
        kept = {name: value for name, value in scores.items() if name != "fingerprint"}
        return {**kept, "run": run, "processor": str(self.store.load_made(key).get("processor", ""))}


class _Unheard:
    """A progress nobody listens to."""

    def begun(self, planned: RunSpec) -> None: ...

    def answered(self, planned: RunSpec, scans: int) -> None: ...

    def finished(self, ended: Ended) -> None: ...


def _truth(planned: RunSpec, known: dict[str, Truth]) -> Truth:
    if planned.sequence.missing:
        return Truth("the data are not here")
    sequence = f"{planned.sequence.label} {planned.seed}"
    if sequence not in known:
        try:
            known[sequence] = (
                registry.dataset(planned.sequence.dataset).make(**planned.sequence.seeded(planned.seed)).truth()
            )
        except Exception as error:  # noqa: BLE001 - a reader's fault, of which each of its runs has told already
            known[sequence] = Truth(f"cannot be read: {error}")
    return known[sequence]
