"""Compare two results folders: which runs and metrics changed by more than the noise and a stated limit."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

import numpy as np

from evalkit.commands.diff.changes import MARKS, SAME, ChangeText, ChangeVerdict, describe_missing
from evalkit.core.errors import StoreError
from evalkit.core.run_result import LostTrack
from evalkit.core.run_status import NOT_EXECUTED
from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.report.analysis.pairwise import (
    MARGIN_POINTS,
    PairedDifference,
    compute_difference,
    is_share_in_map,
    noise_floor,
)
from evalkit.report.analysis.scores import DECIDING, MethodScore
from evalkit.report.formatting import format_loss_times, format_number
from evalkit.results.reader import RunName, StoredResults, StoredRun
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score
from evalkit.stats.runs import FEW_RUNS

ATE = "ate_rmse_m"
TICK_MS = 0.01

MIN_FOR_SESSION = 3
MIN_NAMED_SESSION = 0.03

MAX_LOAD_CHANGE = 1.0
"""A larger difference of the load averages means that other work shared caches and memory with one side."""

MAX_MHZ_RATIO = 1.1
"""Frequencies further apart make times differ by themselves."""

ONE_RUN = 2.0
"""Factor on a limit for a single run, whose noise is unknown: of a time that of its session, of an error its own."""

MAX_CHANCE = 0.05
"""Track losses of a method before and after: runs that all change in one direction with a smaller probability."""

COLUMNS = ("method", "sequence", "metric", "old", "new", "change", "interval", "verdict")
COUNTED: tuple[ChangeVerdict, ...] = ("unchanged", "within the limit")
"""These changes are counted, not listed."""
ORDER: tuple[ChangeVerdict, ...] = (
    "regression", "improvement", "no difference shown", "not comparable", *COUNTED,
)  # fmt: skip


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
class StatusChange:
    """A run whose status changed."""

    method: str
    sequence: str
    seed: int | None
    old: str
    new: str
    reason: str
    verdict: ChangeVerdict


@dataclass(frozen=True, slots=True)
class LostRun:
    """A run that lost the track."""

    seed: int | None
    lost: LostTrack


@dataclass(frozen=True, slots=True)
class TrackChange:
    """The runs of one method over one sequence that lost the track before and after.

    ``runs``: how many completed on both sides. Only for a method that lost the track in any of them.
    """

    method: str
    sequence: str
    old: tuple[LostRun, ...]
    new: tuple[LostRun, ...]
    runs: int
    verdict: ChangeVerdict
    reason: str


@dataclass(frozen=True, slots=True)
class ResultsDiff:
    """All changes. ``only_old``, ``only_new``: "method over sequence", or seeds of it, that one folder alone has.

    ``missing``: how many runs that completed in the old folder have no comparable run in the new one.
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
    pairs = {(method, sequence): None for method, sequence, _ in (*old.runs, *new.runs)}
    before, after = ({(method, sequence) for method, sequence, _ in one.runs} for one in (old, new))
    common = [pair for pair in pairs if pair in before and pair in after]
    reasons = {pair: reason for pair in common if (reason := _reason_not_comparable(old, new, pair))}
    comparable = [pair for pair in common if pair not in reasons]
    if not comparable:
        why = "; ".join(dict.fromkeys(reasons.values())) or "no method ran over the same sequence in both"
        raise StoreError(new.folder, f"not comparable with {old.folder}: {why}", "compare results of one experiment")
    session = _session_factor(old, new, comparable)
    return ResultsDiff(
        old.folder,
        new.folder,
        limits,
        tuple(one for pair in comparable for one in _status_changes(old, new, pair)),
        tuple(one for pair in comparable if (one := _track_change(old, new, pair)) is not None),
        tuple(one for pair in comparable for one in _metric_changes(old, new, pair, metrics, limits, session)),
        tuple(_list_unpaired(old, new, [pair for pair in pairs if pair not in reasons])),
        tuple(_list_unpaired(new, old, [pair for pair in pairs if pair not in reasons])),
        sum(
            run.status == "complete" and (name not in new.runs or name[:2] in reasons) for name, run in old.runs.items()
        ),
        tuple(_group_reasons(reasons)),
        tuple(_notes(old, new, session)),
    )


