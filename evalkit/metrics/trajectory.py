"""Match and align estimate and ground truth; absolute trajectory errors and coverage."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.pose import Pose
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import (
    NO_POSES,
    NO_TRUE_TRAJECTORY,
    Evidence,
    MatchedPoses,
    Unmatched,
    make_metrics,
    make_score,
)

Alignment = Literal["least squares", "first pose", "none"]

IN_MAP = "none, because the ground truth is in the frame of the known map,"

MAX_GAP_S = 1.0
"""Poses farther apart in time are not interpolated."""

MIN_SPREAD_M = 0.05
"""A true path with a smaller spread (RMS) does not determine the heading: it is aligned by its first pose."""


def match_trajectories(
    estimate: Trajectory,
    truth: Trajectory | None,
    alignment: Alignment = "least squares",
    max_gap_s: float = MAX_GAP_S,
    map_from_start: Pose | None = None,
) -> MatchedPoses | Unmatched:
    """Match estimate and ground truth in time and align the estimate to the ground truth.

    ``map_from_start``: where the estimate begins in a known map, whose frame is that of the ground truth; then nothing
    is fitted, whatever ``alignment`` says.

    Of the two trajectories, the one with more poses in the common time span is interpolated at the stamps of the other,
    where its neighbouring poses are at most ``max_gap_s`` apart. Equal stamps need no interpolation.
    """
    if truth is None:
        return Unmatched(NO_TRUE_TRAJECTORY)
    if len(estimate) == 0 or len(truth) == 0:
        return Unmatched(NO_POSES if len(truth) else _EMPTY)
    inside_estimate, inside_truth = _mark_within(estimate, truth), _mark_within(truth, estimate)
    denser, stamps = estimate, truth.stamps_ns[inside_truth]
    if inside_estimate.sum() < inside_truth.sum():
        denser, stamps = truth, estimate.stamps_ns[inside_estimate]
    stamps = stamps[can_interpolate(denser.stamps_ns, stamps, max_gap_s)]
    if len(stamps) < 2:
        return Unmatched(f"estimate and ground truth share {len(stamps)} stamps, at least 2 are needed")
    rule = f"{len(stamps)} equal stamps"
    if not np.isin(stamps, denser.stamps_ns).all():
        names = ("estimate", "ground truth") if denser is estimate else ("ground truth", "estimate")
        rule = f"{names[0]} interpolated at {len(stamps)} stamps of the {names[1]}, gaps up to {max_gap_s:g} s"
    if map_from_start is not None:
        placed = se2.compose(map_from_start.row, estimate.at(stamps))
        return MatchedPoses(stamps, placed, truth.at(stamps), IN_MAP, rule, map_from_start, is_in_map=True)
    return _align(stamps, estimate.at(stamps), truth.at(stamps), alignment, rule)


def can_interpolate(stamps_ns: Stamps, at_ns: ArrayLike, max_gap_s: float) -> Bools:
    """Return which times (K,) equal a stamp or lie between two stamps at most ``max_gap_s`` apart."""
    at = np.asarray(at_ns, dtype=np.int64)
    if len(stamps_ns) == 0:
        return np.zeros(at.shape, dtype=np.bool_)
    inside = (at >= stamps_ns[0]) & (at <= stamps_ns[-1])
    right = np.searchsorted(stamps_ns, at).clip(0, len(stamps_ns) - 1)
    gap = stamps_ns[right] - stamps_ns[np.maximum(right - 1, 0)]
    return np.asarray(inside & ((stamps_ns[right] == at) | (gap <= max_gap_s * 1e9)))


def align_rigidly(source: ArrayLike, target: ArrayLike) -> Floats:
    """Return the least-squares ``target_from_source`` (3,) of pairs of points (N, 2).

    Umeyama, PAMI 13(4), 1991, without scale. In the plane: theta = atan2(K01 - K10, K00 + K11).
    """
    p, q = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    k = (p - p.mean(axis=0)).T @ (q - q.mean(axis=0))
    theta = np.arctan2(k[0, 1] - k[1, 0], k[0, 0] + k[1, 1])
    turned = se2.transform([0.0, 0.0, theta], p.mean(axis=0)[None])[0]
    return np.array([*(q.mean(axis=0) - turned), se2.wrap(theta)])


def compute_errors_m(estimate: Trajectory, truth: Trajectory) -> Floats:
    """Return the distance (N,) of each pose of an aligned estimate to the ground truth; nan where it is unknown.

    The ground truth is interpolated between poses at most ``MAX_GAP_S`` apart.
    """
    known = can_interpolate(truth.stamps_ns, estimate.stamps_ns, MAX_GAP_S)
    errors = np.full(len(estimate), np.nan)
    errors[known] = _compute_distances(estimate.poses[known], truth.at(estimate.stamps_ns[known]))
    return errors


def position_errors(matched: MatchedPoses) -> Floats:
    """Return the distances (N,) between estimated and true positions in metres."""
    return _compute_distances(matched.estimate, matched.truth)


def heading_errors(matched: MatchedPoses) -> Floats:
    """Return estimated minus true headings (N,) in radians within [-pi, pi)."""
    return se2.wrap(matched.estimate[:, 2] - matched.truth[:, 2])


def covered_share(estimate: Trajectory, truth: Trajectory) -> float:
    """Return the share of the ground truth's time span between estimated poses at most ``MAX_GAP_S`` apart."""
    stamps = estimate.stamps_ns[_mark_within(estimate, truth)]
    gaps = np.diff(stamps) * 1e-9
    return float(gaps[gaps <= MAX_GAP_S].sum() / truth.duration_s)


