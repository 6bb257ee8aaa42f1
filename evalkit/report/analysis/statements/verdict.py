"""The verdict over one sequence in sentences: the leader, its lead, failures, and limits of the evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.core.run_status import NOT_EXECUTED, RunStatus
from evalkit.metrics.metric import Metric
from evalkit.report.analysis.comparison import Comparison, find_missing_sequences
from evalkit.report.analysis.map_agreement import MEASURES, MapAgreement, decided_by_maps
from evalkit.report.analysis.pairwise import (
    MARGIN_M,
    MARGIN_SHARE,
    PairedDifference,
    compute_difference,
    is_position,
    is_share_in_map,
    margin,
    noise_floor,
    separation,
)
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import STATUS_LABELS, WITH_TRUTH, MethodScore, select_unfinished
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements import warnings
from evalkit.report.formatting import (
    capitalise,
    format_amount,
    format_difference,
    format_gap,
    format_losses,
    format_median,
    join_words,
    name_or_count,
    strip_full_stop,
)
from evalkit.results.run_record import RunRecord
from evalkit.stats.runs import FEW_RUNS, MAX_RUNS, MIN_RUNS

VerdictOutcome = Literal["winner", "tied", "one run", "single", "lost", "disagreement", "degenerate", "unranked"]
ALL_TIED = "all tied"
"""Why a sequence does not count on which no ranked method is worse than another."""
LED: tuple[VerdictOutcome, ...] = ("winner", "tied")
MAX_UNRANKED = 4
"""More methods that are not ranked for one cause are counted, not named."""

NAMED = 3
"""A sentence on an order without a verdict names at most so many methods."""


@dataclass(frozen=True, slots=True)
class SequenceVerdict:
    """The verdict over one sequence.

    ``leaders``: the method that wins, or all that are tied. ``counts``: whether the sequence counts in the tally of
    wins, which takes ground truth, a geometry that determines the pose, and more than one run of each method.
    ``all_tied``: all ranked methods are tied and no other one lost the track in most runs, so that it tells none apart.
    """

    sequence: str
    outcome: VerdictOutcome
    counts: bool
    leaders: tuple[str, ...]
    sentences: tuple[str, ...]
    all_tied: bool = False


def compute_verdict(comparison: Comparison, sequence: SequenceAnalysis) -> SequenceVerdict:
    """Return the verdict: success, leader, reference method, baseline, warnings, cost, remarks."""
    ranking, degenerate, runs = sequence.deciding, sequence.card.degenerate, sequence.all_runs
    outcome = _find_outcome(sequence)
    sentences = [describe_success(runs), warnings.warn_of_data(runs)]
    sentences += [f"Doubt about the data: {strip_full_stop(text)}." for text in sequence.card.warnings]
    if degenerate:
        sentences.append(f"Degenerate geometry: {strip_full_stop(degenerate)}. The order below is not a ranking.")
    if ranking is None:
        sentences.append("No headline metric has a value here, so there is no ranking.")
    else:
        sentences += [_describe_outcome(sequence, ranking, outcome), warnings.warn_of_guesses(sequence)]
        if outcome in (*LED, "one run"):
            sentences.append(_describe_reference(comparison.methods_with_role("reference"), ranking))
        sentences += [_describe_tuned(ranking), _describe_lost(ranking) if outcome != "lost" else ""]
        sentences += [
            _describe_baseline(sequence, ranking),
            *warnings.warn_of_evidence(sequence, ranking),
        ]
    sentences += [_describe_cost(sequence), warnings.warn_of_processors(runs), *warnings.list_remarks(sequence)]
    leads = ranking is not None and outcome in LED
    leaders = _find_leaders(sequence, ranking) if leads and ranking is not None else ()
    return SequenceVerdict(
        sequence.label,
        outcome,
        leads and ranking is not None and ranking.metric.group in WITH_TRUTH,
        leaders,
        tuple(sentence for sentence in sentences if sentence),
        leads and ranking is not None and _tells_none_apart(comparison, ranking, leaders),
    )


def _tells_none_apart(comparison: Comparison, ranking: Ranking, leaders: Sequence[str]) -> bool:
    """Return whether all ranked methods lead and none but a baseline lost the track in more than half of its runs."""
    baselines = comparison.methods_with_role("baseline")
    lost = [one.method for one in ranking.scores if 2 * one.lost_runs > one.expected and one.method not in baselines]
    return len(leaders) == len(ranking.ranked) and not lost


def describe_success(runs: Sequence[RunRecord]) -> str:
    """Return how many runs finished, which did not, and which could not start, by method."""
    if not runs:
        return "There were no runs."
    missing = select_unfinished(runs)
    absent = [run for run in missing if run.result.status in NOT_EXECUTED]
    broken = [run for run in missing if run.result.status not in NOT_EXECUTED]
    expected = Counter(run.method for run in runs)
    sentences = [f"{len(runs) - len(missing)} of {len(runs)} runs finished."]
    if broken:
        sentences.append(f"Did not finish: {_count_statuses(broken, expected)}.")
    if absent:
        sentences.append(f"Could not start: {_count_absent(absent, runs, expected)}.")
    return " ".join(sentences)


def _count_absent(absent: Sequence[RunRecord], runs: Sequence[RunRecord], expected: Mapping[str, int]) -> str:
    """Return the runs that did not start: sequences without data by their name, the others by method."""
    missing = find_missing_sequences(runs)
    rest = [run for run in absent if run.sequence not in missing or run.result.status != RunStatus.DATA_MISSING]
    parts = [f"all runs on {name} (data missing)" for name in missing]
    return join_words([*parts, *([_count_statuses(rest, expected)] if rest else [])])


def _count_statuses(runs: Sequence[RunRecord], expected: Mapping[str, int]) -> str:
    by_method: dict[str, Counter[str]] = {}
    for run in runs:
        by_method.setdefault(run.method, Counter())[STATUS_LABELS[run.result.status]] += 1
    return join_words(
        f"{method} ({', '.join(f'{count} of {expected[method]} {status}' for status, count in counts.items())})"
        for method, counts in by_method.items()
    )


def _find_outcome(sequence: SequenceAnalysis) -> VerdictOutcome:
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


def _find_leaders(sequence: SequenceAnalysis, ranking: Ranking) -> tuple[str, ...]:
    if decided_by_maps(ranking) and ranking.winner is None:
        return sequence.map_agreement.agreed
    return tuple(score.method for score in ranking.near)


def _describe_outcome(sequence: SequenceAnalysis, ranking: Ranking, outcome: VerdictOutcome) -> str:
    if outcome == "disagreement":
        return _describe_disagreement(sequence.map_agreement)
    if outcome == "lost":
        return f"No method held the track. {_describe_lost(ranking)}"
    sentence = _describe_leaders(ranking, outcome, sequence.all_runs[0].seed is None)
    if outcome == "winner":
        return f"{sentence} The other map metrics agree." if decided_by_maps(ranking) else sentence
    if outcome == "tied" and decided_by_maps(ranking):
        return f"{sentence} Not clearly worse in any map metric: {join_words(_find_leaders(sequence, ranking))}."
    return f"{sentence}{_describe_others_tied(ranking)}" if outcome == "tied" else sentence


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
    metric, first = ranking.metric, ranking.ranked[0]
    near = [score for score in ranking.tied[2:] if score in ranking.near]
    small = [score.method for score in near if separation(metric, first, score) == "within the margin"]
    groups = {
        "Also tied with the first": [score.method for score in near if score.method not in small],
        f"Worse by less than {_format_margin(metric, median(first.values))}, which does not matter here": small,
        "Not told apart from the first": [score.method for score in ranking.tied[2:] if score not in ranking.near],
    }
    return "".join(f" {words}: {join_words(methods)}." for words, methods in groups.items() if methods)


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
    margin = "" if difference is None else f"; {_describe_pairs(difference)}, the difference is "
    margin += "" if difference is None else format_difference(metric, difference, _sign(metric))
    return (
        f"{format_median(metric, winner)}; the runner-up, {runner_up.method}, has "
        f"{format_median(metric, runner_up)}, {format_gap(metric, second, best)}{margin}"
    )


def _describe_pairs(difference: PairedDifference) -> str:
    return f"over {difference.runs} pairs of runs"


def _describe_tie(ranking: Ranking) -> str:
    metric, first, second = ranking.metric, *ranking.tied[:2]
    floor = format_amount(metric, noise_floor(metric))
    least = _format_margin(metric, median(first.values))
    small = {
        "within the noise floor": f"they differ by less than the accuracy of the ground truth ({floor})",
        "within the margin": f"they are less than {least} apart, which does not matter here",
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
    if _sign(metric) * bounds.value < 0.0:
        amount = format_difference(metric, difference, -_sign(metric))
        return f"{first.method} is better by the medians, {second.method} {_describe_pairs(difference)}, by {amount}"
    amount = format_difference(metric, difference, _sign(metric))
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
        return f"these runs can detect a difference of {format_amount(metric, difference.detectable or 0.0, 1)}"
    runs = f"more than {MAX_RUNS}" if difference.needed is None else f"about {max(difference.needed, MIN_RUNS)}"
    return f"{runs} runs of each would settle a difference of this size"


def _sign(metric: Metric) -> float:
    """Return the sign that makes "worse minus better" positive."""
    return -1.0 if metric.better == "higher" else 1.0


def _describe_lost(ranking: Ranking) -> str:
    lost = [
        f"{score.method} {format_losses(score)} ({strip_full_stop(score.lost.reason)})"
        for score in ranking.scores
        if score.lost is not None
    ]
    return f"Lost the track and not ranked: {join_words(lost)}." if lost else ""


def _describe_tuned(ranking: Ranking) -> str:
    tuned = [score.method for score in ranking.scores if score.tuned and score.values]
    return f"Not ranked, because settings were chosen on these data: {join_words(tuned)}." if tuned else ""


def _describe_reference(references: Sequence[str], ranking: Ranking) -> str:
    clauses = [_reference_clause(label, ranking) for label in references if ranking.of(label)]
    return f"The reference method: {'; '.join(clauses)}." if clauses and ranking.ranked else ""


def _reference_clause(label: str, ranking: Ranking) -> str:
    score = ranking.of(label)
    if score is None or score not in ranking.ranked:
        return f"{label} is not ranked: {_explain_unranked(score)}"
    place = f"{label} has {format_amount(ranking.metric, median(score.values))}, "
    if not ranking.repeated:
        return f"{place}place {ranking.ranked.index(score) + 1} of {len(ranking.ranked)} in this order"
    standing, first, truth = mark(ranking, label), ranking.ranked[0], ranking.metric.group in WITH_TRUTH
    if standing == "best":
        return f"{label} {'wins' if truth else 'is ahead'}"
    if standing == "worse":
        best, own = median(first.values), median(score.values)
        figures = f"{format_amount(ranking.metric, own)} against {format_amount(ranking.metric, best)}"
        return f"{label} {'loses' if truth else 'is behind'}, with {figures}: {format_gap(ranking.metric, own, best)}"
    if score is first:
        return f"{label} has the best value, but not by a clear difference"
    return f"{label} is {'tied with' if standing == 'tied' else 'not told apart from'} the best, {first.method}"


def explain_unranked(sequences: Iterable[SequenceAnalysis]) -> str:
    """Return why methods are not ranked: "settings of a and b were chosen on these data; c lost the track"; "" if none.

    A method that is ranked nowhere is named once, by its first cause.
    """
    causes: dict[str, list[str]] = {"tuned": [], "lost": [], "guessed": [], "unfinished": [], "absent": []}
    sequences = tuple(sequences)
    named = {score.method for one in sequences if one.deciding for score in one.deciding.ranked}
    for sequence in sequences:
        for score in sequence.deciding.scores if sequence.deciding else ():
            if not score.rankable and score.method not in named:
                causes[_find_cause(score, sequence.runs[score.method])].append(score.method)
                named.add(score.method)
    clauses = {
        "tuned": "settings of {} were chosen on these data", "lost": "{} lost the track",
        "guessed": "{} registered too few scans", "unfinished": "{} did not complete every run with a value",
        "absent": "{} did not run",
    }  # fmt: skip
    listed = (
        clauses[cause].format(name_or_count(methods, MAX_UNRANKED)) for cause, methods in causes.items() if methods
    )
    return "; ".join(listed)


def _find_cause(score: MethodScore, runs: Sequence[RunRecord]) -> str:
    """Return the first cause for which a score is not ranked."""
    if all(run.result.status in NOT_EXECUTED for run in runs):
        return "absent"
    if not score.complete == score.expected == len(score.values):
        return "unfinished"
    return "lost" if score.lost is not None else "tuned" if score.registers else "guessed"


def _explain_unranked(score: MethodScore | None) -> str:
    if score is None or not score.complete == score.expected == len(score.values):
        return f"{score.complete if score else 'none'} of {score.expected if score else 'its'} runs finished"
    if score.lost is not None:
        return "it lost the track"
    return "it registered too few scans" if not score.registers else "its settings were chosen on these data"


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
            listed = join_words(
                f"{score.method} ({format_amount(ranking.metric, median(score.values))})" for score in behind
            )
            return f"Worse than {baseline} alone ({format_amount(ranking.metric, reference.median)}): {listed}."
    return ""


def _describe_cost(sequence: SequenceAnalysis) -> str:
    for ranking in sequence.rankings.values():
        metric, ranked = ranking.metric, ranking.ranked
        if metric.group == "runtime" and metric.headline and metric.better and len(ranked) > 1:
            first, last = (
                f"{score.method} ({format_amount(metric, median(score.values))})" for score in (ranked[0], ranked[-1])
            )
            return f"{capitalise(metric.label)}: {first} to {last}."
    return ""
