"""Search all back ends in rounds, then compare each best point with its default on fresh seeds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from evalkit.commands.tune.objective import (
    ScoredCandidate,
    compute_error_ratio,
    find_best_candidate,
    is_better,
    score_candidate,
)
from evalkit.commands.tune.plan import TUNED, TrainingRun, TunableMethod, Tuning
from evalkit.commands.tune.search import Search
from evalkit.commands.tune.space import TuningCandidate
from evalkit.config.experiment import Experiment, Method
from evalkit.design.run_points import RunScores, run_points
from evalkit.execution.task import Task
from evalkit.execution.task_runner import OnDone
from evalkit.execution.task_store import TaskStore
from evalkit.stats.intervals import Interval

Compute = Callable[[Sequence[Task[RunScores]]], Mapping[str, RunScores]]
"""Returns the results of tasks by name."""

Candidates = list[tuple[TunableMethod, TuningCandidate]]


class ResultsMissing(Exception):
    """``missing`` results of the search's next tasks are not stored, and nothing may be computed."""

    def __init__(self, missing: int) -> None:
        super().__init__(missing)
        self.missing = missing


@dataclass(frozen=True, eq=False)
class MethodSearch:
    """The search of one back end: every point in the order tried, and the best point against the default.

    ``confirmed``: default and best point on fresh seeds, None if the default was best. ``ratio``: of their errors
    there. ``tuned``: whether the best point replaces the default; ``why``: the reason.
    """

    tunable: TunableMethod
    tried: tuple[ScoredCandidate, ...]
    confirmed: tuple[ScoredCandidate, ScoredCandidate] | None
    ratio: Interval | None
    tuned: bool
    why: str

    @property
    def default(self) -> ScoredCandidate:
        """The default, which is the first point."""
        return self.tried[0]

    @property
    def best(self) -> ScoredCandidate:
        """The best point of the search."""
        return find_best_candidate(self.tried)

    @property
    def chosen(self) -> ScoredCandidate:
        """The best point if it is better beyond noise, otherwise the default."""
        return self.best if self.tuned else self.default

    @property
    def failed(self) -> bool:
        """Whether no run of any point was completed."""
        return all(one.failed for one in self.tried)

    @property
    def cpu_s(self) -> float:
        """CPU seconds of all runs, fresh seeds included."""
        return float(sum(one.cpu_s for one in (*self.tried, *(self.confirmed or ()))))


def run_search(tuning: Tuning, compute: Compute) -> tuple[MethodSearch, ...]:
    """Search every back end that can run here, all with the same budget; the same tuning tries the same points."""
    methods = [tunable for tunable in tuning.methods if not tunable.missing]
    tried: dict[str, list[ScoredCandidate]] = {tunable.label: [] for tunable in methods}
    while candidates := _next_candidates(tuning, methods, tried):
        for tunable, scored in _score(tuning, compute, candidates, tuning.search_runs):
            tried[tunable.label].append(scored)
    return _confirm_best(tuning, compute, methods, tried)


def make_held_out_experiment(tuning: Tuning, results: Sequence[MethodSearch], file: str) -> Experiment:
    """The experiment of every method with its defaults, and tuned if that is better, on the held-out sequences."""
    by_label = {one.tunable.label: one for one in results}
    methods: list[Method] = []
    for tunable in tuning.methods:
        methods.append(tunable.method)
        one = by_label.get(tunable.label)
        if one is not None and one.tuned:
            values = one.chosen.candidate.values
            methods.append(replace(tunable.method, label=tunable.label + TUNED, parameters=values))
    return Experiment(
        "tuned", f"{tuning.title} (default and tuned methods)", tuning.description, f"compare {file}", tuple(methods),
        tuning.held_out, tuning.mapper, tuning.limits,
    )  # fmt: skip


def compute_missing(folder: Path, workers: int, on_done: OnDone) -> Compute:
    """A ``Compute`` that runs tasks without a stored result in ``workers`` processes."""
    return lambda tasks: run_points(tasks, folder, workers, on_done)


