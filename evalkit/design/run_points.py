"""Run and score points of a study or a tuning: one in this process, or many as tasks; metrics as in the report."""

from __future__ import annotations

import io
import json
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypedDict

from evalkit import metrics
from evalkit.core.errors import EvalkitError, plain
from evalkit.core.run_result import RunResult, Score
from evalkit.core.run_status import Cause
from evalkit.execution.dask_cluster import Cluster
from evalkit.execution.one_run import Request, record_run
from evalkit.execution.task import Task
from evalkit.execution.task_runner import OnDone, TaskFailure, TasksFailed, run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.metrics import evaluate as scoring
from evalkit.metrics import pairs, spans
from evalkit.metrics.metric import MAP_GROUPS, Metric
from evalkit.odometry import frontend
from evalkit.odometry.corrections import read_corrections
from evalkit.plugins import protocols, registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import SlamSpec
from evalkit.results.store import whole_records

OF_SCANS = frozenset(metric.name for metric in (*pairs.METRICS, *spans.METRICS))
"""Metrics of other groups that need the scans at the estimated poses, as do those of corrected poses."""

KEPT_SEQUENCES = 2
"""Sequences to keep in memory; points of one sequence follow each other."""


class RunScores(TypedDict):
    """The scores of one run.

    ``status`` and ``reason`` as in ``RunResult``; ``answered`` of ``expected`` scans; ``cpu_s``: CPU time in all;
    ``scores``: values by metric, None without a value, for which ``why`` has the reason.
    """

    status: str
    reason: str
    answered: int
    expected: int
    cpu_s: float
    scores: dict[str, float | None]
    why: dict[str, str]


def evaluate(
    backend: str,
    parameters: Mapping[str, Value],
    dataset: str,
    sequence: Mapping[str, Value],
    mapper: str,
    mapper_parameters: Mapping[str, Value],
    scans: int,
    metrics: Sequence[str],
    code: str,  # noqa: ARG001 - part of the task's key
) -> RunScores:
    """Run a back end on a sequence with complete parameters and compute the named scores.

    ``scans``: scans per map; ``code``: a digest of the plug-ins' sources. A failure of the back end is a result.
    """
    started_s = time.process_time()
    driven = _load_sequence(dataset, json.dumps(dict(sequence), sort_keys=True))
    run = _run(Request(backend, dict(parameters), dataset, dict(sequence)), driven)
    make = partial(registry.mapper(mapper).make, **mapper_parameters)
    scored = _compute_scores(run, driven, make, scans, metrics)
    return {
        "status": run.status,
        "reason": run.reason,
        "answered": len(run.steps),
        "expected": run.expected,
        "cpu_s": time.process_time() - started_s,
        "scores": {name: score.value for name, score in scored.items()},
        "why": {name: score.reason for name, score in scored.items() if score.value is None},
    }


def prepare_sequence(dataset: str, sequence: Mapping[str, Value]) -> None:
    """Simulate a sequence, so that the first run on it is not charged with that time."""
    driven = _load_sequence(dataset, json.dumps(dict(sequence), sort_keys=True))
    with suppress(Exception):  # the run raises and reports it again
        next(iter(driven.frames()), None)


@lru_cache(maxsize=KEPT_SEQUENCES)
def _load_sequence(dataset: str, parameters: str) -> protocols.Sequence:
    return registry.dataset(dataset).make(**json.loads(parameters))


def _run(request: Request, sequence: protocols.Sequence) -> RunResult:
    """Run the back end on the sequence; an exception ends the run and is its cause."""
    steps, corrections = io.BytesIO(), None
    cause, reason = Cause.COMPLETED, ""
    try:
        spec = registry.backend(request.backend)
        odometry = frontend.make_odometry(spec, request.backend_parameters)
        record_run(odometry, sequence.frames(), request, steps)
        if isinstance(spec, SlamSpec):
            corrections = read_corrections(odometry, whole_records(steps.getvalue())["stamp_ns"])
    except EvalkitError as error:
        cause, reason = Cause.EXCEPTION, str(error)
    except Exception as error:  # noqa: BLE001 - whatever a third party's code raises is a result to report
        place = traceback.extract_tb(error.__traceback__)[-1]
        cause, reason = Cause.EXCEPTION, f"{type(error).__name__}: {error} ({place.name})"
    run = RunResult(whole_records(steps.getvalue()), len(sequence), cause, plain(reason))
    if corrections is None:
        return run
    final, closures, cpu_ns = corrections.trajectory, corrections.closures, corrections.cpu_ns
    return replace(run, final=final, loop_closures=closures, final_cpu_ns=cpu_ns)


def _compute_scores(
    run: RunResult, sequence: protocols.Sequence, make_mapper: Any, scans: int, names: Sequence[str]
) -> dict[str, Score]:
    """The named scores; the map is drawn only if a metric needs it, or has no value without it."""
    table = {metric.name: metric for metric in metrics.all_metrics() if metric.name in names}
    evidence = scoring.collect_evidence(run, sequence)
    plain = [
        metric
        for metric in table.values()
        if metric.group not in MAP_GROUPS and (metric.counterpart or metric.name) not in OF_SCANS
    ]
    scores = metrics.compute_scores(evidence, plain)
    with_map = [metric for metric in table.values() if metric not in plain or _needs_scans(metric, scores)]
    if with_map:
        halves = any(metric.group == "map consistency" for metric in with_map)
        evidence = scoring.add_map(evidence, sequence, make_mapper, scans, halves)
        scores |= metrics.compute_scores(evidence, with_map)
    return {name: scores[name] for name in names}


def _needs_scans(metric: Metric, scores: Mapping[str, Score]) -> bool:
    return metric.group == "residuals" and scores[metric.name].value is None


def run_points(
    tasks: Sequence[Task[RunScores]], folder: Path, workers: int, on_done: OnDone, cluster: Cluster | None = None
) -> dict[str, RunScores]:
    """The results of tasks of ``evaluate``, stored in a folder; one that died or timed out is a run without scores."""
    store = TaskStore(folder)
    try:
        return run_tasks(store, tasks, workers, on_done, cluster)
    except TasksFailed as failed:
        failures = failed.failures
        return {
            task.name: store.load(task) or _make_failed_run(task, failures.get(task.name, TaskFailure("")))
            for task in tasks
        }


def _make_failed_run(task: Task[RunScores], failure: TaskFailure) -> RunScores:
    """The scores of a run that has none."""
    metrics = task.arguments["metrics"]
    return {
        "status": "timeout" if failure.timed_out else "crashed",
        "reason": failure.reason,
        "answered": 0,
        "expected": 0,
        "cpu_s": 0.0,
        "scores": dict.fromkeys(metrics),
        "why": dict.fromkeys(metrics, failure.reason),
    }
