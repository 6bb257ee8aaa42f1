"""How sure the comparison as a whole is: success, ranks and tests over all runs with a truth, failures as the worst."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np

from evalkit.core.run_result import NOT_EXECUTED
from evalkit.core.se2 import Floats
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.standings import MARGIN_SHARE, WITH_TRUTH, Standing, deciding, method_of
from evalkit.results.run_record import RunRecord
from evalkit.stats.intervals import Interval, wilson_interval
from evalkit.stats.paired_tests import (
    SignedRankTest,
    signed_rank_tests,
    smallest_detectable_difference,
    vargha_delaney_a12,
)
from evalkit.stats.ranks import FriedmanTest, NotTested, friedman_test, success_quantiles

Runs = Mapping[tuple[str, int | None], float]
"""The deciding error of every run by sequence and seed; infinite where it failed."""

SIGNIFICANT = 0.05
METRES = "m"
NO_SEQUENCE = "no sequence has both a ground truth and a geometry that determines the pose"


@dataclass(frozen=True, slots=True)
class Record:
    """How one method did over all: runs finished with their share's interval, mean rank over sequences, reach.

    ``runs`` that could start; ``rank`` None where it has not met every sequence. ``reach``: the errors (m) that 50, 75
    and 95 % of all its runs stay within, infinite where more failed; none where no sequence is decided in metres.
    """

    method: str
    finished: int
    runs: int
    share: Interval | None
    rank: float | None
    reach: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Duel:
    """One method held against a reference over every run both made.

    ``ratio``: median of its error by the reference's (None: one of them failed in the middle run). ``larger``: how
    often its error would be the larger one (A12). ``detectable``: the ratio that so many runs would have shown.
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
    said: str


@dataclass(frozen=True, slots=True)
class Evidence:
    """The whole comparison held against chance. ``ranks``: Friedman's test, or why there is none."""

    sequences: tuple[str, ...]
    records: tuple[Record, ...]
    duels: tuple[Duel, ...]
    ranks: FriedmanTest | NotTested
    ranked: tuple[str, ...]


def evidence(comparison: Comparison) -> Evidence:
    """How sure a comparison is, over the sequences that have a truth and a geometry that fixes the pose."""
    counted = [found for label in comparison.sequence_labels if (found := _counted(comparison, label))]
    errors = {who: _errors(comparison, counted, who) for who in comparison.method_labels}
    table, ranked = _table(counted, errors)
    means = dict(zip(ranked, _mean_ranks(table), strict=True)) if len(table) else {}
    references = dict.fromkeys(
        [*sorted(means, key=lambda who: means[who])[:1], *method_of(comparison, "reference")[:1]]
    )
    ranks = friedman_test(table) if len(table) else NotTested(NO_SEQUENCE)
    metres = {found.sequence for found in counted if found.metric.unit == METRES}
    return Evidence(
        tuple(found.sequence for found in counted),
        tuple(_record(comparison, who, errors[who], means.get(who), metres) for who in comparison.method_labels),
        _duels(errors, [who for who in references if errors[who]]),
        ranks,
        ranked,
    )


def duels(comparison: Comparison, pairs: Sequence[tuple[str, str]]) -> tuple[Duel, ...]:
    """Every first method held against its second, over the runs both made; those without a common run are left out.

    Holm's adjustment is over these pairs.
    """
    counted = [found for label in comparison.sequence_labels if (found := _counted(comparison, label))]
    errors = {who: _errors(comparison, counted, who) for pair in pairs for who in pair}
    return _held(errors, pairs)


def _counted(comparison: Comparison, sequence: str) -> Standing | None:
    """What decides a sequence, if that is an error against a truth."""
    found = deciding(comparison, sequence)
    if found is None or comparison.sequences[sequence].degenerate:
        return None
    return found if found.metric.group in WITH_TRUTH and found.metric.better == "lower" else None


def _errors(comparison: Comparison, counted: Sequence[Standing], method: str) -> Runs:
    metric = {found.sequence: found.metric.name for found in counted}
    return {
        (record.sequence, record.seed): _error(record, metric[record.sequence])
        for record in comparison.records
        if record.method == method and record.sequence in metric and _could_err(record)
    }


def _could_err(record: RunRecord) -> bool:
    """Whether a run could have an error at all: it was possible here, and is more than a map without trajectory."""
    a_map_alone = record.result.is_complete and not len(record.result.steps)
    return record.result.status not in NOT_EXECUTED and not a_map_alone


