"""The search itself: rounds of points for all back ends together, then the best against the default on fresh seeds."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from evalkit.commands.study.evaluate import RunScores
from evalkit.commands.study.result import run_study_tasks
from evalkit.commands.tune.objective import Tried, best, better, judged, ratio
from evalkit.commands.tune.plan import Entrant, Run, Tuning
from evalkit.commands.tune.search import Search
from evalkit.commands.tune.space import Candidate
from evalkit.execution.task import Task
from evalkit.execution.task_runner import OnDone
from evalkit.execution.task_store import TaskStore
from evalkit.stats.intervals import Interval

Compute = Callable[[Sequence[Task[RunScores]]], Mapping[str, RunScores]]
"""Gives the results of tasks by name."""


class Unmade(Exception):
    """A result is not there, and none shall be made; how many are missing before the search can go on."""

    def __init__(self, missing: int) -> None:
        super().__init__(missing)
        self.missing = missing


@dataclass(frozen=True, eq=False)
class Searched:
    """What came of one back end: every point in the order tried, and how the best did against the default.

    ``confirmed``: default and best on fresh seeds, None where the default was the best. ``ratio``: of their errors
    there. ``tuned``: whether the best is taken; ``why`` says why, or why the default is kept.
    """

    entrant: Entrant
    tried: tuple[Tried, ...]
    confirmed: tuple[Tried, Tried] | None
    ratio: Interval | None
    tuned: bool
    why: str

    @property
    def default(self) -> Tried:
        """The default, which is the first point."""
        return self.tried[0]

    @property
    def best(self) -> Tried:
        """The best point of the search."""
        return best(self.tried)

    @property
    def chosen(self) -> Tried:
        """What is taken: the best if it is better by more than noise, else the default."""
        return self.best if self.tuned else self.default

    @property
    def failed(self) -> bool:
        """Whether no run of no point was completed."""
        return all(one.failed for one in self.tried)

    @property
    def cpu_s(self) -> float:
        """CPU seconds spent on it, confirmation included."""
        return float(sum(one.cpu_s for one in (*self.tried, *(self.confirmed or ()))))


def searched(tuning: Tuning, compute: Compute) -> tuple[Searched, ...]:
    """Every back end that can run here, searched with the same budget; the same tuning gives the same points."""
    entrants = [entrant for entrant in tuning.entrants if not entrant.missing]
    tried: dict[str, list[Tried]] = {entrant.label: [] for entrant in entrants}
    while asked := _asked(tuning, entrants, tried):
        for entrant, one in _judged(tuning, compute, asked, tuning.search_runs):
            tried[entrant.label].append(one)
    return _confirmed(tuning, compute, entrants, tried)


def making(folder: Path, workers: int, done: OnDone) -> Compute:
    """Computes what is not kept in a folder, with so many processes."""
    return lambda tasks: run_study_tasks(tasks, folder, workers, done)


def collecting(folder: Path) -> Compute:
    """Takes what is kept in a folder; Unmade where something is not."""
    store = TaskStore(folder)

    def load(tasks: Sequence[Task[RunScores]]) -> Mapping[str, RunScores]:
        results = {task.name: result for task in tasks if (result := store.load(task)) is not None}
        if len(results) < len(tasks):
            raise Unmade(len(tasks) - len(results))
        return results

    return load


def expected_runs(tuning: Tuning) -> int:
    """At most so many training runs are made."""
    entrants = [entrant for entrant in tuning.entrants if not entrant.missing]
    points = [tuning.points if entrant.space.factors else 1 for entrant in entrants]
    confirming = 2 * len(tuning.confirm_runs) * sum(count > 1 for count in points)
    return sum(points) * len(tuning.search_runs) + confirming


Asked = list[tuple[Entrant, Candidate]]


def _asked(tuning: Tuning, entrants: Sequence[Entrant], tried: Mapping[str, Sequence[Tried]]) -> Asked:
    """The next points of all back ends."""
    asked: Asked = []
    for entrant in entrants:
        known = tried[entrant.label]
        search = Search(entrant.space, tuning.points, tuning.seed)
        found = search.next([one.candidate for one in known], best(known).candidate if known else None)
        asked += [(entrant, candidate) for candidate in found]
    return asked


def _judged(tuning: Tuning, compute: Compute, asked: Asked, runs: Sequence[Run]) -> list[tuple[Entrant, Tried]]:
    """Points with their results; jobs on one sequence stand next to each other: it is simulated once for them."""
    tasks = [tuning.task(entrant, candidate, run) for entrant, candidate in asked for run in runs]
    results = compute(sorted(tasks, key=lambda task: json.dumps(task.arguments["sequence"], sort_keys=True)))
    names = iter(task.name for task in tasks)
    return [
        (entrant, judged(candidate, [results[next(names)] for _ in runs], tuning.objective))
        for entrant, candidate in asked
    ]


def _confirmed(
    tuning: Tuning, compute: Compute, entrants: Sequence[Entrant], tried: Mapping[str, Sequence[Tried]]
) -> tuple[Searched, ...]:
    hopeful = [entrant for entrant in entrants if best(tried[entrant.label]) is not tried[entrant.label][0]]
    asked: Asked = []
    for entrant in hopeful:
        known = tried[entrant.label]
        asked += [(entrant, known[0].candidate), (entrant, best(known).candidate)]
    found: dict[str, list[Tried]] = {}
    for entrant, one in _judged(tuning, compute, asked, tuning.confirm_runs) if asked else []:
        found.setdefault(entrant.label, []).append(one)
    return tuple(_decided(tuning, each, tried[each.label], found.get(each.label, [])) for each in entrants)


def _decided(tuning: Tuning, entrant: Entrant, tried: Sequence[Tried], pair: Sequence[Tried]) -> Searched:
    if not pair:
        why = "it has nothing to search" if len(tried) == 1 else "no point was better in the search"
        return Searched(entrant, tuple(tried), None, None, False, f"default kept: {why}")
    default, candidate = pair
    found = ratio(candidate, default, tuning.seed)
    taken = better(candidate, default, found)
    why = "better on fresh seeds by more than noise" if taken else f"default kept: {_not_better(candidate, default)}"
    return Searched(entrant, tuple(tried), (default, candidate), found, taken, why)


def _not_better(candidate: Tried, default: Tried) -> str:
    if candidate.losses > default.losses:
        return "the best of the search loses more runs on fresh seeds"
    return "what the best of the search gains is not more than noise on fresh seeds"
