"""Brings estimate and truth to the same times and the same frame, and tells how far apart they are there."""

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
from evalkit.metrics.table import DIVERGED, Evidence, MatchedPoses, Metric, make_score, with_support

Alignment = Literal["least squares", "first pose", "none"]

MAX_GAP_S = 1.0
"""Between two poses farther apart in time than this nothing is interpolated."""

MIN_SPREAD_M = 0.05
"""A true path that spreads less (RMS) fixes no heading: it is aligned by its first pose instead."""


def match_trajectories(
    estimate: Trajectory,
    truth: Trajectory | None,
    alignment: Alignment = "least squares",
    max_gap_s: float = MAX_GAP_S,
) -> MatchedPoses | str:
    """Estimate and truth at common times, the estimate brought into the truth's frame; or a text why not.

    Of the two, the one with more poses in the common span is interpolated at the stamps of the other, where the poses
    around the stamp are at most ``max_gap_s`` apart; equal stamps need no interpolation.
    """
    if truth is None:
        return "no true trajectory"
    if len(estimate) == 0 or len(truth) == 0:
        return "the run answered no scan" if len(truth) else "the true trajectory is empty"
    inside_estimate, inside_truth = _within(estimate, truth), _within(truth, estimate)
    denser, stamps = estimate, truth.stamps_ns[inside_truth]
    if inside_estimate.sum() < inside_truth.sum():
        denser, stamps = truth, estimate.stamps_ns[inside_estimate]
    stamps = stamps[can_interpolate(denser.stamps_ns, stamps, max_gap_s)]
    if len(stamps) < 2:
        return f"estimate and truth meet at {len(stamps)} times, at least 2 are needed"
    rule = f"{len(stamps)} equal stamps"
    if not np.isin(stamps, denser.stamps_ns).all():
        names = ("estimate", "truth") if denser is estimate else ("truth", "estimate")
        rule = f"{names[0]} interpolated at {len(stamps)} stamps of the {names[1]}, gaps up to {max_gap_s:g} s"
    return _aligned(stamps, estimate.at(stamps), truth.at(stamps), alignment, rule)


def can_interpolate(stamps_ns: Stamps, at_ns: ArrayLike, max_gap_s: float) -> Bools:
    """Which times (K,) fall on a stamp, or between two stamps at most that far apart."""
    at = np.asarray(at_ns, dtype=np.int64)
    if len(stamps_ns) == 0:
        return np.zeros(at.shape, dtype=np.bool_)
    inside = (at >= stamps_ns[0]) & (at <= stamps_ns[-1])
    right = np.searchsorted(stamps_ns, at).clip(0, len(stamps_ns) - 1)
    gap = stamps_ns[right] - stamps_ns[np.maximum(right - 1, 0)]
    return np.asarray(inside & ((stamps_ns[right] == at) | (gap <= max_gap_s * 1e9)))


def align_rigidly(source: ArrayLike, target: ArrayLike) -> Floats:
    """The ``target_from_source`` (3,) that is best in least squares, for pairs of points (N, 2).

    Umeyama, PAMI 13(4), 1991, without scale; the plane needs no decomposition: theta = atan2(K01 - K10, K00 + K11).
    """
    p, q = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    k = (p - p.mean(axis=0)).T @ (q - q.mean(axis=0))
    theta = np.arctan2(k[0, 1] - k[1, 0], k[0, 0] + k[1, 1])
    turned = se2.transform([0.0, 0.0, theta], p.mean(axis=0)[None])[0]
    return np.array([*(q.mean(axis=0) - turned), se2.wrap(theta)])


def compute_errors_m(estimate: Trajectory, truth: Trajectory, max_gap_s: float = MAX_GAP_S) -> Floats:
    """Distance (N,) of each pose of an already aligned estimate to the truth; nan where the truth is not known.

    The truth is interpolated between poses at most ``max_gap_s`` apart.
    """
    known = can_interpolate(truth.stamps_ns, estimate.stamps_ns, max_gap_s)
    errors = np.full(len(estimate), np.nan)
    errors[known] = _distances(estimate.poses[known], truth.at(estimate.stamps_ns[known]))
    return errors


def position_errors(matched: MatchedPoses) -> Floats:
    """Distances (N,) between estimated and true positions (m)."""
    return _distances(matched.estimate, matched.truth)


def heading_errors(matched: MatchedPoses) -> Floats:
    """Estimated minus true headings (N,) in radians within [-pi, pi)."""
    return se2.wrap(matched.estimate[:, 2] - matched.truth[:, 2])