def _error(record: RunRecord, metric: str) -> float:
    value = record.scores.by_metric[metric].value if metric in record.scores.by_metric else None
    return math.inf if not record.result.is_complete or value is None else value


def _table(counted: Sequence[Standing], errors: Mapping[str, Runs]) -> tuple[Floats, tuple[str, ...]]:
    """Median errors (N, K) of the methods that could start on every sequence, and who they are."""
    by_sequence = {
        who: {found.sequence: [e for (label, _), e in runs.items() if label == found.sequence] for found in counted}
        for who, runs in errors.items()
    }
    ranked = tuple(who for who, own in by_sequence.items() if own and all(own.values()))
    rows = [[_middle(by_sequence[who][found.sequence]) for who in ranked] for found in counted]
    return np.round(np.array(rows, dtype=np.float64).reshape(len(rows), len(ranked)), 9), ranked


def _middle(errors: Sequence[float]) -> float:
    """The median error of a sequence's runs; infinite if any failed, for nobody ranks by the runs it survived."""
    return math.inf if math.inf in errors else median(errors)


def _mean_ranks(table: Floats) -> list[float]:
    smaller = (table[:, None, :] < table[:, :, None]).sum(axis=2)
    equal = (table[:, None, :] == table[:, :, None]).sum(axis=2)
    means: list[float] = (smaller + (equal + 1) / 2.0).mean(axis=0).tolist()
    return means


def _record(comparison: Comparison, who: str, errors: Runs, rank: float | None, metres: set[str]) -> Record:
    started = [t for t in comparison.records if t.method == who and t.result.status not in NOT_EXECUTED]
    finished = sum(record.result.is_complete for record in started)
    share = wilson_interval(finished, len(started)) if started else None
    measured = [error for (sequence, _), error in errors.items() if sequence in metres]
    reach = success_quantiles(measured) if measured else ()
    return Record(who, finished, len(started), share, rank, reach)


def _duels(errors: Mapping[str, Runs], references: Sequence[str]) -> tuple[Duel, ...]:
    return _held(
        errors,
        [
            (who, reference)
            for reference in references
            for who in errors
            if who != reference and who not in references[: references.index(reference)]
        ],
    )


def _held(errors: Mapping[str, Runs], named: Sequence[tuple[str, str]]) -> tuple[Duel, ...]:
    pairs = {(who, reference): _paired(errors[who], errors[reference]) for who, reference in named}
    pairs = {names: both for names, both in pairs.items() if len(both[0])}
    tests = signed_rank_tests({" ".join(names): both for names, both in pairs.items()})
    return tuple(_duel(*names, *both, tests[" ".join(names)]) for names, both in pairs.items())


def _paired(one: Runs, other: Runs) -> tuple[Floats, Floats]:
    """Logarithms (N,) of both errors over common runs, so that a ratio counts the same on every sequence.

    To nine digits: what differs by rounding is equal.
    """
    common = [run for run in one if run in other]
    return _logarithms([one[run] for run in common]), _logarithms([other[run] for run in common])


def _logarithms(errors: Sequence[float]) -> Floats:
    return np.asarray(np.round(np.log(np.maximum(np.array(errors, dtype=np.float64), 1e-12)), 9), dtype=np.float64)


def _duel(who: str, reference: str, ours: Floats, theirs: Floats, test: SignedRankTest) -> Duel:
    both = np.isfinite(ours) & np.isfinite(theirs)
    apart = ours[both] - theirs[both]
    signed = np.where(ours == theirs, 0.0, np.where(ours > theirs, math.inf, -math.inf))
    signed[both] = apart
    middle = float(np.median(np.clip(signed, -1e9, 1e9)))
    better, worse = int((ours < theirs).sum()), int((ours > theirs).sum())
    detectable = smallest_detectable_difference(apart)
    return Duel(
        who,
        reference,
        len(ours),
        better,
        worse,
        math.exp(middle) if abs(middle) < 1e2 else None,
        vargha_delaney_a12(ours, theirs),
        test.p_holm,
        math.exp(detectable) if detectable < 1e2 else math.inf,
        _said(middle, test, len(ours)),
    )


def _said(middle: float, test: SignedRankTest, runs: int) -> str:
    if 2.0 ** (1 - runs) > SIGNIFICANT:  # all runs in one direction: the least p that so many can give
        return "too few runs to show anything"
    if test.p_holm > SIGNIFICANT or abs(middle) < math.log1p(MARGIN_SHARE):
        return "no difference shown"
    return "better" if middle < 0.0 else "worse"
