"""Relative errors of an estimate: from pose to pose, per metre, per turn, from start to end."""

from __future__ import annotations

from functools import partial
from typing import Literal

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats, Stamps
from evalkit.metrics.metric import MatchedPoses, make_metrics, make_score
from evalkit.metrics.trajectory import rms, with_matched_poses

LENGTHS_M = (1.0, 2.0, 5.0, 10.0, 20.0)
START_EVERY_M = 0.1
STEP_S = 1.0
TURN = 2.0 * np.pi
START_EVERY_TURN = np.radians(10.0)


def travelled_m(matched: MatchedPoses) -> Floats:
    """Return the true path length (N,) in metres since the first pose."""
    steps = np.linalg.norm(np.diff(matched.truth[:, :2], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def turned_rad(matched: MatchedPoses) -> Floats:
    """Return the true rotation (N,) in radians since the first pose, left and right turns both counted as positive."""
    return np.concatenate([[0.0], np.cumsum(np.abs(se2.wrap(np.diff(matched.truth[:, 2]))))])


def find_segments(progress: Floats, length: float, start_every: float) -> tuple[Ints, Ints]:
    """Return first and last indices (K,) of all segments of at least ``length`` along ``progress`` (N,).

    ``progress`` must not decrease. A segment starts at the first pose at or beyond each multiple of ``start_every``, so
    that a standstill counts once, and ends at the first pose at least ``length`` farther.
    """
    slack = 1e-9  # sums of steps are not exact
    goals = np.arange(0.0, progress[-1] - length + slack, start_every)
    first = np.unique(np.searchsorted(progress, goals - slack))
    last = np.searchsorted(progress, progress[first] + length - slack)
    reached = last < len(progress)
    return first[reached], last[reached]


def find_pairs_in_time(stamps_ns: Stamps, apart_s: float) -> tuple[Ints, Ints]:
    """Return first and last indices (K,) of all pairs of stamps (N,) ``apart_s`` apart, to half a typical step.

    All pairs, including overlapping ones: each stamp with the stamp nearest to ``apart_s`` later.
    """
    wanted = stamps_ns + round(apart_s * 1e9)
    after = np.minimum(np.searchsorted(stamps_ns, wanted), len(stamps_ns) - 1)
    last = np.where(wanted - stamps_ns[after - 1] < stamps_ns[after] - wanted, after - 1, after)
    near = np.abs(stamps_ns[last] - wanted) <= 0.5 * np.median(np.diff(stamps_ns))
    first = np.arange(len(stamps_ns))
    kept = near & (last > first)
    return first[kept], last[kept]


def relative_errors(matched: MatchedPoses, first: Ints, last: Ints) -> Floats:
    """Return the motions (K, 3) between the true and the estimated step from ``first`` to ``last``.

    Relative pose error (Sturm et al., IROS 2012): (Q_i^-1 Q_j)^-1 (P_i^-1 P_j).
    """
    true = se2.between(matched.truth[first], matched.truth[last])
    estimated = se2.between(matched.estimate[first], matched.estimate[last])
    return se2.between(true, estimated)


def segment_errors(matched: MatchedPoses, lengths_m: tuple[float, ...]) -> Floats:
    """Return for each segment (K, 3): translation error (m), rotation error (rad), true path length (m)."""
    progress = travelled_m(matched)
    rows = [np.zeros((0, 3))]
    for length in lengths_m:
        first, last = find_segments(progress, length, START_EVERY_M)
        errors = relative_errors(matched, first, last)
        rows.append(np.stack([_compute_norms(errors), np.abs(errors[:, 2]), progress[last] - progress[first]], axis=1))
    return np.concatenate(rows)


def _compute_norms(motions: Floats) -> Floats:
    return np.asarray(np.linalg.norm(motions[:, :2], axis=1))


def _compute_steps(matched: MatchedPoses) -> Floats:
    count = len(matched.stamps_ns)
    return relative_errors(matched, np.arange(count - 1), np.arange(1, count))


def _score_step_m(matched: MatchedPoses) -> Score:
    return make_score(rms(_compute_norms(_compute_steps(matched))), len(matched.stamps_ns) - 1)


def _score_step_deg(matched: MatchedPoses) -> Score:
    return make_score(np.degrees(rms(_compute_steps(matched)[:, 2])), len(matched.stamps_ns) - 1)


def _score_second(matched: MatchedPoses, column: Literal["m", "deg"]) -> Score:
    first, last = find_pairs_in_time(matched.stamps_ns, STEP_S)
    if len(first) == 0:
        return Score(None, reason=f"no two matched poses are {STEP_S:g} s apart")
    errors = relative_errors(matched, first, last)
    return make_score(rms(_compute_norms(errors)) if column == "m" else np.degrees(rms(errors[:, 2])), len(first))


def _report_too_short(matched: MatchedPoses, length_m: float) -> Score:
    path = travelled_m(matched)[-1]
    return Score(None, reason=f"a path of {path:.1f} m is too short for segments of {length_m:g} m")


def _score_percent(lengths_m: tuple[float, ...], matched: MatchedPoses) -> Score:
    rows = segment_errors(matched, lengths_m)
    if len(rows) == 0:
        return _report_too_short(matched, min(lengths_m))
    return make_score(100.0 * np.mean(rows[:, 0] / rows[:, 2]), len(rows))


def _score_deg_per_m(matched: MatchedPoses) -> Score:
    rows = segment_errors(matched, LENGTHS_M)
    if len(rows) == 0:
        return _report_too_short(matched, min(LENGTHS_M))
    return make_score(np.degrees(np.mean(rows[:, 1] / rows[:, 2])), len(rows))


def _score_metre_rms(matched: MatchedPoses) -> Score:
    rows = segment_errors(matched, (1.0,))
    return make_score(rms(rows[:, 0]), len(rows)) if len(rows) else _report_too_short(matched, 1.0)


def _score_deg_per_turn(matched: MatchedPoses) -> Score:
    progress = turned_rad(matched)
    first, last = find_segments(progress, TURN, START_EVERY_TURN)
    if len(first) == 0:
        return Score(None, reason=f"a path that turns {np.degrees(progress[-1]):.0f} deg has no segment of 360 deg")
    errors = np.abs(relative_errors(matched, first, last)[:, 2])
    return make_score(np.degrees(np.mean(errors * TURN / (progress[last] - progress[first]))), len(first))


def _score_end_percent(matched: MatchedPoses) -> Score:
    path = travelled_m(matched)[-1]
    if path < 1.0:
        return Score(None, reason=f"a path of {path:.1f} m is too short (1 m needed)")
    last = len(matched.stamps_ns) - 1
    return make_score(
        100.0 * _compute_norms(relative_errors(matched, np.array([0]), np.array([last])))[0] / path, last + 1
    )


KITTI = "Geiger et al., CVPR 2012 (KITTI odometry benchmark), with shorter lengths for rooms"


METRICS = make_metrics(
    "drift",
    {
        "drift_percent": with_matched_poses(partial(_score_percent, LENGTHS_M)),
        **{
            f"drift_{length:g}m_percent": with_matched_poses(partial(_score_percent, (length,))) for length in LENGTHS_M
        },
        "drift_deg_per_m": with_matched_poses(_score_deg_per_m),
        "drift_deg_per_turn": with_matched_poses(_score_deg_per_turn),
        "end_error_percent": with_matched_poses(_score_end_percent),
        "rpe_step_m": with_matched_poses(_score_step_m),
        "rpe_step_deg": with_matched_poses(_score_step_deg),
        "rpe_1s_m": with_matched_poses(partial(_score_second, column="m")),
        "rpe_1s_deg": with_matched_poses(partial(_score_second, column="deg")),
        "rpe_1m_m": with_matched_poses(_score_metre_rms),
    },
    START_EVERY_M=START_EVERY_M,
)
