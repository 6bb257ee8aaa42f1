"""Whether the measures of a map agree: without a truth no single one of them may name a leader."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from evalkit.report.analysis.cells import Cell
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.standings import Standing, behind, distinct, method_of, ranking, standing, worse

MEASURES: Mapping[str, str] = {
    "split_distance_m": "the halves of the run closest together",
    "mom_cm2": "the least scatter across orthogonal walls",
    "cleared_percent": "the fewest hits in cleared space",
    "s2m_m": "the lowest S2M residual",
}
"""A lost trajectory can do well in one of these, hardly in all: metric, and what its best has.

The first three see a map in different ways (its walls twice, its hits across walls, its free space), and each ranks
maps as their true error does with a correlation of at least 0.9 in every world tried (``make metric-validation``).
"""


@dataclass(frozen=True, slots=True)
class Consensus:
    """What the map measures say. ``best``: method by measure; ``agreed``: who is best or level in all of them;
    ``untold``: measures that nobody has a value for."""

    best: Mapping[str, str]
    agreed: tuple[str, ...]
    untold: tuple[str, ...]


def consensus(comparison: Comparison, sequence: str) -> Consensus:
    """The agreement of the measures over one sequence; the bar takes part, for its map is as good as any."""
    best: dict[str, str] = {}
    agreed = comparison.method_labels
    untold = []
    known = {metric.name: metric for metric in comparison.metrics}
    for name in MEASURES:
        ranked = ranking(known[name], standing(comparison, sequence, known[name]).cells) if name in known else ()
        if not ranked:
            untold.append(known[name].label if name in known else name)
            continue
        best[name] = ranked[0].method
        level = [c.method for c in ranked if c is ranked[0] or not distinct(known[name], ranked[0], c)]
        agreed = tuple(label for label in agreed if label in level)
    return Consensus(best, () if untold else agreed, tuple(untold))


def by_maps(found: Standing | None) -> bool:
    """Whether a sequence is decided without a truth."""
    return found is not None and found.metric.group == "map consistency"


def disagrees(comparison: Comparison, found: Standing | None) -> bool:
    """Whether a sequence without truth has nobody who is best or level in every measure of the map."""
    return found is not None and by_maps(found) and not consensus(comparison, found.sequence).agreed


def behind_bar(comparison: Comparison, found: Standing, bar: str) -> tuple[Cell, ...]:
    """The cells shown to be worse than the bar's; without truth, those with the worse map by every measure of it."""
    if not by_maps(found):
        return tuple(cell for cell in found.cells if worse(found.metric, cell, found.of(bar)))
    standings = [standing(comparison, found.sequence, m) for m in comparison.metrics if m.name in MEASURES]
    if len(standings) < len(MEASURES):
        return ()
    return tuple(cell for cell in found.cells if all(_worse_map(one, cell.method, bar) for one in standings))


def _worse_map(found: Standing, method: str, bar: str) -> bool:
    one, other = found.of(method), found.of(bar)
    worse_than = behind(found.metric, one, other)
    return worse_than and one is not None and other is not None and distinct(found.metric, one, other)


def is_behind_bar(comparison: Comparison, found: Standing, method: str) -> bool:
    """Whether a method is clearly worse than a bar where a sequence is decided."""
    bars = method_of(comparison, "baseline")
    return any(cell.method == method for bar in bars for cell in behind_bar(comparison, found, bar))
