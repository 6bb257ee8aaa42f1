"""One planned run made, scored and stored: the same wherever that happens."""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Executor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit import metrics
from evalkit.config.experiment import Experiment, Limits, MapperChoice, RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.run_result import STEP, RunResult, Score, Status
from evalkit.execution import environment, run_process
from evalkit.execution.dask_cluster import TRIES
from evalkit.execution.process_pool import start_pool
from evalkit.execution.worker import Request
from evalkit.metrics import evaluate, evaluate_map
from evalkit.plugins import registry
from evalkit.results.store import HowItEnded, Store

DONE: tuple[Status, ...] = ("complete", "failed", "crashed")
"""Statuses that ``resume`` accepts as done: the same would come of it again."""

LIMITED: tuple[Status, ...] = ("timeout", "out-of-memory")
"""Statuses that ``resume`` accepts as done under the limits they were made with, and no others."""

QUARANTINED = "quarantined: "
"""How the reason of such a run begins; its status is "crashed"."""

COSTS = ("wall_ns", "cpu_ns", "conversion_ns", "harness_ns", "device_ns")
NOT_TIMED = "not timed: made where times do not count"


@dataclass(frozen=True)
class Ended:
    """How a planned run ended.

    ``seconds``: what it took with its scoring; 0 if it was kept or could not be made. ``expected``: scans in its
    sequence, 0 where that was not opened. ``stored``: whether the store holds what came of it.
    """

    planned: RunSpec
    status: Status
    reason: str
    seconds: float = 0.0
    expected: int = 0
    stored: bool = True


@dataclass(frozen=True)
class Recipe:
    """What all runs of a plan are made by: the same wherever they are made.

    ``scored_by``: names the code and the mapper that scores stand on. ``ran_on``: what the environment says, kept with
    every run that is made. ``resume``, ``rerun``, ``collect``: see Engine. ``timed``: whether times count.
    """

    limits: Limits
    mapper: MapperChoice
    scored_by: str
    timed: bool = True
    resume: bool = False
    rerun: frozenset[Status] = frozenset()
    collect: bool = False
    ran_on: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, plan: Experiment, resume: bool, rerun: frozenset[Status], collect: bool, ran_on: Mapping[str, str]
    ) -> Recipe:
        """The recipe of a plan."""
        scored_by = f"{registry.score_fingerprint(plan.mapper.name)} {plan.mapper}"
        return cls(plan.limits, plan.mapper, scored_by, plan.timed, resume, rerun, collect, ran_on)


@dataclass(frozen=True)
class Bench:
    """Where one run is made: a core to pin to, processes to score in, who hears of answers, what ends it early."""

    core: int | None
    scorers: Scorers
    heard: Callable[[int], None]
    stop: threading.Event


class Scorers:
    """Processes to score in. One that dies is replaced, and takes nobody else's scores along."""

    def __init__(self, jobs: int) -> None:
        self._jobs, self._lock = jobs, threading.Lock()
        self._pool = start_pool(jobs)

    def __enter__(self) -> Scorers:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Ends them."""
        self._pool.shutdown(wait=True, cancel_futures=True)

    def do(self, job: Callable[..., None], *arguments: object) -> None:
        """Does a job in a process; BrokenProcessPool where it ends even one of its own: before, it may be another's."""
        shared = self._pool
        try:
            shared.submit(job, *arguments).result()
        except BrokenProcessPool:
            self._replace(shared)
            with start_pool(1) as own:
                if _breaks(own):
                    raise RuntimeError("no process to score in can be started here") from None
                own.submit(job, *arguments).result()

    def _replace(self, broken: Executor) -> None:
        with self._lock:
            if self._pool is broken:
                broken.shutdown(wait=False, cancel_futures=True)
                self._pool = start_pool(self._jobs)


def _breaks(processes: Executor) -> bool:
    """Whether even nothing cannot be done: it is not the run's fault then."""
    try:
        processes.submit(os.getpid).result()
    except BrokenProcessPool:
        return True
    return False


