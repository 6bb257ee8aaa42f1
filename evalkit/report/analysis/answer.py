"""The answer of a comparison: which method to take, what it costs, where it loses, and what limits the answer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from evalkit.metrics.table import Metric
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import decided_by_maps
from evalkit.report.analysis.pills import Pill, compute_pills
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.verdict import LED, SequenceVerdict
from evalkit.report.formatting import format_amount, format_milliseconds, join_words
from evalkit.stats.runs import FEW_RUNS

COST = "cpu_median_ms"
"""The metric of the cost of a scan."""

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

    ``cpu_ms``: CPU time a scan, the median over all sequences; None if not measured. ``ratio``: geometric mean of its
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


@dataclass(frozen=True, slots=True)
class Answer:
    """What title and terminal say.

    ``title``: one sentence that contains ``emphasis`` (the winners by name, "" without any). ``subtitle``: cost, losses
    and the cheapest method. ``winners``: best or tied on most data sets, none if no method is ahead. ``runner_up``: the
    next one. ``cheapest``: of the winners if there are several, else of all methods that are not a baseline.
    ``standings``: every method, best first. ``by_maps``: no data set has ground truth; maps alone are compared.
    """

    title: str
    emphasis: str
    subtitle: str
    pills: tuple[Pill, ...]
    winners: tuple[str, ...]
    runner_up: Standing | None
    cheapest: Standing | None
    losses: tuple[Loss, ...]
    standings: tuple[Standing, ...]
    contests: tuple[Contest, ...]
    by_maps: bool

    def standing(self, method: str) -> Standing:
        """Return the standing of a method."""
        return next(one for one in self.standings if one.method == method)


def compute_answer(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]
) -> Answer:
    """Compute the answer over the data sets with ground truth, or without any over those decided by maps."""
    found = [_find_contest(*pair) for pair in zip(sequences, verdicts, strict=True)]
    contests = [one for one in found if one is not None]
    by_maps = bool(contests) and all(decided_by_maps(one.ranking) for one in contests)
    contests = contests if by_maps else [one for one in contests if not decided_by_maps(one.ranking)]
    standings = _compute_standings(comparison, sequences, contests)
    winners = _find_winners(standings, contests)
    others = [one for one in standings if one.method not in winners and one.counted]
    runner_up = others[0] if winners and others else None
    cheapest = _find_cheapest(comparison, standings, winners)
    losses = _find_losses(winners[0], contests) if len(winners) == 1 else ()
    return Answer(
        _format_title(standings, contests, winners, runner_up)
        if contests
        else _explain_no_contest(sequences, verdicts),
        " or ".join(winners),
        _format_subtitle([one for one in standings if one.method in winners], contests, losses, cheapest),
        compute_pills(comparison, sequences, verdicts, {one.sequence for one in contests}),
        winners,
        runner_up,
        cheapest,
        losses,
        standings,
        tuple(contests),
        by_maps,
    )


def _find_contest(sequence: SequenceAnalysis, verdict: SequenceVerdict) -> Contest | None:
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


def _compute_standings(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], contests: Sequence[Contest]
) -> tuple[Standing, ...]:
    standings = [
        Standing(
            method,
            sum(method in one.leaders for one in contests),
            sum(method not in one.left_out and one.ranking.of(method) is not None for one in contests),
            _find_cost(sequences, method),
            _compute_ratio(contests, method),
            tuple(one.sequence for one in contests if method in one.left_out),
        )
        for method in comparison.method_labels
    ]
    return tuple(sorted(standings, key=lambda one: (-one.led, math.inf if one.ratio is None else one.ratio)))


def _find_cost(sequences: Sequence[SequenceAnalysis], method: str) -> float | None:
    scores = [s.rankings[COST].of(method) for s in sequences if COST in s.rankings]
    known = [score.median for score in scores if score is not None and score.median is not None]
    return median(known) if known else None


def _compute_ratio(contests: Sequence[Contest], method: str, other: str = "") -> float | None:
    """Return the geometric mean of the error divided by another method's ("": the best one's), where both have one."""
    logarithms = []
    for one in contests:
        by_method = {score.method: score for score in one.ranked}
        pair = by_method.get(method), by_method.get(other) if other else one.ranked[0]
        if pair[0] is not None and pair[1] is not None:
            own, reference = (max(median(score.values), 1e-9) for score in pair if score is not None)
            logarithms.append(math.log(own / reference) * (1.0 if one.metric.better == "lower" else -1.0))
    return math.exp(sum(logarithms) / len(logarithms)) if logarithms else None


def _find_winners(standings: Sequence[Standing], contests: Sequence[Contest]) -> tuple[str, ...]:
    """Return the methods that lead most often; none if they are too many to name or all that take part."""
    most = max((one.led for one in standings), default=0)
    winners = tuple(one.method for one in standings if one.led == most) if most else ()
    part = {score.method for one in contests for score in one.ranked}
    return winners if len(winners) < len(part) and len(winners) <= MAX_NAMED else ()


def _find_cheapest(comparison: Comparison, standings: Sequence[Standing], winners: Sequence[str]) -> Standing | None:
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


def _find_losses(winner: str, contests: Sequence[Contest]) -> tuple[Loss, ...]:
    """Return where the winner is clearly worse than the best, the largest ratio first."""
    losses = []
    for one in contests:
        own = next((score for score in one.ranked if score.method == winner), None)
        if own is not None and winner not in one.leaders and not decided_by_maps(one.ranking):
            losses.append(Loss(one.sequence, one.metric, median(own.values), median(one.ranked[0].values)))
    return tuple(sorted(losses, key=lambda loss: -abs(math.log(max(loss.own, 1e-9) / max(loss.best, 1e-9)))))


def _format_title(
    standings: Sequence[Standing], contests: Sequence[Contest], winners: Sequence[str], runner_up: Standing | None
) -> str:
    """Return the title over at least one contest."""
    first, by_maps = standings[0], decided_by_maps(contests[0].ranking)
    if not winners:
        part = {score.method for one in contests for score in one.ranked}
        count = sum(one.led == first.led for one in standings)
        who = f"all {len(part)} methods are" if count == len(part) else f"{count} methods are each"
        if len(contests) == 1:
            return f"No method is ahead: {who} tied on {contests[0].sequence}."
        return f"No method is ahead: {who} best or tied on {first.led} of {len(contests)} data sets."
    names = " or ".join(winners)
    if len(contests) == 1:
        return _format_single(names, len(winners) > 1, contests[0], by_maps)
    counted = first.counted if len(winners) == 1 else len(contests)
    best = f"{'each ' * (len(winners) > 1)}{'the best map' if by_maps else 'best or tied'}"
    rest = "" if runner_up is None else f"; next best {runner_up.led} of {runner_up.counted}"
    kind = f"{'recording' if by_maps else 'data set'}{'s' if counted != 1 else ''}"
    return f"Take {names}: {best} on {first.led} of {counted} {kind}{rest}."


def _format_single(names: str, tied: bool, contest: Contest, by_maps: bool) -> str:
    """Return the title over a single data set with winners."""
    if by_maps:
        return f"Take {names}: the best map of {contest.sequence}, which has no ground truth."
    if tied:
        return f"Take {names}: tied for the best on {contest.sequence}."
    others = [one.method for one in contest.ranking.tied if one not in contest.ranking.near]
    if not others:
        return f"Take {names}: best on {contest.sequence}."
    who = join_words(others) if len(others) <= MAX_NAMED else f"{len(others)} others"
    return f"Take {names}: ahead on {contest.sequence}, but not told apart from {who} by these runs."


def _explain_no_contest(sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]) -> str:
    """Return why no method is ahead or ranked."""
    outcomes = {verdict.outcome for verdict in verdicts}
    ranked = {score.method for s in sequences if s.deciding is not None for score in s.deciding.ranked}
    degenerate = join_words(v.sequence for v in verdicts if v.outcome == "degenerate")
    reasons = (
        (all(sequence.none_finished for sequence in sequences), "No run finished: there is no answer."),
        (outcomes == {"lost"}, "No method held the track: there is no answer."),
        (len(ranked) == 1, f"Only {join_words(ranked)} is ranked: there is no other method to compare it with."),
        (not ranked, "No method is ranked: none completed every run with a value of the deciding metric."),
        ("disagreement" in outcomes, "No method is ahead: without ground truth, the map metrics disagree."),
        (
            outcomes <= {"degenerate", "unranked"},
            f"No method is ranked: the geometry of {degenerate} does not determine the pose.",
        ),
        (bool(outcomes & set(LED)), "No method is ahead: too few runs to tell the methods apart."),
        (
            all(run.seed is None for sequence in sequences for run in sequence.all_runs),
            f"No method is ahead: a verdict takes {FEW_RUNS} runs of a recording (nuisance = {FEW_RUNS - 1}).",
        ),
        (True, "No method is ahead: a verdict takes repeated runs."),
    )
    return next(text for holds, text in reasons if holds)


def _format_subtitle(
    winners: Sequence[Standing], contests: Sequence[Contest], losses: Sequence[Loss], cheapest: Standing | None
) -> str:
    if not winners:
        return ""
    costs = {one.method: format_milliseconds(one.cpu_ms) for one in winners if one.cpu_ms is not None}
    sentences = []
    if len(winners) == 1 and costs:
        sentences.append(f"{costs[winners[0].method]} a scan here.")
    elif costs:
        sentences.append(f"A scan takes {join_words(f'{text} with {method}' for method, text in costs.items())}.")
    if len(winners) == 1 and len(contests) == 1 and not decided_by_maps(contests[0].ranking):
        metric, (best, second) = contests[0].metric, contests[0].ranked[:2]
        figures = [format_amount(metric, median(score.values)) for score in (best, second)]
        sentences.append(f"{figures[0]} against {figures[1]} of {second.method}.")
    elif len(winners) == 1 and losses:
        sentences.append(_format_losses(losses))
    if cheapest is not None:
        sentences.append(_format_cheapest(cheapest, winners, contests))
    return " ".join(filter(None, sentences))


def _format_losses(losses: Sequence[Loss]) -> str:
    told = [
        f"{loss.sequence} ({format_amount(loss.metric, loss.own)} against {format_amount(loss.metric, loss.best)})"
        for loss in losses
    ]
    if len(told) == 1:
        return f"It loses only {told[0]}."
    return f"It loses {join_words(told)}." if len(told) == 2 else f"It loses {len(told)}, most of all {told[0]}."


def _format_cheapest(cheapest: Standing, winners: Sequence[Standing], contests: Sequence[Contest]) -> str:
    if len(winners) > 1:
        return f"Cheapest of them: {cheapest.method}."
    if cheapest.method == winners[0].method:
        return "It is also the cheapest matcher."
    ratio = _compute_ratio(contests, cheapest.method, winners[0].method)
    measure, *others = {one.metric.label if decided_by_maps(one.ranking) else "error" for one in contests}
    times = "" if ratio is None or others else f", {ratio:.1f} times the {measure}"
    return f"Cheapest matcher: {cheapest.method}, {format_milliseconds(cheapest.cpu_ms or 0.0)}{times}."
