"""Where a plan's runs execute: on this machine, a few at a time, results on disk as they come."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from multiprocessing import get_context
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Protocol

import numpy as np

from evalkit import environment, lifeline, map_scoring, registry, runner, scoring
from evalkit.errors import StoreError
from evalkit.experiment import MapperChoice, Plan, Planned
from evalkit.store import Store
from evalkit.types import STEP, Run, Status, Trial, Truth
from evalkit.worker import Request

DONE: tuple[Status, ...] = ("complete", "failed", "crashed")
"""Statuses that ``resume`` accepts as done: the same would come of it again."""

LIMITED: tuple[Status, ...] = ("timeout", "out-of-memory")
"""Statuses that ``resume`` accepts as done under the limits they were made with, and no others."""


class Progress(Protocol):
    """Hears how a comparison goes on; called from several threads."""

    def begun(self, planned: Planned) -> None:
        """A run starts."""
        ...

    def answered(self, planned: Planned, scans: int) -> None:
        """A run has answered so many scans."""
        ...

    def finished(self, trial: Trial) -> None:
        """A run is done, scored and stored."""
        ...


@dataclass(frozen=True)
class Engine:
    """This machine, ``jobs`` runs at a time, each pinned to a core of its own.

    ``resume`` keeps what is done, but makes runs that ended in one of ``rerun`` again. ``collect`` makes none: what is
    not there is skipped. ``ran_on``: what the environment says, kept with every run that is made.
    """

    plan: Plan
    store: Store
    progress: Progress
    jobs: int = 1
    resume: bool = False
    ran_on: Mapping[str, str] = field(default_factory=dict)
    rerun: frozenset[Status] = frozenset()
    collect: bool = False

    def trials(self) -> tuple[Trial, ...]:
        """Every run of the plan, made, scored and stored, in the plan's order.

        A run that fails is a row with a reason; only a results folder that cannot be written stops the whole.
        """
        with nullcontext() if self.collect else self.store.writer():
            return self._trials()

    def _trials(self) -> tuple[Trial, ...]:
        os.environ.update(environment.SINGLE_THREAD)  # inherited by the scoring processes, as by the runs
        planned = list(self.plan.runs())
        cores = _cores(self.jobs)
        stop = threading.Event()
        with (
            _scorers(self.jobs) as scorers,
            ThreadPoolExecutor(self.jobs) as slots,
        ):
            futures = [slots.submit(self._one, item, cores, scorers, stop) for item in planned]
            try:
                done = [future.result() for future in futures]
            except BaseException:  # an interrupt or an unwritable folder: end what runs, start nothing more
                stop.set()
                slots.shutdown(wait=True, cancel_futures=True)
                raise
        truths: dict[str, Truth] = {}
        return tuple(self._with_truth(item, trial, truths) for item, trial in zip(planned, done, strict=True))

    def _one(
        self, planned: Planned, cores: SimpleQueue[int | None], scorers: ProcessPoolExecutor, stop: threading.Event
    ) -> Trial:
        """One run's row; whatever is raised here stops all the others at once."""
        if stop.is_set():
            raise CancelledError
        core = cores.get()
        try:
            self.progress.begun(planned)
            trial = self._made(planned, core, scorers, stop)
            if not stop.is_set():
                self.progress.finished(trial)
        except BaseException:
            stop.set()
            raise
        finally:
            cores.put(core)  # after the scoring, which must not compete with a timed run
        return trial

    def _made(self, planned: Planned, core: int | None, scorers: ProcessPoolExecutor, stop: threading.Event) -> Trial:
        run = self._run(planned, core, stop)
        content: Mapping[str, Any] = {"scores": {}}
        if (len(run.steps) or run.status == "complete") and not stop.is_set():
            try:
                content = self._scored(planned, run, core, scorers)
            except StoreError:
                raise
            except Exception as error:  # noqa: BLE001 - a run that cannot be scored must not take the others with it
                run = replace(run, status="failed", reason=f"scoring failed: {type(error).__name__}: {error}")
        return self._trial(planned, run, content)

    def _run(self, planned: Planned, core: int | None, stop: threading.Event) -> Run:
        """The stored run if it will do, else a new one."""
        absent = _absent(planned)
        if absent is not None:
            return absent
        known = self._kept(planned) if self.resume or self.collect else None
        if known is not None:
            return known
        if self.collect:
            return _unmade(planned, "skipped", "not made yet; the same command without --collect makes it")
        request = Request(
            planned.contestant.backend,
            dict(planned.contestant.parameters),
            planned.course.dataset,
            planned.course.seeded(planned.seed),
            core,
        )
        run = runner.run(
            request,
            (planned.contestant.label, planned.course.label),
            self.store.fresh(planned.key),
            self.plan.limits,
            lambda scans: self.progress.answered(planned, scans),
            stop,
        )
        if not stop.is_set():
            self.store.save_run(planned.key, run, self._how_made())
        return run

    def _kept(self, planned: Planned) -> Run | None:
        """The stored run, None where there is none or it must be repeated: what was absent may have come."""
        known = self.store.load_run(planned.key)
        if known is None or self.collect:
            return known
        if known.status in self.rerun:
            return None
        if known.status in DONE:
            return known
        same_limits = self.store.load_made(planned.key).get("limits") == asdict(self.plan.limits)
        return known if known.status in LIMITED and same_limits else None

    def _how_made(self) -> dict[str, Any]:
        where = {name: self.ran_on.get(name, "unknown") for name in environment.KEPT_WITH_RUNS}
        return {"made": datetime.now(UTC).isoformat(), **where, "limits": asdict(self.plan.limits)}

    def _scored(self, planned: Planned, run: Run, core: int | None, scorers: ProcessPoolExecutor) -> Mapping[str, Any]:
        """The stored scores if the code they stand on is unchanged, else new ones."""
        fingerprint = f"{registry.score_fingerprint(self.plan.mapper.name)} {self.plan.mapper}"
        known = self.store.load_scores(planned.key) if self.resume or self.collect else None
        if known is None or known["fingerprint"] != fingerprint:
            _in_pool(scorers, score_stored, self.store.folder, planned, run, self.plan.mapper, fingerprint, core)
            known = self.store.load_scores(planned.key)
        if known is None:
            raise ValueError(f"{self.store.run_folder(planned.key)}: scores were written but cannot be read back")
        return known

    def _trial(self, planned: Planned, run: Run, content: Mapping[str, Any]) -> Trial:
        return Trial(
            key=planned.key,
            contestant=planned.contestant.label,
            backend=planned.contestant.backend,
            backend_parameters=planned.contestant.parameters,
            sequence=planned.course.label,
            dataset=planned.course.dataset,
            dataset_parameters=planned.course.seeded(planned.seed),
            seed=planned.seed,
            command=self.plan.command(planned),
            run=run,
            truth=Truth("not loaded"),
            **{name: value for name, value in content.items() if name != "fingerprint"},
        )

    def _with_truth(self, planned: Planned, trial: Trial, truths: dict[str, Truth]) -> Trial:
        if planned.course.missing:
            return replace(trial, truth=Truth("the data are not here"))
        course = f"{planned.course.label} {planned.seed}"
        if course not in truths:
            truths[course] = _truth(planned)
        return replace(trial, truth=truths[course])


