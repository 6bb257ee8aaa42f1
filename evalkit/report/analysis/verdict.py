"""The verdict over one sequence in sentences: who leads, by how much, what failed, and what cannot be told."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.core.run_result import NOT_EXECUTED
from evalkit.metrics.table import Metric
from evalkit.report.analysis import warnings
from evalkit.report.analysis.cells import Cell, apart
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import MEASURES, behind_bar, by_maps, consensus, disagrees
from evalkit.report.analysis.standings import (
    MARGIN_SHARE,
    STATUS,
    WITH_TRUTH,
    Standing,
    deciding,
    method_of,
    noise_floor,
    standing,
    unfinished,
)
from evalkit.report.html.formatting import amount, difference, figure, gap, joined, plain, told
from evalkit.results.run_record import RunRecord

Outcome = Literal["winner", "ahead", "level", "unrivalled", "disagreement", "degenerate", "nothing"]
SAME = {"stretches": "on the same scans", "runs": "run by run"}
LED: tuple[Outcome, ...] = ("winner", "ahead", "level")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What one sequence says. ``leaders``: who wins or is ahead (in one run each), or all that are level.

    ``counts``: whether it enters the tally of wins, which takes truth and a geometry that fixes the pose. ``repeated``:
    whether the ranked methods were run more than once.
    """

    sequence: str
    outcome: Outcome
    counts: bool
    leaders: tuple[str, ...]
    sentences: tuple[str, ...]
    repeated: bool = True


def verdict(comparison: Comparison, sequence: str) -> Verdict:
    """The verdict over one sequence: success first, then who leads, then the paper's method, the bar and the cost."""
    found = deciding(comparison, sequence)
    degenerate = comparison.sequences[sequence].degenerate
    records = comparison.of_sequence(sequence)
    outcome = _outcome(comparison, found, degenerate)
    sentences = [success(records), warnings.of_data(records)]
    if degenerate:
        sentences.append(f"Degenerate by design: {plain(degenerate)}. The order below is no ranking.")
    if found is None:
        sentences.append("No headline metric has a value here, so nobody can be ranked.")
    else:
        sentences += [_told(comparison, found, outcome), warnings.of_guesses(comparison, sequence)]
        sentences += [_paper(comparison, found) if outcome not in ("degenerate", "disagreement") else ""]
        sentences += [_bar(comparison, found), *warnings.of_evidence(found)]
    sentences += [_cost(comparison, sequence), warnings.of_times(records)]
    counts = outcome in LED and found is not None and found.metric.group in WITH_TRUTH
    leaders = _leading(comparison, found) if found and outcome in LED else ()
    repeated = found is not None and found.repeated
    return Verdict(sequence, outcome, counts, leaders, tuple(s for s in sentences if s), repeated)


def success(records: Sequence[RunRecord]) -> str:
    """How many runs finished; then what could not start here, and what did not finish, by method."""
    if not records:
        return "There was nothing to run."
    missing = unfinished(records)
    absent = [record for record in missing if record.result.status in NOT_EXECUTED]
    broken = [record for record in missing if record.result.status not in NOT_EXECUTED]
    expected = Counter(record.method for record in records)
    sentences = [f"{len(records) - len(missing)} of {len(records)} runs finished."]
    if broken:
        sentences.append(f"Did not finish: {_ends(broken, expected)}.")
    if absent:
        sentences.append(f"Could not start: {_ends(absent, expected)}.")
    return " ".join(sentences)


def _ends(records: Sequence[RunRecord], expected: Mapping[str, int]) -> str:
    ends: dict[str, Counter[str]] = {}
    for record in records:
        ends.setdefault(record.method, Counter())[STATUS[record.result.status]] += 1
    return joined(
        f"{who} ({', '.join(f'{count} of {expected[who]} {end}' for end, count in counts.items())})"
        for who, counts in ends.items()
    )


def _outcome(comparison: Comparison, found: Standing | None, degenerate: str) -> Outcome:
    if degenerate:
        return "degenerate"
    if found is None or not found.ranked:
        return "nothing"
    if len(found.ranked) == 1:
        return "unrivalled"
    if disagrees(comparison, found):
        return "disagreement"
    if found.winner is None:
        return "level"
    return "winner" if found.repeated else "ahead"


def _leading(comparison: Comparison, found: Standing) -> tuple[str, ...]:
    level = tuple(cell.method for cell in found.level)
    return consensus(comparison, found.sequence).agreed if by_maps(found) else level


def _told(comparison: Comparison, found: Standing, outcome: Outcome) -> str:
    if outcome == "disagreement":
        return _disagreement(comparison, found)
    if not by_maps(found) or outcome not in LED:
        return _leaders(found, outcome)
    if outcome == "level" and found.why_level == "no interval":
        best = joined(consensus(comparison, found.sequence).agreed)
        return (
            f"No difference shown: one run each gives no interval. By every measure of the map {best} is best or level."
        )
    return f"{_leaders(found, outcome)} The other measures of the map do not contradict."


def _leaders(found: Standing, outcome: Outcome) -> str:
    metric, ranked = found.metric, found.ranked
    if not ranked:
        return f"Nobody completed every run with a value for {metric.label}, so nobody can win."
    first = f"{ranked[0].method} has {told(metric, ranked[0])}"
    if len(ranked) == 1:
        return f"Only {first} {metric.label} over every run: there is nobody to compare it with."
    if outcome == "degenerate":
        return f"On {metric.label}, {first}, {_last(metric, ranked)}."
    if outcome == "ahead":
        return (
            f"{ranked[0].method} is ahead in the one run there is, on {metric.label}: "
            f"{_lead(metric, ranked[0], ranked[1])}."
        )
    if outcome == "winner":
        verb = "wins" if metric.group in WITH_TRUTH else "is ahead"
        return f"{ranked[0].method} {verb} on {metric.label}: {_lead(metric, ranked[0], ranked[1])}."
    between, rest = (joined(f"{cell.method} {told(metric, cell)}" for cell in found.level[:2]), found.level[2:])
    others = f" Nor between the first and {joined(cell.method for cell in rest)}." if rest else ""
    return f"No difference shown on {metric.label} between {between}: {_why_level(found)}.{others}"


