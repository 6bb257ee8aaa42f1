"""The verdict over one sequence in sentences: the leader, its lead, failures, and limits of the evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.core.run_result import NOT_EXECUTED
from evalkit.metrics.table import Metric
from evalkit.report.analysis import warnings
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import MEASURES, MapAgreement, decided_by_maps
from evalkit.report.analysis.pairwise import MARGIN_SHARE, compute_difference, is_position, noise_floor
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import STATUS_LABELS, WITH_TRUTH, MethodScore, unfinished
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import (
    capitalise,
    format_amount,
    format_difference,
    format_gap,
    format_median,
    format_number,
    join_words,
    strip_full_stop,
)
from evalkit.results.run_record import RunRecord

Outcome = Literal["winner", "ahead", "tied", "single", "disagreement", "degenerate", "unranked"]
LED: tuple[Outcome, ...] = ("winner", "ahead", "tied")
PAIRED = {"blocks": "on the same scans", "runs": "run by run"}


@dataclass(frozen=True, slots=True)
class SequenceVerdict:
    """The verdict over one sequence.

    ``leaders``: the method that wins or is ahead (with one run each), or all that are tied. ``counts``: whether the
    sequence counts in the tally of wins, which takes ground truth and a geometry that determines the pose.
    ``repeated``: whether the ranked methods ran more than once.
    """

    sequence: str
    outcome: Outcome
    counts: bool
    leaders: tuple[str, ...]
    sentences: tuple[str, ...]
    repeated: bool = True


def compute_verdict(comparison: Comparison, sequence: SequenceAnalysis) -> SequenceVerdict:
    """Return the verdict: success, leader, reference method, baseline, warnings, cost."""
    ranking, degenerate, runs = sequence.deciding, sequence.card.degenerate, sequence.all_runs
    outcome = _find_outcome(sequence)
    sentences = [describe_success(runs), warnings.warn_of_data(runs)]
    if degenerate:
        sentences.append(f"Degenerate geometry: {strip_full_stop(degenerate)}. The order below is not a ranking.")
    if ranking is None:
        sentences.append("No headline metric has a value here, so there is no ranking.")
    else:
        sentences += [_describe_outcome(sequence, ranking, outcome), warnings.warn_of_guesses(sequence)]
        if outcome not in ("degenerate", "disagreement"):
            sentences.append(_describe_reference(comparison.methods_with_role("reference"), ranking))
        sentences += [_describe_baseline(sequence, ranking), *warnings.warn_of_evidence(ranking)]
    sentences += [_describe_cost(sequence), warnings.warn_of_processors(runs)]
    leads = ranking is not None and outcome in LED
    return SequenceVerdict(
        sequence.label,
        outcome,
        leads and ranking is not None and ranking.metric.group in WITH_TRUTH,
        _find_leaders(sequence, ranking) if leads and ranking is not None else (),
        tuple(sentence for sentence in sentences if sentence),
        ranking is not None and ranking.repeated,
    )


def describe_success(runs: Sequence[RunRecord]) -> str:
    """Return how many runs finished, which did not, and which could not start, by method."""
    if not runs:
        return "There were no runs."
    missing = unfinished(runs)
    absent = [run for run in missing if run.result.status in NOT_EXECUTED]
    broken = [run for run in missing if run.result.status not in NOT_EXECUTED]
    expected = Counter(run.method for run in runs)
    sentences = [f"{len(runs) - len(missing)} of {len(runs)} runs finished."]
    if broken:
        sentences.append(f"Did not finish: {_count_statuses(broken, expected)}.")
    if absent:
        sentences.append(f"Could not start: {_count_statuses(absent, expected)}.")
    return " ".join(sentences)


def _count_statuses(runs: Sequence[RunRecord], expected: Mapping[str, int]) -> str:
    by_method: dict[str, Counter[str]] = {}
    for run in runs:
        by_method.setdefault(run.method, Counter())[STATUS_LABELS[run.result.status]] += 1
    return join_words(
        f"{method} ({', '.join(f'{count} of {expected[method]} {status}' for status, count in counts.items())})"
        for method, counts in by_method.items()
    )


def _find_outcome(sequence: SequenceAnalysis) -> Outcome:
    ranking = sequence.deciding
    if sequence.card.degenerate:
        return "degenerate"
    if ranking is None or not ranking.ranked:
        return "unranked"
    if len(ranking.ranked) == 1:
        return "single"
    if sequence.map_agreement.disagrees:
        return "disagreement"
    if ranking.winner is None:
        return "tied"
    return "winner" if ranking.repeated else "ahead"


def _find_leaders(sequence: SequenceAnalysis, ranking: Ranking) -> tuple[str, ...]:
    if decided_by_maps(ranking):
        return sequence.map_agreement.agreed
    return tuple(score.method for score in ranking.tied)


def _describe_outcome(sequence: SequenceAnalysis, ranking: Ranking, outcome: Outcome) -> str:
    if outcome == "disagreement":
        return _describe_disagreement(sequence.map_agreement)
    if not decided_by_maps(ranking) or outcome not in LED:
        return _describe_leaders(ranking, outcome)
    if outcome == "tied" and ranking.why_tied == "no interval":
        best = join_words(sequence.map_agreement.agreed)
        return f"No difference shown: one run each gives no interval. In every map metric {best} is best or tied."
    return f"{_describe_leaders(ranking, outcome)} The other map metrics agree."


def _describe_leaders(ranking: Ranking, outcome: Outcome) -> str:
    metric, ranked = ranking.metric, ranking.ranked
    if not ranked:
        return f"No method completed every run with a value for {metric.label}, so there is no winner."
    first = f"{ranked[0].method} has {format_median(metric, ranked[0])}"
    if len(ranked) == 1:
        return f"Only {first} {metric.label} over every run: there is no other method to compare with."
    if outcome == "degenerate":
        last = f"{ranked[-1].method}, has {format_median(metric, ranked[-1])}"
        return f"On {metric.label}, {first}; the last of the finished methods, {last}."
    if outcome == "ahead":
        return f"{ranked[0].method} is ahead in its single run, on {metric.label}: {_describe_lead(ranking)}."
    if outcome == "winner":
        verb = "wins" if metric.group in WITH_TRUTH else "is ahead"
        return f"{ranked[0].method} {verb} on {metric.label}: {_describe_lead(ranking)}."
    pair = join_words(f"{score.method} ({format_median(metric, score)})" for score in ranking.tied[:2])
    rest = join_words(score.method for score in ranking.tied[2:])
    others = f" Also tied with the first: {rest}." if ranking.tied[2:] else ""
    return f"On {metric.label}, {pair} are tied: {_describe_tie(ranking)}.{others}"


def _describe_disagreement(agreement: MapAgreement) -> str:
    if agreement.missing:
        return f"Without ground truth there is no leader: {join_words(agreement.missing)} has no value."
    strengths: dict[str, list[str]] = {}
    for name, method in agreement.best.items():
        strengths.setdefault(method, []).append(MEASURES[name])
    (first, has), *others = strengths.items()
    listed = [f"{first} has {join_words(has)}", *(f"{method} {join_words(best)}" for method, best in others)]
    return f"The map metrics disagree: {', '.join(listed)}."


def _describe_lead(ranking: Ranking) -> str:
    metric, (winner, runner_up) = ranking.metric, ranking.ranked[:2]
    best, second = median(winner.values), median(runner_up.values)
    difference = compute_difference(runner_up, winner)
    margin = ""
    if difference is not None:
        amount = format_difference(metric, difference, _sign(metric))
        margin = f"; the difference, {PAIRED[difference.resampled]}, is {amount}"
    return (
        f"{format_median(metric, winner)}; the runner-up, {runner_up.method}, has "
        f"{format_median(metric, runner_up)}, {format_gap(metric, second, best)}{margin}"
    )


def _describe_tie(ranking: Ranking) -> str:
    metric, first, second = ranking.metric, *ranking.tied[:2]
    if ranking.why_tied == "within the noise floor":
        return (
            f"they differ by less than the accuracy of the ground truth ({format_amount(metric, noise_floor(metric))})"
        )
    if ranking.why_tied == "no interval":
        return "one run each, without an error for every scan, gives no interval"
    if ranking.why_tied == "within the margin":
        return f"they are less than {100 * MARGIN_SHARE:.0f} % {'or 2 mm ' if is_position(metric) else ''}apart"
    difference = compute_difference(second, first)
    if difference is None:
        return "they cannot be compared"
    bounds = difference.interval
    if bounds.low == bounds.high == 0.0 or difference.detectable < 0.05 * 10.0**-metric.digits:
        return "they are equal to every printed digit"
    detectable = f"{format_number(difference.detectable, metric.digits + 1)}\u00a0{metric.unit}".rstrip()
    amount = format_difference(metric, difference, _sign(metric))
    return (
        f"{PAIRED[difference.resampled]}, {second.method} is worse by {amount}, which may be chance; these runs can "
        f"detect a difference of {detectable}"
    )


def _sign(metric: Metric) -> float:
    """Return the sign that makes "worse minus better" positive."""
    return -1.0 if metric.better == "higher" else 1.0


def _describe_reference(references: Sequence[str], ranking: Ranking) -> str:
    clauses = [_reference_clause(label, ranking) for label in references if ranking.of(label)]
    return f"The reference method: {'; '.join(clauses)}." if clauses and ranking.ranked else ""


def _reference_clause(label: str, ranking: Ranking) -> str:
    score = ranking.of(label)
    wins = ranking.metric.group in WITH_TRUTH and ranking.repeated
    if score is None or not score.rankable:
        if score is not None and not score.registers:
            return f"{label} is not ranked: it registered too few scans"
        count = f"{score.complete} of {score.expected}" if score else "none"
        return f"{label} is not ranked ({count} of its runs finished)"
    first = ranking.ranked[0]
    if score in ranking.tied:
        return f"{label} {_reference_among_best(score, ranking, wins)}"
    best, own = median(first.values), median(score.values)
    figures = f"{format_amount(ranking.metric, own)} against {format_amount(ranking.metric, best)}"
    return f"{label} {'loses' if wins else 'is behind'}, with {figures}: {format_gap(ranking.metric, own, best)}"


def _reference_among_best(score: MethodScore, ranking: Ranking, wins: bool) -> str:
    if ranking.winner is score:
        return "wins" if wins else "is ahead"
    if len(ranking.ranked) == 1:
        return "is the only ranked method"
    if score is ranking.ranked[0]:
        return "has the best value, but not by a clear difference"
    return f"is tied with the best, {ranking.ranked[0].method}"


def _describe_baseline(sequence: SequenceAnalysis, ranking: Ranking) -> str:
    for baseline, behind in sequence.behind.items():
        reference = ranking.of(baseline)
        if not any(score.values for score in ranking.scores if score.method != baseline):
            return ""
        if reference is None or reference.median is None:
            return f"{baseline} has no value here, so there is no baseline to beat."
        if behind and decided_by_maps(ranking):
            return f"Worse map than {baseline} alone, in every map metric: {join_words(s.method for s in behind)}."
        if behind:
            amount = format_amount(ranking.metric, reference.median)
            listed = join_words(
                f"{score.method} ({format_amount(ranking.metric, median(score.values))})" for score in behind
            )
            return f"Worse than {baseline} alone ({amount}): {listed}."
    return ""


def _describe_cost(sequence: SequenceAnalysis) -> str:
    for ranking in sequence.rankings.values():
        metric, ranked = ranking.metric, ranking.ranked
        if metric.group == "runtime" and metric.headline and metric.better and len(ranked) > 1:
            first, last = (
                f"{score.method} ({format_amount(metric, median(score.values))})" for score in (ranked[0], ranked[-1])
            )
            return f"{capitalise(metric.label)}: best {first}, worst {last}."
    return ""
