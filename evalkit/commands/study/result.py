"""The results of a study as tables of numbers; lost runs enter with their bound as value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from evalkit.commands.study.effects import ModelFit
from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.plan import Design, Point, Response, Study, format_task_name
from evalkit.core.se2 import Floats
from evalkit.execution.dask_cluster import Cluster
from evalkit.execution.task import Task
from evalkit.execution.task_runner import OnDone, TaskFailure, TasksFailed, run_tasks
from evalkit.execution.task_store import TaskStore


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study with the results of its tasks by name."""

    study: Study
    results: Mapping[str, RunScores]

    def result(self, key: str, seed: int | None) -> RunScores:
        """The result of one run."""
        return self.results[format_task_name(key, seed)]

    def value(self, response: Response, key: str, seed: int | None) -> float | None:
        """The value of a metric, None if it has none."""
        return self.result(key, seed)["scores"][response.name]

    def lost(self, key: str, seed: int | None) -> str:
        """Why a run is lost (it failed, or a response is beyond its bound), or ""."""
        return find_loss_reason(self.result(key, seed), self.study.responses)

    def bounded_value(self, response: Response, key: str, seed: int | None) -> float:
        """A metric's value; the response's bound (nan without one) if the run is lost by it or failed."""
        return bounded_value(self.result(key, seed), response)

    def table(self, design: Design, response: Response) -> Floats:
        """The bounded metric (N, S) of a design's points and seeds."""
        return np.array([self.row(design, response, point) for point in design.points])

    def row(self, design: Design, response: Response, point: Point) -> Floats:
        """The bounded metric (S,) of one point."""
        return np.array([self.bounded_value(response, point.key, seed) for seed in design.runs(point)])

    def counts(self, design: Design) -> tuple[int, int]:
        """The number of a design's lost runs and of all its runs."""
        lost = [self.lost(point.key, seed) for point in design.points for seed in design.runs(point)]
        return sum(map(bool, lost)), len(lost)

    @cache  # noqa: B019 - an outcome lives as long as its page is made
    def fit(self, design: Design, response: Response) -> ModelFit | None:
        """The effects on a response (its logarithm on a log scale), from means over the seeds.

        None for a design without a model, and if too few points have a value.
        """
        if design.kind not in ("optimal", "fractional"):
            return None
        values = to_scale(response, self.table(design, response))
        known = np.isfinite(values).any(axis=1)
        means = np.array([row[np.isfinite(row)].mean() for row in values[known]])
        try:
            return ModelFit(design.model, design.positions[known], means)
        except ValueError:
            return None

    def fits(self, response: Response) -> list[tuple[Design, ModelFit]]:
        """The designs for which effects on a response can be computed, with their fits."""
        return [(design, fit) for design in self.study.designs if (fit := self.fit(design, response)) is not None]


def find_loss_reason(result: RunScores, responses: Sequence[Response]) -> str:
    """Why a run is lost (it failed, or a response is beyond its bound), or ""."""
    if result["status"] != "complete":
        return f"{result['status']}: {result['reason']}"
    for response in responses:
        value = result["scores"][response.name]
        if response.lost is not None and value is None:
            return f"no {response.metric.label}: {result['why'][response.name]}"
        if value is not None and response.worse(value):
            return f"{response.metric.label} {value:.3g} {response.metric.unit}".rstrip()
    return ""


def bounded_value(result: RunScores, response: Response) -> float:
    """A response's value; its bound (nan without one) if the run failed, has no value or is beyond the bound."""
    value = result["scores"][response.name]
    if value is None or result["status"] != "complete" or response.worse(value):
        return np.nan if response.lost is None else response.lost
    return value


def to_scale(response: Response, values: Floats) -> Floats:
    """Values on a response's scale: natural logarithms on a log scale, nan where there is none."""
    if response.scale == "linear":
        return values
    return np.log(values, out=np.full_like(values, np.nan), where=values > 0.0)


def run_study_tasks(
    tasks: Sequence[Task[RunScores]], folder: Path, workers: int, on_done: OnDone, cluster: Cluster | None = None
) -> dict[str, RunScores]:
    """The results of a study's tasks, stored in a folder; a task that died or timed out is a run without scores."""
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