def rms(values: Floats) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def with_matched_poses(measure: Callable[[MatchedPoses], Score]) -> Callable[[Evidence], Score]:
    """Return ``measure`` of the matched poses as a function of the evidence; no value if nothing was matched."""

    def compute(evidence: Evidence) -> Score:
        if isinstance(evidence.matched, Unmatched):
            return Score(None, reason=evidence.matched.reason)
        return measure(evidence.matched)

    return compute


def _mark_within(trajectory: Trajectory, span: Trajectory) -> Bools:
    stamps = trajectory.stamps_ns
    if len(span) == 0:
        return np.zeros(len(stamps), dtype=np.bool_)
    return np.asarray((stamps >= span.stamps_ns[0]) & (stamps <= span.stamps_ns[-1]))


def _align(stamps: Stamps, estimate: Floats, truth: Floats, alignment: Alignment, rule: str) -> MatchedPoses:
    spread = rms(np.linalg.norm(truth[:, :2] - truth[:, :2].mean(axis=0), axis=1))
    how: str = alignment
    if alignment == "none":
        row = np.zeros(3)
    elif alignment == "first pose" or spread < MIN_SPREAD_M:
        row = se2.compose(truth[0], se2.inverse(estimate[0]))
        how = "first pose" if alignment == "first pose" else f"first pose (the true path spreads only {spread:.2f} m)"
    else:
        row = align_rigidly(estimate[:, :2], truth[:, :2])
    return MatchedPoses(stamps, se2.compose(row, estimate), truth, how, rule, Pose.of(row))


def _compute_distances(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.linalg.norm(one[:, :2] - other[:, :2], axis=1))


def _score_answered(evidence: Evidence) -> Score:
    expected = evidence.run.expected
    if expected == 0:
        return Score(None, reason=_UNKNOWN_LENGTH)
    return make_score(100.0 * len(evidence.run.steps) / expected, expected)


def _score_covered(evidence: Evidence) -> Score:
    truth = evidence.truth.trajectory
    if truth is None or truth.duration_s == 0.0:
        return Score(None, reason=NO_TRUE_TRAJECTORY if truth is None else _NO_DURATION)
    return make_score(100.0 * covered_share(evidence.run.estimate, truth), len(evidence.run.steps))


_EMPTY = "the ground-truth trajectory is empty"
_NO_DURATION = "the ground-truth trajectory has no duration"
_UNKNOWN_LENGTH = "the number of scans in the sequence is unknown"


METRICS = make_metrics(
    "trajectory",
    {
        "ate_rmse_m": with_matched_poses(lambda m: make_score(rms(position_errors(m)), len(m.stamps_ns))),
        "ate_median_m": with_matched_poses(lambda m: make_score(np.median(position_errors(m)), len(m.stamps_ns))),
        "ate_max_m": with_matched_poses(lambda m: make_score(position_errors(m).max(), len(m.stamps_ns))),
        "heading_rmse_deg": with_matched_poses(
            lambda m: make_score(np.degrees(rms(heading_errors(m))), len(m.stamps_ns))
        ),
        "answered_percent": _score_answered,
        "covered_percent": _score_covered,
    },
    MAX_GAP_S=MAX_GAP_S,
)
