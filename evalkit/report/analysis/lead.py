"""The methods that lead most often, and whether the runs and the paired tests bear out that they are recommended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evalkit.report.analysis.contests import count_led_of_shared
from evalkit.report.analysis.pairwise import is_shown_among
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.significance import Significance
from evalkit.report.analysis.standings import MAX_NAMED, Standing, Tally
from evalkit.report.formatting import join_words


@dataclass(frozen=True, slots=True)
class Lead:
    """The methods of the title.

    ``winners``: those that lead most often, without those that lead as often and have rivals. ``rivals``: the methods
    that paired tests call better (``tested``), else those that lead more often where both count. ``beaten``: methods
    that lead as often and have rivals by the tests, ``behind``: only by the data sets where both count.
    ``undecided``: methods that may lead as often as the winners, which too few runs tell. ``after``: without any of
    these, the method that leads most often after the winners; None if the paired tests call it worse than another one
    of the rest.
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
    def is_single(self) -> bool:
        """Whether the title is on one method: "it" in the line below."""
        return len(self.winners) == 1 and not self.rivals

    @property
    def names(self) -> str:
        """The winners in a sentence: "a or b" if they are recommended, else "a and b"."""
        return " or ".join(self.winners) if self.recommended else join_words(self.winners)


def find_lead(tally: Tally, significance: Significance) -> Lead:
    """Return the methods of the title; none if too many lead to be named.

    Where each of those that lead most often has rivals, one is named with these: if possible one that no paired test
    beats, else one that no other of them beats.
    """
    winners = tally.winners
    better = {one: significance.find_better(one) for one in winners}
    rivals = {one: better[one] or _find_ahead(tally, one) for one in winners}
    unbeaten = tuple(one for one in winners if not rivals[one])
    if len(unbeaten or winners) > MAX_NAMED or not winners:
        return Lead(())
    if not unbeaten:
        winner = min(winners, key=lambda one: (bool(better[one]), bool(set(better[one]) & set(winners))))
        return Lead((winner,), rivals[winner], tested=bool(better[winner]))
    beaten = tuple(one for one in winners if better[one])
    behind = tuple(one for one in winners if rivals[one] and not better[one])
    undecided = _find_undecided(tally, unbeaten, significance)
    after = None if beaten or behind or undecided else _find_after(tally, unbeaten, significance)
    return Lead(unbeaten, beaten=beaten, behind=behind, undecided=undecided, after=after)


def _find_ahead(tally: Tally, winner: str) -> tuple[str, ...]:
    """Return the methods that lead more often than a winner where both count."""
    methods = [one.method for one in tally.standings]
    led = {method: count_led_of_shared(tally.contests, (winner, method))[1] for method in methods}
    return tuple(method for method, (own, its) in led.items() if its > own)


def _find_undecided(tally: Tally, winners: Sequence[str], significance: Significance) -> tuple[str, ...]:
    """Return the methods that would lead as often as the winners if they were tied wherever these runs do not decide.

    Without those that the paired tests call worse than a winner. A difference on one of several data sets decides only
    if it is shown among all on which both are ranked (``is_shown_among``), whether these count or not.
    """
    led = {one.method: one.led for one in tally.standings}
    found = []
    for method in (one.method for one in tally.standings if one.method not in winners):
        shared = [one for one in tally.contests if set(winners) & set(one.leaders) and not one.by_maps]
        ranked = [{score.method for score in one.ranked} for one in tally.judged]
        together = sum(method in names and bool(names & set(winners)) for names in ranked)
        undecided = sum(_is_undecided(one.ranking, method, together) for one in shared)
        told_apart = set(winners) & set(significance.find_better(method))
        if undecided and led[method] + undecided >= led[winners[0]] and not told_apart:
            found.append(method)
    return tuple(found)


def _is_undecided(ranking: Ranking, method: str, data_sets: int) -> bool:
    """Return whether too few runs tell that a method is worse than the best, of so many data sets that may show it."""
    standing, score = mark(ranking, method), ranking.of(method)
    if standing != "worse" or score is None:
        return standing == "undecided"
    return not is_shown_among(score, ranking.ranked[0], data_sets)


def _find_after(tally: Tally, winners: Sequence[str], significance: Significance) -> Standing | None:
    """Return the standing of the best method that is no winner and for which a data set counts."""
    rest = [one for one in tally.standings if one.counted and one.method not in winners]
    first = [one for one in rest if one.led == rest[0].led]
    names = {one.method for one in rest}
    return next((one for one in first if not names & set(significance.find_better(one.method))), None)