def load_stored(folder: Path) -> Compute:
    """A ``Compute`` that only loads stored results. It raises ResultsMissing if some are missing."""
    store = TaskStore(folder)

    def load(tasks: Sequence[Task[RunScores]]) -> Mapping[str, RunScores]:
        results = {task.name: result for task in tasks if (result := store.load(task)) is not None}
        if len(results) < len(tasks):
            raise ResultsMissing(len(tasks) - len(results))
        return results

    return load


def count_runs(tuning: Tuning) -> int:
    """The largest number of training runs that the search may need."""
    methods = [tunable for tunable in tuning.methods if not tunable.missing]
    points = [tuning.points if tunable.space.factors else 1 for tunable in methods]
    confirm_runs = 2 * len(tuning.confirm_runs) * sum(count > 1 for count in points)
    return sum(points) * len(tuning.search_runs) + confirm_runs


def _next_candidates(
    tuning: Tuning, methods: Sequence[TunableMethod], tried: Mapping[str, Sequence[ScoredCandidate]]
) -> Candidates:
    """The next points of all back ends."""
    candidates: Candidates = []
    for tunable in methods:
        known = tried[tunable.label]
        search = Search(tunable.space, tuning.points, tuning.seed)
        best = find_best_candidate(known).candidate if known else None
        candidates += [(tunable, candidate) for candidate in search.next([one.candidate for one in known], best)]
    return candidates


def _score(
    tuning: Tuning, compute: Compute, candidates: Candidates, runs: Sequence[TrainingRun]
) -> list[tuple[TunableMethod, ScoredCandidate]]:
    """Run and score points; tasks on one sequence are neighbours, so that it is simulated once."""
    tasks = [tuning.task(tunable, candidate, run) for tunable, candidate in candidates for run in runs]
    results = compute(sorted(tasks, key=lambda task: json.dumps(task.arguments["sequence"], sort_keys=True)))
    names = iter(task.name for task in tasks)
    return [
        (tunable, score_candidate(candidate, [results[next(names)] for _ in runs], tuning.objective))
        for tunable, candidate in candidates
    ]


def _confirm_best(
    tuning: Tuning, compute: Compute, methods: Sequence[TunableMethod], tried: Mapping[str, Sequence[ScoredCandidate]]
) -> tuple[MethodSearch, ...]:
    """Run default and best point on fresh seeds for every back end whose best point is not the default."""
    candidates: Candidates = []
    for tunable in methods:
        known = tried[tunable.label]
        if (best := find_best_candidate(known)) is not known[0]:
            candidates += [(tunable, known[0].candidate), (tunable, best.candidate)]
    pairs: dict[str, list[ScoredCandidate]] = {}
    for tunable, scored in _score(tuning, compute, candidates, tuning.confirm_runs) if candidates else []:
        pairs.setdefault(tunable.label, []).append(scored)
    return tuple(_decide_result(each, tried[each.label], pairs.get(each.label, [])) for each in methods)


def _decide_result(
    tunable: TunableMethod, tried: Sequence[ScoredCandidate], pair: Sequence[ScoredCandidate]
) -> MethodSearch:
    """Take the best point or keep the default, by the ``pair`` of default and best on fresh seeds."""
    if not pair:
        why = "it has nothing to search" if len(tried) == 1 else "no point was better in the search"
        return MethodSearch(tunable, tuple(tried), None, None, False, f"default kept: {why}")
    default, candidate = pair
    ratio = compute_error_ratio(candidate, default)
    tuned = is_better(candidate, default, ratio)
    why = "better on fresh seeds by more than noise" if tuned else _explain_default(candidate, default)
    return MethodSearch(tunable, tuple(tried), (default, candidate), ratio, tuned, why)


def _explain_default(candidate: ScoredCandidate, default: ScoredCandidate) -> str:
    if candidate.losses > default.losses:
        return "default kept: the best point of the search loses more runs on fresh seeds"
    return "default kept: the gain of the best point is within noise on fresh seeds"
