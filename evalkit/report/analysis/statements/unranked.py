"""Why methods are not ranked: a lost track, settings chosen on these data, runs that did not finish."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from evalkit.core.run_status import NOT_EXECUTED
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_losses, join_words, name_or_count, strip_full_stop

MAX_UNRANKED = 4
"""More methods that are not ranked for one cause are counted, not named."""

CAUSES: Mapping[str, tuple[str, str]] = {
    "tuned": ("settings of {} were chosen on these data", "its settings were chosen on these data"),
    "lost": ("{} lost the track", "it lost the track"),
    "guessed": ("{} registered too few scans", "it registered too few scans"),
    "unfinished": ("{} did not complete every run with a value", "{0.complete} of {0.expected} runs finished"),
    "absent": ("{} did not run", "it did not run"),
}
"""Clauses on all methods that are not ranked for a cause, and on a single one, in the order of the former."""


def describe_lost(ranking: Ranking) -> str:
    """Return which methods lost the track, when and why; "" if none did."""
    lost = [
        f"{score.method} {format_losses(score)} ({strip_full_stop(score.lost.reason)})"
        for score in ranking.scores
        if score.lost is not None
    ]
    return f"Lost the track and not ranked: {join_words(lost)}." if lost else ""


def describe_tuned(ranking: Ranking) -> str:
    """Return which methods have settings that were chosen on these data; "" if none."""
    tuned = [score.method for score in ranking.scores if score.tuned and score.values]
    return f"Not ranked, because settings were chosen on these data: {join_words(tuned)}." if tuned else ""


def explain_unranked(sequences: Sequence[SequenceAnalysis]) -> str:
    """Return why methods are not ranked: "settings of a and b were chosen on these data; c lost the track"; "" if none.

    A method that is ranked nowhere is named once, by its first cause.
    """
    causes: dict[str, list[str]] = {cause: [] for cause in CAUSES}
    named = {score.method for one in sequences if one.deciding for score in one.deciding.ranked}
    for sequence in sequences:
        for score in sequence.deciding.scores if sequence.deciding else ():
            if not score.rankable and score.method not in named:
                absent = all(run.result.status in NOT_EXECUTED for run in sequence.runs[score.method])
                causes["absent" if absent else _find_cause(score)].append(score.method)
                named.add(score.method)
    return "; ".join(
        CAUSES[cause][0].format(name_or_count(methods, MAX_UNRANKED)) for cause, methods in causes.items() if methods
    )


def explain_unranked_score(score: MethodScore) -> str:
    """Return why a single method is not ranked: "it lost the track"."""
    return CAUSES[_find_cause(score)][1].format(score)


def _find_cause(score: MethodScore) -> str:
    """Return the first cause for which a score is not ranked."""
    if not score.whole:
        return "unfinished" if score.expected else "absent"
    return "lost" if score.lost is not None else "tuned" if score.registers else "guessed"
