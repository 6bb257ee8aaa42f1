"""The title of the page: which method to take, or why none is ahead."""

from __future__ import annotations

from collections.abc import Sequence

from evalkit.report.analysis.contests import Contest
from evalkit.report.analysis.lead import Lead
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import MAX_NAMED, Tally
from evalkit.report.analysis.statements.outcome import LED
from evalkit.report.analysis.statements.unranked import explain_unranked
from evalkit.report.analysis.statements.verdict import SequenceVerdict
from evalkit.report.formatting import join_words, name_or_count
from evalkit.stats.runs import FEW_RUNS

MAX_RIVALS = 2
"""More methods with smaller errors than the one that leads are counted, not named."""


def format_title(tally: Tally, lead: Lead) -> str:
    """Return the title over at least one contest."""
    first, *others = tally.contests
    how = " by the fit to the known map" if first.by_fit else ""
    if not lead.winners:
        return f"No method is ahead: {_describe_draw(tally)}{how}."
    if lead.rivals:
        leads = f"is best or tied on {_count_led(tally, lead.winners)}" if others else f"leads on {first.sequence}"
        return f"No method is ahead: {lead.names} {leads}{how}, but {_describe_rivals(lead)}."
    if lead.undecided:
        return f"{lead.names} {_describe_undecided(tally, lead, how)} by these runs."
    if not others:
        return f"Take {lead.names}: {_describe_single(first)}{how}."
    best = f"{'each ' * (len(lead.winners) > 1)}{'the best map' if first.by_maps else 'best or tied'}"
    return f"Take {lead.names}: {best} on {_count_led(tally, lead.winners)}{how}{_describe_others(tally, lead)}."


def _describe_rivals(lead: Lead) -> str:
    names, several = name_or_count(lead.rivals, MAX_RIVALS), len(lead.rivals) > 1
    if lead.tested:
        return f"{names} {('has', 'have')[several]} smaller errors in paired tests"
    return f"{names} {('leads', 'lead')[several]} more often where {('both count', 'they count too')[several]}"


def _describe_undecided(tally: Tally, lead: Lead, how: str) -> str:
    """Return where the winners lead, which others may lead as often: "leads on lab, but is not told apart from b"."""
    several, single = len(lead.winners) > 1, len(tally.contests) == 1
    bases = {one.counted for one in tally.standings if one.method in lead.winners}
    count = _count_led(tally, lead.winners) if len(bases) == 1 else _count_data_sets(tally.standings[0].led)
    where = tally.contests[0].sequence if single else count
    leads = f"{'each ' * (several and not single)}{('leads', 'lead')[several]}"
    who = name_or_count(lead.undecided, MAX_NAMED)
    return f"{leads} on {where}{how}, but {('is', 'are')[several]} not told apart from {who}"


def _describe_single(contest: Contest) -> str:
    """Return how the winners stand on a single data set."""
    if contest.by_maps:
        return f"the best map of {contest.sequence}, which has no ground truth"
    first = "best" if contest.ranking.tied == contest.ranking.near else "ahead"
    return f"{'tied for the best' if len(contest.leaders) > 1 else first} on {contest.sequence}"


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


def _count_led(tally: Tally, winners: Sequence[str]) -> str:
    """Return on how many data sets the winners lead, of those that count: "3 of 3 data sets that count for it"."""
    counted = [one.counted for one in tally.standings if one.method in winners]
    bases = list(dict.fromkeys(counted))
    kind = f"{'recording' if tally.contests[0].by_maps else 'data set'}{'s' * (bases != [1])}"
    limit = "" if bases == [len(tally.contests)] else _limit(bases == [1], len(winners) > 1)
    of_each = bases if len(bases) == 1 else counted
    return f"{join_words(f'{tally.standings[0].led} of {base}' for base in of_each)} {kind}{limit}"


def _limit(one: bool, several: bool = False) -> str:
    """Return the words behind a number of data sets that is not that of all which count."""
    return f" that count{'s' * one} for {('it', 'them')[several]}"


def _describe_others(tally: Tally, lead: Lead) -> str:
    """Return which methods lead as often but are beaten, or on how many of its data sets the next method leads."""
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
