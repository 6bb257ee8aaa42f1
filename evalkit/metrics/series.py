"""The values over time that a score summarizes, for the metrics that have a bootstrap interval within a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import RunResult, Scores
from evalkit.core.se2 import Floats
from evalkit.metrics import corrected_poses, drift, relations
from evalkit.metrics.metric import Unmatched
from evalkit.metrics.trajectory import match_trajectories
from evalkit.stats.bootstrap import MIN_VALUES, Series, Statistic


class ScoredRun(Protocol):
    """A run with its scores and ground truth."""

    @property
    def result(self) -> RunResult:
        """How the run went."""
        ...

    @property
    def scores(self) -> Scores:
        """Its evaluation."""
        ...

    @property
    def truth(self) -> Truth:
        """The ground truth of its sequence."""
        ...


def _make_error_series(run: ScoredRun) -> Series | None:
    """Return the distances to the truth, scan by scan, where the truth is known."""
    if run.scores.errors_m is None or len(run.scores.errors_m) != len(run.result.steps):
        return None
    known = np.isfinite(run.scores.errors_m)
    return _make_time_series(run.result.steps["stamp_ns"][known], run.scores.errors_m[known], "rms")


def _make_cpu_series(statistic: Statistic) -> Callable[[ScoredRun], Series | None]:
    """Return a function for the CPU times in milliseconds, scan by scan, where they were measured."""

    def series(run: ScoredRun) -> Series | None:
        steps = run.result.steps
        return (
            _make_time_series(steps["stamp_ns"], steps["cpu_ns"] * 1e-6, statistic) if steps["cpu_ns"].any() else None
        )

    return series


def _segment_errors(run: ScoredRun) -> Series | None:
    """Return the errors of segments of all lengths in percent, by their start; not evenly spaced in time."""
    matched = match_trajectories(run.result.estimate, run.truth.trajectory)
    if isinstance(matched, Unmatched):
        return None
    progress = drift.travelled_m(matched)
    starts = [drift.find_segments(progress, length, drift.START_EVERY_M)[0] for length in drift.LENGTHS_M]
    rows = drift.segment_errors(matched, drift.LENGTHS_M)
    if len(rows) == 0:
        return None
    first = np.concatenate(starts)
    length = np.repeat(np.arange(len(starts)), [len(one) for one in starts])
    order = np.lexsort((length, first))
    span_s = float(matched.stamps_ns[first.max()] - matched.stamps_ns[first.min()]) * 1e-9
    keys = matched.stamps_ns[first] * len(starts) + length
    percent = 100.0 * rows[:, 0] / rows[:, 2]
    return Series(keys[order], percent[order], "mean", max(span_s / len(rows), 1e-3))


def _relation_errors(part: relations.RelationPart) -> Callable[[ScoredRun], Series | None]:
    """Return a function for the translation errors of measured motions, by the first of their two times."""

    def series(run: ScoredRun) -> Series | None:
        known = run.truth.relations
        if known is None or len(known) == 0:
            return None
        motions, covered = relations.compute_estimated_motions(run.result.estimate, known)
        errors = relations.symmetric_errors(motions, known.first_from_second[covered])[:, 0]
        wanted = relations.select_part(known, part)[covered]
        order = np.argsort(known.first_ns[covered][wanted], kind="stable")
        return Series(np.flatnonzero(covered)[wanted][order], errors[wanted][order], "mean", None)

    return series


@dataclass(frozen=True, eq=False)
class ScoredAnswers:
    """A ScoredRun that is not stored: answers with their scores and ground truth."""

    result: RunResult
    scores: Scores
    truth: Truth


def _of_final(series: Callable[[ScoredRun], Series | None]) -> Callable[[ScoredRun], Series | None]:
    """Return a function for the corrected poses of a run."""

    def final_series(run: ScoredRun) -> Series | None:
        corrected, alignment = run.result.with_final_answers, run.scores.final
        if corrected is None or alignment is None:
            return None
        return series(ScoredAnswers(corrected, Scores(errors_m=alignment.errors_m), run.truth))

    return final_series


def _make_time_series(stamps_ns: Ints, values: Floats, statistic: Statistic) -> Series | None:
    if len(stamps_ns) < MIN_VALUES:
        return None
    return Series(stamps_ns, values, statistic, float(np.median(np.diff(stamps_ns))) * 1e-9)


_OF_POSES: Mapping[str, Callable[[ScoredRun], Series | None]] = {
    "ate_rmse_m": _make_error_series,
    "drift_percent": _segment_errors,
    **{f"relations_{part}_mean_m": _relation_errors(part) for part in ("all", "short", "long")},
}

SERIES: Mapping[str, Callable[[ScoredRun], Series | None]] = {
    **_OF_POSES,
    **{
        metric.name: _of_final(_OF_POSES[metric.counterpart])
        for metric in corrected_poses.METRICS
        if metric.counterpart in _OF_POSES
    },
    "cpu_median_ms": _make_cpu_series("median"),
    "real_time_factor": _make_cpu_series("inverse"),
}
"""The series of a record by the name of the metric; None where the record does not have it."""
