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
from evalkit.core.run_result import NO_STEPS, Cause, RunResult, RunStatus, Score
from evalkit.execution import environment, run_process
from evalkit.execution.dask_cluster import TRIES
from evalkit.execution.process_pool import start_pool
from evalkit.execution.worker import Request
from evalkit.metrics import evaluate, evaluate_map
from evalkit.plugins import registry
from evalkit.plugins.specs import MapSpec
from evalkit.results.store import Store

FINAL = (RunStatus.COMPLETE, RunStatus.FAILED, RunStatus.CRASHED)
"""Statuses that ``--resume`` treats as final."""

LIMITED = (RunStatus.TIMEOUT, RunStatus.OUT_OF_MEMORY)
"""Statuses that ``--resume`` treats as final under the limits they were made with, and no others."""

COSTS = ("wall_ns", "cpu_ns", "conversion_ns", "harness_ns", "device_ns")
NOT_TIMED = "not timed: made where times do not count"


@dataclass(frozen=True)
class FinishedRun:
    """A run that needs nothing more. ``seconds``: what it took with its scoring; 0 if it was kept or not executed."""

    spec: RunSpec
    result: RunResult
    seconds: float = 0.0


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
    rerun: frozenset[RunStatus] = frozenset()
    collect: bool = False
    ran_on: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(
        cls, plan: Experiment, resume: bool, rerun: frozenset[RunStatus], collect: bool, ran_on: Mapping[str, str]
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


def cached_run(store: Store, recipe: Recipe, spec: RunSpec) -> FinishedRun | None:
    """The run if it cannot be executed, or needs neither executing nor scoring any more; None where it does."""
    if (unavailable := unavailable_result(spec)) is not None:
        return FinishedRun(spec, unavailable)
    if not (recipe.resume or recipe.collect):
        return None
    result = _final_result(store, recipe, spec)
    if result is None and recipe.collect:
        return FinishedRun(
            spec, empty_result(Cause.NOT_RUN, "not made yet; the same command without --collect makes it")
        )
    if result is None or (result.is_scorable and store.scored_by(spec.key) != recipe.scored_by):
        return None
    return FinishedRun(spec, result)


def execute_run(store: Store, recipe: Recipe, spec: RunSpec, bench: Bench) -> FinishedRun:
    """Execute a run, unless a stored one will do, and score it; all of it is in the store.

    Whatever goes wrong is a cause with a reason, but StoreError: a results folder that cannot be written; and
    CancelledError where it was stopped.
    """
    begun = time.monotonic()
    result = _final_result(store, recipe, spec)
    if result is None and recipe.collect:
        return FinishedRun(spec, empty_result(Cause.UNREADABLE, "what is stored of it cannot be read"))
    if result is None:
        result = _run(store, recipe, spec, bench)
    if bench.stop.is_set():
        raise CancelledError
    if result.is_scorable:
        result = _scored(store, recipe, spec, result, bench)
    return FinishedRun(spec, result, max(time.monotonic() - begun, 1e-9))


def unavailable_result(spec: RunSpec) -> RunResult | None:
    """The result of a run whose data or library is not here; None where both are."""
    if spec.sequence.missing:
        return empty_result(Cause.DATA_MISSING, spec.sequence.missing)
    if spec.method.missing:
        return empty_result(Cause.NOT_INSTALLED, spec.method.missing)
    return None


def empty_result(cause: Cause, reason: str) -> RunResult:
    """The result of a run without an answer."""
    return RunResult(NO_STEPS, 0, cause, reason)


def quarantine(store: Store, recipe: Recipe, spec: RunSpec, why: str, result: RunResult | None = None) -> RunResult:
    """Store a run that is not executed again unless asked for; ``result``: what it answered before."""
    reason = f"quarantined: {why}; --rerun crashed tries again"
    result = replace(
        result or empty_result(Cause.QUARANTINED, reason), cause=Cause.QUARANTINED, reason=reason,
        provenance=_provenance(recipe, spec, None),
    )  # fmt: skip
    store.forget(spec.key, "scores.json")
    store.save_result(spec, result)
    store.forget_tries(spec.key)
    return result


def _final_result(store: Store, recipe: Recipe, spec: RunSpec) -> RunResult | None:
    """The stored result if it is final; what was not available may be now."""
    if not (recipe.resume or recipe.collect) or (result := store.load_result(spec.key)) is None or recipe.collect:
        return result if recipe.resume or recipe.collect else None
    if result.status in recipe.rerun or (recipe.timed and not result.provenance.get("timed", True)):
        return None
    same_limits = result.provenance.get("limits") == asdict(recipe.limits)
    return result if result.status in FINAL or (result.status in LIMITED and same_limits) else None


def _run(store: Store, recipe: Recipe, spec: RunSpec, bench: Bench) -> RunResult:
    """A new run, stored."""
    lost = store.tries(spec.key) if recipe.resume and "crashed" not in recipe.rerun else []
    if len(lost) >= TRIES:
        return quarantine(store, recipe, spec, f"evalkit was ended twice while it ran ({', '.join(lost)})")
    request = Request(
        spec.method.backend,
        dict(spec.method.parameters),
        spec.sequence.dataset,
        spec.dataset_parameters,
        bench.core,
    )
    folder = store.fresh(spec.key)
    store.note_tries(spec.key, [*lost, f"process {os.getpid()} on {platform.node()}"])
    try:
        run = run_process.run(request, folder, recipe.limits, bench.heard, bench.stop)
    finally:
        store.forget_tries(spec.key)  # whoever comes here has not been ended by it
    if not recipe.timed:
        run = replace(run, steps=_without_times(run.steps))
    if bench.stop.is_set():
        raise CancelledError
    run = replace(run, provenance=_provenance(recipe, spec, bench.core))
    store.save_result(spec, run)
    return run


def _scored(store: Store, recipe: Recipe, spec: RunSpec, result: RunResult, bench: Bench) -> RunResult:
    """Score a run in a process of its own; returns its result, changed where the scoring failed."""
    if store.scored_by(spec.key) == recipe.scored_by:
        return result
    store.forget(spec.key, "scores.json")  # of other code
    try:
        bench.scorers.do(score_stored, store.folder, spec, result, recipe, bench.core)
    except StoreError:
        raise
    except BrokenProcessPool as error:
        return quarantine(store, recipe, spec, f"it ended the process that scored it twice ({error})", result)
    except Exception as error:  # noqa: BLE001 - a run that cannot be scored must not stop the others
        reason = f"scoring failed: {type(error).__name__}: {error}"
        return replace(result, cause=Cause.SCORING_FAILED, reason=reason)
    if store.scored_by(spec.key) is None:
        reason = f"scoring failed: {store.run_folder(spec.key)}: scores were written but cannot be read back"
        return replace(result, cause=Cause.SCORING_FAILED, reason=reason)
    return result


def score_stored(folder: Path, spec: RunSpec, run: RunResult, recipe: Recipe, core: int | None) -> None:
    """Scores one run and keeps the result in the store; runs in a process of the scoring pool, on the run's core."""
    if core is not None:
        os.sched_setaffinity(0, {core})
    mapper = recipe.mapper
    entrant, drawn_by = registry.backend(spec.method.backend), registry.mapper(mapper.name)
    sequence = registry.dataset(spec.sequence.dataset).make(**spec.dataset_parameters)
    if isinstance(entrant, MapSpec):
        scores = evaluate_map.score(run, entrant.make(**spec.method.parameters), sequence)
    else:
        scores = evaluate.score(run, sequence, lambda: drawn_by.make(**mapper.parameters), mapper.scans)
    if not recipe.timed and not run.steps["wall_ns"].any():
        scores = replace(scores, by_metric={name: _untimed(name, score) for name, score in scores.by_metric.items()})
    Store(folder).save_scores(spec.key, scores, recipe.scored_by)


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


def _provenance(recipe: Recipe, spec: RunSpec, core: int | None) -> dict[str, Any]:
    where = {name: recipe.ran_on.get(name, "unknown") for name in environment.KEPT_WITH_RUNS}
    libraries = ("numpy", "scipy", *registry.find_backend(spec.method.backend).requires)
    return {
        "executed_at": datetime.now(UTC).isoformat(),
        **where,
        "core": core,
        "versions": environment.versions(libraries),
        "timed": recipe.timed,
        "limits": asdict(recipe.limits),
    }
