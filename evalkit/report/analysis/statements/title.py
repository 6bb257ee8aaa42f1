"""The title of the page, which method to take, and the line below it: its cost, where it loses, the cheapest one."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from evalkit.report.analysis.lead import Lead
from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import MAX_NAMED, Contest, Loss, Standing, Tally, compare
from evalkit.report.analysis.statements.outcome import LED
from evalkit.report.analysis.statements.unranked import explain_unranked
from evalkit.report.analysis.statements.verdict import SequenceVerdict
from evalkit.report.formatting import capitalise, format_amount, format_milliseconds, join_words, name_or_count
from evalkit.stats.runs import FEW_RUNS

BY_FIT = " by the fit to the known map"
"""What follows the name of a data set without ground truth that the fit to a known map decides."""

MAX_RIVALS = 2
"""More methods with smaller errors than the one that leads are counted, not named."""


def format_title(tally: Tally, lead: Lead) -> str:
    """Return the title over at least one contest."""
    several, contests = len(lead.winners) > 1, tally.contests
    how = BY_FIT if decided_by_fit(contests[0].ranking) else ""
    if not lead.winners:
        return f"No method is ahead: {_describe_draw(tally)}{how}."
    single = contests[0].sequence if len(contests) == 1 else ""
    counts = single or _count_led(tally, lead.winners)
    if lead.undecided and not lead.rivals:
        who, verb = name_or_count(lead.undecided, MAX_NAMED), ("is", "are")[several]
        leads = "each lead" if several and not single else ("leads", "lead")[several]
        if counts.count(" of ") > 1:  # on other numbers of data sets each
            counts = _count_data_sets(tally.standings[0].led)
        return f"{lead.names} {leads} on {counts}{how}, but {verb} not told apart from {who} by these runs."
    if lead.rivals:
        what = f"{lead.names} {'leads' if single else 'is best or tied'} on {counts}{how}"
        return f"No method is ahead: {what}, but {_describe_rivals(lead)}."
    what = _describe_single(contests[0]) if single else f"{_describe_best(tally, lead.winners)} on {counts}"
    return f"Take {lead.names}: {what}{how}{_describe_others(tally, lead)}."


def _describe_rivals(lead: Lead) -> str:
    names, several = name_or_count(lead.rivals, MAX_RIVALS), len(lead.rivals) > 1
    if lead.tested:
        return f"{names} {('has', 'have')[several]} smaller errors in paired tests"
    return f"{names} {('leads', 'lead')[several]} more often where {('both count', 'they count too')[several]}"


def _describe_draw(tally: Tally) -> str:
    """Return how many methods lead most often, where these are too many to name or all that take part."""
    led = tally.standings[0].led
    first = [one for one in tally.standings if one.led == led]
    part = {score.method for one in tally.contests for score in one.ranked}
    who = f"all {len(part)} methods are" if len(first) == len(part) else f"{len(first)} methods are each"
    if len(tally.contests) == 1:
        return f"{who} tied on {tally.contests[0].sequence}"
    alike = {one.counted for one in first} == {len(tally.contests)}
    return f"{who} best or tied on {f'{led} of {len(tally.contests)} data sets' if alike else _count_data_sets(led)}"


def _count_data_sets(count: int) -> str:
    return f"{count} data set{'s' * (count != 1)}"


def _describe_best(tally: Tally, winners: Sequence[str]) -> str:
    by_maps = decided_by_maps(tally.contests[0].ranking)
    return f"{'each ' * (len(winners) > 1)}{'the best map' if by_maps else 'best or tied'}"


def _count_led(tally: Tally, winners: Sequence[str]) -> str:
    """Return on how many data sets the winners lead, of those that count: "3 of 3 data sets that count for it"."""
    counted = [one.counted for one in tally.standings if one.method in winners]
    bases = list(dict.fromkeys(counted))
    kind = f"{'recording' if decided_by_maps(tally.contests[0].ranking) else 'data set'}{'s' * (bases != [1])}"
    limit = "" if bases == [len(tally.contests)] else _limit(bases == [1], len(winners) > 1)
    of_each = bases if len(bases) == 1 else counted
    return f"{join_words(f'{tally.standings[0].led} of {base}' for base in of_each)} {kind}{limit}"


def _limit(one: bool, several: bool = False) -> str:
    """Return the words behind a number of data sets that is not that of all which count."""
    return f" that count{'s' * one} for {('it', 'them')[several]}"


def _describe_others(tally: Tally, lead: Lead) -> str:
    """Return which methods lead as often but are beaten, or on how many of its data sets the next method leads."""
    if len(tally.contests) == 1:
        return ""
    if lead.beaten or lead.behind:
        tests = ("the paired tests find a better method", "the paired tests find better methods")
        counts = ("another one leads more often where both count", "others lead more often where they count too")
        groups = ((lead.beaten, tests), (lead.behind, counts))
        return "".join(_describe_as_often(names, why[len(names) > 1]) for names, why in groups if names)
    other = lead.after
    if other is None:
        return ""
    if not other.led:
        return "; no other method on any"
    count = len(tally.contests)
    limited = any(one.counted < count for one in tally.standings if one.method in lead.winners)
    base = f"{other.counted}{_limit(other.counted == 1)}" if other.counted < count else f"{'all ' * limited}{count}"
    return f"; next best: {other.method}, {other.led} of {base}"


def _describe_as_often(methods: Sequence[str], why: str) -> str:
    leads = "lead" if len(methods) > 1 else "leads"
    return f"; {name_or_count(methods, MAX_RIVALS)} {leads} as often, but {why}"


def _describe_single(contest: Contest) -> str:
    """Return how the winners stand on a single data set."""
    if decided_by_maps(contest.ranking):
        return f"the best map of {contest.sequence}, which has no ground truth"
    first = "best" if contest.ranking.tied == contest.ranking.near else "ahead"
    return f"{'tied for the best' if len(contest.leaders) > 1 else first} on {contest.sequence}"


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
    tally: Tally, lead: Lead, losses: Sequence[Loss], lost: Sequence[tuple[str, MethodScore]], cheapest: Standing | None
) -> str:
    """Return what the counts of the title leave out, cost, losses and the cheapest method; "" without a winner.

    ``lost``: where a winner lost the track. Without a method that is ahead, what the counts leave out, which methods
    lead where all count, where the one that leads lost the track, and the cheapest.
    """
    winners, alone = lead.winners, len(lead.winners) == 1 and not lead.rivals
    if not winners:
        return ""
    sentences = [_format_bases(tally.contests, lead, alone)]
    if lead.rivals:
        sentences.append(_format_where_all_count(tally.contests))
    else:
        sentences += [_format_costs(tally, winners), _format_errors(tally.contests, winners, losses)]
    sentences.append(_format_lost(lost, alone))
    if cheapest is not None:
        sentences.append(_format_cheapest(cheapest, lead, tally.contests))
    return " ".join(filter(None, sentences))


def _format_bases(contests: Sequence[Contest], lead: Lead, alone: bool) -> str:
    """Return why fewer data sets count for a method of the title than for others, and both counts on the same ones.

    ``alone``: the title has one winner, "it".
    """
    after = lead.after.method if lead.after is not None and lead.after.led and not lead.undecided else ""
    named = [*lead.winners, *([after] if after else [])]
    limits = [_format_limit(contests, method, alone and method in lead.winners) for method in named]
    if not any(limits):
        return ""
    shared = [one for one in contests if set(named) <= set(one.part)]
    if alone and after and shared:
        own, its = (sum(method in one.leaders for one in shared) for method in named)
        limits.append(f"Where both count: {own} of {len(shared)} against {its} of {len(shared)}.")
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
