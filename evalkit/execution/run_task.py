"""Execute one run, score it and store both: the same code on this machine and on the worker of a cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext, suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evalkit import metrics
from evalkit.config.experiment import Experiment, MapperChoice, RunSpec
from evalkit.config.limits import Limits
from evalkit.core.arrays import keep_freed_memory
from evalkit.core.errors import MachineFault, StoreError
from evalkit.core.run_result import NO_STEPS, RunResult, Score
from evalkit.core.run_status import Cause
from evalkit.execution import environment, run_process
from evalkit.execution.one_run import Request
from evalkit.execution.shared_frames import SharedFrames, open_kept
from evalkit.execution.subprocesses import WorkerPool
from evalkit.metrics import evaluate
from evalkit.plugins import registry
from evalkit.plugins.known_map import load_known_map
from evalkit.plugins.parameters import ALIGN_TRUTH
from evalkit.plugins.specs import MapSpec
from evalkit.results.store import Store

COSTS = ("wall_ns", "cpu_ns", "conversion_ns", "harness_ns", "device_ns", "preparation_ns")
MAX_ATTEMPTS = 2
"""A run that killed this many processes is quarantined."""

BEFORE_SCORING = "before_scoring"
"""Key of the provenance: cause and reason of a run whose scoring has failed, before it did."""

NOT_TIMED = "not timed: executed where times do not count"


@dataclass(frozen=True)
class RunSettings:
    """Settings that all runs of an experiment share, wherever they are executed.

    ``scoring_code``: identifies the scoring code and the mapper. ``timed``: whether times count. ``environment``:
    description of the machine, kept with every executed run.
    """

    limits: Limits
    mapper: MapperChoice
    scoring_code: str
    timed: bool = True
    environment: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_experiment(cls, experiment: Experiment, description: Mapping[str, str]) -> RunSettings:
        """The settings of an experiment on a machine with this description.

        Raises NotInstalled for a metric that does not load, before any run.
        """
        metrics.all_metrics()
        mapper = experiment.mapper
        scoring_code = f"{registry.hash_scoring_code(mapper.name)} {mapper}"
        return cls(experiment.limits, mapper, scoring_code, experiment.timed, description)


@dataclass(frozen=True)
class PendingRun:
    """A run to execute, or only to score where ``is_executed``: its result is stored already.

    ``attempts``: names of processes that started the run and died before its end.
    """

    spec: RunSpec
    is_executed: bool = False
    attempts: tuple[str, ...] = ()


@dataclass(frozen=True)
class WorkerSlot:
    """Resources for one run: a core to pin to, processes for scoring, a callback with the number of answered scans.

    ``stop``: ends the run early when set. ``frames``: of the data that several runs share; None: each run reads them.
    """

    core: int | None
    scoring: WorkerPool
    report_answers: Callable[[int], None]
    stop: threading.Event
    frames: SharedFrames | None = None


def execute_run(store: Store, settings: RunSettings, pending: PendingRun, slot: WorkerSlot) -> RunResult:
    """Execute a pending run unless its result is stored already, score it, and store both.

    Every failure is a cause with a reason, except two: raises StoreError if the results folder cannot be written, and
    CancelledError if the run was stopped.
    """
    spec = pending.spec
    if pending.is_executed:
        stored = store.load_result(spec.key) or empty_result(Cause.UNREADABLE, "its stored result cannot be read")
        if (result := before_scoring(stored)) is not stored:
            store.save_result(spec, result)
    else:
        result = _execute(store, settings, pending, slot)
    if slot.stop.is_set():
        raise CancelledError
    return _score(store, settings, spec, result, slot) if result.is_scorable else result


def unavailable_result(spec: RunSpec) -> RunResult | None:
    """The result of a run whose data or library is not available here; None if both are."""
    if spec.sequence.missing:
        return empty_result(Cause.DATA_MISSING, spec.sequence.missing)
    if spec.method.missing:
        return empty_result(Cause.NOT_INSTALLED, spec.method.missing)
    return None


def empty_result(cause: Cause, reason: str) -> RunResult:
    """The result of a run without an answer."""
    return RunResult(NO_STEPS, 0, cause, reason)


def before_scoring(result: RunResult) -> RunResult:
    """The result that a run had before its scoring failed; a result that was not changed by a scoring as it is."""
    if (ended := result.provenance.get(BEFORE_SCORING)) is None:
        return result
    provenance = {name: value for name, value in result.provenance.items() if name != BEFORE_SCORING}
    return replace(result, cause=Cause(ended["cause"]), reason=ended["reason"], provenance=provenance)


def quarantine(
    store: Store, settings: RunSettings, spec: RunSpec, what: str, result: RunResult | None = None
) -> RunResult:
    """Store that a run kills processes, so that only ``--rerun crashed`` executes it again.

    ``result``: what the run answered before, if anything. Returns the stored result.
    """
    changes: dict[str, Any] = {
        "cause": Cause.QUARANTINED,
        "reason": f"quarantined: {what}; --rerun crashed runs it again",
        "provenance": _provenance(store, settings, spec, None),
    }
    result = replace(result, **changes) if result else RunResult(NO_STEPS, 0, **changes)
    store.discard_scores(spec.key)
    store.save_result(spec, result)
    return result


def _execute(store: Store, settings: RunSettings, pending: PendingRun, slot: WorkerSlot) -> RunResult:
    """Execute a run in a process of its own and store its result; quarantine a run that killed too many processes."""
    spec = pending.spec
    if len(pending.attempts) >= MAX_ATTEMPTS:
        what = f"evalkit was killed twice while it ran ({', '.join(pending.attempts)})"
        return quarantine(store, settings, spec, what)
    attempt = f"process {os.getpid()} on {environment.host_name()}"
    shared = nullcontext() if slot.frames is None else slot.frames.of_run(spec, slot.core)
    with shared as frames, store.begin(spec.key, [*pending.attempts, attempt]) as folder:
        request = Request(
            spec.method.backend,
            dict(spec.method.parameters),
            spec.sequence.dataset,
            spec.dataset_parameters,
            slot.core,
            frames,
            registry.find_address("backends", spec.method.backend),
        )
        result = run_process.run(request, folder, settings.limits, slot.report_answers, slot.stop)
        if slot.stop.is_set():
            raise CancelledError
        steps = result.steps if settings.timed else _without_times(result.steps)
        result = replace(result, steps=steps, provenance=_provenance(store, settings, spec, slot.core))
        if not settings.timed:
            result = replace(result, final_cpu_ns=0)
        store.save_result(spec, result)
    return result


def _score(store: Store, settings: RunSettings, spec: RunSpec, result: RunResult, slot: WorkerSlot) -> RunResult:
    """Score a run in a process of its own; returns its result, with a cause that is stored if the scoring failed."""
    try:
        try:
            slot.scoring.run(score_and_save, store.folder, spec, result, settings, slot.core)
        except BrokenProcessPool:  # perhaps killed by something else
            slot.scoring.check("scoring", MachineFault.REMEDY)
            slot.scoring.run(score_and_save, store.folder, spec, result, settings, slot.core)
    except StoreError:
        raise
    except BrokenProcessPool as error:
        what = f"scoring it killed its process twice ({error})"
        return quarantine(store, settings, spec, what, result)
    except Exception as error:  # noqa: BLE001 - a run that cannot be scored must not stop the others
        store.discard_scores(spec.key)  # of other code, from an earlier scoring
        if fault := error if isinstance(error, MachineFault) else MachineFault.of("scoring", error):
            failed = _with_failed_scoring(result, Cause.MACHINE_FAULT, str(fault))
            with suppress(StoreError):  # a full disk
                store.save_result(spec, failed)
            return failed
        failed = _with_failed_scoring(result, Cause.SCORING_FAILED, f"scoring failed: {type(error).__name__}: {error}")
        store.save_result(spec, failed)
        return failed
    return result


def _with_failed_scoring(result: RunResult, cause: Cause, reason: str) -> RunResult:
    ended = {"cause": result.cause, "reason": result.reason}
    return replace(result, cause=cause, reason=reason, provenance={**result.provenance, BEFORE_SCORING: ended})


def score_and_save(folder: Path, spec: RunSpec, result: RunResult, settings: RunSettings, core: int | None) -> None:
    """Score one run on the core it was executed on, and store the scores; runs in a process of the scoring pool."""
    keep_freed_memory()
    if core is not None:
        os.sched_setaffinity(0, {core})
    mapper = registry.mapper(settings.mapper.name)
    backend = None if len(result.steps) else registry.backend(spec.method.backend)  # only a map answers no scan
    sequence = open_kept(folder, spec.sequence.dataset, tuple(spec.dataset_parameters.items()))
    if isinstance(backend, MapSpec):
        scores = evaluate.evaluate_map(result, backend.make(**spec.method.parameters), sequence)
    else:
        scores = evaluate.evaluate_run(
            result,
            sequence,
            lambda: mapper.make(**settings.mapper.parameters),
            settings.mapper.scans,
            load_known_map(spec.dataset_parameters, sequence),
            bool(spec.dataset_parameters.get(ALIGN_TRUTH, False)),
        )
    if not settings.timed and not result.steps["wall_ns"].any():
        without = {name: _drop_time(name, score) for name, score in scores.by_metric.items()}
        scores = replace(scores, by_metric=without)
    store = Store(folder)
    store.save_scores(spec.key, scores, settings.scoring_code)
    if store.load_scores(spec.key) is None:
        raise RuntimeError(f"{store.run_folder(spec.key)}: scores were written but cannot be read back")


def _drop_time(name: str, score: Score) -> Score:
    return Score(None, score.support, NOT_TIMED) if name in _time_metrics() else score


@cache
def _time_metrics() -> frozenset[str]:
    return frozenset(one.name for one in metrics.all_metrics() if one.group == "runtime" and one.unit != "MiB")


def _without_times(steps: NDArray[np.void]) -> NDArray[np.void]:
    copied = steps.copy()
    for name in COSTS:
        copied[name] = 0
    return copied


def _provenance(store: Store, settings: RunSettings, spec: RunSpec, core: int | None) -> dict[str, Any]:
    """When and where a run was executed, with which versions and limits (JSON values).

    ``folder``: the working folder as seen from the results, so that both may be moved together.
    """
    where = {name: settings.environment.get(name, "unknown") for name in environment.KEPT_WITH_RUNS}
    libraries = ("numpy", "scipy", *registry.find_backend(spec.method.backend).requires)
    return {
        "executed_at": datetime.now(UTC).isoformat(),
        **where,
        "folder": os.path.relpath(Path.cwd(), store.folder.resolve()),
        "core": core,
        "versions": environment.versions(libraries),
        "timed": settings.timed,
        "limits": asdict(settings.limits),
    }
