"""Run the methods of an experiment over one seed of a world, and keep scores and error series."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit import metrics
from evalkit.commands.metric_validation import perturbation
from evalkit.commands.metric_validation.map_rebuilding import find_true_poses, make_run
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Scores
from evalkit.execution.task import AnyTask, make_task
from evalkit.execution.worker import Request, record_run
from evalkit.metrics.evaluate import collect_evidence
from evalkit.metrics.series import SERIES
from evalkit.metrics.table import MatchedPoses
from evalkit.metrics.trajectory import compute_errors_m
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score

METRICS = ("ate_rmse_m", "drift_percent")
"""Metrics with a series within the run, from which the bootstrap draws."""

DRIFTS = ("drift 1", "drift 2")
"""Two methods made of the true poses and independent random walks of the heading."""
DRIFT_DEG = 1.0
"""deg per square root of a metre"""


@dataclass(frozen=True)
class ScoredSeed:
    """A run with its scores and ground truth, as the series of the metrics need it."""

    result: RunResult
    scores: Scores
    truth: Truth


@dataclass(frozen=True, eq=False)
class SeedRuns:
    """The runs of one method over all seeds of a world, in one metric: values (S,) and their draws."""

    world: str
    method: str
    metric: str
    values: tuple[float, ...]
    draws: tuple[BootstrapDraws | None, ...]


def make_seed_task(
    world: str,
    dataset: str,
    parameters: Mapping[str, Value],
    seed: int,
    methods: Sequence[tuple[str, str, Mapping[str, Value]]],
    modules: Sequence[str],
) -> AnyTask:
    """Return the task of one seed; ``methods``: label, back end and parameters; ``modules``: of the plug-ins."""
    task = make_task(
        f"{world} {seed}",
        run_seed,
        dataset=dataset,
        parameters=dict(parameters),
        seed=seed,
        methods=[(label, backend, dict(values)) for label, backend, values in methods],
    )
    return task.depending_on(*modules)


def run_seed(
    dataset: str, parameters: dict[str, Value], seed: int, methods: list[tuple[str, str, dict[str, Value]]]
) -> dict[str, Any]:
    """Run every method and the random walks over one seed; return scores and series by method and metric."""
    sequence = registry.dataset(dataset).open(parameters)
    results = {label: _run(sequence, dataset, backend, values) for label, backend, values in methods}
    poses = find_true_poses(sequence)
    for number, label in enumerate(DRIFTS):
        moved = perturbation.drift(poses, DRIFT_DEG, np.random.default_rng([seed, number]))
        results[label] = make_run(sequence, moved)
    return {
        f"{label}|{metric}|{name}": value
        for label, result in results.items()
        for metric, content in _score(result, sequence).items()
        for name, value in content.items()
    }


def read_runs(world: str, method: str, metric: str, results: Sequence[Mapping[str, Any]]) -> SeedRuns:
    """Return the runs of a method over the results of all seeds; the blocks of a seed are the same for all methods."""
    values, draws = [], []
    for seed, result in enumerate(results):
        score = result.get(f"{method}|{metric}|score")
        if score is None:
            continue
        content = {name: result.get(f"{method}|{metric}|{name}") for name in ("keys", "values", "statistic", "period")}
        values.append(float(score))
        draws.append(_draw(content, float(score), seed))
    return SeedRuns(world, method, metric, tuple(values), tuple(draws))


def _run(sequence: SensorSequence, dataset: str, backend: str, parameters: dict[str, Value]) -> RunResult:
    steps = io.BytesIO()
    odometry = frontend.make_odometry(registry.backend(backend), parameters)
    record_run(odometry, sequence, Request(backend, parameters, dataset, {}), steps)
    return RunResult(np.frombuffer(steps.getvalue(), dtype=STEP), len(sequence))


def _score(result: RunResult, sequence: SensorSequence) -> dict[str, dict[str, Any]]:
    evidence = collect_evidence(result, sequence)
    table = [metric for metric in metrics.METRICS if metric.name in METRICS]
    scores, true = metrics.compute_scores(evidence, table), evidence.truth.trajectory
    if true is None or not isinstance(evidence.matched, MatchedPoses):
        raise ValueError("world: no ground-truth trajectory; choose a data set that has one")
    errors = compute_errors_m(result.estimate.moved(evidence.matched.world_from_start, "world"), true)
    run = ScoredSeed(result, Scores(scores, errors_m=errors), evidence.truth)
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
