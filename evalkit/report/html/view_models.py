"""What the page shows, as texts and flags: the templates only arrange it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.core.run_result import NOT_EXECUTED, RunStatus
from evalkit.metrics.table import Metric
from evalkit.plugins.specs import Published
from evalkit.report.analysis.cells import Cell, interval
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import disagrees, is_behind_bar
from evalkit.report.analysis.standings import STATUS, Standing, deciding, standing, unfinished
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

    columns: tuple[tuple[str, Standing | None], ...]
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


def headline(comparison: Comparison, sequence: str) -> Table:
    """The first table of a sequence: methods down, headline metrics across, what decides and what it costs first.

    Where there is a true map, the maps' consistency is left to the table of all metrics.
    """
    found = [standing(comparison, sequence, metric) for metric in _headline_metrics(comparison, sequence)]
    present = [one for one in found if _told(one)]
    rows = [_row(comparison, label, own, present) for label, own in comparison.by_method(sequence).items()]
    return Table(tuple(one.metric for one in present), tuple(rows), _absent(found))


def share(records: Sequence[RunRecord]) -> str:
    """The 95 % interval of the share of runs that finish, of those that could start; "" where none could."""
    started = [record for record in records if record.result.status not in NOT_EXECUTED]
    if not started:
        return ""
    found = wilson_interval(len(started) - len(unfinished(started)), len(started))
    return f"95 %: {100.0 * found.low:.0f}–{100.0 * found.high:.0f} %"


def absent(comparison: Comparison, sequence: str) -> dict[str, tuple[str, ...]]:
    """All metrics of a sequence that nobody has a value for, by the reason."""
    return _absent([standing(comparison, sequence, metric) for metric in comparison.metrics])


def glance(comparison: Comparison) -> Glance:
    """Every method over every sequence in the metric that decides it."""
    columns = tuple((label, deciding(comparison, label)) for label in comparison.sequence_labels)
    rows = tuple(
        (who, tuple(_glanced(comparison, found, who) for _, found in columns)) for who in comparison.method_labels
    )
    return Glance(columns, rows)


def everything(comparison: Comparison, sequence: str) -> dict[str, tuple[Line, ...]]:
    """All metrics of a sequence by group; metrics that nobody has a value for are left out."""
    degenerate = bool(comparison.sequences[sequence].degenerate)
    groups: dict[str, list[Line]] = {}
    for metric in comparison.metrics:
        found = standing(comparison, sequence, metric)
        if _told(found):
            numbers = tuple(number(found, cell, degenerate) for cell in found.cells)
            groups.setdefault(metric.group, []).append(Line(metric, numbers))
    return {group: tuple(lines) for group, lines in groups.items()}


def number(found: Standing, cell: Cell, unranked: bool = False) -> Number:
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
    contest = len(found.level) < len(found.ranked) and not unranked
    return Number(
        printed(metric, middle),
        extent,
        middle,
        f"{metric.label}: median of {runs}{support}",
        best=contest and cell is found.ranked[0],
        level=contest and cell in found.level and len(found.level) > 1,
        partial=partial,
    )


def _extent(metric: Metric, cell: Cell) -> str:
    """The 95 % interval, or the lowest and highest of several runs, as the page prints it beneath the number."""
    found = interval(cell)
    if found is not None:
        return f"95 %: {printed(metric, found.low)}–{printed(metric, found.high)}"
    return f"{printed(metric, min(cell.values))}–{printed(metric, max(cell.values))}" if len(cell.values) > 1 else ""


def printed(metric: Metric, value: float) -> str:
    """A number with the metric's decimals and a true minus sign."""
    return f"{value:.{metric.digits}f}".replace("-", "\u2212")


def failures(records: Sequence[RunRecord]) -> tuple[Failure, ...]:
    """The runs that did not complete, those of one method with one reason together."""
    together: dict[tuple[str, RunStatus, str], list[RunRecord]] = {}
    for record in unfinished(records):
        together.setdefault((record.method, record.result.status, record.result.reason), []).append(record)
    return tuple(
        Failure(who, _seeds(alike), STATUS[status], _progress(alike), reason)
        for (who, status, reason), alike in together.items()
    )


def published(comparison: Comparison, sequence: str) -> tuple[Metric, tuple[Reference, ...]] | None:
    """Our methods among published figures, best first, with the metric; None where nothing was published."""
    rows = comparison.sequences[sequence].published
    metric = _counterpart(comparison, rows) if rows else None
    if metric is None:
        return None
    deviation = next((m for m in comparison.metrics if m.name == rows[0].spread_metric), None)
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
    for cell in standing(comparison, sequence, metric).ranked:
        beside = standing(comparison, sequence, deviation).of(cell.method) if deviation else None
        spread = printed(deviation, beside.median) if deviation and beside and beside.median is not None else ""
        references.append(Reference(cell.method, printed(metric, median(cell.values)), spread, median(cell.values), ""))
    return metric, tuple(sorted(references, key=lambda row: row.sort))


def notes(records: Sequence[RunRecord]) -> dict[str, int]:
    """Defects counted while reading a sequence: the highest count over its runs."""
    counts: dict[str, int] = {}
    for record in records:
        for name, count in record.result.notes.items():
            counts[name] = max(counts.get(name, 0), int(count))
    return {name: count for name, count in counts.items() if count}


def _headline_metrics(comparison: Comparison, sequence: str) -> list[Metric]:
    decision = deciding(comparison, sequence)
    first = decision.metric.name if decision else ""
    mapped = any(record.truth.grid is not None for record in comparison.of_sequence(sequence))
    shown = [m for m in comparison.metrics if m.headline and not (mapped and m.group == "map consistency")]
    return sorted(shown, key=lambda metric: (metric.name != first, metric.group != "runtime"))


def _row(comparison: Comparison, label: str, records: Sequence[RunRecord], present: Sequence[Standing]) -> Row:
    cells = [(found, cell) for found in present if (cell := found.of(label)) is not None]
    complete = len(records) - len(unfinished(records))
    decision = deciding(comparison, records[0].sequence)
    behind = decision is not None and is_behind_bar(comparison, decision, label)
    degenerate = bool(comparison.sequences[records[0].sequence].degenerate)
    numbers = tuple(number(found, cell, degenerate) for found, cell in cells)
    return Row(label, complete, len(records), share(records), numbers, failures(records), behind)


def _glanced(comparison: Comparison, found: Standing | None, method: str) -> Number:
    cell = found.of(method) if found else None
    if found is None or cell is None:
        return Number("–", tip="no value for any headline metric" if found is None else "not run here")
    unranked = bool(comparison.sequences[found.sequence].degenerate) or disagrees(comparison, found)
    return number(found, cell, unranked)


def _told(found: Standing) -> bool:
    return any(cell.values or cell.partial for cell in found.cells)


def _absent(found: Sequence[Standing]) -> dict[str, tuple[str, ...]]:
    """Metrics nobody has a value for, by the reason that complete runs give; none where nothing was completed."""
    reasons: dict[str, tuple[str, ...]] = {}
    for one in found:
        reason = next((cell.reason for cell in one.cells if cell.complete), "")
        if reason and not _told(one):
            reasons[reason] = (*reasons.get(reason, ()), one.metric.label)
    return reasons


def _counterpart(comparison: Comparison, rows: Sequence[Published]) -> Metric | None:
    named = rows[0].metric
    for metric in comparison.metrics:
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
