"""Metrics before and after: which changed by more than the noise and a stated limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from evalkit.commands.diff.changes import SAME, ChangeVerdict
from evalkit.commands.diff.compared_runs import ComparedRuns, RunPairs, RunSeed
from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.report.analysis.pairwise import (
    MARGIN_POINTS,
    PairedDifference,
    compute_difference,
    count_relations,
    is_share_in_map,
    noise_floor,
)
from evalkit.report.analysis.scores import DECIDING, MethodScore
from evalkit.results.reader import StoredRun
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score
from evalkit.stats.runs import FEW_RUNS

ATE = "ate_rmse_m"
TICK_MS = 0.01

MAX_LOAD_CHANGE = 1.0
"""A larger difference of the load averages means that other work shared caches and memory with one side."""

MAX_MHZ_RATIO = 1.1
"""Frequencies further apart make times differ by themselves."""

ONE_RUN = 2.0
"""Factor on a limit for a single run, whose noise is unknown: of a time that of its session, of an error its own."""


@dataclass(frozen=True, slots=True)
class DiffLimits:
    """Increases (as a share) of an error and of a CPU time that are not a regression."""

    error: float = 0.05
    time: float = 0.10


@dataclass(frozen=True, slots=True)
class MetricChange:
    """One metric of one method over one sequence, before and after: medians over the runs that both folders have.

    ``low``, ``high``: bounds of the interval of the difference new - old at ``confidence``, None without an interval.
    """

    method: str
    sequence: str
    metric: str
    unit: str
    old: float
    new: float
    low: float | None
    high: float | None
    confidence: float | None
    runs: int
    verdict: ChangeVerdict
    reason: str


@dataclass(frozen=True, slots=True)
class MissingMetric:
    """A metric that has a value before and none after, in runs of one method over one sequence that completed in both.

    ``runs``: names of these runs.
    """

    method: str
    sequence: str
    metric: str
    runs: tuple[str, ...]


def find_missing_metrics(runs: ComparedRuns, metrics: Sequence[Metric]) -> Iterator[MissingMetric]:
    """Yield every metric with a value before and none after, of those that are compared and those without a card here.

    The second are metrics that an earlier version had, or that had another name.
    """
    known = {metric.name: metric for metric in metrics}
    without: dict[str, list[str]] = {}
    for seed, (before, after) in runs.complete.items():
        for name in before.scores:
            if name not in after.scores and (name not in known or _is_compared(known[name])):
                without.setdefault(name, []).append(runs.name_run(seed))
    for name, where in without.items():
        yield MissingMetric(runs.method, runs.sequence, name, tuple(where))


def compare_metrics(
    runs: ComparedRuns, metrics: Sequence[Metric], limits: DiffLimits, session: float | None
) -> Iterator[MetricChange]:
    """Compare every headline metric of the estimate's quality, and the CPU time.

    ``session``: the factor on all CPU times, None if the processors differ.
    """
    complete = runs.complete
    for metric in metrics:
        if _is_compared(metric):
            pairs = {seed: pair for seed, pair in complete.items() if all(metric.name in run.scores for run in pair)}
            if pairs:
                yield _compare_metric(runs, metric, pairs, limits, session)


def _is_compared(metric: Metric) -> bool:
    return metric.headline and bool(metric.better) and (metric.group in DECIDING or metric.name == COST)


def _compare_metric(
    runs: ComparedRuns, metric: Metric, pairs: RunPairs, limits: DiffLimits, session: float | None
) -> MetricChange:
    seeds, olds, news = tuple(pairs), [one for one, _ in pairs.values()], [other for _, other in pairs.values()]
    before = _score(runs.method, metric.name, seeds, olds, news)
    after = _score(runs.method, metric.name, seeds, news, olds)
    if metric.name == COST:  # intervals within one session say nothing about another session
        difference = None
        verdict, reason = _judge_time(before, after, limits, session)
        if verdict in ("regression", "improvement") and (why := _find_machine_change(olds, news)):
            verdict, reason = "not comparable", why
    else:
        difference = compute_difference(after, before)
        verdict, reason = _judge_error(metric, before, after, difference, limits)
    interval = difference.interval if difference else None
    low, high, confidence = (interval.low, interval.high, interval.confidence) if interval else (None, None, None)
    return MetricChange(
        runs.method, runs.sequence, metric.name, metric.unit, median(before.values), median(after.values),
        low, high, confidence, len(pairs), verdict, reason,
    )  # fmt: skip


def _judge_error(
    metric: Metric, old: MethodScore, new: MethodScore, difference: PairedDifference | None, limits: DiffLimits
) -> tuple[ChangeVerdict, str]:
    if old.values == new.values:
        return "unchanged", SAME
    before, after = median(old.values), median(new.values)
    limit = limits.error * (ONE_RUN if len(old.values) == 1 else 1.0)
    if within := _find_limit(metric, before, after, limit, count_relations(old, new)):
        return "within the limit", within
    if new.perturbed and 1 < len(new.values) < FEW_RUNS:
        return "no difference shown", f"{len(new.values)} perturbed runs, {FEW_RUNS} give a verdict"
    if difference is not None and not difference.interval.excludes(0.0):
        percent = 100 * difference.interval.confidence
        return "no difference shown", f"the {percent:.0f} % interval of the difference contains zero"
    if difference is not None and difference.interval.value * (after - before) <= 0.0:
        return "no difference shown", "the medians and the runs in pairs differ in opposite directions"
    worse = metric.sign * (after - before) > 0.0
    noise = "beyond the noise" if difference is not None else "of one run, whose noise is not known"
    return ("regression" if worse else "improvement"), f"more than {100 * limit:g} %, {noise}"


def _find_limit(metric: Metric, before: float, after: float, limit: float, relations: int) -> str:
    """Return which limit the change of a value does not exceed, "" if it exceeds all. ``limit``: share of the value."""
    change = abs(after - before)
    if change <= limit * abs(before):
        return f"at most {100 * limit:g} %"
    if is_share_in_map(metric) and change <= MARGIN_POINTS:
        return f"at most {MARGIN_POINTS:g} percentage point"
    return "at most what errors of the ground truth make" if change <= noise_floor(metric, relations) else ""


def _judge_time(
    old: MethodScore, new: MethodScore, limits: DiffLimits, session: float | None
) -> tuple[ChangeVerdict, str]:
    """Compare CPU times after division by the session's factor; a change must hold in every run."""
    if session is None:
        return "not comparable", "another processor"
    if old.values == new.values:
        return "unchanged", SAME
    expected = [session * value for value in old.values]
    before, after = median(expected), median(new.values)
    limit = limits.time * (ONE_RUN if len(old.values) == 1 else 1.0)
    if abs(after - before) <= max(limit * before, TICK_MS):
        return "within the limit", f"at most {100 * limit:g} % relative to all other methods"
    if min(new.values) < before < max(new.values) or min(expected) < after < max(expected):
        return "no difference shown", "the runs before and after overlap"
    verdict: ChangeVerdict = "regression" if after > before else "improvement"
    return verdict, f"more than {100 * limit:g} % relative to all other methods"


