"""The verdict over one sequence in sentences: the leader, its lead, failures, and limits of the evidence."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.core.run_status import NOT_EXECUTED, RunStatus
from evalkit.report.analysis.comparison import Comparison, find_missing_sequences
from evalkit.report.analysis.map_agreement import decided_by_maps
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import STATUS_LABELS, WITH_TRUTH, MethodScore, select_unfinished
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements import warnings
from evalkit.report.analysis.statements.outcome import (
    LED,
    VerdictOutcome,
    describe_outcome,
    find_leaders,
    find_outcome,
)
from evalkit.report.analysis.statements.unranked import describe_lost, describe_tuned, explain_unranked_score
from evalkit.report.formatting import capitalise, format_amount, format_gap, join_words, strip_full_stop
from evalkit.results.run_record import RunRecord

ALL_TIED = "all tied"
"""Why a sequence does not count on which no ranked method is worse than another."""


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
    outcome = find_outcome(sequence)
    sentences = [describe_success(runs), warnings.warn_of_data(runs)]
    sentences += [f"Doubt about the data: {strip_full_stop(text)}." for text in sequence.card.warnings]
    if degenerate:
        sentences.append(f"Degenerate geometry: {strip_full_stop(degenerate)}. The order below is not a ranking.")
    if ranking is None:
        sentences.append("No headline metric has a value here, so there is no ranking.")
    else:
        sentences += [describe_outcome(sequence, ranking, outcome), warnings.warn_of_guesses(sequence)]
        if outcome in (*LED, "one run"):
            sentences.append(_describe_reference(comparison.methods_with_role("reference"), ranking))
        sentences += [describe_tuned(ranking), describe_lost(ranking) if outcome != "lost" else ""]
        sentences += [_describe_baseline(sequence, ranking), *warnings.warn_of_evidence(sequence, ranking)]
    sentences += [_describe_cost(sequence), warnings.warn_of_processors(runs), *warnings.list_remarks(sequence)]
    led = ranking if outcome in LED else None
    leaders = find_leaders(sequence, led) if led is not None else ()
    return SequenceVerdict(
        sequence.label,
        outcome,
        led is not None and led.metric.group in WITH_TRUTH,
        leaders,
        tuple(sentence for sentence in sentences if sentence),
        led is not None and _tells_none_apart(comparison, led, leaders),
    )


def _tells_none_apart(comparison: Comparison, ranking: Ranking, leaders: Sequence[str]) -> bool:
    """Return whether all ranked methods lead and none but a baseline lost the track in more than half of its runs."""
    baselines = comparison.methods_with_role("baseline")
    lost = [one.method for one in ranking.scores if 2 * one.lost_runs > one.expected and one.method not in baselines]
    return len(leaders) == len(ranking.ranked) and not lost


def describe_success(runs: Sequence[RunRecord]) -> str:
    """Return how many runs finished, and which did not, were interrupted, or could not start, by method."""
    if not runs:
        return "There were no runs."
    missing = select_unfinished(runs)
    interrupted = [run for run in missing if run.result.status == RunStatus.INTERRUPTED]
    absent = [run for run in missing if run.result.status in NOT_EXECUTED and run not in interrupted]
    broken = [run for run in missing if run.result.status not in NOT_EXECUTED]
    expected = Counter(run.method for run in runs)
    sentences = [f"{len(runs) - len(missing)} of {len(runs)} runs finished."]
    if broken:
        sentences.append(f"Did not finish: {_count_statuses(broken, expected)}.")
    if interrupted:
        sentences.append(f"Left out: {_count_statuses(interrupted, expected)}.")
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


def _describe_reference(references: Sequence[str], ranking: Ranking) -> str:
    clauses = [_reference_clause(score, ranking) for label in references if (score := ranking.of(label))]
    return f"The reference method: {'; '.join(clauses)}." if clauses and ranking.ranked else ""


def _reference_clause(score: MethodScore, ranking: Ranking) -> str:
    label = score.method
    if score not in ranking.ranked:
        return f"{label} is not ranked: {explain_unranked_score(score)}"
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
