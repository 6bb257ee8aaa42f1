"""Compare default and tuned methods on the held-out sequences: better, tied, or overfitted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evalkit.commands.tune.plan import TUNED
from evalkit.commands.tune.search_loop import MethodSearch
from evalkit.core.run_status import NOT_EXECUTED, RunStatus
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.pairwise import PairedDifference, compute_difference, separation
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import MethodScore
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.significance import PairedComparison, compare_pairs


@dataclass(frozen=True)
class HeldOutSequence:
    """Default and tuned method in the deciding metric of one sequence.

    ``difference``: paired difference, above 0 if tuned is worse; ``significant``: whether its interval excludes 0.
    """

    ranking: Ranking
    default: MethodScore
    tuned: MethodScore
    difference: PairedDifference | None
    significant: bool

    @property
    def worse(self) -> bool:
        """Whether tuned is significantly worse."""
        return self.significant and self.difference is not None and self.difference.interval.value > 0.0


@dataclass(frozen=True)
class HeldOutVerdict:
    """The held-out comparison of one back end's tuned and default method.

    ``paired``: over all runs with a ground truth, None if there is none; ``lost``: runs lost by default and tuned.
    """

    label: str
    paired: PairedComparison | None
    sequences: tuple[HeldOutSequence, ...]
    lost: tuple[int, int]
    overfitted: bool
    verdict: str


def judge_held_out(analysis: Analysis, results: Sequence[MethodSearch]) -> tuple[HeldOutVerdict, ...]:
    """The verdicts on all back ends that were tuned, adjusted together (Holm)."""
    labels = [one.tunable.label for one in results if one.tuned]
    pairs = compare_pairs(analysis.comparison, analysis.sequences, [(label + TUNED, label) for label in labels])
    by_default = {pair.reference: pair for pair in pairs}
    return tuple(_judge_method(analysis, label, by_default.get(label)) for label in labels)


def _judge_method(analysis: Analysis, label: str, paired: PairedComparison | None) -> HeldOutVerdict:
    sequences = tuple(
        one for sequence in analysis.sequences if (one := _compare_on_sequence(sequence, label)) is not None
    )
    lost = _count_lost(analysis.comparison, label), _count_lost(analysis.comparison, label + TUNED)
    worse = [one.ranking.sequence for one in sequences if one.worse]
    better = [one.ranking.sequence for one in sequences if one.significant and not one.worse]
    overfitted = lost[1] > lost[0] or bool(worse) or (paired is not None and paired.verdict == "worse")
    return HeldOutVerdict(label, paired, sequences, lost, overfitted, _describe_verdict(paired, lost, worse, better))


def _describe_verdict(
    paired: PairedComparison | None, lost: tuple[int, int], worse: Sequence[str], better: Sequence[str]
) -> str:
    if lost[1] > lost[0]:
        return f"overfitted: it loses {lost[1]} held-out runs, the default {lost[0]}"
    if paired is not None and paired.verdict == "worse":
        return "overfitted: worse than the default on held-out runs"
    where = f"; overfitted on {', '.join(worse)}, where it is worse than the default" if worse else ""
    if paired is None:
        return f"not comparable: no run of both has a ground truth and a geometry that determines the pose{where}"
    if paired.verdict == "better":
        return f"better on held-out runs too{where}"
    alone = f", but significantly better on {', '.join(better)}" if better else ""
    return f"{paired.verdict} over all held-out runs{alone}{where}"


def _compare_on_sequence(sequence: SequenceAnalysis, label: str) -> HeldOutSequence | None:
    ranking = sequence.deciding
    if ranking is None or ranking.metric.better != "lower":
        return None
    default, tuned = ranking.of(label), ranking.of(label + TUNED)
    if default is None or tuned is None or not default.values or not tuned.values:
        return None
    shown = separation(ranking.metric, tuned, default) == "clear"
    return HeldOutSequence(ranking, default, tuned, compute_difference(tuned, default), shown)


def _count_lost(comparison: Comparison, label: str) -> int:
    statuses = [record.result.status for record in comparison.records if record.method == label]
    return sum(status != RunStatus.COMPLETE and status not in NOT_EXECUTED for status in statuses)
