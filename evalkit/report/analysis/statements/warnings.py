"""Warnings that limit a verdict: no ground truth, a single run, damaged data, scans that kept the initial guess."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from evalkit.metrics.validated import load_validation
from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import MAX_GUESSED, MethodScore, guessed_percent
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_bounds, join_words, strip_full_stop
from evalkit.results.run_record import RunRecord

LOST_SCANS = re.compile(r"^(?!reference).*\b(damaged|skipped|dropped)\b|^scans .*left out")
"""Notes on scans that reached no method; readers name them by these words."""
MAX_LOST_PERCENT = 1.0

MAX_SHORT_PERCENT = 50.0
"""From this share of relations (%) of less than 10 s on, what they measure is stated."""

MIN_NAMED_GUESSED = 10.0
"""From this share of scans (%) that keep the initial guess, a method is named."""


def warn_of_evidence(sequence: SequenceAnalysis, ranking: Ranking) -> list[str]:
    """Return sentences on the limits of the deciding metric."""
    excerpt_scans = sequence.all_runs[0].spec.sequence.excerpt_scans
    warnings = []
    short = find_short_percent(sequence, ranking)
    if short > MAX_SHORT_PERCENT:
        warnings.append(f"{short:.0f} % of these relations span less than 10 s: they measure local motion, not drift.")
    if decided_by_fit(ranking):
        limitations = strip_full_stop(ranking.metric.limitations)
        warnings.append(
            f"Without ground truth, {ranking.metric.label} decides: how well the scans fit the known map at the poses. "
            f"Limitations: {limitations}."
        )
    if decided_by_maps(ranking):
        limitations = strip_full_stop(ranking.metric.limitations)
        warnings.append(f"Without ground truth, {ranking.metric.label} compares maps only. Limitations: {limitations}.")
        validated = load_validation().agreement_of(ranking.metric.name)
        if validated is not None and validated.overall is not None:
            correlation = validated.overall
            warnings.append(
                f"Over {correlation.support} maps with a known error, its Spearman correlation with that error was "
                f"{correlation.value:.2f} (95\u00a0% interval {format_bounds(correlation)})."
            )
    score = next((one for one in ranking.ranked if one.spread and one.spread.kind == "perturbed"), None)
    if score is not None:
        warnings.append(
            f"The spread is that of {_describe_repetitions(score, excerpt_scans)} under small perturbations (a later "
            "start, fewer beams, noise at the resolution of the ranges, lengths of the methods changed by at most "
            "1\u00a0%), the same for all methods; another recording may differ by more."
        )
    return warnings


def find_short_percent(sequence: SequenceAnalysis, ranking: Ranking) -> float:
    """Return how many percent of all relations that decide span less than 10 s; 0 where others decide."""
    every = ranking.metric.name
    short = every.replace("_all_", "_short_")
    if ranking.metric.group != "relations" or short == every:
        return 0.0
    supports = [run.scores.by_metric for run in sequence.all_runs if run.result.is_complete]
    counts = [sum(own[name].support for own in supports if name in own) for name in (short, every)]
    return 100.0 * counts[0] / counts[1] if counts[1] else 0.0


def _describe_repetitions(score: MethodScore, excerpt_scans: int) -> str:
    count = len(score.values)
    if excerpt_scans:
        return f"{count} excerpts of {excerpt_scans:,} scans of this recording"
    return f"{count} runs of this recording, {'one as it is and the others' if None in score.seeds else 'all'}"


def warn_of_data(runs: Sequence[RunRecord]) -> str:
    """Return a sentence on scans damaged or left out, if they are more than 1 % of a run's scans; else "".

    The notes of an excerpt count scans of the whole recording, so its share is unknown.
    """
    worst: dict[str, tuple[int, float]] = {}
    for run in (one for one in runs if not one.spec.sequence.excerpt_scans):
        for name, count in run.result.notes.items():
            percent = 100.0 * count / max(run.result.expected, 1)
            if LOST_SCANS.search(name) and percent > worst.get(name, (0, MAX_LOST_PERCENT))[1]:
                worst[name] = (int(count), percent)
    if not worst:
        return ""
    listed = join_words(f"{count:,} {name} ({percent:.0f} % of the scans)" for name, (count, percent) in worst.items())
    return f"The data are damaged: {listed}."


def warn_of_processors(runs: Sequence[RunRecord]) -> str:
    """Return a sentence if times were measured on different processors; else ""."""
    timed = [run for run in runs if len(run.result.steps) and run.result.steps["wall_ns"].any()]
    by_processor: dict[str, list[str]] = defaultdict(list)
    for run in timed:
        by_processor[run.result.provenance.get("processor") or "an unknown processor"].append(run.method)
    if len(by_processor) < 2:
        return ""
    listed = join_words(
        f"{join_words(dict.fromkeys(methods))} on {processor}" for processor, methods in sorted(by_processor.items())
    )
    return f"Times were measured on different processors and cannot be compared: {listed}."


def warn_of_guesses(sequence: SequenceAnalysis) -> str:
    """Return sentences on methods that kept the initial guess on more than 10 % of the scans; else ""."""
    shares = {
        method: guessed_percent([run for run in own if run.result.is_complete]) for method, own in sequence.runs.items()
    }
    named = {method: share for method, share in shares.items() if share > MIN_NAMED_GUESSED}
    if not named:
        return ""
    listed = join_words(f"{method} on {share:.0f} % of the scans" for method, share in named.items())
    sentence = f"Methods that kept the initial guess: {listed}."
    unranked = [method for method, share in named.items() if share > MAX_GUESSED]
    return f"{sentence} Not ranked, because of too few registrations: {join_words(unranked)}." if unranked else sentence


def list_remarks(sequence: SequenceAnalysis) -> list[str]:
    """Return a sentence for each method with remarks: those of its first run with any, and how many runs have some."""
    sentences = []
    for method, own in sequence.runs.items():
        remarked = [run.result.remarks for run in own if run.result.remarks]
        if remarked:
            count = f" in {len(remarked)} of {len(own)} runs, for example" if len(own) > 1 else ""
            sentences.append(f"Remark of {method}{count}: {'; '.join(map(strip_full_stop, remarked[0]))}.")
    return sentences
