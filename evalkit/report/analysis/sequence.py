"""The analysis of one sequence: all rankings and what follows from them, computed once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from evalkit.metrics.metric import Metric
from evalkit.report.analysis.comparison import Comparison, SequenceCard
from evalkit.report.analysis.driven_paths import describe_alignments, describe_drive
from evalkit.report.analysis.map_agreement import MapAgreement, compute_map_agreement, find_worse_than
from evalkit.report.analysis.ranking import PairwiseTable, Ranking, compute_pairwise, compute_rankings, find_deciding
from evalkit.report.analysis.scores import MethodScore, select_unfinished
from evalkit.results.run_record import RunRecord


@dataclass(frozen=True)
class SequenceAnalysis:
    """Everything computed of one sequence.

    ``runs``: by method, lowest seed first. ``rankings``: by the metric's name. ``deciding``: the ranking that decides
    the sequence, None without a value. ``behind``: scores worse than a baseline, by baseline. ``drive``: name and text
    of what the runs measured of the drive. ``alignments``: how estimates were aligned to the ground truth.
    """

    label: str
    card: SequenceCard
    runs: Mapping[str, tuple[RunRecord, ...]]
    rankings: Mapping[str, Ranking]
    deciding: Ranking | None
    pairwise: PairwiseTable | None
    map_agreement: MapAgreement
    behind: Mapping[str, tuple[MethodScore, ...]]
    drive: tuple[tuple[str, str], ...]
    alignments: tuple[str, ...]

    @property
    def all_runs(self) -> tuple[RunRecord, ...]:
        """The runs of all methods, in the order of the methods."""
        return tuple(run for own in self.runs.values() for run in own)

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods that ran over this sequence."""
        return tuple(self.runs)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """All metrics, in the order of the table of metrics."""
        return tuple(ranking.metric for ranking in self.rankings.values())

    @property
    def final(self) -> Ranking | None:
        """The ranking of the methods with corrected poses by these, in the metric that decides.

        None without any, and where no correction changes a value.
        """
        answers = self.deciding
        if answers is None:
            return None
        found = next((one for one in self.rankings.values() if one.metric.counterpart == answers.metric.name), None)
        if found is None:
            return None
        pairs = [(score, answers.of(score.method)) for score in found.scores if score.values or score.partial]
        same = (other is not None and _is_close(one.values, other.values) for one, other in pairs)
        return None if all(same) else found

    @property
    def none_finished(self) -> bool:
        """Whether no run completed."""
        return len(select_unfinished(self.all_runs)) == len(self.all_runs)

    def is_behind(self, method: str) -> bool:
        """Return whether a method is clearly worse than a baseline."""
        return any(score.method == method for scores in self.behind.values() for score in scores)


def _is_close(first: Sequence[float], second: Sequence[float]) -> bool:
    """Return whether two series differ by rounding at most."""
    return len(first) == len(second) and all(map(math.isclose, first, second))


def analyse_sequence(comparison: Comparison, label: str) -> SequenceAnalysis:
    """Compute the analysis of one sequence."""
    runs = comparison.runs_by_method(label)
    baselines = comparison.methods_with_role("baseline")
    card = comparison.sequences[label]
    rankings = compute_rankings(comparison, label)
    deciding = find_deciding(rankings)
    agreement = compute_map_agreement(rankings, comparison.method_labels, deciding)
    if deciding is not None and agreement.decides:
        outvoted = tuple(one.method for one in deciding.tied if one.method not in agreement.agreed)
        deciding = replace(deciding, comparable=deciding.comparable and not agreement.disagrees, outvoted=outvoted)
        rankings[deciding.metric.name] = deciding
    paths = () if deciding is None else tuple(s.method for s in deciding.ranked if s.method not in baselines)
    return SequenceAnalysis(
        label,
        card,
        runs,
        rankings,
        deciding,
        compute_pairwise(deciding, comparison.methods_with_role("reference")),
        agreement,
        {baseline: find_worse_than(rankings, deciding, baseline) for baseline in baselines},
        describe_drive(runs, paths if agreement.disagrees else paths[:1]),
        describe_alignments([run for own in runs.values() for run in own]),
    )
