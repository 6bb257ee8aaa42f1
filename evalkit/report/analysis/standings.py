"""How each method stands over all data sets that count: where it leads, what it costs, and where it loses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import decided_by_maps
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.verdict import LED, SequenceVerdict

MAX_NAMED = 3
"""More methods than these are counted, not named, in the title."""


@dataclass(frozen=True, slots=True)
class Contest:
    """One data set that counts.

    ``ranked``: methods that count there, best first; ``leaders``: the best and those without a clear difference.
    ``left_out``: methods with a value whose settings were chosen there.
    """

    sequence: str
    ranking: Ranking
    ranked: tuple[MethodScore, ...]
    leaders: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def metric(self) -> Metric:
        """The metric that decides the data set."""
        return self.ranking.metric


@dataclass(frozen=True, slots=True)
class Standing:
    """One method over all data sets that count: best or tied on ``led`` of the ``counted`` where it takes part.

    ``cpu_ms``: CPU time a scan, the median over these data sets, or over all if none counts; None if not measured.
    ``ratio``: geometric mean of its
    error divided by the best one's, over the data sets where it has one; None without any. ``left_out``: data sets on
    which its settings were chosen.
    """

    method: str
    led: int
    counted: int
    cpu_ms: float | None
    ratio: float | None
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Loss:
    """A data set on which a method is clearly worse than the best: both errors in the unit of the metric."""

    sequence: str
    metric: Metric
    own: float
    best: float


def find_contest(sequence: SequenceAnalysis, verdict: SequenceVerdict) -> Contest | None:
    """Return the contest on a sequence; None if it has no verdict, or fewer than two methods count there.

    A sequence on which some methods are undecided and none is worse has no verdict; without ground truth, unless maps
    set some of the methods apart.
    """
    ranking = sequence.deciding
    if ranking is None or verdict.outcome not in LED:
        return None
    marks = {mark(ranking, score.method) for score in ranking.ranked}
    all_lead = len(verdict.leaders) == len(ranking.ranked) or not decided_by_maps(ranking)
    if "undecided" in marks and "worse" not in marks and all_lead:
        return None
    left_out = tuple(score.method for score in ranking.scores if score.tuned and score.values)
    return Contest(sequence.label, ranking, ranking.ranked, verdict.leaders, left_out) if verdict.leaders else None


def compute_standings(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest]
) -> tuple[Standing, ...]:
    """Return every method's standing, best first."""
    counted = select_counted(sequences, contests)
    standings = [
        Standing(
            method,
            sum(method in one.leaders for one in contests),
            sum(method not in one.left_out and one.ranking.of(method) is not None for one in contests),
            find_cost(counted, method),
            compute_ratio(contests, method),
            tuple(one.sequence for one in contests if method in one.left_out),
        )
        for method in comparison.method_labels
    ]
    return tuple(sorted(standings, key=lambda one: (-one.led, math.inf if one.ratio is None else one.ratio)))


def select_counted(sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest]) -> Sequence[SequenceAnalysis]:
    """Return the sequences that count, whose errors and times the answer states; all if none counts."""
    names = {one.sequence for one in contests}
    return [sequence for sequence in sequences if sequence.label in names] or sequences


def find_cost(sequences: Sequence[SequenceAnalysis], method: str) -> float | None:
    """Return the CPU time of a scan (ms), the median over sequences; None if it was not measured."""
    scores = [s.rankings[COST].of(method) for s in sequences if COST in s.rankings]
    known = [score.median for score in scores if score is not None and score.median is not None]
    return median(known) if known else None


def compute_ratio(contests: Sequence[Contest], method: str, other: str = "") -> float | None:
    """Return the geometric mean of the error divided by another method's ("": the best one's), where both have one."""
    logarithms = []
    for one in contests:
        by_method = {score.method: score for score in one.ranked}
        pair = by_method.get(method), by_method.get(other) if other else one.ranked[0]
        if pair[0] is not None and pair[1] is not None:
            own, reference = (max(median(score.values), 1e-9) for score in pair if score is not None)
            logarithms.append(math.log(own / reference) * (1.0 if one.metric.better == "lower" else -1.0))
    return math.exp(sum(logarithms) / len(logarithms)) if logarithms else None


def find_winners(standings: Sequence[Standing], contests: Sequence[Contest]) -> tuple[str, ...]:
    """Return the methods that lead most often; none if they are too many to name or all that take part."""
    most = max((one.led for one in standings), default=0)
    winners = tuple(one.method for one in standings if one.led == most) if most else ()
    part = {score.method for one in contests for score in one.ranked}
    return winners if len(winners) < len(part) and len(winners) <= MAX_NAMED else ()


def find_cheapest(comparison: Comparison, standings: Sequence[Standing], winners: Sequence[str]) -> Standing | None:
    """Return the cheapest of several winners, else of all methods but baselines; None if several cost the same."""
    baselines = comparison.methods_with_role("baseline")
    considered = [
        one
        for one in standings
        if one.cpu_ms is not None and (one.method in winners if len(winners) > 1 else one.method not in baselines)
    ]
    if not winners or len(considered) < 2:
        return None
    least = min(one.cpu_ms or 0.0 for one in considered)
    cheapest = [one for one in considered if one.cpu_ms == least]
    return cheapest[0] if len(cheapest) == 1 else None


def find_losses(winner: str, contests: Sequence[Contest]) -> tuple[Loss, ...]:
    """Return where the winner is clearly worse than the best, the largest ratio first."""
    losses = []
    for one in contests:
        own = next((score for score in one.ranked if score.method == winner), None)
        if own is not None and winner not in one.leaders and not decided_by_maps(one.ranking):
            losses.append(Loss(one.sequence, one.metric, median(own.values), median(one.ranked[0].values)))
    return tuple(sorted(losses, key=lambda loss: -abs(math.log(max(loss.own, 1e-9) / max(loss.best, 1e-9)))))
