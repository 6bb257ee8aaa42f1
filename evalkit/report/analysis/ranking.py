"""Rankings of the methods over one sequence: one ranking a metric, and the paired differences where it matters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from evalkit.metrics.metric import Group, Metric
from evalkit.metrics.series import SERIES
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.pairwise import PairedDifference, Separation, compute_difference, is_tied, separation
from evalkit.report.analysis.record_bootstrap import RecordBootstrap
from evalkit.report.analysis.scores import DECIDING, MethodScore, compute_score
from evalkit.results.run_record import RunRecord

WITHOUT_BASELINE: tuple[Group, ...] = ("residuals", "runtime")
"""Groups in which the baseline is not ranked, because it does no registration."""

WHY_NOT_CLEAR: Mapping[Separation, str] = {
    "within the noise floor": "less than the accuracy of the ground truth",
    "within the margin": "too small to matter",
    "one run": "one run, no verdict",
    "not shown": "no difference shown",
}

Mark = Literal["best", "tied", "undecided", "worse", "lost", "not comparable"]
"""How a method stands in one metric of one sequence, for every output."""

MAX_LONG_M = 1.0
"""Long relations with a larger mean error in every method compare lost tracks: short relations decide then."""


@dataclass(frozen=True, slots=True)
class Ranking:
    """One metric over one sequence.

    ``scores``: of all methods. ``ranked``: the rankable ones, best first. ``tied``: the best and those that do not
    differ clearly from it. ``near``: those of them that are close to the best; they are called tied. ``why_tied``: the
    reason of the first tie, "clear" without a tie. ``comparable``: False if the geometry does not determine the pose,
    or the map metrics that decide disagree. ``outvoted``: where maps decide, the tied methods that are not best or tied
    in every map metric.
    """

    sequence: str
    metric: Metric
    scores: tuple[MethodScore, ...]
    ranked: tuple[MethodScore, ...]
    tied: tuple[MethodScore, ...]
    near: tuple[MethodScore, ...]
    why_tied: Separation
    comparable: bool = True
    outvoted: tuple[str, ...] = ()

    @property
    def repeated(self) -> bool:
        """Whether the ranked methods ran more than once: only then are there a winner and ties."""
        return sum(len(score.values) > 1 for score in self.ranked) > 1

    @property
    def winner(self) -> MethodScore | None:
        """The method clearly better than every other ranked one; None for a tie or a single ranked method."""
        return self.tied[0] if len(self.tied) == 1 and len(self.ranked) > 1 else None

    @property
    def has_values(self) -> bool:
        """Whether any run has a value, including runs that ended early."""
        return any(score.values or score.partial for score in self.scores)

    def of(self, method: str) -> MethodScore | None:
        """Return the score of a method; None if it did not run over this sequence."""
        return next((score for score in self.scores if score.method == method), None)


def mark(ranking: Ranking, method: str) -> Mark:
    """Return how a method stands in a ranking: the one rule for page, terminal and exports.

    "best": clearly better than every other ranked method. "tied": the best value, or close to it without a clear
    difference. "undecided": farther from it, but these runs do not show the difference; or outvoted. "worse": clearly
    worse than the best value. "lost": it lost the track. "not comparable": no complete value, a single run, a single
    method, settings chosen on this data set, no better direction, or a sequence without a ranking.
    """
    score = ranking.of(method)
    if score is not None and score.lost is not None:
        return "lost"
    if score not in ranking.ranked or not ranking.repeated or not ranking.comparable:
        return "not comparable"
    if ranking.winner is score:
        return "best"
    if score in ranking.tied:
        if separation(ranking.metric, ranking.ranked[0], score) == "one run":
            return "not comparable"
        return "tied" if score in ranking.near and method not in ranking.outvoted else "undecided"
    return "worse"


@dataclass(frozen=True, slots=True)
class PairwiseEntry:
    """A method against a reference: how much worse it is (below zero: better), and the verdict in words."""

    difference: PairedDifference | None
    verdict: str


@dataclass(frozen=True, slots=True)
class PairwiseTable:
    """The ranked methods of a sequence (rows) against references (columns), in the metric that decides it."""

    metric: Metric
    references: tuple[str, ...]
    rows: tuple[tuple[str, tuple[PairwiseEntry | None, ...]], ...]


def compute_rankings(comparison: Comparison, sequence: str) -> dict[str, Ranking]:
    """Rank the methods of one sequence in every metric; the result is by the metric's name."""
    runs = comparison.runs_by_method(sequence)
    bootstrap = RecordBootstrap([run for own in runs.values() for run in own], SERIES)
    return {metric.name: _compute_ranking(comparison, runs, metric, bootstrap) for metric in comparison.metrics}


