"""The tables of a report's page as texts and flags, which the templates arrange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.core.run_result import NOT_EXECUTED, RunStatus
from evalkit.metrics.table import Metric
from evalkit.plugins.specs import Published
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import STATUS_LABELS, MethodScore, unfinished
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.results.run_record import RunRecord
from evalkit.stats.intervals import wilson_interval


@dataclass(frozen=True, slots=True)
class TableNumber:
    """A number in a table. ``sort``: None sorts last. ``tip``: its support, or why it is missing.

    ``best``: the best of the methods that completed every run; ``tied``: without a clear difference from it.
    ``partial``: values of runs that ended early, shown apart because they are not comparable.
    """

    text: str
    extent: str = ""
    sort: float | None = None
    tip: str = ""
    best: bool = False
    tied: bool = False
    partial: str = ""


@dataclass(frozen=True, slots=True)
class FailedRuns:
    """Runs of one method that ended the same way."""

    method: str
    seeds: str
    status: str
    progress: str
    reason: str


@dataclass(frozen=True, slots=True)
class HeadlineRow:
    """One method over one sequence. ``success``: the interval of the share of runs that finish."""

    method: str
    complete: int
    expected: int
    success: str
    numbers: tuple[TableNumber, ...]
    failures: tuple[FailedRuns, ...]
    behind_baseline: bool


@dataclass(frozen=True, slots=True)
class HeadlineTable:
    """A headline table; ``absent``: headline metrics without a value, by the reason."""

    metrics: tuple[Metric, ...]
    rows: tuple[HeadlineRow, ...]
    absent: dict[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class GlanceTable:
    """The whole comparison in one table; a sequence without any value has no ranking."""

    columns: tuple[tuple[str, Ranking | None], ...]
    rows: tuple[tuple[str, tuple[TableNumber, ...]], ...]


@dataclass(frozen=True, slots=True)
class MetricRow:
    """One metric over all methods of a sequence."""

    metric: Metric
    numbers: tuple[TableNumber, ...]


@dataclass(frozen=True, slots=True)
class PublishedRow:
    """A published result or one of this report; ``source``: "" for this report."""

    label: str
    value: str
    spread: str
    sort: float
    source: str


def build_headline(sequence: SequenceAnalysis) -> HeadlineTable:
    """Return the first table of a sequence: methods in rows; deciding metric, cost and headline metrics in columns.

    With a true map, map consistency appears only in the table of all metrics.
    """
    rankings = [sequence.rankings[metric.name] for metric in _headline_metrics(sequence)]
    present = [one for one in rankings if one.has_values]
    rows = [_row(sequence, label, own, present) for label, own in sequence.runs.items()]
    return HeadlineTable(tuple(one.metric for one in present), tuple(rows), _absent(rankings))


def format_success(records: Sequence[RunRecord]) -> str:
    """Return the 95 % interval of the share of runs that finish, of those that could start; "" without any."""
    started = [record for record in records if record.result.status not in NOT_EXECUTED]
    if not started:
        return ""
    interval = wilson_interval(len(started) - len(unfinished(started)), len(started))
    return f"95 %: {100.0 * interval.low:.0f}–{100.0 * interval.high:.0f} %"


def find_absent(sequence: SequenceAnalysis) -> dict[str, tuple[str, ...]]:
    """Return all metrics of a sequence without a value, by the reason."""
    return _absent(list(sequence.rankings.values()))


def build_glance(analysis: Analysis) -> GlanceTable:
    """Return every method over every sequence in its deciding metric."""
    columns = tuple((sequence.label, sequence.deciding) for sequence in analysis.sequences)
    rows = tuple(
        (method, tuple(_glance_number(sequence, method) for sequence in analysis.sequences))
        for method in analysis.comparison.method_labels
    )
    return GlanceTable(columns, rows)


def build_all_metrics(sequence: SequenceAnalysis) -> dict[str, tuple[MetricRow, ...]]:
    """Return all metrics of a sequence with a value, by group."""
    degenerate = bool(sequence.card.degenerate)
    groups: dict[str, list[MetricRow]] = {}
    for ranking in sequence.rankings.values():
        metric = ranking.metric
        if ranking.has_values:
            numbers = tuple(format_score(ranking, score, degenerate) for score in ranking.scores)
            groups.setdefault(metric.group, []).append(MetricRow(metric, numbers))
    return {group: tuple(lines) for group, lines in groups.items()}


def format_score(ranking: Ranking, score: MethodScore, unranked: bool = False) -> TableNumber:
    """Return a score as printed: the median with its interval or range, or a dash with the reason as its tip.

    ``unranked``: the geometry is degenerate, or the map metrics disagree, so nothing is marked as best.
    """
    metric = ranking.metric
    partial = ", ".join(format_value(metric, value) for value in score.partial)
    if not score.values:
        return TableNumber("–", tip=score.reason, partial=partial)
    middle = median(score.values)
    extent, runs = _extent(metric, score), f"{len(score.values)} of {score.expected} runs"
    if len(score.values) < score.expected:
        extent = f"{runs} {extent}".rstrip()
    if len(score.values) > 1:
        runs += f" ({format_value(metric, min(score.values))} to {format_value(metric, max(score.values))})"
    support = f", support {score.support}" if score.support else ""
    contest = len(ranking.tied) < len(ranking.ranked) and not unranked
    return TableNumber(
        format_value(metric, middle),
        extent,
        middle,
        f"{metric.label}: median of {runs}{support}",
        best=contest and score is ranking.ranked[0],
        tied=contest and score in ranking.tied and len(ranking.tied) > 1,
        partial=partial,
    )


def _extent(metric: Metric, score: MethodScore) -> str:
    """Return the 95 % interval, or the lowest and highest of several runs, as printed below the number."""
    interval = score.interval
    if interval is not None:
        return f"95 %: {format_value(metric, interval.low)}–{format_value(metric, interval.high)}"
    return (
        f"{format_value(metric, min(score.values))}–{format_value(metric, max(score.values))}"
        if len(score.values) > 1
        else ""
    )


def format_value(metric: Metric, value: float) -> str:
    """Return a number with the metric's decimals and a true minus sign."""
    return f"{value:.{metric.digits}f}".replace("-", "\u2212")