def settled(store: Store, recipe: Recipe, planned: RunSpec) -> Ended | None:
    """How a run ended that needs neither making nor scoring any more, or cannot be made; None where it does."""
    for status, why in absent(planned):
        return Ended(planned, status, why, stored=False)
    if not (recipe.resume or recipe.collect):
        return None
    known = _acceptable(store, recipe, planned)
    if known is None:
        if recipe.collect:
            why = "not made yet; the same command without --collect makes it"
            return Ended(planned, "skipped", why, stored=False)
        return None
    if scorable(known.status, known.reason, known.answered) and store.scored_by(planned.key) != recipe.scored_by:
        return None
    return Ended(planned, known.status, known.reason, expected=known.expected)


def made(store: Store, recipe: Recipe, planned: RunSpec, bench: Bench) -> Ended:
    """How a run ended that is made, unless a stored one will do, and scored; all of it is in the store.

    Whatever goes wrong is a status with a reason, but StoreError: a results folder that cannot be written; and
    CancelledError where it was stopped.
    """
    begun = time.monotonic()
    run = store.load_run(planned.key) if _acceptable(store, recipe, planned) else None
    if run is None and recipe.collect:
        return Ended(planned, "skipped", "what is stored of it cannot be read", stored=False)
    if run is None:
        run = _run(store, recipe, planned, bench)
    status, reason = run.status, run.reason
    if bench.stop.is_set():
        raise CancelledError
    if scorable(status, reason, len(run.steps)):
        status, reason = _scored(store, recipe, planned, run, bench)
    return Ended(planned, status, reason, max(time.monotonic() - begun, 1e-9), run.expected)


def absent(planned: RunSpec) -> list[tuple[Status, str]]:
    """Why a run cannot be made, for want of data or of a library: nothing or the first reason of each."""
    reasons: list[tuple[Status, str]] = [
        ("data-missing", planned.sequence.missing),
        ("not-installed", planned.method.missing),
    ]
    return [(status, reason) for status, reason in reasons if reason]


def unmade(planned: RunSpec, status: Status, reason: str) -> RunResult:
    """A run without an answer."""
    return RunResult(planned.method.label, planned.sequence.label, status, reason, np.zeros(0, dtype=STEP), expected=0)


def quarantined(store: Store, recipe: Recipe, planned: RunSpec, why: str, run: RunResult | None = None) -> RunResult:
    """A run that nobody shall try again unasked, kept in the store; ``run``: what it answered before."""
    reason = f"{QUARANTINED}{why}; --rerun crashed tries again"
    kept = replace(run or unmade(planned, "crashed", reason), status="crashed", reason=reason)
    store.forget(planned.key, "scores.json")
    store.save_run(planned.key, kept, _how_made(recipe, planned, None))
    store.forget_tries(planned.key)
    return kept


def _acceptable(store: Store, recipe: Recipe, planned: RunSpec) -> HowItEnded | None:
    """How the stored run ended, if it will do; what was absent may have come."""
    if not (recipe.resume or recipe.collect) or (known := store.how_it_ended(planned.key)) is None:
        return None
    if recipe.collect:
        return known
    how = store.load_made(planned.key)
    if known.status in recipe.rerun or (recipe.timed and not how.get("timed", True)):
        return None
    same_limits = how.get("limits") == asdict(recipe.limits)
    return known if known.status in DONE or (known.status in LIMITED and same_limits) else None


def scorable(status: Status, reason: str, answered: int) -> bool:
    """Whether a run that ended so has scores."""
    return (answered > 0 or status == "complete") and not reason.startswith(QUARANTINED)


