"""Compare two results folders: which runs, tracks and metrics changed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

from evalkit.commands.diff.changes import ChangeVerdict
from evalkit.commands.diff.compared_runs import ComparedRuns, RunSeed, pair_runs
from evalkit.commands.diff.metric_changes import (
    TICK_MS,
    DiffLimits,
    MetricChange,
    MissingMetric,
    compare_metrics,
    find_missing_metrics,
)
from evalkit.commands.diff.run_changes import StatusChange, TrackChange, compare_statuses, compare_tracks
from evalkit.core.errors import StoreError
from evalkit.core.run_status import NOT_EXECUTED
from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.results.reader import StoredResults, StoredRun

MIN_FOR_SESSION = 3
MIN_NAMED_SESSION = 0.03


@dataclass(frozen=True, slots=True)
class ResultsDiff:
    """All changes. ``only_old``, ``only_new``: "method over sequence", or seeds of it, that one folder alone has.

    ``missing``: how many runs that completed in the old folder have no comparable run in the new one.
    ``missing_metrics``: metrics with a value in the old folder and none in the new one, of runs that both have.
    ``not_comparable``: pairs with the reason. ``notes``: conditions that limit the comparison.
    """

    old: str
    new: str
    limits: DiffLimits
    statuses: tuple[StatusChange, ...]
    tracks: tuple[TrackChange, ...]
    changes: tuple[MetricChange, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]
    missing: int
    missing_metrics: tuple[MissingMetric, ...]
    not_comparable: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def regressions(self) -> int:
        """The number of regressions among statuses, losses of the track and metrics."""
        return self.count("regression")

    def count(self, verdict: ChangeVerdict) -> int:
        """Return how many statuses, losses of the track and metrics have a verdict."""
        return sum(one.verdict == verdict for group in (self.statuses, self.tracks, self.changes) for one in group)


def compare_results(
    old: StoredResults, new: StoredResults, metrics: Sequence[Metric], limits: DiffLimits
) -> ResultsDiff:
    """Compare the runs that both folders have.

    Raises StoreError if the folders have no comparable runs.
    """
    pairs, reasons = pair_runs(old, new), {}
    for one in pairs:
        defaults = {**old.defaults.get(one.sequence, {}), **new.defaults.get(one.sequence, {})}
        if one.old and one.new and (reason := _reason_not_comparable(one, defaults)):
            reasons[one] = reason
    others = [one for one in pairs if one not in reasons]
    comparable = [one for one in others if one.old and one.new]
    if not comparable:
        why = "; ".join(dict.fromkeys(reasons.values())) or "no method ran over the same sequence in both"
        raise StoreError(new.folder, f"not comparable with {old.folder}: {why}", "compare results of one experiment")
    other_processor = old.processor and new.processor and old.processor != new.processor
    session = None if other_processor else _session_factor(comparable)
    return ResultsDiff(
        old.folder,
        new.folder,
        limits,
        tuple(change for one in comparable for change in compare_statuses(one)),
        tuple(change for one in comparable if (change := compare_tracks(one)) is not None),
        tuple(change for one in comparable for change in compare_metrics(one, metrics, limits, session)),
        tuple(text for one in others if (text := _describe_unpaired(one, one.old, one.new))),
        tuple(text for one in others if (text := _describe_unpaired(one, one.new, one.old))),
        sum(_count_missing(one, one in reasons) for one in pairs),
        tuple(lost for one in comparable for lost in find_missing_metrics(one, metrics)),
        tuple(_group_reasons(reasons)),
        tuple(_notes(old, new, session)),
    )


def _describe_unpaired(runs: ComparedRuns, own: Mapping[RunSeed, StoredRun], other: Mapping[RunSeed, StoredRun]) -> str:
    """Return "method over sequence" if only one folder has runs of it, with the seeds if the other has some of them."""
    alone = [seed for seed in own if seed not in other]
    seeds = f" ({', '.join(map(runs.name_run, alone))})" if other else ""
    return f"{runs.method} over {runs.sequence}{seeds}" if alone else ""


def _count_missing(runs: ComparedRuns, not_comparable: bool) -> int:
    """Return how many runs that completed before have no comparable run after."""
    return sum(run.status == "complete" and (not_comparable or seed not in runs.new) for seed, run in runs.old.items())


def _session_factor(comparable: Sequence[ComparedRuns]) -> float:
    """Return the factor by which the CPU times of all methods changed together: a property of the machine.

    The median over the methods; 1 for fewer than three methods, which cannot separate the two.
    """
    ratios: dict[str, list[float]] = {}
    for one in comparable:
        for pair in one.common.values():
            before, after = (run.scores.get(COST, 0.0) for run in pair)
            if min(before, after) > TICK_MS:
                ratios.setdefault(one.method, []).append(after / before)
    return median(median(own) for own in ratios.values()) if len(ratios) >= MIN_FOR_SESSION else 1.0


def _group_reasons(reasons: Mapping[ComparedRuns, str]) -> Iterator[str]:
    """Return one sentence for the methods that share a sequence and a reason."""
    together: dict[tuple[str, str], list[str]] = {}
    for one, why in reasons.items():
        together.setdefault((one.sequence, why), []).append(one.method)
    for (sequence, why), methods in together.items():
        yield f"{sequence}: not comparable: {why} ({', '.join(methods)})"


def _reason_not_comparable(runs: ComparedRuns, defaults: Mapping[str, Any]) -> str:
    """Return why the runs of both folders are not of the same sequence, "" if they are.

    ``defaults``: a parameter that one version did not have yet counts as at its present default.
    """
    if not runs.common:
        what = "perturbations" if runs.perturbed else "seeds"
        return f"{what} {_list_seeds(runs.old)} against {_list_seeds(runs.new)}"
    one, other = (run.parameters for run in next(iter(runs.common.values())))
    differing = []
    for name in {**one, **other}:
        values = [own[name] if name in own else defaults.get(name, beside[name])
                  for own, beside in ((one, other), (other, one))]  # fmt: skip
        if values[0] != values[1]:
            differing.append(f"{name} {values[0]} against {values[1]}")
    return f"the sequence differs: {', '.join(differing)}" if differing else ""


def _notes(old: StoredResults, new: StoredResults, session: float | None) -> Iterator[str]:
    if session is None:
        yield f"times are not compared: {old.processor} against {new.processor}"
    elif abs(session - 1.0) > MIN_NAMED_SESSION:
        yield (
            f"the CPU time of all methods together changed by {100.0 * (session - 1.0):+.0f} %: this is attributed to "
            "the machine, so a change common to all methods is not detected"
        ).replace("-", "\u2212")
    for one in (old, new):
        if one.unfinished:
            yield f"{one.folder}: {one.unfinished} runs did not finish; they are left out"
        missing = sum(run.status in NOT_EXECUTED for run in one.runs.values())
        if missing:
            yield f"{one.folder}: {missing} {'run was' if missing == 1 else 'runs were'} not possible there"


def _list_seeds(runs: Mapping[RunSeed, StoredRun]) -> str:
    return ", ".join("none" if seed is None else str(seed) for seed in runs)
