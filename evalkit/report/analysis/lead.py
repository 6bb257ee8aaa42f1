"""The methods that lead most often, and whether the runs and the paired tests bear out that they are recommended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evalkit.report.analysis.map_agreement import decided_by_maps
from evalkit.report.analysis.ranking import mark
from evalkit.report.analysis.significance import Significance
from evalkit.report.analysis.standings import MAX_NAMED, Standing, Tally
from evalkit.report.formatting import join_words


@dataclass(frozen=True, slots=True)
class Lead:
    """The methods of the title.

    ``winners``: those that lead most often, without those that lead as often and have rivals. ``rivals``: the methods
    that paired tests call better (``tested``), else those that lead more often where both count. ``beaten``: methods
    that lead as often and have rivals by the tests, ``behind``: only by the data sets where both count.
    ``undecided``: methods that may lead as often as the winners, which too few runs tell. ``after``: the method that
    leads most often after these, None if the paired tests call it worse than another one of the rest.
    """

    winners: tuple[str, ...]
    rivals: tuple[str, ...] = ()
    tested: bool = False
    beaten: tuple[str, ...] = ()
    behind: tuple[str, ...] = ()
    undecided: tuple[str, ...] = ()
    after: Standing | None = None

    @property
    def recommended(self) -> bool:
        """Whether the title recommends the winners."""
        return bool(self.winners) and not self.rivals and not self.undecided

    @property
    def names(self) -> str:
        """The winners in a sentence: "a or b" if they are recommended, else "a and b"."""
        return " or ".join(self.winners) if self.recommended else join_words(self.winners)


def find_lead(tally: Tally, significance: Significance) -> Lead:
    """Return the methods of the title; none if too many lead to be named.

    Where each of those that lead most often has rivals, one is named with these: if possible one that no paired test
    beats, else one that no other of them beats.
    """
    better = {one: significance.find_better(one) for one in tally.winners}
    more = {one: _find_ahead(tally, one) for one in tally.winners}
    unbeaten = tuple(one for one in tally.winners if not better[one] and not more[one])
    if len(unbeaten or tally.winners) > MAX_NAMED or not tally.winners:
        return Lead(())
    if not unbeaten:
        untested = [one for one in tally.winners if not better[one]]
        by_others = [one for one in tally.winners if not set(better[one]) & set(tally.winners)]
        winner = (untested or by_others or tally.winners)[0]
        return Lead((winner,), better[winner] or more[winner], bool(better[winner]))
    beaten = tuple(one for one in tally.winners if better[one])
    behind = tuple(one for one in tally.winners if more[one] and not better[one])
    after = None if beaten or behind else _find_after(tally, unbeaten, significance)
    return Lead(
        unbeaten, beaten=beaten, behind=behind, undecided=_find_undecided(tally, unbeaten, significance), after=after
    )


def _find_ahead(tally: Tally, winner: str) -> tuple[str, ...]:
    """Return the methods that lead more often than a winner where both count."""
    found = []
    for method in (one.method for one in tally.standings):
        shared = [one for one in tally.contests if {winner, method} <= set(one.part)]
        own, its = (sum(name in one.leaders for one in shared) for name in (winner, method))
        found += [method] if its > own else []
    return tuple(found)


def _find_undecided(tally: Tally, winners: Sequence[str], significance: Significance) -> tuple[str, ...]:
    """Return the methods that would lead as often as the winners if they were tied wherever these runs do not decide.

    Without those that the paired tests call worse than a winner.
    """
    led = {one.method: one.led for one in tally.standings}
    found = []
    for method in (one.method for one in tally.standings if one.method not in winners):
        shared = [one for one in tally.contests if set(winners) & set(one.leaders) and not decided_by_maps(one.ranking)]
        undecided = sum(mark(one.ranking, method) == "undecided" for one in shared)
        told_apart = set(winners) & set(significance.find_better(method))
        if undecided and led[method] + undecided >= led[winners[0]] and not told_apart:
            found.append(method)
    return tuple(found)


def _find_after(tally: Tally, winners: Sequence[str], significance: Significance) -> Standing | None:
    """Return the standing of the best method that is no winner and for which a data set counts."""
    rest = [one for one in tally.standings if one.counted and one.method not in winners]
    first = [one for one in rest if one.led == rest[0].led]
    names = {one.method for one in rest}
    return next((one for one in first if not names & set(significance.find_better(one.method))), None)
