"""A plan's runs made, or taken from the store: what is done, what is missing, and in the end every row."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import dataclass, field
from functools import cached_property

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import RunStatus, Scores
from evalkit.execution import run_task
from evalkit.execution.executors import Here, Place, Progress
from evalkit.execution.run_task import FinishedRun, Recipe
from evalkit.plugins import registry
from evalkit.results.run_record import RunRecord
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
    rerun: frozenset[RunStatus] = frozenset()
    collect: bool = False
    place: Place | None = None

    @cached_property
    def planned(self) -> tuple[RunSpec, ...]:
        """Every run, in the plan's order."""
        return tuple(self.plan.runs())

    def ended(self) -> Generator[FinishedRun]:
        """Every run as it ends, made, scored and stored; what is done already comes first. None stays in memory.

        A run that fails is a row with a reason; only a results folder that cannot be written stops the whole.
        """
        with nullcontext() if self.collect else self.store.writer():
            yield from self._ended(self.planned, self.progress)

    def records(self) -> tuple[RunRecord, ...]:
        """Every run of the plan with all its answers, maps and scores, in the plan's order: what a report draws."""
        truths: dict[str, Truth] = {}
        rows: dict[str, RunRecord] = {}
        with nullcontext() if self.collect else self.store.writer():
            for progress in (self.progress, _Unheard()):  # what turns out to be damaged is made once more
                missing = [item for item in self.planned if item.key not in rows]
                with closing(self._ended(missing, progress)) as all_ended:
                    for ended in all_ended:
                        if (record := self._record(ended, truths)) is not None:
                            rows[record.key] = record
        if unread := [item.key for item in self.planned if item.key not in rows]:
            raise StoreError(str(self.store.run_folder(unread[0])), "was written but cannot be read back", REMEDY)
        return tuple(rows[item.key] for item in self.planned)

    def _ended(self, planned: Sequence[RunSpec], progress: Progress) -> Generator[FinishedRun]:
        recipe = Recipe.of(self.plan, self.resume, self.rerun, self.collect, self.ran_on)
        todo = []
        for item in planned:
            if (ended := run_task.cached_run(self.store, recipe, item)) is None:
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

    def _record(self, run: FinishedRun, truths: dict[str, Truth]) -> RunRecord | None:
        """The run with its scores and truth; None where its scores are damaged, which are then removed."""
        scores = self.store.load_scores(run.spec.key) if run.result.is_scorable else Scores()
        if scores is None:
            self.store.forget(run.spec.key, "scores.json")
            return None
        return RunRecord(run.spec, run.result, scores, _truth(run.spec, truths), self.plan.command(run.spec))


class _Unheard:
    """A progress nobody listens to."""

    def begun(self, planned: RunSpec) -> None: ...

    def answered(self, planned: RunSpec, scans: int) -> None: ...

    def finished(self, run: FinishedRun) -> None: ...


def _truth(planned: RunSpec, known: dict[str, Truth]) -> Truth:
    if planned.sequence.missing:
        return Truth("the data are not here")
    sequence = f"{planned.sequence.label} {planned.seed}"
    if sequence not in known:
        try:
            known[sequence] = registry.dataset(planned.sequence.dataset).make(**planned.dataset_parameters).truth()
        except Exception as error:  # noqa: BLE001 - a reader's fault, of which each of its runs has told already
            known[sequence] = Truth(f"cannot be read: {error}")
    return known[sequence]