def covered_share(estimate: Trajectory, truth: Trajectory, max_gap_s: float = MAX_GAP_S) -> float:
    """The share of the truth's time span between poses of the estimate at most ``max_gap_s`` apart."""
    stamps = estimate.stamps_ns[_within(estimate, truth)]
    gaps = np.diff(stamps) * 1e-9
    return float(gaps[gaps <= max_gap_s].sum() / truth.duration_s)


def rms(values: Floats) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def with_matched_poses(measure: Callable[[MatchedPoses], Score]) -> Callable[[Evidence], Score]:
    """The same measure of evidence, which says why where estimate and truth were not matched."""

    def compute(evidence: Evidence) -> Score:
        if isinstance(evidence.matched, MatchedPoses):
            return measure(evidence.matched)
        return Score(None, 0, evidence.matched or "no true trajectory")

    return compute


def _within(trajectory: Trajectory, span: Trajectory) -> Bools:
    stamps = trajectory.stamps_ns
    if len(span) == 0:
        return np.zeros(len(stamps), dtype=np.bool_)
    return np.asarray((stamps >= span.stamps_ns[0]) & (stamps <= span.stamps_ns[-1]))


def _aligned(stamps: Stamps, estimate: Floats, truth: Floats, alignment: Alignment, rule: str) -> MatchedPoses:
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


def _distances(one: Floats, other: Floats) -> Floats:
    return np.asarray(np.linalg.norm(one[:, :2] - other[:, :2], axis=1))


def _answered(evidence: Evidence) -> Score:
    expected = evidence.run.expected
    if expected == 0:
        return Score(None, 0, "how many scans there are is not known")
    return make_score(100.0 * len(evidence.run.steps) / expected, expected)


def _covered(evidence: Evidence) -> Score:
    truth = evidence.truth.trajectory
    if truth is None or truth.duration_s == 0.0:
        return Score(None, 0, "no true trajectory" if truth is None else "the true trajectory has no duration")
    return make_score(100.0 * covered_share(evidence.run.estimate, truth), len(evidence.run.steps))


ATE = "Sturm et al., IROS 2012 (absolute trajectory error); Umeyama, PAMI 13(4), 1991"

_ROWS = (
    Metric("ate_rmse_m", "ATE RMSE", "m", "lower", "drift",
           "Root mean square distance between estimated and true positions at the same times, after the rigid "
           "alignment without scale that makes it smallest.", ATE,
           "when the error arose: one early wrong turn weighs more than a late one; scans that were not answered",
           with_matched_poses(lambda m: make_score(rms(position_errors(m)), len(m.stamps_ns))), headline=True),
    Metric("ate_median_m", "ATE median", "m", "lower", "drift",
           "Median of the same distances.", ATE, "everything in the worse half of the run",
           with_matched_poses(lambda m: make_score(np.median(position_errors(m)), len(m.stamps_ns)))),
    Metric("ate_max_m", "ATE maximum", "m", "lower", "drift",
           "Largest of the same distances.", ATE, "everything but the worst moment",
           with_matched_poses(lambda m: make_score(position_errors(m).max(), len(m.stamps_ns)))),
    Metric("heading_rmse_deg", "heading RMSE", "deg", "lower", "drift",
           "Root mean square difference of estimated and true headings, after the same alignment.", ATE,
           "errors of position; scans that were not answered",
           with_matched_poses(lambda m: make_score(np.degrees(rms(heading_errors(m))), len(m.stamps_ns))), 2),
    Metric("answered_percent", "scans answered", "%", "higher", "drift",
           "Scans answered before the run ended, of all scans in the sequence.", "evalkit",
           "whether the answers are right", _answered, 1),
    Metric("covered_percent", "true time covered", "%", "higher", "drift",
           f"Share of the true trajectory's time span between answers at most {MAX_GAP_S:g} s apart.", "evalkit",
           "whether the answers are right", _covered, 1),
)  # fmt: skip

UNMATCHED = (
    "no true trajectory",
    "the run answered no scan",
    "the true trajectory is empty",
    "estimate and truth meet at ... times, at least 2 are needed",
    DIVERGED,
)
"""Why a metric of matched poses may have no value."""

METRICS = with_support(
    _ROWS,
    {
        "answered_percent": ("scans in the sequence", ("how many scans there are is not known",)),
        "covered_percent": (
            "scans answered",
            ("no true trajectory", "the true trajectory has no duration"),
        ),
        "*": ("poses matched with the truth", UNMATCHED),
    },
)
