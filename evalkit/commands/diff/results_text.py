"""The comparison of two results folders as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

from evalkit.commands.diff.changes import ORDER, ChangeText, ChangeVerdict, describe_missing, format_verdict
from evalkit.commands.diff.metric_changes import ONE_RUN, MetricChange
from evalkit.commands.diff.results_changes import ResultsDiff
from evalkit.commands.diff.run_changes import StatusChange, TrackChange
from evalkit.metrics.metric import Metric
from evalkit.report.formatting import format_number

COLUMNS = ("method", "sequence", "metric", "old", "new", "change", "interval", "verdict")
COUNTED: tuple[ChangeVerdict, ...] = ("unchanged", "within the limit")
"""These changes are counted, not listed."""


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
        f"{describe_missing(len(diff.missing_metrics), 'metric', diff.old, diff.new)}"
        f"{head} beyond {_describe_limits(diff)} and the noise; {diff.count('improvement')} improved, "
        f"{sum(map(verdicts.count, COUNTED))} of {len(verdicts)} numbers are unchanged or within the limit."
    )
    remarks = (
        *([f"only in {diff.old}: {', '.join(diff.only_old)}"] if diff.only_old else []),
        *([f"only in {diff.new}: {', '.join(diff.only_new)}"] if diff.only_new else []),
        *_describe_missing_metrics(diff, metrics),
        *diff.not_comparable,
        *diff.notes,
    )
    content: dict[str, Any] = {"regressions": count, **asdict(diff)}
    missing = diff.missing + len(diff.missing_metrics)
    return ChangeText(COLUMNS, tuple(rows), remarks, conclusion, count, missing, content)


def _describe_missing_metrics(diff: ResultsDiff, metrics: Mapping[str, Metric]) -> Iterator[str]:
    """Yield one line for each sequence and metric that has a value in the old folder alone, with the runs."""
    together: dict[tuple[str, str], list[str]] = {}
    for one in diff.missing_metrics:
        together.setdefault((one.sequence, one.metric), []).append(f"{one.method} ({', '.join(one.runs)})")
    for (sequence, name), methods in together.items():
        label = metrics[name].label if name in metrics else name
        yield f"{sequence}: {label} has a value in {diff.old} and none in {diff.new}: {', '.join(methods)}"


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


def _status_row(one: StatusChange) -> tuple[str, ...]:
    verdict = format_verdict(one.verdict, one.reason)
    run = one.run if one.seed is None else f"run {one.run}"
    return (one.method, one.sequence, run, one.old, one.new, "", "", verdict)


def _track_row(one: TrackChange) -> tuple[str, ...]:
    counts = [f"lost in {len(side)} of {one.runs}" if side else "held" for side in (one.old, one.new)]
    verdict = format_verdict(one.verdict, one.reason)
    return (one.method, one.sequence, "track", *counts, "", "", verdict)


def _metric_row(one: MetricChange, metric: Metric) -> tuple[str, ...]:
    unit = f" [{metric.unit}]" if metric.unit else ""
    old, new = (format_number(value, metric.digits + 1) for value in (one.old, one.new))
    share = f"{100.0 * (one.new - one.old) / abs(one.old):+.1f} %".replace("-", "−") if one.old else ""
    bounds = ""
    if one.low is not None and one.high is not None and one.confidence is not None:
        bounds = f"{format_number(one.low, metric.digits + 1)} to {format_number(one.high, metric.digits + 1)}"
        bounds = f"{100 * one.confidence:.0f} %: {bounds}"
    verdict = format_verdict(one.verdict, one.reason)
    return (one.method, one.sequence, f"{metric.label}{unit}", old, new, share, bounds, verdict)