def score_stored(
    folder: Path, planned: Planned, run: Run, mapper: MapperChoice, fingerprint: str, core: int | None
) -> None:
    """Scores one run and keeps the result in the store; runs in a process of the scoring pool, on the run's core."""
    if core is not None:
        os.sched_setaffinity(0, {core})
    entrant, drawn_by = registry.backend(planned.contestant.backend), registry.mapper(mapper.name)
    sequence = registry.dataset(planned.course.dataset).make(**planned.course.seeded(planned.seed))
    if entrant.kind == "map":
        scored = map_scoring.score(run, entrant.make(**planned.contestant.parameters), sequence)
    else:
        scored = scoring.score(run, sequence, lambda: drawn_by.make(**mapper.parameters), mapper.scans)
    content = {
        "fingerprint": fingerprint,
        "world_from_start": scored.world_from_start.row.tolist(),
        "alignment": scored.alignment,
        "scores": {name: asdict(score) for name, score in scored.scores.items()},
    }
    Store(folder).save_scores(planned.key, content, scored.grid, scored.errors_m)


def _scorers(jobs: int) -> ProcessPoolExecutor:
    """Processes to score in."""
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"), initializer=_settle)


def _settle() -> None:
    """A scoring process's start: an interrupt at the keyboard is its parent's business, its parent's end its own."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    lifeline.watch_parent()


def _in_pool(scorers: ProcessPoolExecutor, job: Callable[..., None], *arguments: object) -> None:
    """Does a job in the pool; where a process of the pool has died, in a pool of its own: it may be another's fault."""
    try:
        scorers.submit(job, *arguments).result()
    except BrokenProcessPool:
        with _scorers(1) as own:
            own.submit(job, *arguments).result()


def _truth(planned: Planned) -> Truth:
    try:
        return registry.dataset(planned.course.dataset).make(**planned.course.seeded(planned.seed)).truth()
    except Exception as error:  # noqa: BLE001 - a reader's fault, of which each of its runs has told already
        return Truth(f"cannot be read: {error}")


def _absent(planned: Planned) -> Run | None:
    """The run that cannot be made for want of a library or of data, or None."""
    reasons: list[tuple[Status, str]] = [
        ("data-missing", planned.course.missing),
        ("not-installed", planned.contestant.missing),
    ]
    for status, reason in reasons:
        if reason:
            return _unmade(planned, status, reason)
    return None


def _unmade(planned: Planned, status: Status, reason: str) -> Run:
    return Run(planned.contestant.label, planned.course.label, status, reason, np.zeros(0, dtype=STEP), expected=0)


def _cores(jobs: int) -> SimpleQueue[int | None]:
    """One core per job to pin to; None where the system cannot pin."""
    cores: SimpleQueue[int | None] = SimpleQueue()
    known = environment.cores() or [None]
    for job in range(jobs):
        cores.put(known[job % len(known)])
    return cores
