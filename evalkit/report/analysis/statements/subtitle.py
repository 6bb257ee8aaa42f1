"""The line below the title: what the counts leave out, cost, losses and the cheapest method."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from evalkit.report.analysis.contests import Contest, compare, count_led_of_shared
from evalkit.report.analysis.lead import Lead
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.standings import MAX_NAMED, Loss, Standing, Tally
from evalkit.report.formatting import capitalise, format_amount, format_milliseconds, join_words, name_or_count


def format_subtitle(
    tally: Tally, lead: Lead, losses: Sequence[Loss], lost: Sequence[tuple[str, MethodScore]], cheapest: Standing | None
) -> str:
    """Return what the counts of the title leave out, cost, losses and the cheapest method; "" without a winner.

    ``lost``: where a winner lost the track. Without a method that is ahead, what the counts leave out, which methods
    lead where all count, where the one that leads lost the track, and the cheapest.
    """
    if not lead.winners:
        return ""
    sentences = [_format_bases(tally.contests, lead)]
    if lead.rivals:
        sentences.append(_format_where_all_count(tally.contests))
    else:
        sentences.append(_format_costs(tally, lead.winners))
    if lead.is_single:
        sentences.append(_format_errors(tally.contests, lead.winners[0], losses))
    sentences.append(_format_lost(lost, lead.is_single))
    if cheapest is not None:
        sentences.append(_format_cheapest(cheapest, lead, tally.contests))
    return " ".join(filter(None, sentences))


def _format_bases(contests: Sequence[Contest], lead: Lead) -> str:
    """Return why fewer data sets count for a method of the title than for others, and both counts on the same ones."""
    after = [lead.after.method] if lead.after is not None and lead.after.led else []
    named = [*lead.winners, *after]
    limits = [_format_limit(contests, method, lead.is_single and method not in after) for method in named]
    if any(limits) and lead.is_single and after:
        shared, (own, its) = count_led_of_shared(contests, named)
        limits.append(f"Where both count: {own} of {shared} against {its} of {shared}." if shared else "")
    return " ".join(filter(None, limits))


def _format_where_all_count(contests: Sequence[Contest]) -> str:
    """Return which methods lead on the data sets that count for all methods; "" if these are all, none or many."""
    methods = {method for one in contests for method in one.part}
    shared = [one for one in contests if set(one.part) == methods]
    if not 0 < len(shared) < len(contests) or len(shared) > MAX_NAMED:
        return ""
    clauses = [
        f"{name_or_count(one.leaders, MAX_NAMED)} {('is', 'are')[len(one.leaders) > 1]} "
        f"{'best or tied' if one.ranking.winner is None else 'best'} {'on ' + one.sequence if shared[1:] else 'there'}"
        for one in shared
    ]
    count = f"count{'s' * (len(shared) == 1)} for all methods"
    return f"Only {join_words(one.sequence for one in shared)} {count}: {', '.join(clauses)}."


def _format_limit(contests: Sequence[Contest], method: str, alone: bool) -> str:
    """Return which data sets do not count for a method (``alone``: "its", "it"), and why; "" if all do."""
    without = [one for one in contests if method not in one.part]
    tuned = [one.sequence for one in without if one.was_tuned(method)]
    absent = [one.sequence for one in without if not one.was_tuned(method)]
    reasons = (
        (tuned, f"{'Its settings' if alone else f'Settings of {method}'} were chosen on"),
        (absent, f"{'It' if alone else method} did not run on"),
    )
    return " ".join(f"{why} {name_or_count(where, MAX_NAMED, 'data sets')}." for where, why in reasons if where)


def _format_costs(tally: Tally, winners: Sequence[str]) -> str:
    own = {one.method: one.cpu_ms for one in tally.standings if one.method in winners and one.cpu_ms is not None}
    costs = {method: format_milliseconds(cpu_ms) for method, cpu_ms in own.items()}
    if len(winners) == 1:
        return "".join(f"{text} a scan here." for text in costs.values())
    return f"A scan takes {join_words(f'{text} with {method}' for method, text in costs.items())}." if costs else ""


def _format_errors(contests: Sequence[Contest], winner: str, losses: Sequence[Loss]) -> str:
    """Return the error of a single winner beside another one's, or where it is worse than the best."""
    if len(contests) == 1 and not contests[0].by_maps:
        return _format_figures(winner, contests[0])
    return _format_losses(losses) if losses else ""


def _format_figures(winner: str, contest: Contest) -> str:
    """Return the error of the winner, and that of the best or the next one."""
    own = next(score for score in contest.ranked if score.method == winner)
    other = next(score for score in contest.ranked if score.method != winner)
    figures = [format_amount(contest.metric, median(score.values)) for score in (own, other)]
    what = f"{capitalise(contest.metric.label)}: " if contest.by_fit else ""
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
    if contest.by_fit:
        return "share of wrong positions"
    return contest.metric.label if contest.by_maps else "error"


def _format_losses(losses: Sequence[Loss]) -> str:
    texts = [
        f"{loss.sequence} ({format_amount(loss.metric, loss.own)} against {format_amount(loss.metric, loss.best)})"
        for loss in losses
    ]
    if len(texts) == 1:
        return f"It loses only {texts[0]}."
    return f"It loses {join_words(texts)}." if len(texts) == 2 else f"It loses {len(texts)}, most of all {texts[0]}."


def _format_cheapest(cheapest: Standing, lead: Lead, contests: Sequence[Contest]) -> str:
    winner, *others = lead.winners
    spent = format_milliseconds(cheapest.cpu_ms or 0.0)
    if lead.rivals:
        return f"Cheapest matcher: {cheapest.method}, {spent}."
    if others:
        return f"Cheapest of them: {cheapest.method}."
    if cheapest.method == winner:
        return "It is also the cheapest matcher."
    relative = compare(contests, cheapest.method, winner)
    measure, *more = {_name_measure(one) for one in contests}
    times = "" if relative.error is None or more else f"{relative.error:.1f} times the {measure}"
    if relative.shared == len(contests):
        return f"Cheapest matcher: {', '.join(filter(None, (cheapest.method, spent, times)))}."
    if relative.cpu is None:
        return f"Cheapest matcher: {cheapest.method}."
    both = ", ".join(filter(None, (f"{relative.cpu:.2g} times the time", times)))
    return f"Cheapest matcher: {cheapest.method}, {both} on {relative.shared} of {len(contests)}."