def rank_scores(metric: Metric, scores: Iterable[MethodScore]) -> tuple[MethodScore, ...]:
    """Return the rankable scores, best first; none if the metric has no better direction."""
    if not metric.better:
        return ()
    return tuple(sorted((one for one in scores if one.rankable), key=lambda one: metric.sign * median(one.values)))


def find_deciding(rankings: Mapping[str, Ranking]) -> Ranking | None:
    """Return the ranking that decides a sequence: the first headline metric, by strength of evidence, with a value."""
    headline = [one for one in rankings.values() if one.metric.headline and one.metric.better]
    if _is_long_lost(rankings.get("relations_long_mean_m")):
        headline.sort(key=lambda one: "_short_" not in one.metric.name)
    for group in DECIDING:
        for ranking in headline:
            if ranking.metric.group == group and any(score.values for score in ranking.scores):
                return ranking
    return None


def _is_long_lost(ranking: Ranking | None) -> bool:
    """Return whether every method has lost the relations over long times, so that they only compare lost tracks."""
    medians = [score.median for score in ranking.scores if score.median is not None] if ranking else []
    return bool(medians) and min(medians) > MAX_LONG_M


def compute_pairwise(ranking: Ranking | None, references: Sequence[str]) -> PairwiseTable | None:
    """Compute the differences from the best and from the reference method; None with fewer than two ranked methods."""
    if ranking is None or len(ranking.ranked) < 2:
        return None
    ranked = [label for label in references if ranking.of(label) in ranking.ranked]
    compared = tuple(dict.fromkeys([ranking.ranked[0].method, *ranked[:1]]))
    rows = tuple(
        (score.method, tuple(_compute_entry(ranking, score, reference) for reference in compared))
        for score in ranking.ranked
    )
    return PairwiseTable(ranking.metric, compared, rows)


def _compute_ranking(
    comparison: Comparison, runs: Mapping[str, Sequence[RunRecord]], metric: Metric, bootstrap: RecordBootstrap
) -> Ranking:
    scores = tuple(
        compute_score(own, metric, bootstrap, own[0].spec.sequence.dataset in comparison.methods[method].tuned_on)
        for method, own in runs.items()
    )
    excluded = comparison.methods_with_role("baseline") if metric.group in WITHOUT_BASELINE else ()
    ranked = rank_scores(metric, (score for score in scores if score.method not in excluded))
    apart: list[Separation] = [separation(metric, ranked[0], score) for score in ranked[1:]]
    ties: list[tuple[MethodScore, Separation]] = [
        (score, why) for score, why in zip(ranked[1:], apart, strict=True) if why != "clear"
    ]
    sequence = next(iter(runs.values()))[0].sequence
    tied = (*ranked[:1], *(score for score, _ in ties))
    comparable = not comparison.sequences[sequence].degenerate
    near = (*ranked[:1], *(score for score, why in ties if is_tied(metric, why, ranked[0], score)))
    return Ranking(sequence, metric, scores, ranked, tied, near, ties[0][1] if ties else "clear", comparable)


def _compute_entry(ranking: Ranking, score: MethodScore, reference: str) -> PairwiseEntry | None:
    other = ranking.of(reference)
    if other is None or other is score:
        return None
    metric = ranking.metric
    difference = compute_difference(score, other) if metric.better == "lower" else compute_difference(other, score)
    apart = separation(metric, score, other)
    if apart == "clear" and difference is not None:
        return PairwiseEntry(difference, "worse" if difference.interval.value > 0.0 else "better")
    return PairwiseEntry(difference, WHY_NOT_CLEAR.get(apart, "no difference shown"))
