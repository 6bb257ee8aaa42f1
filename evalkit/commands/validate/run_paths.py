"""The paths of two methods' runs at the same scans: their distance, their errors, and what rounding may cause."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.metrics.runtime import period_ns
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate
from evalkit.results.run_record import RunRecord
from evalkit.stats.bootstrap import block_length

CONFIDENCE = 0.90
"""Confidence of all intervals: two one-sided tests at 5 %."""

Records = Mapping[str, Mapping[str, RunRecord]]
"""Runs by place ("room, seed 0") and by method."""

ScanMargin = tuple[float, float]
"""The margin of one scan: metres, radians."""

ScanMargins = Mapping[str, ScanMargin]
"""The margin of one scan by place."""


@dataclass(frozen=True, eq=False)
class RunErrors:
    """Errors of one run: stamps (N,), distance to the truth (N,), error of the motion over about 1 s (N,); nan."""

    stamps_ns: Floats
    ate: Floats
    rpe: Floats


def compute_errors(record: RunRecord) -> RunErrors:
    """Errors of a run against the truth, nan where the truth is not known."""
    run, truth = record.result, record.truth.trajectory
    stamps = run.steps["stamp_ns"]
    unknown = np.full(len(stamps), np.nan)
    if truth is None or record.scores.errors_m is None or len(stamps) < 3:
        return RunErrors(stamps, unknown, unknown)
    rpe, gap = unknown.copy(), max(1, round(1e9 / max(period_ns(run), 1.0)))
    known = np.flatnonzero(can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S))
    first = np.intersect1d(known, known - gap)
    true = se2.between(truth.at(stamps[first]), truth.at(stamps[first + gap]))
    poses = run.estimate.poses
    apart = se2.between(true, se2.between(poses[first], poses[first + gap]))
    rpe[first] = np.hypot(apart[:, 0], apart[:, 1])
    return RunErrors(stamps, np.asarray(record.scores.errors_m), rpe)


def path_distances(one: RunRecord, other: RunRecord) -> tuple[Floats, Floats]:
    """Seconds (N,) since the first scan that both answered, and the distance (m) of the paths from the same start."""
    stamps, a, b = np.intersect1d(one.result.steps["stamp_ns"], other.result.steps["stamp_ns"], return_indices=True)
    if not len(stamps):
        return np.zeros(0), np.zeros(0)
    apart = one.result.estimate.poses[a, :2] - other.result.estimate.poses[b, :2]
    return (stamps - stamps[0]) * 1e-9, np.asarray(np.linalg.norm(apart, axis=1))


def path_bound(margin: ScanMargin, scans: int, path_m: float) -> tuple[float, str]:
    """The largest distance (m) of two paths whose scans lie within a margin, and why in words."""
    metres, radians = margin
    bound = scans * (metres + radians * path_m)
    return bound, f"{bound:.2g} m: {scans} scans, each {metres:.2g} m and {radians:.2g} rad over {path_m:.1f} m of path"


def pooled_errors(runs: Sequence[Mapping[str, RunRecord]], a: str, b: str, quantity: str) -> tuple[Floats, Floats, int]:
    """Errors (N,) of two methods at the same scans of all runs, and the number of scans in a block of ten seconds."""
    errors_a, errors_b, block = [], [], 1
    for run in runs:
        one, other = compute_errors(run[a]), compute_errors(run[b])
        _, i, j = np.intersect1d(one.stamps_ns, other.stamps_ns, return_indices=True)
        pair = np.stack([getattr(one, quantity)[i], getattr(other, quantity)[j]])
        known = np.isfinite(pair).all(axis=0)
        errors_a.append(pair[0, known])
        errors_b.append(pair[1, known])
        block = max(block, block_length(max(len(i), 1), period_ns(run[a].result) * 1e-9))
    return np.concatenate(errors_a), np.concatenate(errors_b), block


def sequence_of(place: str) -> str:
    """The sequence of a place."""
    return place.partition(",")[0]


def have_answers(runs: Mapping[str, RunRecord], *labels: str) -> bool:
    """Whether all these methods answered more than two scans."""
    return all(label in runs and len(runs[label].result.steps) > 2 for label in labels)
