"""Agreement of the map metrics: without ground truth no single one of them names a leader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from evalkit.report.analysis.pairwise import is_clearly_worse
from evalkit.report.analysis.ranking import Ranking, rank_scores
from evalkit.report.analysis.scores import MethodScore

MEASURES: Mapping[str, str] = {
    "split_distance_m": "the smallest distance between the halves of the run",
    "mom_cm2": "the least scatter across orthogonal walls",
    "cleared_percent": "the fewest hits in cleared space",
    "s2m_m": "the lowest S2M residual",
}
"""Metrics that must agree, and what the best one in each has. A lost trajectory may do well in one, hardly in all.

The first three judge a map in different ways (doubled walls, hits across walls, free space). Each ranks maps like their
true error with a correlation of at least 0.9 in every world tested (`validated.json`).
"""


@dataclass(frozen=True, slots=True)
class MapAgreement:
    """``best``: method by metric. ``agreed``: methods best or tied in every metric. ``missing``: metrics without value.

    ``worse``: of each other method with values, the label of the first metric in which it is clearly worse.
    ``decides``: whether the sequence is decided by maps alone, without ground truth.
    """

    best: Mapping[str, str]
    agreed: tuple[str, ...]
    missing: tuple[str, ...]
    decides: bool
    worse: Mapping[str, str] = field(default_factory=dict)

    @property
    def disagrees(self) -> bool:
        """Whether the sequence is decided by maps and no method is best or tied in every metric."""
        return self.decides and not self.agreed


def compute_map_agreement(
    rankings: Mapping[str, Ranking], methods: Sequence[str], deciding: Ranking | None
) -> MapAgreement:
    """Compute the agreement over one sequence; the baseline takes part, because its map is comparable."""
    best: dict[str, str] = {}
    worse: dict[str, str] = {}
    agreed, missing = tuple(methods), []
    for name in MEASURES:
        ranking = rankings.get(name)
        ranked = rank_scores(ranking.metric, ranking.scores) if ranking else ()
        if not ranking or not ranked:
            missing.append(ranking.metric.label if ranking else name)
            continue
        best[name] = ranked[0].method
        beaten = {
            one.method: ranking.metric.label for one in ranked if is_clearly_worse(ranking.metric, one, ranked[0])
        }
        worse = beaten | worse  # the first metric counts
        tied = {one.method for one in ranked} - beaten.keys()
        agreed = tuple(label for label in agreed if label in tied)
    return MapAgreement(best, () if missing else agreed, tuple(missing), decided_by_maps(deciding), worse)


def decided_by_maps(ranking: Ranking | None) -> bool:
    """Return whether a ranking decides a sequence without ground truth."""
    return ranking is not None and ranking.metric.group == "map consistency"


def decided_by_fit(ranking: Ranking | None) -> bool:
    """Return whether a ranking decides a sequence without ground truth, by the fit of the scans to a known map."""
    return ranking is not None and ranking.metric.group == "localisation"


def find_worse_than(
    rankings: Mapping[str, Ranking], deciding: Ranking | None, baseline: str
) -> tuple[MethodScore, ...]:
    """Return the scores clearly worse than the baseline's; without ground truth, those worse in every map metric."""
    if deciding is None:
        return ()
    if not decided_by_maps(deciding):
        reference = deciding.of(baseline)
        return tuple(score for score in deciding.scores if is_clearly_worse(deciding.metric, score, reference))
    measures = [rankings[name] for name in MEASURES if name in rankings]
    if len(measures) < len(MEASURES):
        return ()
    return tuple(
        score
        for score in deciding.scores
        if all(is_clearly_worse(one.metric, one.of(score.method), one.of(baseline)) for one in measures)
    )
