"""Who stands where: medians over the complete runs, and who leads by a difference that is shown and matters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.core.run_result import RunStatus
from evalkit.metrics.table import Group, Metric
from evalkit.report.analysis.bootstrap import RecordBootstrap
from evalkit.report.analysis.cells import Cell, apart
from evalkit.report.analysis.comparison import Comparison
from evalkit.results.run_record import RunRecord

# The published relations are only good to this much themselves, whatever two methods differ by.
RELATIONS_FLOOR = {"m": 0.03, "deg": 0.4, "°": 0.4}

# Nobody is better by less: a share of the better value, and metres where positions are compared.
MARGIN_SHARE = 0.05
MARGIN_M = 0.002

GUESSED = "guess_kept_percent"

# What decides a sequence: official relations where they exist, then a true trajectory, then maps.
DECIDING: tuple[Group, ...] = ("relations", "drift", "map against truth", "map consistency")
WITH_TRUTH: tuple[Group, ...] = DECIDING[:3]

# What the bar cannot compete in, because it registers nothing.
WITHOUT_BAR: tuple[Group, ...] = ("residuals", "runtime")

STATUS: dict[RunStatus, str] = {
    RunStatus.COMPLETE: "complete",
    RunStatus.FAILED: "failed",
    RunStatus.CRASHED: "crashed",
    RunStatus.TIMEOUT: "timed out",
    RunStatus.OUT_OF_MEMORY: "out of memory",
    RunStatus.NOT_INSTALLED: "not installed",
    RunStatus.DATA_MISSING: "data missing",
    RunStatus.SKIPPED: "not run yet",
}

Level = Literal["clear", "within the noise floor", "no interval", "not shown", "within the margin"]
"""Whether two differ, or why nobody should say so."""


@dataclass(frozen=True, slots=True)
class Standing:
    """One metric over one sequence. ``ranked``: the rankable cells, best first; ``level``: those level with it."""

    sequence: str
    metric: Metric
    cells: tuple[Cell, ...]
    ranked: tuple[Cell, ...]
    level: tuple[Cell, ...]
    why_level: Level

    @property
    def repeated(self) -> bool:
        """Whether those who are ranked were run more than once: only then does anybody win."""
        return any(len(cell.values) > 1 for cell in self.ranked)

    @property
    def winner(self) -> Cell | None:
        """The one that leads by more than the noise; None where several are level, or nobody else can be compared."""
        return self.level[0] if len(self.level) == 1 and len(self.ranked) > 1 else None

    def of(self, method: str) -> Cell | None:
        """The cell of a method; None if it is not in this sequence."""
        return next((cell for cell in self.cells if cell.method == method), None)


def standing(comparison: Comparison, sequence: str, metric: Metric) -> Standing:
    """Where all methods stand in one metric over one sequence."""
    known = (sequence, metric.name)
    if known not in comparison.standings:
        comparison.standings[known] = _standing(comparison, sequence, metric)
    return comparison.standings[known]


def ranking(metric: Metric, cells: Sequence[Cell]) -> tuple[Cell, ...]:
    """The rankable cells, best first; empty where neither direction is better."""
    if not metric.better:
        return ()
    sign = 1.0 if metric.better == "lower" else -1.0
    return tuple(sorted((c for c in cells if c.rankable), key=lambda c: sign * median(c.values)))


def difference(metric: Metric, one: Cell, other: Cell) -> Level:
    """Whether two cells with values differ clearly, or why nobody should say so: compared run by run.

    Clear is a paired difference whose 95 % interval excludes zero and whose median is of at least the margin.
    """
    differences = _differences(one, other)
    if not differences:
        return "no interval"
    size = abs(median(differences))
    if size < noise_floor(metric):
        return "within the noise floor"
    found = apart(one, other)
    if found is None:
        return "no interval"
    if not found.interval.excludes(0.0):
        return "not shown"
    return "within the margin" if size < margin(metric, _better(metric, one, other)) else "clear"


def distinct(metric: Metric, one: Cell, other: Cell) -> bool:
    """Whether two cells differ by at least the margin, in the same direction in every run, shown or not."""
    differences = _differences(one, other)
    if not differences or (min(differences) <= 0.0 <= max(differences)):
        return False
    return abs(median(differences)) >= max(margin(metric, _better(metric, one, other)), noise_floor(metric))


def noise_floor(metric: Metric) -> float:
    """The difference below which the truth itself cannot tell two methods apart (the metric's unit); 0: none."""
    return RELATIONS_FLOOR.get(metric.unit, 0.0) if metric.group == "relations" else 0.0


def margin(metric: Metric, better: float) -> float:
    """The least difference that counts beside the better value: 5 % of it, one printed digit, 2 mm of a position."""
    position = metric.unit == "m" and metric.group in ("drift", "relations")
    return max(MARGIN_SHARE * abs(better), 10.0**-metric.digits, MARGIN_M if position else 0.0)


def worse(metric: Metric, one: Cell | None, other: Cell | None) -> bool:
    """Whether one cell is shown to be worse than another; False where they cannot be compared."""
    return (
        behind(metric, one, other)
        and one is not None
        and other is not None
        and (difference(metric, one, other) == "clear")
    )


def behind(metric: Metric, one: Cell | None, other: Cell | None) -> bool:
    """Whether the median of one cell is worse than that of another, by however little."""
    if not metric.better or one is None or other is None or not one.values or not other.values:
        return False
    further = median(one.values) - median(other.values)
    return further > 0.0 if metric.better == "lower" else further < 0.0


def deciding(comparison: Comparison, sequence: str) -> Standing | None:
    """The standing that decides a sequence: the first headline metric, by strength of evidence, with any value."""
    headline = [metric for metric in comparison.metrics if metric.headline and metric.better]
    for group in DECIDING:
        for metric in headline:
            if metric.group == group:
                found = standing(comparison, sequence, metric)
                if any(cell.values for cell in found.cells):
                    return found
    return None


def method_of(comparison: Comparison, role: str) -> tuple[str, ...]:
    """The labels of the methods with a role, in order."""
    return tuple(label for label in comparison.method_labels if comparison.methods[label].role == role)


def unfinished(records: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """The records that did not complete, in order."""
    return tuple(record for record in records if not record.result.is_complete)


def guessed_percent(records: Sequence[RunRecord]) -> float:
    """The share of scans (%) that a method left to the guess, the median over its runs; 0 where unknown."""
    scores = [record.scores.by_metric[GUESSED].value for record in records if GUESSED in record.scores.by_metric]
    known = [value for value in scores if value is not None]
    return median(known) if known else 0.0


def _standing(comparison: Comparison, sequence: str, metric: Metric) -> Standing:
    cells = tuple(_cell(records, metric, comparison.bootstrap) for records in comparison.by_method(sequence).values())
    bars = method_of(comparison, "baseline") if metric.group in WITHOUT_BAR else ()
    ranked = ranking(metric, [cell for cell in cells if cell.method not in bars])
    level = tuple(cell for cell in ranked if cell is ranked[0] or difference(metric, ranked[0], cell) != "clear")
    why = difference(metric, ranked[0], level[1]) if len(level) > 1 else "clear"
    return Standing(sequence, metric, cells, ranked, level, why)


def _differences(one: Cell, other: Cell) -> list[float]:
    theirs = dict(zip(other.seeds, other.values, strict=True))
    return [value - theirs[seed] for seed, value in zip(one.seeds, one.values, strict=True) if seed in theirs]


def _cell(records: Sequence[RunRecord], metric: Metric, bootstrap: RecordBootstrap) -> Cell:
    complete = [record for record in records if record.result.is_complete]
    scored = [(t, t.scores.by_metric[metric.name]) for t in complete if metric.name in t.scores.by_metric]
    known = [(t, score.value, score.support) for t, score in scored if score.value is not None]
    ended = [t.scores.by_metric[metric.name].value for t in unfinished(records) if metric.name in t.scores.by_metric]
    return Cell(
        records[0].method,
        tuple(value for _, value, _ in known),
        tuple(value for value in ended if value is not None),
        len(complete),
        len(records),
        int(median(support for *_, support in known)) if known else 0,
        "" if known else _why_none(records, metric),
        tuple(t.seed for t, *_ in known),
        guessed_percent(complete),
        tuple(bootstrap.draws(t, metric.name) for t, *_ in known),
    )


def _why_none(records: Sequence[RunRecord], metric: Metric) -> str:
    reasons = [
        record.scores.by_metric[metric.name].reason
        for record in records
        if record.result.is_complete and metric.name in record.scores.by_metric
    ]
    reasons += [f"{STATUS[record.result.status]}: {record.result.reason}" for record in unfinished(records)]
    return "; ".join(dict.fromkeys(reasons)) or "not scored"


def _better(metric: Metric, one: Cell, other: Cell) -> float:
    medians = (median(one.values), median(other.values))
    return max(medians) if metric.better == "higher" else min(medians)
