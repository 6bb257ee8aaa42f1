"""How each method stands over all data sets that count: where it leads, what it costs, and where it loses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.contests import Contest, Relative, compare, find_contests, select_counted
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.outcome import LED
from evalkit.report.analysis.statements.verdict import SequenceVerdict

MAX_NAMED = 3
"""More methods than these are counted, not named, in the title."""


@dataclass(frozen=True, slots=True)
class Standing:
    """One method over all data sets that count: best or tied on ``led`` of the ``counted`` where it takes part.

    ``cpu_ms``: CPU time a scan, the median over these data sets, or over all if none counts; None if not measured.
    ``relative``: against the method that all are compared with (`find_common`). ``left_out``: data sets on which its
    settings were chosen.
    """

    method: str
    led: int
    counted: int
    cpu_ms: float | None
    relative: Relative
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Tally:
    """The data sets that count, and how the methods stand over them, best first.

    ``winners``: the methods that lead most often. ``common``: the method that all are compared with. ``judged``: the
    rankings of all data sets with a verdict, whether they count or tell no method apart.
    """

    contests: tuple[Contest, ...]
    standings: tuple[Standing, ...]
    winners: tuple[str, ...]
    common: str
    judged: tuple[Ranking, ...]


@dataclass(frozen=True, slots=True)
class Loss:
    """A data set on which a method is clearly worse than the best: both errors in the unit of the metric."""

    sequence: str
    metric: Metric
    own: float
    best: float


def compute_tally(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]
) -> Tally:
    """Compute how the methods stand over the data sets that count."""
    contests = find_contests(comparison, sequences, verdicts)
    led = zip(sequences, verdicts, strict=True)
    judged = tuple(one.deciding for one, verdict in led if one.deciding is not None and verdict.outcome in LED)
    common = find_common(comparison, contests)
    standings = compute_standings(comparison, sequences, contests, common)
    return Tally(contests, standings, find_winners(standings, contests), common, judged)


def find_common(comparison: Comparison, contests: Sequence[Contest]) -> str:
    """Return the method that all are compared with: it has a value on most data sets; "" without any.

    Of several the reference method, else the one that leads most often, a baseline last.
    """

    def order(method: str) -> tuple[int, bool, bool, int]:
        values = sum(one.find_value(method) is not None for one in contests)
        role = comparison.methods[method].role
        return values, role == "reference", role != "baseline", sum(method in one.leaders for one in contests)

    return max(comparison.method_labels, key=order) if contests else ""


def compute_standings(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest], common: str
) -> tuple[Standing, ...]:
    """Return every method's standing, best first; ``common``: the method that all are compared with."""
    counted = select_counted(sequences, contests)
    standings = [
        Standing(
            method,
            sum(method in one.leaders for one in contests),
            sum(method in one.part for one in contests),
            find_cost(counted, method),
            compare(contests, method, common),
            tuple(one.sequence for one in contests if method in one.left_out),
        )
        for method in comparison.method_labels
    ]

    def order(one: Standing) -> tuple[int, float]:
        return -one.led, math.inf if one.relative.error is None else one.relative.error

    return tuple(sorted(standings, key=order))


def find_cost(sequences: Sequence[SequenceAnalysis], method: str) -> float | None:
    """Return the CPU time of a scan (ms), the median over sequences; None if it was not measured."""
    scores = [s.rankings[COST].of(method) for s in sequences if COST in s.rankings]
    known = [score.median for score in scores if score is not None and score.median is not None]
    return median(known) if known else None


def find_winners(standings: Sequence[Standing], contests: Sequence[Contest]) -> tuple[str, ...]:
    """Return the methods that lead most often; none if they are all that take part."""
    most = max((one.led for one in standings), default=0)
    winners = tuple(one.method for one in standings if one.led == most) if most else ()
    part = {score.method for one in contests for score in one.ranked}
    return winners if len(winners) < len(part) else ()


def find_cheapest(comparison: Comparison, standings: Sequence[Standing], winners: Sequence[str]) -> Standing | None:
    """Return the cheapest of several winners, else of all methods but baselines; None if several cost the same.

    Compared by CPU time on the same data sets.
    """
    baselines = comparison.methods_with_role("baseline")
    considered = [
        (one.relative.cpu, one)
        for one in standings
        if one.relative.cpu is not None and (one.method in winners if len(winners) > 1 else one.method not in baselines)
    ]
    if not winners or len(considered) < 2:
        return None
    least = min(cpu for cpu, _ in considered)
    cheapest = [one for cpu, one in considered if cpu < least * (1.0 + 1e-9)]
    return cheapest[0] if len(cheapest) == 1 else None


def find_lost(
    sequences: Sequence[SequenceAnalysis], winners: Sequence[str]
) -> tuple[tuple[str, MethodScore], ...]:  # fmt: skip
    """Return the sequences on which a winner lost the track, with its score, where the geometry does not explain it."""
    deciding = [(one.label, one.deciding) for one in sequences if one.deciding is not None and not one.card.degenerate]
    return tuple(
        (label, score)
        for winner in winners
        for label, ranking in deciding
        if (score := ranking.of(winner)) is not None and score.lost is not None
    )


def find_losses(winner: str, contests: Sequence[Contest]) -> tuple[Loss, ...]:
    """Return where the winner is clearly worse than the best, the largest ratio first."""
    losses = []
    for one in contests:
        own = next((score for score in one.ranked if score.method == winner), None)
        if own is not None and mark(one.ranking, winner) == "worse" and not one.by_maps:
            losses.append(Loss(one.sequence, one.metric, median(own.values), median(one.ranked[0].values)))
    return tuple(sorted(losses, key=lambda loss: -abs(math.log(max(loss.own, 1e-9) / max(loss.best, 1e-9)))))
