"""Run the methods of an experiment once, over a seed or a perturbed recording; keep scores and error series."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit import metrics
from evalkit.commands.metric_validation import perturbation
from evalkit.commands.metric_validation.map_rebuilding import find_true_poses, make_run
from evalkit.core.errors import EvalkitError
from evalkit.core.run_result import STEP, RunResult, Scores
from evalkit.execution.one_run import Request, find_run_parameters, record_run
from evalkit.execution.task import AnyTask, make_task
from evalkit.metrics.evaluate import collect_evidence
from evalkit.metrics.metric import MatchedPoses
from evalkit.metrics.series import SERIES, ScoredAnswers
from evalkit.metrics.trajectory import compute_errors_m
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score

METRICS = ("ate_rmse_m", "drift_percent", "relations_all_mean_m")
"""Metrics with a series within the run, from which the bootstrap draws."""

DRIFTS = ("drift 1", "drift 2")
"""Two methods made of the true poses of a world and independent random walks of the heading."""
DRIFT_DEG = 1.0
"""deg per square root of a metre"""

FAILED = "failed"


@dataclass(frozen=True, eq=False)
class SeedRuns:
    """The runs of one method over all seeds or perturbations of a sequence, in one metric: values (S,) and draws."""

    sequence: str
    method: str
    metric: str
    values: tuple[float, ...]
    draws: tuple[BootstrapDraws | None, ...]


def make_seed_task(
    label: str,
    dataset: str,
    parameters: Mapping[str, Value],
    seed: int | None,
    methods: Sequence[tuple[str, str, Mapping[str, Value]]],
    modules: Sequence[str],
) -> AnyTask:
    """Return the task of one seed or perturbation; None: the recording as it is.

    ``label``: of the sequence; ``methods``: label, back end and parameters; ``modules``: of the plug-ins.
    """
    task = make_task(
        f"{label} {seed}",
        run_seed,
        dataset=dataset,
        parameters=dict(parameters),
        seed=seed,
        methods=[(label, backend, dict(values)) for label, backend, values in methods],
    )
    return task.depending_on(*modules)


def run_seed(
    dataset: str, parameters: dict[str, Value], seed: int | None, methods: list[tuple[str, str, dict[str, Value]]]
) -> dict[str, Any]:
    """Run every method, and on a world the random walks; return scores and series by method and metric.

    A method that cannot run has the reason under ``method|failed``.
    """
    spec = registry.dataset(dataset)
    sequence = spec.open(parameters)
    results, failed = {}, {}
    for label, backend, values in methods:
        try:
            results[label] = _run(sequence, Request(backend, values, dataset, parameters))
        except EvalkitError as error:
            failed[f"{label}|{FAILED}"] = str(error)
    if spec.seeded and seed is not None:
        poses = find_true_poses(sequence)
        for number, label in enumerate(DRIFTS):
            moved = perturbation.drift(poses, DRIFT_DEG, np.random.default_rng([seed, number]))
            results[label] = make_run(sequence, moved)
    return failed | {
        f"{label}|{metric}|{name}": value
        for label, result in results.items()
        for metric, content in _score(result, sequence).items()
        for name, value in content.items()
    }


def read_reasons(method: str, results: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why a method could not run, once for each run that it could not make."""
    return [str(result[key]) for result in results if (key := f"{method}|{FAILED}") in result]


def select_scored(methods: Sequence[str], metric: str, results: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the results in which every method has a score of the metric, so that runs stay paired."""
    return [one for one in results if all(one.get(f"{method}|{metric}|score") is not None for method in methods)]


def read_runs(sequence: str, method: str, metric: str, results: Sequence[Mapping[str, Any]]) -> SeedRuns:
    """Return the runs of a method over the results of all seeds; the blocks of a seed are the same for all methods."""
    values, draws = [], []
    for seed, result in enumerate(results):
        score = result.get(f"{method}|{metric}|score")
        if score is None:
            continue
        content = {name: result.get(f"{method}|{metric}|{name}") for name in ("keys", "values", "statistic", "period")}
        values.append(float(score))
        draws.append(_draw(content, float(score), seed))
    return SeedRuns(sequence, method, metric, tuple(values), tuple(draws))


def _run(sequence: SensorSequence, request: Request) -> RunResult:
    steps = io.BytesIO()
    odometry = frontend.make_odometry(registry.backend(request.backend), find_run_parameters(request))
    record_run(odometry, sequence.frames(), request, steps)
    return RunResult(np.frombuffer(steps.getvalue(), dtype=STEP), len(sequence))


def _score(result: RunResult, sequence: SensorSequence) -> dict[str, dict[str, Any]]:
    evidence = collect_evidence(result, sequence)
    table = [metric for metric in metrics.METRICS if metric.name in METRICS]
    scores, true, errors = metrics.compute_scores(evidence, table), evidence.truth.trajectory, None
    if true is not None and isinstance(evidence.matched, MatchedPoses):
        errors = compute_errors_m(result.estimate.moved(evidence.matched.world_from_start, "world"), true)
    run = ScoredAnswers(result, Scores(scores, errors_m=errors), evidence.truth)
    found: dict[str, dict[str, Any]] = {}
    for name in METRICS:
        series = SERIES[name](run)
        found[name] = {"score": scores[name].value}
        if series is not None:
            found[name] |= {"keys": series.keys, "values": series.values}
            found[name] |= {"statistic": series.statistic, "period": series.period_s}
    return found


def _draw(content: Mapping[str, Any], score: float, seed: int) -> BootstrapDraws | None:
    if content["values"] is None:
        return None
    series = Series(np.asarray(content["keys"]), np.asarray(content["values"]), content["statistic"], content["period"])
    return bootstrap_score(series, score, np.random.default_rng([0, seed]))
