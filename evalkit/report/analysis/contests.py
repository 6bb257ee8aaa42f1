"""The data sets that count, and two methods compared over them."""

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


def select_counted(sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest]) -> Sequence[SequenceAnalysis]:
    """Return the sequences that count, whose errors and times the answer states; all if none counts."""
    names = {one.sequence for one in contests}
    return [sequence for sequence in sequences if sequence.label in names] or sequences


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
