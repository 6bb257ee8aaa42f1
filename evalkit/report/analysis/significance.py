"""Statistics over all runs with ground truth: success, ranks and paired tests; a failed run counts as the worst."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.run_status import NOT_EXECUTED
from evalkit.core.se2 import Floats
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.pairwise import MARGIN_SHARE
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import WITH_TRUTH
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.results.run_record import RunRecord
from evalkit.stats.intervals import Interval, wilson_interval
from evalkit.stats.paired_tests import (
    SignedRankTest,
    least_p,
    signed_rank_tests,
    smallest_detectable_difference,
    vargha_delaney_a12,
)
from evalkit.stats.ranks import FriedmanTest, NotTested, compute_ranks, friedman_test, success_quantiles

ErrorsByRun = Mapping[tuple[str, int | None], float]
"""The deciding error of every run by sequence and seed; infinite if the run failed."""

SIGNIFICANCE_LEVEL = 0.05
INVERSE = {"better": "worse", "worse": "better"}
METRES = "m"
NO_SEQUENCE = "no sequence has both a ground truth and a geometry that determines the pose"


@dataclass(frozen=True, slots=True)
class MethodRecord:
    """One method over all sequences.

    ``finished`` of the ``runs`` that could start, with the interval of that ``share``. ``rank``: mean rank over the
    data sets, None if a sequence is missing. ``quantiles``: errors (m) that 50, 75 and 95 % of its ``measured`` runs
    over ``sequences`` do not exceed, infinite if more failed; none if no sequence is decided in metres.
    """

    method: str
    finished: int
    runs: int
    share: Interval | None
    rank: float | None
    quantiles: tuple[float, ...]
    measured: int
    sequences: int


@dataclass(frozen=True, slots=True)
class PairedComparison:
    """One method against a reference over all runs that both have.

    ``ratio``: median of its error divided by the reference's, None if one of them failed in the median run. ``larger``:
    probability that its error is the larger one on the same sequence (A12), the mean over the sequences by their runs.
    ``detectable``: the ratio that so many runs detect with a power of 80 %, whatever the other rows show.
    """

    method: str
    reference: str
    runs: int
    better: int
    worse: int
    ratio: float | None
    larger: float
    p: float
    detectable: float
    verdict: str


@dataclass(frozen=True, slots=True)
class Significance:
    """The statistics over all ``sequences`` with ground truth. ``ranked``: methods in the order of ``ranks``."""

    sequences: tuple[str, ...]
    records: tuple[MethodRecord, ...]
    comparisons: tuple[PairedComparison, ...]
    ranks: FriedmanTest | NotTested
    ranked: tuple[str, ...]

    def find_better(self, method: str) -> tuple[str, ...]:
        """Return the methods that the paired tests call better than a method, over the runs that both have."""
        pairs = [
            *((one.method, one.verdict) for one in self.comparisons if one.reference == method),
            *((one.reference, INVERSE.get(one.verdict)) for one in self.comparisons if one.method == method),
        ]
        return tuple(other for other, verdict in pairs if verdict == "better")


def compute_significance(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], winners: Sequence[str] = ()
) -> Significance:
    """Compute the statistics over the sequences with ground truth and a geometry that determines the pose.

    Every method is tested against the best-ranked one, the ``winners`` of the title and the reference method.
    """
    counted = _counted_rankings(sequences)
    errors = {method: _run_errors(comparison, counted, method) for method in comparison.method_labels}
    ranked = tuple(
        m for m, own in errors.items() if counted and {one.sequence for one in counted} == {s for s, _ in own}
    )
    table = _errors_of_data_sets(sequences, counted, [errors[method] for method in ranked])
    means = dict(zip(ranked, compute_ranks(table).mean(axis=0).tolist(), strict=True)) if len(table) else {}
    best = sorted(means, key=lambda method: means[method])[:1]
    references = [
        label
        for label in dict.fromkeys([*best, *winners, *comparison.methods_with_role("reference")[:1]])
        if errors[label]
    ]  # fmt: skip
    pairs = [
        (method, reference)
        for number, reference in enumerate(references)
        for method in errors
        if method != reference and method not in references[:number]
    ]
    metres = {ranking.sequence for ranking in counted if ranking.metric.unit == METRES}
    return Significance(
        tuple(ranking.sequence for ranking in counted),
        tuple(_method_record(comparison, m, errors[m], means.get(m), metres) for m in comparison.method_labels),
        _compare_pairs(errors, pairs),
        friedman_test(table) if len(table) else NotTested(NO_SEQUENCE),
        ranked,
    )


def compare_pairs(
    comparison: Comparison, sequences: Sequence[SequenceAnalysis], pairs: Sequence[tuple[str, str]]
) -> tuple[PairedComparison, ...]:
    """Compare every first method with its second over their common runs; pairs without a common run are left out.

    Holm's adjustment is over these pairs.
    """
    counted = _counted_rankings(sequences)
    errors = {method: _run_errors(comparison, counted, method) for pair in pairs for method in pair}
    return _compare_pairs(errors, pairs)


def _counted_rankings(sequences: Sequence[SequenceAnalysis]) -> list[Ranking]:
    """Return the deciding rankings that are errors against ground truth."""
    return [
        sequence.deciding
        for sequence in sequences
        if sequence.deciding is not None
        and not sequence.card.degenerate
        and sequence.deciding.metric.group in WITH_TRUTH
        and sequence.deciding.metric.better == "lower"
    ]


def _run_errors(comparison: Comparison, counted: Sequence[Ranking], method: str) -> ErrorsByRun:
    """Return the errors of a method, without those on data sets that its settings were chosen on."""
    tuned = {one.sequence for one in counted if (score := one.of(method)) is not None and score.tuned}
    metric = {one.sequence: one.metric.name for one in counted if one.sequence not in tuned}
    return {
        (run.sequence, run.seed): _run_error(run, metric[run.sequence])
        for run in comparison.records
        if run.method == method and run.sequence in metric and _can_have_error(run)
    }


def _can_have_error(run: RunRecord) -> bool:
    """Return whether a run could start and is more than a map without a trajectory."""
    map_only = run.result.is_complete and not len(run.result.steps)
    return run.result.status not in NOT_EXECUTED and not map_only


def _run_error(run: RunRecord, metric: str) -> float:
    value = run.scores.by_metric[metric].value if metric in run.scores.by_metric else None
    return math.inf if not run.result.is_complete or value is None else value


def _errors_of_data_sets(
    sequences: Sequence[SequenceAnalysis], counted: Sequence[Ranking], errors: Sequence[ErrorsByRun]
) -> Floats:
    """Return errors (N, K) of K methods over N data sets, as logarithms: sequences of one data set are no two proofs.

    The mean over the sequences of a data set of the median over the runs of a sequence.
    """
    data_set = {one.label: one.all_runs[0].spec.sequence.dataset for one in sequences}
    rows: dict[str, list[list[float]]] = {}
    for ranking in counted:
        own = [_median_error([e for (label, _), e in runs.items() if label == ranking.sequence]) for runs in errors]
        rows.setdefault(data_set[ranking.sequence], []).append(own)
    return np.array([_logarithms(own).mean(axis=0) for own in rows.values()]).reshape(len(rows), len(errors))


def _median_error(errors: Sequence[float]) -> float:
    """Return the median error of a sequence's runs; infinite if any failed."""
    return math.inf if math.inf in errors else median(errors)


