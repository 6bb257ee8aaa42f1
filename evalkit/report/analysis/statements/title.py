"""The title of the page, which method to take, and the line below it: its cost, where it loses, the cheapest one."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import MAX_NAMED, Contest, Loss, Standing, Tally, compare, find_next
from evalkit.report.analysis.statements.outcome import LED
from evalkit.report.analysis.statements.unranked import explain_unranked
from evalkit.report.analysis.statements.verdict import SequenceVerdict
from evalkit.report.formatting import capitalise, format_amount, format_milliseconds, join_words, name_or_count
from evalkit.stats.runs import FEW_RUNS

BY_FIT = " by the fit to the known map"
"""What follows the name of a data set without ground truth that the fit to a known map decides."""

MAX_RIVALS = 2
"""More methods with smaller errors than the one that leads are counted, not named."""


def format_title(
    standings: Sequence[Standing], contests: Sequence[Contest], winners: Sequence[str], rivals: Sequence[str]
) -> str:
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
    if len(contests) == 1:
        return _recommend(winners, _describe_single(contests[0], how), rivals)
    counted = next(one.counted for one in standings if one.method == winners[0])
    counted = counted if len(winners) == 1 else len(contests)
    best = f"{'each ' * (len(winners) > 1)}{'the best map' if by_maps else 'best or tied'}"
    kind = f"{'recording' if by_maps else 'data set'}{'s' if counted != 1 else ''}"
    own = _limit(counted) if counted < len(contests) else ""
    what = f"{best} on {first.led} of {counted} {kind}{own}{how}"
    if not rivals:
        what += _describe_next(standings, winners, len(contests), bool(own))
    return _recommend(winners, what, rivals)


def _recommend(winners: Sequence[str], what: str, rivals: Sequence[str]) -> str:
    """Return the title: which method to take, or which one leads and which others have smaller errors all the same."""
    names = " or ".join(winners)
    if not rivals:
        return f"Take {names}: {what}."
    has = ("has", "have")[len(rivals) > 1]
    where = "where both ran" if len(rivals) == 1 else "where they ran too"
    return f"{names} is {what}, but {name_or_count(rivals, MAX_RIVALS)} {has} smaller errors {where}."


def _limit(counted: int) -> str:
    """Return the words behind a number of data sets that is not that of all which count."""
    return f" that count{'s' if counted == 1 else ''} for it"


def _describe_next(standings: Sequence[Standing], winners: Sequence[str], count: int, limited: bool) -> str:
    """Return on how many of its data sets the next method leads.

    ``count``: data sets that count; ``limited``: fewer of them count for the winner, and its number says so.
    """
    other = find_next(standings, winners)
    if other is None:
        return ""
    if not other.led:
        return "; no other method on any"
    base = f"{other.counted}{_limit(other.counted)}" if other.counted < count else f"{'all ' * limited}{count}"
    return f"; next best: {other.method}, {other.led} of {base}"


def _describe_single(contest: Contest, how: str) -> str:
    """Return how the winners stand on a single data set."""
    if decided_by_maps(contest.ranking):
        return f"the best map of {contest.sequence}, which has no ground truth"
    if len(contest.leaders) > 1:
        return f"tied for the best on {contest.sequence}{how}"
    others = [one.method for one in contest.ranking.tied if one not in contest.ranking.near]
    if not others:
        return f"best on {contest.sequence}{how}"
    who = join_words(others) if len(others) <= MAX_NAMED else f"{len(others)} others"
    return f"ahead on {contest.sequence}{how}, but not told apart from {who} by these runs"


def explain_no_contest(sequences: Sequence[SequenceAnalysis], verdicts: Sequence[SequenceVerdict]) -> str:
    """Return why no method is ahead or ranked."""
    outcomes = {verdict.outcome for verdict in verdicts}
    others = [sequence for sequence in sequences if not sequence.card.degenerate]
    ranked = {score.method for one in others if one.deciding is not None for score in one.deciding.ranked}
    why = explain_unranked(others)
    degenerate = [sequence.label for sequence in sequences if sequence.card.degenerate]
    causes = [why or "none has a value of the deciding metric"] if others else []
    causes += [f"the geometry of {join_words(degenerate)} does not determine the pose"] if degenerate else []
    reasons = (
        (all(sequence.none_finished for sequence in sequences), "No run finished: there is no answer."),
        (outcomes == {"lost"}, "No method held the track: there is no answer."),
        (
            len(ranked) == 1,
            f"Only {join_words(ranked)} is ranked: {why or 'there is no other method to compare it with'}.",
        ),
        (not ranked, f"No method is ranked: {'; '.join(causes)}."),
        ("disagreement" in outcomes, "No method is ahead: without ground truth, the map metrics disagree."),
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
    tally: Tally,
    winners: Sequence[str],
    rivals: Sequence[str],
    losses: Sequence[Loss],
    lost: Sequence[tuple[str, MethodScore]],
    cheapest: Standing | None,
) -> str:
    """Return what the counts of the title leave out, cost, losses and the cheapest method; "" without a winner.

    ``lost``: where a winner lost the track. Without a method to take, what the counts leave out, where the ones that
    lead lost the track, and the cheapest.
    """
    if not winners:
        return ""
    alone = len(winners) == 1 and not rivals
    sentences = [_format_bases(tally, winners, rivals)]
    if not rivals:
        sentences += [_format_costs(tally, winners), _format_errors(tally.contests, winners, losses)]
    sentences.append(_format_lost(lost, alone))
    if cheapest is not None:
        sentences.append(_format_cheapest(cheapest, winners, tally.contests, alone))
    return " ".join(filter(None, sentences))


def _format_bases(tally: Tally, winners: Sequence[str], rivals: Sequence[str]) -> str:
    """Return why fewer data sets count for a method of the title than for others, and both counts on the same ones."""
    winner = winners[0] if len(winners) == 1 else ""
    other = None if rivals else find_next(tally.standings, winners)
    after = other.method if other is not None and other.led else ""
    limits = [_format_limit(tally.contests, method, method == winner) for method in (winner, after) if method]
    if not any(limits):
        return ""
    shared = [one for one in tally.contests if {winner, after} <= set(one.part)]
    if shared:
        own, its = (sum(method in one.leaders for one in shared) for method in (winner, after))
        limits.append(f"Where both count: {own} of {len(shared)} against {its} of {len(shared)}.")
    return " ".join(filter(None, limits))


def _format_limit(contests: Sequence[Contest], method: str, alone: bool) -> str:
    """Return which data sets do not count for a method (``alone``: "its", "it"), and why; "" if all do."""
    without = [one for one in contests if method not in one.part]
    tuned = [one.sequence for one in without if one.was_tuned(method)]
    absent = [one.sequence for one in without if not one.was_tuned(method)]
    reasons = (
        (tuned, f"{'Its settings' if alone else f'Settings of {method}'} were chosen on"),
        (absent, f"{'It' if alone else method} did not run on"),
    )
    return " ".join(f"{why} {_name_or_count(where)}." for where, why in reasons if where)


def _name_or_count(sequences: Sequence[str]) -> str:
    return join_words(sequences) if len(sequences) <= MAX_NAMED else f"{len(sequences)} data sets"


def _format_costs(tally: Tally, winners: Sequence[str]) -> str:
    own = {one.method: one.cpu_ms for one in tally.standings if one.method in winners and one.cpu_ms is not None}
    costs = {method: format_milliseconds(cpu_ms) for method, cpu_ms in own.items()}
    if len(winners) == 1:
        return "".join(f"{text} a scan here." for text in costs.values())
    return f"A scan takes {join_words(f'{text} with {method}' for method, text in costs.items())}." if costs else ""


def _format_errors(contests: Sequence[Contest], winners: Sequence[str], losses: Sequence[Loss]) -> str:
    """Return the error of a single winner beside another one's, or where it is worse than the best."""
    if len(winners) == 1 and len(contests) == 1 and not decided_by_maps(contests[0].ranking):
        return _format_figures(winners[0], contests[0])
    return _format_losses(losses) if len(winners) == 1 and losses else ""