def group_failures(records: Sequence[RunRecord]) -> tuple[FailedRuns, ...]:
    """Return the runs that did not complete; those of one method with one reason are one entry."""
    together: dict[tuple[str, RunStatus, str], list[RunRecord]] = {}
    for record in unfinished(records):
        together.setdefault((record.method, record.result.status, record.result.reason), []).append(record)
    return tuple(
        FailedRuns(method, _seeds(own), STATUS_LABELS[status], _progress(own), reason)
        for (method, status, reason), own in together.items()
    )


def build_published(sequence: SequenceAnalysis) -> tuple[Metric, tuple[PublishedRow, ...]] | None:
    """Return this report's methods among published results, best first, with the metric; None without publications."""
    rows = sequence.card.published
    metric = _counterpart(sequence.metrics, rows) if rows else None
    if metric is None:
        return None
    deviation = next((m for m in sequence.metrics if m.name == rows[0].spread_metric), None)
    references = [
        PublishedRow(
            row.label,
            format_value(metric, row.value),
            "" if row.spread is None else format_value(metric, row.spread),
            row.value,
            row.source,
        )
        for row in rows
    ]
    for score in sequence.rankings[metric.name].ranked:
        beside = sequence.rankings[deviation.name].of(score.method) if deviation else None
        spread = format_value(deviation, beside.median) if deviation and beside and beside.median is not None else ""
        references.append(
            PublishedRow(score.method, format_value(metric, median(score.values)), spread, median(score.values), "")
        )
    return metric, tuple(sorted(references, key=lambda row: row.sort))


def count_notes(records: Sequence[RunRecord]) -> dict[str, int]:
    """Return the defects counted while reading a sequence: the highest count over its runs."""
    counts: dict[str, int] = {}
    for record in records:
        for name, count in record.result.notes.items():
            counts[name] = max(counts.get(name, 0), int(count))
    return {name: count for name, count in counts.items() if count}


def _headline_metrics(sequence: SequenceAnalysis) -> list[Metric]:
    decision = sequence.deciding
    first = decision.metric.name if decision else ""
    mapped = any(record.truth.grid is not None for record in sequence.all_runs)
    shown = [m for m in sequence.metrics if m.headline and not (mapped and m.group == "map consistency")]
    return sorted(shown, key=lambda metric: (metric.name != first, metric.group != "runtime"))


def _row(
    sequence: SequenceAnalysis, label: str, records: Sequence[RunRecord], present: Sequence[Ranking]
) -> HeadlineRow:
    cells = [(ranking, score) for ranking in present if (score := ranking.of(label)) is not None]
    complete = len(records) - len(unfinished(records))
    behind, degenerate = sequence.is_behind(label), bool(sequence.card.degenerate)
    numbers = tuple(format_score(ranking, score, degenerate) for ranking, score in cells)
    return HeadlineRow(label, complete, len(records), format_success(records), numbers, group_failures(records), behind)


def _glance_number(sequence: SequenceAnalysis, method: str) -> TableNumber:
    ranking = sequence.deciding
    score = ranking.of(method) if ranking else None
    if ranking is None or score is None:
        return TableNumber("–", tip="no value for any headline metric" if ranking is None else "not run here")
    unranked = bool(sequence.card.degenerate) or sequence.map_agreement.disagrees
    return format_score(ranking, score, unranked)


def _absent(rankings: Sequence[Ranking]) -> dict[str, tuple[str, ...]]:
    """Return the metrics without a value, by the reason of the complete runs; none if no run completed."""
    reasons: dict[str, tuple[str, ...]] = {}
    for one in rankings:
        reason = next((score.reason for score in one.scores if score.complete), "")
        if reason and not one.has_values:
            reasons[reason] = (*reasons.get(reason, ()), one.metric.label)
    return reasons


def _counterpart(metrics: Sequence[Metric], rows: Sequence[Published]) -> Metric | None:
    named = rows[0].metric
    for metric in metrics:
        if metric.name == named or (not named and metric.group == "relations" and metric.unit == "m"):
            return metric
    return None


def _seeds(records: Sequence[RunRecord]) -> str:
    seeds = [str(record.seed) for record in records if record.seed is not None]
    if not seeds:
        return ""
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(seeds)}"


def _progress(records: Sequence[RunRecord]) -> str:
    counts = dict.fromkeys(
        f"{len(t.result.steps)} of {t.result.expected} scans" for t in records if len(t.result.steps)
    )
    return f"after {' / '.join(counts)}" if counts else ""