def describe_results_diff(diff: ResultsDiff, metrics: Mapping[str, Metric], everything: bool = False) -> ChangeText:
    """Return the comparison as text, worst first: changed statuses, lost tracks, then metrics.

    ``everything``: list also what did not change.
    """
    shown = [one for one in diff.changes if everything or one.verdict not in COUNTED]
    tracks = [one for one in diff.tracks if everything or one.verdict not in COUNTED]
    rows = [_status_row(one) for one in sorted(diff.statuses, key=lambda one: ORDER.index(one.verdict))]
    rows += [_track_row(one) for one in sorted(tracks, key=lambda one: ORDER.index(one.verdict))]
    rows += [_metric_row(one, metrics[one.metric]) for one in sorted(shown, key=lambda one: ORDER.index(one.verdict))]
    verdicts = [one.verdict for one in diff.changes]
    count = diff.regressions
    head = "No regression" if count == 0 else f"{count} regression{'s' if count > 1 else ''}"
    conclusion = (
        f"{describe_missing(diff.missing, 'run', diff.old, diff.new)}"
        f"{head} beyond {_describe_limits(diff)} and the noise; {diff.count('improvement')} improved, "
        f"{sum(map(verdicts.count, COUNTED))} of {len(verdicts)} numbers are unchanged or within the limit."
    )
    remarks = (
        *([f"only in {diff.old}: {', '.join(diff.only_old)}"] if diff.only_old else []),
        *([f"only in {diff.new}: {', '.join(diff.only_new)}"] if diff.only_new else []),
        *diff.not_comparable,
        *diff.notes,
    )
    content: dict[str, Any] = {"regressions": count, **asdict(diff)}
    return ChangeText(COLUMNS, tuple(rows), remarks, conclusion, count, diff.missing, content)


def _describe_limits(diff: ResultsDiff) -> str:
    """Return the limits that were applied; those of a single run are larger."""
    single = {change.runs == 1 for change in diff.changes}
    factor, remark = 1.0, ""
    if single == {True}:
        factor, remark = ONE_RUN, " (doubled: single runs)"
    elif True in single:
        remark = " (doubled for single runs)"
    error, time = (100.0 * factor * limit for limit in (diff.limits.error, diff.limits.time))
    return f"{error:g} % of an error, {time:g} % of CPU time{remark}"


