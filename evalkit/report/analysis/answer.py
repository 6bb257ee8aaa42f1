"""The answer of a comparison: the standings of the methods, and the title of the page that states them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.contests import Contest
from evalkit.report.analysis.lead import find_lead
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.significance import Significance
from evalkit.report.analysis.standings import Loss, Standing, Tally, find_cheapest, find_losses, find_lost
from evalkit.report.analysis.statements.pills import Pill, compute_pills
from evalkit.report.analysis.statements.subtitle import format_subtitle
from evalkit.report.analysis.statements.title import explain_no_contest, format_title
from evalkit.report.analysis.statements.verdict import SequenceVerdict


@dataclass(frozen=True, slots=True)
class Answer:
    """What title and terminal say.

    ``title``: one sentence that contains ``emphasis`` (the winners by name, "" if none is ahead). ``subtitle``: cost,
    losses and the cheapest method. ``winners``: best or tied on most data sets, none if no method is ahead. ``rivals``:
    methods that are better than these by paired tests, or lead more often where both count. ``undecided``: methods that
    these runs do not tell apart from the winners. With any of both the title recommends none.
    ``cheapest``: of the winners if there are several, else of all methods that are not a baseline.
    ``standings``: every method, best first. ``common``: the method whose errors and times theirs are divided by.
    ``by_maps``: no data set has ground truth or a known map; the maps drawn alone are compared.
    """

    title: str
    emphasis: str
    subtitle: str
    pills: tuple[Pill, ...]
    winners: tuple[str, ...]
    rivals: tuple[str, ...]
    undecided: tuple[str, ...]
    cheapest: Standing | None
    losses: tuple[Loss, ...]
    standings: tuple[Standing, ...]
    contests: tuple[Contest, ...]
    common: str
    by_maps: bool

    @property
    def ahead(self) -> tuple[str, ...]:
        """The winners that the page shows in their colour: none if the title says that no method is ahead."""
        return () if self.rivals else self.winners

    def standing(self, method: str) -> Standing:
        """Return the standing of a method."""
        return next(one for one in self.standings if one.method == method)


def compute_answer(
    comparison: Comparison,
    sequences: Sequence[SequenceAnalysis],
    verdicts: Sequence[SequenceVerdict],
    tally: Tally,
    significance: Significance,
) -> Answer:
    """Compute the answer from the tally of the data sets that count, and the paired tests over all runs."""
    contests, standings = tally.contests, tally.standings
    lead = find_lead(tally, significance)
    winners = lead.winners
    cheapest = find_cheapest(comparison, standings, winners)
    losses = find_losses(winners[0], contests) if len(winners) == 1 else ()
    return Answer(
        format_title(tally, lead) if contests else explain_no_contest(sequences, verdicts),
        "" if lead.rivals else lead.names,
        format_subtitle(tally, lead, losses, find_lost(sequences, winners), cheapest),
        compute_pills(comparison, sequences, verdicts, contests, winners),
        winners,
        lead.rivals,
        lead.undecided,
        cheapest,
        losses,
        standings,
        contests,
        tally.common,
        bool(contests) and contests[0].by_maps,
    )
