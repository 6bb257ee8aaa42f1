"""How a comparison over one sequence came out, in words: who leads, by how much, and what a tie rests on."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import Literal

from evalkit.metrics.metric import Metric
from evalkit.report.analysis.map_agreement import MEASURES, MapAgreement, decided_by_maps
from evalkit.report.analysis.pairwise import (
    MARGIN_M,
    MARGIN_SHARE,
    PairedDifference,
    compute_difference,
    count_relations,
    is_position,
    is_share_in_map,
    margin,
    noise_floor,
    separation,
)
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import WITH_TRUTH, MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.unranked import describe_lost
from evalkit.report.formatting import format_amount, format_difference, format_gap, format_median, join_words
from evalkit.stats.runs import FEW_RUNS, MAX_RUNS, MIN_RUNS

VerdictOutcome = Literal["winner", "tied", "one run", "single", "lost", "disagreement", "degenerate", "unranked"]
LED: tuple[VerdictOutcome, ...] = ("winner", "tied")

NOT_APART = "not told apart"
"""Why a sequence does not count on which too few runs tell the ranked methods apart, and none is worse."""

NAMED = 3
"""A sentence on an order without a verdict names at most so many methods."""


def find_outcome(sequence: SequenceAnalysis) -> VerdictOutcome:
    """Return how the comparison over a sequence came out."""
    ranking = sequence.deciding
    if sequence.card.degenerate:
        return "degenerate"
    if ranking is None:
        return "unranked"
    valued = [score for score in ranking.scores if score.values]
    if valued and all(score.lost for score in valued):
        return "lost"
    if len(ranking.ranked) < 2:
        return "single" if ranking.ranked else "unranked"
    if not ranking.repeated:
        return "one run"
    undecided: VerdictOutcome = "disagreement" if sequence.map_agreement.disagrees else "tied"
    return undecided if ranking.winner is None or not ranking.comparable else "winner"


def find_leaders(sequence: SequenceAnalysis, ranking: Ranking) -> tuple[str, ...]:
    """Return the method that wins, or all that are tied."""
    if decided_by_maps(ranking) and ranking.winner is None:
        return sequence.map_agreement.agreed
    return tuple(score.method for score in ranking.near)


def describe_outcome(sequence: SequenceAnalysis, ranking: Ranking, outcome: VerdictOutcome) -> str:
    """Return the outcome in one sentence, or a few for a tie."""
    if outcome == "disagreement":
        return _describe_disagreement(sequence.map_agreement)
    if outcome == "lost":
        return f"No method held the track. {describe_lost(ranking)}"
    sentence = _describe_leaders(ranking, outcome, sequence.all_runs[0].seed is None)
    if outcome == "winner":
        return f"{sentence} The other map metrics agree." if decided_by_maps(ranking) else sentence
    if outcome == "tied" and decided_by_maps(ranking):
        return f"{sentence} {_describe_best_maps(sequence.map_agreement, ranking)}"
    return f"{sentence}{_describe_others_tied(ranking)}" if outcome == "tied" else sentence


def _describe_best_maps(agreement: MapAgreement, ranking: Ranking) -> str:
    """Return which methods have the best maps, and why not those with a better value than one of them."""
    order = [score.method for score in ranking.ranked]
    last = max((order.index(method) for method in agreement.agreed if method in order), default=0)
    others = [f"{one} ({agreement.worse[one]})" for one in order[:last] if one in agreement.worse]
    sentence = f"Not clearly worse in any map metric: {join_words(agreement.agreed)}."
    return f"{sentence} Clearly worse in one of them: {join_words(others)}." if others else sentence


def _describe_leaders(ranking: Ranking, outcome: VerdictOutcome, recorded: bool) -> str:
    metric, ranked = ranking.metric, ranking.ranked
    if not ranked:
        return f"No method is ranked on {metric.label}, so there is no winner."
    first = f"{ranked[0].method} has {format_median(metric, ranked[0])}"
    if len(ranked) == 1:
        return f"Only {first} {metric.label} over every run: there is no other ranked method to compare with."
    if outcome == "degenerate":
        last = f"{ranked[-1].method}, has {format_median(metric, ranked[-1])}"
        return f"On {metric.label}, {first}; the last of the finished methods, {last}."
    if outcome == "one run":
        order = join_words(f"{score.method} ({format_median(metric, score)})" for score in ranked[:NAMED])
        needed = f"{FEW_RUNS} or more (nuisance = {FEW_RUNS - 1})" if recorded else f"{MIN_RUNS} or more"
        return f"One run each gives an order and no verdict, which takes {needed}. On {metric.label}: {order}."
    if outcome == "winner":
        verb = "wins" if metric.group in WITH_TRUTH else "is ahead"
        return f"{ranked[0].method} {verb} on {metric.label}: {_describe_lead(ranking)}."
    pair = join_words(f"{score.method} ({format_median(metric, score)})" for score in ranking.tied[:2])
    how = "are tied" if ranking.tied[1] in ranking.near else "are not told apart by these runs"
    return f"On {metric.label}, {pair} {how}: {_describe_tie(ranking)}."


def _describe_others_tied(ranking: Ranking) -> str:
    """Return sentences on the methods after the second that are not clearly worse than the first."""
    first = ranking.ranked[0]
    near = [score for score in ranking.tied[2:] if score in ranking.near]
    small = [score for score in near if separation(ranking.metric, first, score) == "within the margin"]
    groups = {
        "Also tied with the first": [score for score in near if score not in small],
        f"Worse by at most {_describe_small(ranking, small)}, which does not matter here": small,
        "Not told apart from the first": [score for score in ranking.tied[2:] if score not in ranking.near],
    }
    return "".join(f" {words}: {join_words(one.method for one in own)}." for words, own in groups.items() if own)


def _describe_small(ranking: Ranking, scores: Sequence[MethodScore]) -> str:
    """Return the smallest difference that matters, and the bound of an interval of the differences beyond it, if any.

    "2 mm (interval up to 2.4 mm)"; "2 mm" also over two pairs of runs, which have no interval.
    """
    metric, better = ranking.metric, median(ranking.ranked[0].values)
    found = [compute_difference(score, ranking.ranked[0]) for score in scores]
    ends = [abs(end) for one in found if one and one.runs >= MIN_RUNS for end in (one.interval.low, one.interval.high)]
    bound, least = max(ends, default=0.0), _format_margin(metric, better)
    return f"{least} (interval up to {format_amount(metric, bound)})" if bound > margin(metric, better) else least


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
    shown = ""
    if difference is not None:
        amount = format_difference(metric, difference, metric.sign)
        shown = f"; {_describe_pairs(difference)}, the difference is {amount}"
    return (
        f"{format_median(metric, winner)}; the runner-up, {runner_up.method}, has "
        f"{format_median(metric, runner_up)}, {format_gap(metric, second, best)}{shown}"
    )


def _describe_pairs(difference: PairedDifference) -> str:
    return f"over {difference.runs} pairs of runs"


def _describe_tie(ranking: Ranking) -> str:
    metric, first, second = ranking.metric, *ranking.tied[:2]
    relations = count_relations(first, second)
    floor = f"{format_amount(metric, noise_floor(metric, relations))} over {relations} relations"
    small = {
        "within the noise floor": f"they differ by less than the accuracy of the ground truth ({floor})",
        "within the margin": f"they are at most {_describe_small(ranking, [second])} apart, which does not matter here",
    }
    if ranking.why_tied in small:
        return small[ranking.why_tied]
    difference = compute_difference(second, first)
    if ranking.why_tied == "one run" or difference is None or difference.detectable is None:
        return f"{second.method} has no second run in common with {first.method}"
    bounds = difference.interval
    if (bounds.low, bounds.high) != (0.0, 0.0) and first.perturbed and difference.runs < FEW_RUNS:
        return f"they have {difference.runs} pairs of perturbed runs, and a verdict takes {FEW_RUNS}"
    if bounds.low == bounds.high == 0.0 or difference.detectable < 0.05 * 10.0**-metric.digits:
        return "they are equal to every printed digit"
    if metric.sign * bounds.value < 0.0:
        amount = format_difference(metric, difference, -metric.sign)
        return f"{first.method} is better by the medians, {second.method} {_describe_pairs(difference)}, by {amount}"
    amount = format_difference(metric, difference, metric.sign)
    shown = f"{_describe_pairs(difference)}, {second.method} is worse by {amount}, which may be chance"
    return f"{shown}; {_describe_need(metric, difference, min(median(first.values), median(second.values)))}"


def _format_margin(metric: Metric, better: float) -> str:
    """Return the smallest difference that matters beside a value: "5 %", "2 mm", "1 percentage point"."""
    least = margin(metric, better)
    if least <= MARGIN_SHARE * abs(better):
        return f"{100 * MARGIN_SHARE:.0f} %"
    if is_position(metric):
        return f"{1000.0 * MARGIN_M:.0f} mm"
    return f"{least:.0f} percentage point" if is_share_in_map(metric) else format_amount(metric, least)


def _describe_need(metric: Metric, difference: PairedDifference, better: float) -> str:
    """Return how many runs would settle a difference of the measured size, or what so many runs can detect."""
    if abs(difference.interval.value) < margin(metric, better):
        if difference.misses_double:
            return "these runs do not even detect a value twice as large"
        return f"these runs can detect a difference of {format_amount(metric, difference.detectable or 0.0, 1)}"
    runs = f"more than {MAX_RUNS}" if difference.needed is None else f"about {max(difference.needed, MIN_RUNS)}"
    return f"{runs} runs of each would settle a difference of this size"