def _run(store: Store, recipe: Recipe, planned: RunSpec, bench: Bench) -> RunResult:
    """A new run, stored."""
    lost = store.tries(planned.key) if recipe.resume and "crashed" not in recipe.rerun else []
    if len(lost) >= TRIES:
        return quarantined(store, recipe, planned, f"evalkit was ended twice while it ran ({', '.join(lost)})")
    request = Request(
        planned.method.backend,
        dict(planned.method.parameters),
        planned.sequence.dataset,
        planned.sequence.seeded(planned.seed),
        bench.core,
    )
    labels = planned.method.label, planned.sequence.label
    folder = store.fresh(planned.key)
    store.note_tries(planned.key, [*lost, f"process {os.getpid()} on {platform.node()}"])
    try:
        run = run_process.run(request, labels, folder, recipe.limits, bench.heard, bench.stop)
    finally:
        store.forget_tries(planned.key)  # whoever comes here has not been ended by it
    if not recipe.timed:
        run = replace(run, steps=_without_times(run.steps))
    if bench.stop.is_set():
        raise CancelledError
    store.save_run(planned.key, run, _how_made(recipe, planned, bench.core))
    return run


def _scored(store: Store, recipe: Recipe, planned: RunSpec, run: RunResult, bench: Bench) -> tuple[Status, str]:
    """Scores a run in a process of its own; its status and reason after that."""
    if store.scored_by(planned.key) == recipe.scored_by:
        return run.status, run.reason
    store.forget(planned.key, "scores.json")  # of other code: nobody may take them for this run's where scoring fails
    try:
        bench.scorers.do(score_stored, store.folder, planned, run, recipe, bench.core)
    except StoreError:
        raise
    except BrokenProcessPool as error:
        kept = quarantined(store, recipe, planned, f"it ended the process that scored it twice ({error})", run)
        return kept.status, kept.reason
    except Exception as error:  # noqa: BLE001 - a run that cannot be scored must not take the others with it
        return "failed", f"scoring failed: {type(error).__name__}: {error}"
    if store.scored_by(planned.key) is None:
        return "failed", f"scoring failed: {store.run_folder(planned.key)}: scores were written but cannot be read back"
    return run.status, run.reason


def score_stored(folder: Path, planned: RunSpec, run: RunResult, recipe: Recipe, core: int | None) -> None:
    """Scores one run and keeps the result in the store; runs in a process of the scoring pool, on the run's core."""
    if core is not None:
        os.sched_setaffinity(0, {core})
    mapper = recipe.mapper
    entrant, drawn_by = registry.backend(planned.method.backend), registry.mapper(mapper.name)
    sequence = registry.dataset(planned.sequence.dataset).make(**planned.sequence.seeded(planned.seed))
    if entrant.kind == "map":
        scored = evaluate_map.score(run, entrant.make(**planned.method.parameters), sequence)
    else:
        scored = evaluate.score(run, sequence, lambda: drawn_by.make(**mapper.parameters), mapper.scans)
    scores = scored.scores
    if not recipe.timed and not run.steps["wall_ns"].any():
        scores = {name: _untimed(name, score) for name, score in scores.items()}
    content = {
        "fingerprint": recipe.scored_by,
        "world_from_start": scored.world_from_start.row.tolist(),
        "alignment": scored.alignment,
        "scores": {name: asdict(score) for name, score in scores.items()},
    }
    Store(folder).save_scores(planned.key, content, scored.grid, scored.errors_m)


def _untimed(name: str, score: Score) -> Score:
    return Score(None, score.support, NOT_TIMED) if name in _times() else score


@cache
def _times() -> frozenset[str]:
    """The metrics of time."""
    return frozenset(one.name for one in metrics.all_metrics() if one.group == "runtime" and one.unit != "MiB")


def _without_times(steps: NDArray[np.void]) -> NDArray[np.void]:
    bare = steps.copy()
    for name in COSTS:
        bare[name] = 0
    return bare


def _how_made(recipe: Recipe, planned: RunSpec, core: int | None) -> dict[str, Any]:
    where = {name: recipe.ran_on.get(name, "unknown") for name in environment.KEPT_WITH_RUNS}
    libraries = ("numpy", "scipy", *registry.entrant(planned.method.backend).requires)
    return {
        "made": datetime.now(UTC).isoformat(),
        **where,
        "core": core,
        "versions": environment.versions(libraries),
        "timed": recipe.timed,
        "limits": asdict(recipe.limits),
    }