def _find_machine_change(old: Sequence[StoredRun], new: Sequence[StoredRun]) -> str:
    """Return why another CPU time is the machine's and not the code's, "" if nothing says so."""
    if all(one.key and one.key == other.key for one, other in zip(old, new, strict=True)):
        return "machine was busy or slower: code, data and parameters are identical"
    if any(run.conditions.disturbed for run in (*old, *new)):
        return "machine was busy: other processes took CPU time from the run"
    loads = _median_condition(old, "load"), _median_condition(new, "load")
    if abs(loads[1] - loads[0]) > MAX_LOAD_CHANGE:
        return f"machine was busy: load {loads[0]:.1f} against {loads[1]:.1f}"
    mhz = _median_condition(old, "mhz"), _median_condition(new, "mhz")
    if max(mhz) > MAX_MHZ_RATIO * min(mhz):
        return f"machine ran at another frequency: {mhz[0]:.0f} against {mhz[1]:.0f} MHz"
    return ""


def _median_condition(runs: Sequence[StoredRun], name: str) -> float:
    """Return the median of a condition over runs; nan if it is not known for any."""
    known = [value for run in runs if (value := getattr(run.conditions, name)) is not None]
    return median(known) if known else math.nan


def _score(
    method: str, metric: str, seeds: tuple[RunSeed, ...], own: Sequence[StoredRun], others: Sequence[StoredRun]
) -> MethodScore:
    """Return a method's score on one side; ``others``: the same runs on the other side.

    Draws are taken over the scans that both sides have, so that a difference of draws is paired.
    """
    draws = tuple(_draws(metric, *pair) for pair in zip(own, others, strict=True))
    values = tuple(run.scores[metric] for run in own)
    perturbed = any(run.perturbed for run in (*own, *others))
    support = int(median(run.supports.get(metric, 0) for run in own))
    return MethodScore(method, values, (), len(own), len(own), support, "", seeds, draws=draws, perturbed=perturbed)


def _draws(metric: str, own: StoredRun, other: StoredRun) -> BootstrapDraws | None:
    if metric != ATE or len(own.errors_m) < 2 or len(other.errors_m) < 2:
        return None
    shared = np.isin(own.stamps_ns, other.stamps_ns)
    period_s = float(np.median(np.diff(own.stamps_ns))) * 1e-9
    series = Series(own.stamps_ns[shared], own.errors_m[shared], "rms", period_s)
    return bootstrap_score(series, own.scores[metric], np.random.default_rng(0))
