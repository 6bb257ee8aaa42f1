"""The title of the page, which method to take, and the line below it: its cost, where it loses, the cheapest one."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import MAX_NAMED, Contest, Loss, Standing, compute_ratio
from evalkit.report.analysis.statements.verdict import LED, SequenceVerdict, explain_unranked
from evalkit.report.formatting import capitalise, format_amount, format_milliseconds, join_words, name_or_count
from evalkit.stats.runs import FEW_RUNS

BY_FIT = " by the fit to the known map"
"""What follows the name of a data set without ground truth that the fit to a known map decides."""


def format_title(standings: Sequence[Standing], contests: Sequence[Contest], winners: Sequence[str]) -> str:
    """Return the title over at least one contest."""
    first, by_maps = standings[0], decided_by_maps(contests[0].ranking)
    how = BY_FIT if decided_by_fit(contests[0].ranking) else ""
    if not winners:
        part = {score.method for one in contests for score in one.ranked}
        count = sum(one.led == first.led for one in standings)
        who = f"all {len(part)} methods are" if count == len(part) else f"{count} methods are each"
        if len(contests) == 1:
            return f"No method is ahead: {who} tied on {contests[0].sequence}{how}."
        return f"No method is ahead: {who} best or tied on {first.led} of {len(contests)} data sets{how}."
    names = " or ".join(winners)
    if len(contests) == 1:
        return _format_single(names, len(winners) > 1, contests[0], how)
    counted = first.counted if len(winners) == 1 else len(contests)
    best = f"{'each ' * (len(winners) > 1)}{'the best map' if by_maps else 'best or tied'}"
    kind = f"{'recording' if by_maps else 'data set'}{'s' if counted != 1 else ''}"
    rest = _describe_others(standings, winners, len(contests))
    return f"Take {names}: {best} on {first.led} of {counted} {kind}{how}{rest}."


def _describe_others(standings: Sequence[Standing], winners: Sequence[str], contests: int) -> str:
    """Return on how many data sets any other method leads at most, and which methods were compared on fewer."""
    others = [one for one in standings if one.counted and one.method not in winners]
    if not others:
        return ""
    most = max(one.led for one in others)
    rest = f", no other method on {f'more than {most}' if most else 'any'}"
    fewer = [one.method for one in standings if 0 < one.counted < contests]
    if not fewer:
        return rest
    return f"{rest}; {name_or_count(fewer, 1)} {'was' if len(fewer) == 1 else 'were'} not compared on all {contests}"


def _format_single(names: str, tied: bool, contest: Contest, how: str) -> str:
    """Return the title over a single data set with winners."""
    if decided_by_maps(contest.ranking):
        return f"Take {names}: the best map of {contest.sequence}, which has no ground truth."
    if tied:
        return f"Take {names}: tied for the best on {contest.sequence}{how}."
    others = [one.method for one in contest.ranking.tied if one not in contest.ranking.near]
    if not others:
        return f"Take {names}: best on {contest.sequence}{how}."
    who = join_words(others) if len(others) <= MAX_NAMED else f"{len(others)} others"
    return f"Take {names}: ahead on {contest.sequence}{how}, but not told apart from {who} by these runs."


def explain_no_contest(sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]) -> str:
    """Return why no method is ahead or ranked."""
    outcomes = {verdict.outcome for verdict in verdicts}
    rankings = [sequence.deciding for sequence in sequences if sequence.deciding is not None]
    ranked = {score.method for ranking in rankings for score in ranking.ranked}
    why = explain_unranked(sequences)
    degenerate = join_words(v.sequence for v in verdicts if v.outcome == "degenerate")
    reasons = (
        (all(sequence.none_finished for sequence in sequences), "No run finished: there is no answer."),
        (outcomes == {"lost"}, "No method held the track: there is no answer."),
        (
            len(ranked) == 1,
            f"Only {join_words(ranked)} is ranked: {why or 'there is no other method to compare it with'}.",
        ),
        (not ranked, f"No method is ranked: {why or 'none has a value of the deciding metric'}."),
        ("disagreement" in outcomes, "No method is ahead: without ground truth, the map metrics disagree."),
        (
            outcomes <= {"degenerate", "unranked"},
            f"No method is ranked: the geometry of {degenerate} does not determine the pose.",
        ),
        (
            outcomes <= {"single", "lost", "unranked", "degenerate"},
            "No method is ahead: no data set ranks two methods.",
        ),
        (bool(outcomes & set(LED)), "No method is ahead: too few runs to tell the methods apart."),
        (
            all(run.seed is None for sequence in sequences for run in sequence.all_runs),
            f"No method is ahead: each ran once, and a verdict takes {FEW_RUNS - 1} more runs, slightly perturbed "
            f"(nuisance = {FEW_RUNS - 1}).",
        ),
        (True, "No method is ahead: a verdict takes repeated runs."),
    )
    return next(text for holds, text in reasons if holds)


def format_subtitle(
    winners: Sequence[Standing], contests: Sequence[Contest], losses: Sequence[Loss], cheapest: Standing | None
) -> str:
    """Return cost, losses and the cheapest method; "" without a winner."""
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
        what = f"{capitalise(metric.label)}: " if decided_by_fit(contests[0].ranking) else ""
        sentences.append(f"{what}{figures[0]} against {figures[1]} of {second.method}.")
    elif len(winners) == 1 and losses:
        sentences.append(_format_losses(losses))
    if cheapest is not None:
        sentences.append(_format_cheapest(cheapest, winners, contests))
    return " ".join(filter(None, sentences))


def _name_measure(contest: Contest) -> str:
    if decided_by_fit(contest.ranking):
        return "share of wrong positions"
    return contest.metric.label if decided_by_maps(contest.ranking) else "error"


def _format_losses(losses: Sequence[Loss]) -> str:
    texts = [
        f"{loss.sequence} ({format_amount(loss.metric, loss.own)} against {format_amount(loss.metric, loss.best)})"
        for loss in losses
    ]
    if len(texts) == 1:
        return f"It loses only {texts[0]}."
    return f"It loses {join_words(texts)}." if len(texts) == 2 else f"It loses {len(texts)}, most of all {texts[0]}."


def _format_cheapest(cheapest: Standing, winners: Sequence[Standing], contests: Sequence[Contest]) -> str:
    if len(winners) > 1:
        return f"Cheapest of them: {cheapest.method}."
    if cheapest.method == winners[0].method:
        return "It is also the cheapest matcher."
    ratio = compute_ratio(contests, cheapest.method, winners[0].method)
    measure, *others = {_name_measure(one) for one in contests}
    times = "" if ratio is None or others else f", {ratio:.1f} times the {measure}"
    shared = sum({cheapest.method, winners[0].method} <= {one.method for one in contest.ranked} for contest in contests)
    if times and shared < len(contests):
        times += f" on {shared} of {len(contests)}"
    return f"Cheapest matcher: {cheapest.method}, {format_milliseconds(cheapest.cpu_ms or 0.0)}{times}."
