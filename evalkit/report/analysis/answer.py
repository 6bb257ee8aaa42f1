"""The answer of a comparison: the standings of the methods, and the title of the page that states them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import decided_by_fit, decided_by_maps
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.standings import (
    Contest,
    Loss,
    Standing,
    compute_standings,
    find_cheapest,
    find_contest,
    find_losses,
    find_winners,
)
from evalkit.report.analysis.statements.pills import Pill, compute_pills
from evalkit.report.analysis.statements.title import explain_no_contest, format_subtitle, format_title
from evalkit.report.analysis.statements.verdict import SequenceVerdict


@dataclass(frozen=True, slots=True)
class Answer:
    """What title and terminal say.

    ``title``: one sentence that contains ``emphasis`` (the winners by name, "" without any). ``subtitle``: cost, losses
    and the cheapest method. ``winners``: best or tied on most data sets, none if no method is ahead.
    ``cheapest``: of the winners if there are several, else of all methods that are not a baseline.
    ``standings``: every method, best first. ``by_maps``: no data set has ground truth or a known map; the maps drawn
    alone are compared.
    """

    title: str
    emphasis: str
    subtitle: str
    pills: tuple[Pill, ...]
    winners: tuple[str, ...]
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
    """Compute the answer over the data sets with the strongest evidence: ground truth, a known map, the maps drawn."""
    found = [find_contest(*pair) for pair in zip(sequences, verdicts, strict=True)]
    by_evidence: tuple[list[Contest], ...] = ([], [], [])
    for one in found:
        if one is not None:
            by_evidence[2 if decided_by_maps(one.ranking) else decided_by_fit(one.ranking)].append(one)
    contests = next(filter(None, by_evidence), [])
    by_maps = bool(contests) and contests is by_evidence[2]
    standings = compute_standings(comparison, sequences, contests)
    winners = find_winners(standings, contests)
    cheapest = find_cheapest(comparison, standings, winners)
    losses = find_losses(winners[0], contests) if len(winners) == 1 else ()
    return Answer(
        format_title(standings, contests, winners) if contests else explain_no_contest(sequences, verdicts),
        " or ".join(winners),
        format_subtitle([one for one in standings if one.method in winners], contests, losses, cheapest),
        compute_pills(comparison, sequences, verdicts, {one.sequence for one in contests}),
        winners,
        cheapest,
        losses,
        standings,
        tuple(contests),
        by_maps,
    )
