"""How each method stands over all data sets that count: where it leads, what it costs, and where it loses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.core.run_status import BROKEN, NOT_EXECUTED
from evalkit.metrics.metric import Metric
from evalkit.metrics.runtime import COST
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.outcome import LED
from evalkit.report.analysis.statements.verdict import SequenceVerdict

MAX_NAMED = 3
"""More methods than these are counted, not named, in the title."""


@dataclass(frozen=True, slots=True)
class Contest:
    """One data set that counts.

    ``ranked``: methods that are ranked there, best first; ``leaders``: the best and those without a clear difference.
    ``part``: methods with a run that started there and settings that were not chosen there. ``left_out``: methods with
    a value whose settings were chosen there. ``tells_apart``: not all tied. ``costs``: the ranking by CPU time, None if
    it was not measured.
    """

    sequence: str
    ranking: Ranking
    ranked: tuple[MethodScore, ...]
    leaders: tuple[str, ...]
    part: tuple[str, ...]
    left_out: tuple[str, ...]
    tells_apart: bool
    costs: Ranking | None = None

    @property
    def metric(self) -> Metric:
        """The metric that decides the data set."""
        return self.ranking.metric

    @property
    def by_fit(self) -> bool:
        """Whether the fit to a known map decides the data set, without ground truth."""
        return decided_by_fit(self.ranking)

    @property
    def by_maps(self) -> bool:
        """Whether the maps drawn alone decide the data set, without ground truth."""
        return decided_by_maps(self.ranking)

    def was_tuned(self, method: str) -> bool:
        """Whether settings of a method were chosen here."""
        score = self.ranking.of(method)
        return score is not None and score.tuned

    def find_value(self, method: str) -> float | None:
        """Return the error of a method that takes part and completed every run, whether it kept the track or not."""
        score = self.ranking.of(method) if method in self.part else None
        return max(median(score.values), 1e-9) if score is not None and score.whole else None

    def find_cpu_ms(self, method: str) -> float | None:
        """Return the CPU time of a scan (ms); None if it was not measured."""
        score = self.costs.of(method) if self.costs is not None else None
        return None if score is None else score.median


@dataclass(frozen=True, slots=True)
class Relative:
    """A method against another one, over the ``shared`` data sets that count on which both have a value.

    ``error``, ``cpu``: geometric means of its error and of its CPU time divided by the other's; None without any.
    """

    shared: int = 0
    error: float | None = None
    cpu: float | None = None


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
    relative: Relative = Relative()
    left_out: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Tally:
    """The data sets that count, and how the methods stand over them, best first.

    ``winners``: the methods that lead most often. ``common``: the method that all are compared with.
    """

    contests: tuple[Contest, ...]
    standings: tuple[Standing, ...]
    winners: tuple[str, ...]
    common: str


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
    common = find_common(comparison, contests)
    standings = compute_standings(comparison, sequences, contests, common)
    return Tally(contests, standings, find_winners(standings, contests), common)


def find_contests(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]
) -> tuple[Contest, ...]:
    """Return the contests with the strongest evidence: ground truth, else a known map, else the maps drawn.

    One on which all are tied tells none apart, and does not count beside others. None if a single method is ranked.
    """
    by_evidence: tuple[list[Contest], ...] = ([], [], [])
    for sequence, verdict in zip(sequences, verdicts, strict=True):
        if (one := _find_contest(comparison, sequence, verdict)) is not None:
            by_evidence[2 if one.by_maps else one.by_fit].append(one)
    found: list[Contest] = next(filter(None, by_evidence), [])
    if len({score.method for one in found for score in one.ranked}) < 2:
        return ()
    return tuple([one for one in found if one.tells_apart] or found)


def _find_contest(
    comparison: Comparison, sequence: SequenceAnalysis, verdict: SequenceVerdict
) -> Contest | None:  # fmt: skip
    """Return the contest on a sequence; None if it has no verdict, or fewer than two methods count there.

    A sequence on which some methods are undecided and none is worse has no verdict; without ground truth, unless maps
    set some of the methods apart. A single ranked method leads where it holds alone (`holds_alone`).
    """
    ranking = sequence.deciding
    alone = verdict.outcome == "single" and holds_alone(comparison, sequence)
    if ranking is None or not (alone or verdict.outcome in LED):
        return None
    leaders = (ranking.ranked[0].method,) if alone else verdict.leaders
    marks = {mark(ranking, score.method) for score in ranking.ranked}
    all_lead = len(leaders) == len(ranking.ranked) or not decided_by_maps(ranking)
    if not leaders or ("undecided" in marks and "worse" not in marks and all_lead):
        return None
    started = {run.method for run in sequence.all_runs if run.result.status not in NOT_EXECUTED}
    part = tuple(score.method for score in ranking.scores if score.method in started and not score.tuned)
    left_out = tuple(score.method for score in ranking.scores if score.tuned and score.values)
    apart, costs = not verdict.all_tied, sequence.rankings.get(COST)
    return Contest(sequence.label, ranking, ranking.ranked, leaders, part, left_out, apart, costs)


def holds_alone(comparison: Comparison, sequence: SequenceAnalysis) -> bool:
    """Return whether the one ranked method ran more than once, and another one failed or lost the track.

    The other one is no baseline, and its settings were not chosen there. Maps drawn alone do not count.
    """
    ranking = sequence.deciding
    if ranking is None or decided_by_maps(ranking) or len(ranking.ranked[0].values) < 2:
        return False
    baselines = comparison.methods_with_role("baseline")
    others = [one for one in ranking.scores if one not in ranking.ranked and one.method not in baselines]
    broken = {run.method for run in sequence.all_runs if run.result.status in BROKEN}
    return any((one.lost is not None or one.method in broken) and not one.tuned for one in others)


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


def select_counted(sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest]) -> Sequence[SequenceAnalysis]:
    """Return the sequences that count, whose errors and times the answer states; all if none counts."""
    names = {one.sequence for one in contests}
    return [sequence for sequence in sequences if sequence.label in names] or sequences


def find_cost(sequences: Sequence[SequenceAnalysis], method: str) -> float | None:
    """Return the CPU time of a scan (ms), the median over sequences; None if it was not measured."""
    scores = [s.rankings[COST].of(method) for s in sequences if COST in s.rankings]
    known = [score.median for score in scores if score is not None and score.median is not None]
    return median(known) if known else None


def compare(contests: Sequence[Contest], method: str, other: str) -> Relative:
    """Compare error and CPU time of two methods over the data sets that count on which both have a value."""
    errors, times = [], []
    for one in contests:
        own, its = one.find_value(method), one.find_value(other)
        if own is None or its is None:
            continue
        errors.append(one.metric.sign * math.log(own / its))
        spent = one.find_cpu_ms(method), one.find_cpu_ms(other)
        if spent[0] and spent[1]:
            times.append(math.log(spent[0] / spent[1]))
    return Relative(len(errors), _compute_geometric_mean(errors), _compute_geometric_mean(times))


def count_led_of_shared(contests: Sequence[Contest], methods: Sequence[str]) -> tuple[int, tuple[int, ...]]:
    """Return on how many data sets all of these methods take part, and on how many of those each of them leads."""
    shared = [one for one in contests if set(methods) <= set(one.part)]
    return len(shared), tuple(sum(method in one.leaders for one in shared) for method in methods)


def find_mean_cpu_ms(contests: Sequence[Contest], method: str) -> float | None:
    """Return the CPU time of a scan (ms), the geometric mean over the data sets on which a method has a value."""
    found = [one.find_cpu_ms(method) for one in contests if one.find_value(method) is not None]
    return _compute_geometric_mean([math.log(cpu_ms) for cpu_ms in found if cpu_ms])


def _compute_geometric_mean(logarithms: Sequence[float]) -> float | None:
    return math.exp(sum(logarithms) / len(logarithms)) if logarithms else None


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