def _method_record(
    comparison: Comparison, method: str, errors: ErrorsByRun, rank: float | None, metres: set[str]
) -> MethodRecord:
    started = [run for run in comparison.records if run.method == method and run.result.status not in NOT_EXECUTED]
    finished = sum(run.result.is_complete for run in started)
    share = wilson_interval(finished, len(started)) if started else None
    measured = {run: error for run, error in errors.items() if run[0] in metres}
    quantiles = success_quantiles(list(measured.values())) if measured else ()
    where = {sequence for sequence, _ in measured}
    return MethodRecord(method, finished, len(started), share, rank, quantiles, len(measured), len(where))


def _compare_pairs(errors: Mapping[str, ErrorsByRun], named: Sequence[tuple[str, str]]) -> tuple[PairedComparison, ...]:
    pairs = {(method, reference): _pair_errors(errors[method], errors[reference]) for method, reference in named}
    pairs = {names: both for names, both in pairs.items() if len(both[0])}
    tests = signed_rank_tests({" ".join(names): both for names, both in pairs.items()})
    return tuple(
        _compare_pair(*names, *both, _larger(errors[names[0]], errors[names[1]]), tests[" ".join(names)], len(pairs))
        for names, both in pairs.items()
    )


def _pair_errors(one: ErrorsByRun, other: ErrorsByRun) -> tuple[Floats, Floats]:
    """Return the logarithms (N,) of both errors over common runs: a ratio counts the same on every sequence.

    Rounded to nine digits, so that rounding errors make no difference.
    """
    common = [run for run in one if run in other]
    return _logarithms([one[run] for run in common]), _logarithms([other[run] for run in common])


def _larger(one: ErrorsByRun, other: ErrorsByRun) -> float:
    """Return A12 of the common runs of each sequence, its mean weighted by their number.

    Over the runs of all sequences, how far the sequences differ would hide how far the methods do.
    """
    counts = Counter(sequence for sequence, seed in one if (sequence, seed) in other)
    total = 0.0
    for sequence, count in counts.items():
        own, its = ({run: error for run, error in errors.items() if run[0] == sequence} for errors in (one, other))
        total += count * vargha_delaney_a12(*_pair_errors(own, its))
    return total / counts.total()


def _logarithms(errors: ArrayLike) -> Floats:
    return np.asarray(np.round(np.log(np.maximum(np.array(errors, dtype=np.float64), 1e-12)), 9), dtype=np.float64)


def _compare_pair(
    method: str, reference: str, own: Floats, other: Floats, larger: float, test: SignedRankTest, rows: int
) -> PairedComparison:
    both = np.isfinite(own) & np.isfinite(other)
    differences = own[both] - other[both]
    signed = np.where(own == other, 0.0, np.where(own > other, math.inf, -math.inf))
    signed[both] = differences
    middle = float(np.median(np.clip(signed, -1e9, 1e9)))
    alpha = SIGNIFICANCE_LEVEL / rows  # the least of Holm's levels
    detectable = smallest_detectable_difference(differences, alpha) if least_p(len(own)) <= alpha else math.inf
    return PairedComparison(
        method,
        reference,
        len(own),
        int((own < other).sum()),
        int((own > other).sum()),
        math.exp(middle) if abs(middle) < 1e2 else None,
        larger,
        test.p_holm,
        math.exp(detectable) if detectable < 1e2 else math.inf,
        _verdict(middle, test, len(own)),
    )


def _verdict(middle: float, test: SignedRankTest, runs: int) -> str:
    if least_p(runs) > SIGNIFICANCE_LEVEL:
        return "too few runs"
    if test.p_holm > SIGNIFICANCE_LEVEL or abs(middle) < math.log1p(MARGIN_SHARE):
        return "no difference shown"
    return "better" if middle < 0.0 else "worse"