def _disagreement(comparison: Comparison, found: Standing) -> str:
    measured = consensus(comparison, found.sequence)
    if measured.untold:
        return f"Nobody is named without truth: there is no value for {joined(measured.untold)}."
    strengths: dict[str, list[str]] = {}
    for name, who in measured.best.items():
        strengths.setdefault(who, []).append(MEASURES[name])
    (first, has), *others = strengths.items()
    listed = [f"{first} has {joined(has)}", *(f"{who} {joined(best)}" for who, best in others)]
    return f"The map measures disagree: {', '.join(listed)}."


def _lead(metric: Metric, winner: Cell, runner_up: Cell) -> str:
    best, second = median(winner.values), median(runner_up.values)
    found = apart(runner_up, winner)
    over = f"; the difference, {SAME[found.by]}, is {difference(metric, found, _sign(metric))}" if found else ""
    return (
        f"{told(metric, winner)}; the runner-up, {runner_up.method}, "
        f"has {told(metric, runner_up)}, {gap(metric, second, best)}{over}"
    )


def _last(metric: Metric, ranked: Sequence[Cell]) -> str:
    return f"and the last of those who finished, {ranked[-1].method}, {told(metric, ranked[-1])}"


def _why_level(found: Standing) -> str:
    metric, first, second = found.metric, found.level[0], found.level[1]
    if found.why_level == "within the noise floor":
        return f"they differ by less than the truth can tell ({amount(metric, noise_floor(metric))})"
    if found.why_level == "no interval":
        return "one run each, without an error for every scan, gives no interval"
    if found.why_level == "within the margin":
        position = metric.unit == "m" and metric.group in ("drift", "relations")
        return f"they are less than {100 * MARGIN_SHARE:.0f} % {'or 2 mm ' if position else ''}apart"
    between = apart(second, first)
    if between is None:
        return "they cannot be compared"
    if between.interval.low == between.interval.high == 0.0 or between.detectable < 0.05 * 10.0**-metric.digits:
        return "they are the same to every digit printed"
    reach = f"{figure(between.detectable, metric.digits + 1)}\u00a0{metric.unit}".rstrip()
    said = difference(metric, between, _sign(metric))
    return (
        f"{SAME[between.by]}, {second.method} is worse by {said}, which may be nothing; these runs would have "
        f"shown a difference of {reach}"
    )


def _sign(metric: Metric) -> float:
    """What makes "worse minus better" a positive number."""
    return -1.0 if metric.better == "higher" else 1.0


def _paper(comparison: Comparison, found: Standing) -> str:
    labels = method_of(comparison, "reference")
    clauses = [_paper_clause(label, found) for label in labels if found.of(label)]
    return f"The paper's method: {'; '.join(clauses)}." if clauses and found.ranked else ""


def _paper_clause(label: str, found: Standing) -> str:
    cell = found.of(label)
    if cell is None or not cell.rankable:
        if cell is not None and not cell.registers:
            return f"{label} registered too little to be ranked"
        count = f"{cell.complete} of {cell.expected}" if cell else "none"
        return f"{label} cannot be ranked ({count} of its runs finished)"
    if cell in found.level:
        return _paper_first(cell, found)
    best, own = median(found.ranked[0].values), median(cell.values)
    figures = f"{amount(found.metric, own)} against {amount(found.metric, best)}"
    verb = "loses" if found.metric.group in WITH_TRUTH and found.repeated else "is behind"
    return f"{label} {verb}, with {figures}: {gap(found.metric, own, best)}"


def _paper_first(cell: Cell, found: Standing) -> str:
    if found.winner is cell:
        return f"{cell.method} {'wins' if found.metric.group in WITH_TRUTH and found.repeated else 'is ahead'}"
    if len(found.ranked) == 1:
        return f"{cell.method} has nobody beside it"
    if cell is found.ranked[0]:
        return f"{cell.method} has the best value, but not by a difference that is shown"
    return f"no difference is shown between {cell.method} and the best, {found.ranked[0].method}"


def _bar(comparison: Comparison, found: Standing) -> str:
    for bar in method_of(comparison, "baseline"):
        measure = found.of(bar)
        if not any(cell.values for cell in found.cells if cell.method != bar):
            return ""
        if measure is None or measure.median is None:
            return f"{bar} has no value here, so the others have no bar to pass."
        behind = behind_bar(comparison, found, bar)
        if behind and by_maps(found):
            listed = joined(cell.method for cell in behind)
            return f"A worse map than {bar} alone, by every measure: {listed}."
        if behind:
            listed = joined(f"{cell.method} ({amount(found.metric, median(cell.values))})" for cell in behind)
            return f"Worse than {bar} alone ({amount(found.metric, measure.median)}): {listed}."
    return ""


def _cost(comparison: Comparison, sequence: str) -> str:
    for metric in comparison.metrics:
        if metric.group == "runtime" and metric.headline and metric.better:
            ranked = standing(comparison, sequence, metric).ranked
            if len(ranked) > 1:
                first, last = (f"{c.method} ({amount(metric, median(c.values))})" for c in (ranked[0], ranked[-1]))
                return f"{metric.label[0].upper()}{metric.label[1:]}: best {first}, worst {last}."
    return ""