def _format_figures(winner: str, contest: Contest) -> str:
    """Return the error of the winner, and that of the best or the next one."""
    own = next(score for score in contest.ranked if score.method == winner)
    other = next(score for score in contest.ranked if score.method != winner)
    figures = [format_amount(contest.metric, median(score.values)) for score in (own, other)]
    what = f"{capitalise(contest.metric.label)}: " if decided_by_fit(contest.ranking) else ""
    return f"{what}{figures[0]} against {figures[1]} of {other.method}."


def _format_lost(lost: Sequence[tuple[str, MethodScore]], alone: bool) -> str:
    """Return where the winner (``alone``: "It"), or each of them, lost the track."""
    by_method: dict[str, list[str]] = {}
    for label, score in lost:
        count = f" ({score.lost_runs} of {score.expected} runs)" if score.expected > 1 else ""
        by_method.setdefault(score.method, []).append(f"{label}{count}")
    return " ".join(
        f"{'It' if alone else method} lost the track on {join_words(where)}." for method, where in by_method.items()
    )


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


def _format_cheapest(
    cheapest: Standing, winners: Sequence[str], contests: Sequence[Contest], alone: bool
) -> str:  # fmt: skip
    if len(winners) > 1:
        return f"Cheapest of them: {cheapest.method}."
    if cheapest.method == winners[0]:
        return "It is also the cheapest matcher." if alone else f"Cheapest matcher: {cheapest.method}."
    relative = compare(contests, cheapest.method, winners[0])
    measure, *others = {_name_measure(one) for one in contests}
    times = "" if relative.error is None or others else f"{relative.error:.1f} times the {measure}"
    if relative.shared == len(contests):
        spent = format_milliseconds(cheapest.cpu_ms or 0.0)
        return f"Cheapest matcher: {', '.join(filter(None, (cheapest.method, spent, times)))}."
    if relative.cpu is None:
        return f"Cheapest matcher: {cheapest.method}."
    both = ", ".join(filter(None, (f"{relative.cpu:.2g} times the time", times)))
    return f"Cheapest matcher: {cheapest.method}, {both} on {relative.shared} of {len(contests)}."
