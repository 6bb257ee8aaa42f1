"""What the page shows, as texts and flags: the templates only arrange it."""

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
class Number:
    """A cell of a table. ``sort``: None sorts last. ``tip``: what it stands on, or why there is nothing.

    ``best``: the best of those who completed every run; ``level``: not separable from it. ``partial``: what runs that
    ended early had reached, shown apart because it is comparable with nothing.
    """

    text: str
    extent: str = ""
    sort: float | None = None
    tip: str = ""
    best: bool = False
    level: bool = False
    partial: str = ""


@dataclass(frozen=True, slots=True)
class Failure:
    """Runs of one method that ended the same way."""

    method: str
    seeds: str
    status: str
    progress: str
    reason: str


@dataclass(frozen=True, slots=True)
class Row:
    """One method over one sequence. ``success``: the interval of the share of runs that finish."""

    method: str
    complete: int
    expected: int
    success: str
    numbers: tuple[Number, ...]
    failures: tuple[Failure, ...]
    behind_bar: bool


@dataclass(frozen=True, slots=True)
class Table:
    """A headline table; ``absent``: reasons, with the headline metrics that mean nothing here for each."""

    metrics: tuple[Metric, ...]
    rows: tuple[Row, ...]
    absent: dict[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class Glance:
    """The whole comparison in one table; a sequence without any value has no standing."""

    columns: tuple[tuple[str, Ranking | None], ...]
    rows: tuple[tuple[str, tuple[Number, ...]], ...]


@dataclass(frozen=True, slots=True)
class Line:
    """One metric over all methods of a sequence."""

    metric: Metric
    numbers: tuple[Number, ...]


@dataclass(frozen=True, slots=True)
class Reference:
    """A row of a table that sets a metric beside what others have printed; ``source`` is empty for our own rows."""

    label: str
    value: str
    spread: str
    sort: float
    source: str


def headline(sequence: SequenceAnalysis) -> Table:
    """The first table of a sequence: methods down, headline metrics across, what decides and what it costs first.

    Where there is a true map, the maps' consistency is left to the table of all metrics.
    """
    found = [sequence.rankings[metric.name] for metric in _headline_metrics(sequence)]
    present = [one for one in found if one.has_values]
    rows = [_row(sequence, label, own, present) for label, own in sequence.runs.items()]
    return Table(tuple(one.metric for one in present), tuple(rows), _absent(found))


def share(trials: Sequence[RunRecord]) -> str:
    """The 95 % interval of the share of runs that finish, of those that could start; "" where none could."""
    started = [trial for trial in trials if trial.result.status not in NOT_EXECUTED]
    if not started:
        return ""
    found = wilson_interval(len(started) - len(unfinished(started)), len(started))
    return f"95 %: {100.0 * found.low:.0f}–{100.0 * found.high:.0f} %"


def absent(sequence: SequenceAnalysis) -> dict[str, tuple[str, ...]]:
    """All metrics of a sequence that nobody has a value for, by the reason."""
    return _absent(list(sequence.rankings.values()))


def glance(analysis: Analysis) -> Glance:
    """Every method over every sequence in the metric that decides it."""
    columns = tuple((sequence.label, sequence.deciding) for sequence in analysis.sequences)
    rows = tuple(
        (who, tuple(_glanced(sequence, who) for sequence in analysis.sequences))
        for who in analysis.comparison.method_labels
    )
    return Glance(columns, rows)


def everything(sequence: SequenceAnalysis) -> dict[str, tuple[Line, ...]]:
    """All metrics of a sequence by group; metrics that nobody has a value for are left out."""
    degenerate = bool(sequence.card.degenerate)
    groups: dict[str, list[Line]] = {}
    for found in sequence.rankings.values():
        metric = found.metric
        if found.has_values:
            numbers = tuple(number(found, cell, degenerate) for cell in found.scores)
            groups.setdefault(metric.group, []).append(Line(metric, numbers))
    return {group: tuple(lines) for group, lines in groups.items()}


def number(found: Ranking, cell: MethodScore, unranked: bool = False) -> Number:
    """A cell as printed: the median with its interval or the range of its runs, or a dash with the reason as its tip.

    ``unranked``: the geometry cannot fix the pose, or the map measures disagree, so nothing is marked as best.
    """
    metric = found.metric
    partial = ", ".join(printed(metric, value) for value in cell.partial)
    if not cell.values:
        return Number("–", tip=cell.reason, partial=partial)
    middle = median(cell.values)
    extent, runs = _extent(metric, cell), f"{len(cell.values)} of {cell.expected} runs"
    if len(cell.values) < cell.expected:
        extent = f"{runs} {extent}".rstrip()
    if len(cell.values) > 1:
        runs += f" ({printed(metric, min(cell.values))} to {printed(metric, max(cell.values))})"
    support = f", support {cell.support}" if cell.support else ""
    contest = len(found.tied) < len(found.ranked) and not unranked
    return Number(
        printed(metric, middle),
        extent,
        middle,
        f"{metric.label}: median of {runs}{support}",
        best=contest and cell is found.ranked[0],
        level=contest and cell in found.tied and len(found.tied) > 1,
        partial=partial,
    )


def _extent(metric: Metric, cell: MethodScore) -> str:
    """The 95 % interval, or the lowest and highest of several runs, as the page prints it beneath the number."""
    found = cell.interval
    if found is not None:
        return f"95 %: {printed(metric, found.low)}–{printed(metric, found.high)}"
    return f"{printed(metric, min(cell.values))}–{printed(metric, max(cell.values))}" if len(cell.values) > 1 else ""


def printed(metric: Metric, value: float) -> str:
    """A number with the metric's decimals and a true minus sign."""
    return f"{value:.{metric.digits}f}".replace("-", "\u2212")


def failures(trials: Sequence[RunRecord]) -> tuple[Failure, ...]:
    """The runs that did not complete, those of one method with one reason together."""
    together: dict[tuple[str, RunStatus, str], list[RunRecord]] = {}
    for trial in unfinished(trials):
        together.setdefault((trial.method, trial.result.status, trial.result.reason), []).append(trial)
    return tuple(
        Failure(who, _seeds(alike), STATUS_LABELS[status], _progress(alike), reason)
        for (who, status, reason), alike in together.items()
    )


def published(sequence: SequenceAnalysis) -> tuple[Metric, tuple[Reference, ...]] | None:
    """Our methods among published figures, best first, with the metric; None where nothing was published."""
    rows = sequence.card.published
    metric = _counterpart(sequence.metrics, rows) if rows else None
    if metric is None:
        return None
    deviation = next((m for m in sequence.metrics if m.name == rows[0].spread_metric), None)
    references = [
        Reference(
            row.label,
            printed(metric, row.value),
            "" if row.spread is None else printed(metric, row.spread),
            row.value,
            row.source,
        )
        for row in rows
    ]
    for cell in sequence.rankings[metric.name].ranked:
        beside = sequence.rankings[deviation.name].of(cell.method) if deviation else None
        spread = printed(deviation, beside.median) if deviation and beside and beside.median is not None else ""
        references.append(Reference(cell.method, printed(metric, median(cell.values)), spread, median(cell.values), ""))
    return metric, tuple(sorted(references, key=lambda row: row.sort))


def notes(trials: Sequence[RunRecord]) -> dict[str, int]:
    """Defects counted while reading a sequence: the highest count over its runs."""
    counts: dict[str, int] = {}
    for trial in trials:
        for name, count in trial.result.notes.items():
            counts[name] = max(counts.get(name, 0), int(count))
    return {name: count for name, count in counts.items() if count}


def _headline_metrics(sequence: SequenceAnalysis) -> list[Metric]:
    decision = sequence.deciding
    first = decision.metric.name if decision else ""
    mapped = any(trial.truth.grid is not None for trial in sequence.all_runs)
    shown = [m for m in sequence.metrics if m.headline and not (mapped and m.group == "map consistency")]
    return sorted(shown, key=lambda metric: (metric.name != first, metric.group != "runtime"))


def _row(sequence: SequenceAnalysis, label: str, trials: Sequence[RunRecord], present: Sequence[Ranking]) -> Row:
    cells = [(found, cell) for found in present if (cell := found.of(label)) is not None]
    complete = len(trials) - len(unfinished(trials))
    behind, degenerate = sequence.is_behind(label), bool(sequence.card.degenerate)
    numbers = tuple(number(found, cell, degenerate) for found, cell in cells)
    return Row(label, complete, len(trials), share(trials), numbers, failures(trials), behind)


def _glanced(sequence: SequenceAnalysis, method: str) -> Number:
    found = sequence.deciding
    cell = found.of(method) if found else None
    if found is None or cell is None:
        return Number("–", tip="no value for any headline metric" if found is None else "not run here")
    unranked = bool(sequence.card.degenerate) or sequence.map_agreement.disagrees
    return number(found, cell, unranked)


def _absent(found: Sequence[Ranking]) -> dict[str, tuple[str, ...]]:
    """Metrics nobody has a value for, by the reason that complete runs give; none where nothing was completed."""
    reasons: dict[str, tuple[str, ...]] = {}
    for one in found:
        reason = next((cell.reason for cell in one.scores if cell.complete), "")
        if reason and not one.has_values:
            reasons[reason] = (*reasons.get(reason, ()), one.metric.label)
    return reasons


def _counterpart(metrics: Sequence[Metric], rows: Sequence[Published]) -> Metric | None:
    named = rows[0].metric
    for metric in metrics:
        if metric.name == named or (not named and metric.group == "relations" and metric.unit == "m"):
            return metric
    return None


def _seeds(trials: Sequence[RunRecord]) -> str:
    seeds = [str(trial.seed) for trial in trials if trial.seed is not None]
    if not seeds:
        return ""
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(seeds)}"


def _progress(trials: Sequence[RunRecord]) -> str:
    counts = dict.fromkeys(f"{len(t.result.steps)} of {t.result.expected} scans" for t in trials if len(t.result.steps))
    return f"after {' / '.join(counts)}" if counts else ""