def _list_unpaired(own: StoredResults, other: StoredResults, pairs: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Return the methods over sequences that only one folder has, with the seeds if the other has some of them."""
    for pair in pairs:
        runs, others = _runs_of(own, pair), _runs_of(other, pair)
        alone = [name for name in runs if name not in others]
        if alone:
            seeds = f" ({', '.join(_name_seed(name[2]) for name in alone)})" if others else ""
            yield f"{pair[0]} over {pair[1]}{seeds}"


def _session_factor(old: StoredResults, new: StoredResults, comparable: Sequence[tuple[str, str]]) -> float:
    """Return the factor by which the CPU times of all methods changed together: a property of the machine.

    The median over the methods; 1 for fewer than three methods, which cannot separate the two.
    """
    ratios: dict[str, list[float]] = {}
    for pair in comparable:
        before, after = _runs_of(old, pair), _runs_of(new, pair)
        for name in before:
            times = [runs[name].scores.get(COST, 0.0) for runs in (before, after) if name in runs]
            if len(times) == 2 and min(times) > TICK_MS:
                ratios.setdefault(pair[0], []).append(times[1] / times[0])
    return median(median(own) for own in ratios.values()) if len(ratios) >= MIN_FOR_SESSION else 1.0


def _group_reasons(reasons: Mapping[tuple[str, str], str]) -> Iterator[str]:
    """Return one sentence for the methods that share a sequence and a reason."""
    together: dict[tuple[str, str], list[str]] = {}
    for (method, sequence), why in reasons.items():
        together.setdefault((sequence, why), []).append(method)
    for (sequence, why), methods in together.items():
        yield f"{sequence}: not comparable: {why} ({', '.join(methods)})"


def _reason_not_comparable(old: StoredResults, new: StoredResults, pair: tuple[str, str]) -> str:
    """Return why the runs of a pair are not of the same sequence, "" if they are."""
    before, after = _runs_of(old, pair), _runs_of(new, pair)
    seeds = [name[2] for name in before if name in after]
    if not seeds:
        return f"seeds {_list_seeds(before)} against {_list_seeds(after)}"
    one, other = before[(*pair, seeds[0])].parameters, after[(*pair, seeds[0])].parameters
    defaults = {**old.defaults.get(pair[1], {}), **new.defaults.get(pair[1], {})}
    differing = []
    for name in {**one, **other}:
        # a parameter that one version did not have yet counts as at its present default
        values = [own[name] if name in own else defaults.get(name, beside[name])
                  for own, beside in ((one, other), (other, one))]  # fmt: skip
        if values[0] != values[1]:
            differing.append(f"{name} {values[0]} against {values[1]}")
    return f"the sequence differs: {', '.join(differing)}" if differing else ""


def _status_changes(old: StoredResults, new: StoredResults, pair: tuple[str, str]) -> Iterator[StatusChange]:
    before, after = _runs_of(old, pair), _runs_of(new, pair)
    for name, run in after.items():
        if name in before and before[name].status != run.status:
            verdict: ChangeVerdict = "not comparable"
            if run.status == "complete":
                verdict = "improvement"
            elif before[name].status == "complete":
                verdict = "regression"
            yield StatusChange(*name, before[name].status, run.status, run.reason, verdict)


def _track_change(old: StoredResults, new: StoredResults, pair: tuple[str, str]) -> TrackChange | None:
    """Compare which runs lost the track, among those that completed on both sides; None if none did."""
    both = _complete_in_both(old, new, pair)
    before, after = (
        tuple(LostRun(name[2], lost) for name in both if (lost := one.runs[name].lost)) for one in (old, new)
    )
    if not before and not after:
        return None
    return TrackChange(*pair, before, after, len(both), *_judge_tracks(before, after))


def _judge_tracks(old: Sequence[LostRun], new: Sequence[LostRun]) -> tuple[ChangeVerdict, str]:
    """Any loss where all runs held the track is a regression; further losses must be more than chance (sign test)."""
    more = [one for one in new if one.seed not in [other.seed for other in old]]
    fewer = [one for one in old if one.seed not in [other.seed for other in new]]
    if not more and not fewer:
        return "unchanged", "lost in the same runs"
    said = "; ".join(
        f"{what}: {', '.join(f'{_name_seed(one.seed)} {format_loss_times(one.lost)}' for one in runs)}"
        for what, runs in (("newly lost", more), ("no longer lost", fewer)) if runs
    )  # fmt: skip
    changed = len(more) + len(fewer)
    chance = sum(math.comb(changed, count) for count in range(max(len(more), len(fewer)), changed + 1)) / 2**changed
    if old and new and chance > MAX_CHANCE:
        return "no difference shown", said
    return ("regression" if len(more) > len(fewer) else "improvement"), said


def _complete_in_both(old: StoredResults, new: StoredResults, pair: tuple[str, str]) -> list[RunName]:
    before, after = _runs_of(old, pair), _runs_of(new, pair)
    return [name for name in before if name in after and before[name].status == after[name].status == "complete"]


def _metric_changes(
    old: StoredResults,
    new: StoredResults,
    pair: tuple[str, str],
    metrics: Sequence[Metric],
    limits: DiffLimits,
    session: float,
) -> Iterator[MetricChange]:
    """Compare every headline metric of the estimate's quality, and the CPU time."""
    before, after = _runs_of(old, pair), _runs_of(new, pair)
    both = _complete_in_both(old, new, pair)
    for metric in metrics:
        if metric.headline and metric.better and (metric.group in DECIDING or metric.name == COST):
            runs = [
                (name, before[name], after[name])
                for name in both
                if metric.name in before[name].scores and metric.name in after[name].scores
            ]
            if runs:
                yield _metric_change(pair, metric, runs, limits, session if _same_processor(old, new) else None)


def _metric_change(
    pair: tuple[str, str],
    metric: Metric,
    runs: Sequence[tuple[RunName, StoredRun, StoredRun]],
    limits: DiffLimits,
    session: float | None,
) -> MetricChange:
    """Compare one metric. ``session``: the factor on all CPU times, None if the processors differ."""
    before = _score(pair[0], metric.name, [(name, one, other) for name, one, other in runs])
    after = _score(pair[0], metric.name, [(name, other, one) for name, one, other in runs])
    if metric.name == COST:  # intervals within one session say nothing about another session
        difference = None
        verdict, reason = _judge_time(before, after, limits, session)
        if verdict in ("regression", "improvement") and (why := _find_machine_change(runs)):
            verdict, reason = "not comparable", why
    else:
        difference = compute_difference(after, before)
        verdict, reason = _judge_error(metric, before, after, difference, limits)
    interval = difference.interval if difference else None
    low, high, confidence = (interval.low, interval.high, interval.confidence) if interval else (None, None, None)
    old, new = median(before.values), median(after.values)
    return MetricChange(
        *pair, metric.name, metric.unit, old, new, low, high, confidence, len(runs), verdict, reason
    )  # fmt: skip


def _judge_error(
    metric: Metric, old: MethodScore, new: MethodScore, difference: PairedDifference | None, limits: DiffLimits
) -> tuple[ChangeVerdict, str]:
    if old.values == new.values:
        return "unchanged", SAME
    before, after = median(old.values), median(new.values)
    limit = limits.error * (ONE_RUN if len(old.values) == 1 else 1.0)
    points = MARGIN_POINTS if is_share_in_map(metric) else 0.0
    if abs(after - before) <= max(limit * abs(before), noise_floor(metric), points):
        floor = f"{points:g} percentage point" if points else "the accuracy of the ground truth"
        return "within the limit", f"at most {100 * limit:g} %, or less than {floor}"
    if new.perturbed and 1 < len(new.values) < FEW_RUNS:
        return "no difference shown", f"{len(new.values)} perturbed runs, {FEW_RUNS} give a verdict"
    if difference is not None and not difference.interval.excludes(0.0):
        percent = 100 * difference.interval.confidence
        return "no difference shown", f"the {percent:.0f} % interval of the difference contains zero"
    worse = after > before if metric.better == "lower" else after < before
    noise = "beyond the noise" if difference is not None else "of one run, whose noise is not known"
    return ("regression" if worse else "improvement"), f"more than {100 * limit:g} %, {noise}"


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


def _find_machine_change(runs: Sequence[tuple[RunName, StoredRun, StoredRun]]) -> str:
    """Return why another CPU time is the machine's and not the code's, "" if nothing says so."""
    pairs = [(one, other) for _, one, other in runs]
    if all(one.key and one.key == other.key for one, other in pairs):
        return "machine was busy or slower: code, data and parameters are identical"
    if any(side.conditions.disturbed for pair in pairs for side in pair):
        return "machine was busy: other processes took CPU time from the run"
    old, new = [one for one, _ in pairs], [other for _, other in pairs]
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


def _score(method: str, metric: str, runs: Sequence[tuple[RunName, StoredRun, StoredRun]]) -> MethodScore:
    """Return a method's score on one side; each entry of ``runs``: name, the run, the same run on the other side.

    Draws are taken over the scans that both sides have, so that a difference of draws is paired.
    """
    draws = tuple(_draws(metric, own, other) for _, own, other in runs)
    values = tuple(own.scores[metric] for _, own, _ in runs)
    count, seeds = len(runs), tuple(name[2] for name, *_ in runs)
    perturbed = any(side.perturbed for _, *both in runs for side in both)
    return MethodScore(method, values, (), count, count, 0, "", seeds, draws=draws, perturbed=perturbed)


def _draws(metric: str, own: StoredRun, other: StoredRun) -> BootstrapDraws | None:
    if metric != ATE or len(own.errors_m) < 2 or len(other.errors_m) < 2:
        return None
    shared = np.isin(own.stamps_ns, other.stamps_ns)
    period_s = float(np.median(np.diff(own.stamps_ns))) * 1e-9
    series = Series(own.stamps_ns[shared], own.errors_m[shared], "rms", period_s)
    return bootstrap_score(series, own.scores[metric], np.random.default_rng(0))


def _same_processor(old: StoredResults, new: StoredResults) -> bool:
    return not old.processor or not new.processor or old.processor == new.processor


def _notes(old: StoredResults, new: StoredResults, session: float) -> Iterator[str]:
    if not _same_processor(old, new):
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


def _runs_of(results: StoredResults, pair: tuple[str, str]) -> dict[RunName, StoredRun]:
    return {name: run for name, run in results.runs.items() if name[:2] == pair}


def _list_seeds(runs: Mapping[RunName, StoredRun]) -> str:
    return ", ".join("none" if seed is None else str(seed) for *_, seed in runs)


def _name_seed(seed: int | None) -> str:
    return "run" if seed is None else f"seed {seed}"


def _status_row(one: StatusChange) -> tuple[str, ...]:
    seed = "" if one.seed is None else f" seed {one.seed}"
    verdict = f"{MARKS.get(one.verdict, '')}{one.verdict}{f': {one.reason}' if one.reason else ''}"
    return (one.method, one.sequence, f"run{seed}", one.old, one.new, "", "", verdict)


def _track_row(one: TrackChange) -> tuple[str, ...]:
    counts = [f"lost in {len(side)} of {one.runs}" if side else "held" for side in (one.old, one.new)]
    verdict = f"{MARKS.get(one.verdict, '')}{one.verdict}: {one.reason}"
    return (one.method, one.sequence, "track", *counts, "", "", verdict)


def _metric_row(one: MetricChange, metric: Metric) -> tuple[str, ...]:
    unit = f" [{metric.unit}]" if metric.unit else ""
    old, new = (format_number(value, metric.digits + 1) for value in (one.old, one.new))
    share = f"{100.0 * (one.new - one.old) / abs(one.old):+.1f} %".replace("-", "−") if one.old else ""
    bounds = ""
    if one.low is not None and one.high is not None and one.confidence is not None:
        bounds = f"{format_number(one.low, metric.digits + 1)} to {format_number(one.high, metric.digits + 1)}"
        bounds = f"{100 * one.confidence:.0f} %: {bounds}"
    verdict = f"{MARKS.get(one.verdict, '')}{one.verdict}: {one.reason}"
    return (one.method, one.sequence, f"{metric.label}{unit}", old, new, share, bounds, verdict)
