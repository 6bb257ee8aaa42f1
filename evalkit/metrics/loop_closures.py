"""Loop closures and corrections of a SLAM: their numbers, precision and recall against the truth, and their cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.run_result import RunResult, Score
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import NO_FINAL, NO_TRUE_TRAJECTORY, Evidence, cached, make_metrics, make_score
from evalkit.metrics.relations import symmetric_errors
from evalkit.metrics.revisits import NO_REVISIT, find_all_revisits, within_limits
from evalkit.metrics.runtime import NOT_MEASURED, is_measured
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate

RIGHT_M, RIGHT_DEG = 0.2, 5.0
"""A closure is right if its motion is at most this far from the true one."""

CLOSED_WITHIN_M = 5.0
"""A revisit is closed by a closure whose frames lie within this path of both visits.

A robot that leaves its earlier path for less than this does not return anew.
"""


@dataclass(frozen=True, eq=False)
class JudgedClosures:
    """The accepted closures (K,) with true poses at both frames: their stamps, and which are right."""

    earlier_ns: Stamps
    later_ns: Stamps
    right: Bools


def measure_errors(closures: Sequence[LoopClosure], truth: Trajectory | None) -> Floats:
    """Return the error (K, 2) of each closure's motion in m and rad; nan where the truth of a frame is not known.

    It is that of both orders of the two frames, averaged.
    """
    errors = np.full((len(closures), 2), np.nan)
    if truth is None or len(truth) < 2 or not closures:
        return errors
    stamps = np.array([[one.other_stamp_ns, one.stamp_ns] for one in closures], dtype=np.int64)
    known = can_interpolate(truth.stamps_ns, stamps, MAX_GAP_S).all(axis=1)
    measured = np.array([one.other_from_base.row for one in closures])[known]
    earlier, later = stamps[known].T
    errors[known] = symmetric_errors(measured, se2.between(truth.at(earlier), truth.at(later)))
    return errors


def judge_closures(closures: Sequence[LoopClosure], truth: Trajectory) -> JudgedClosures:
    """Compare the accepted closures with the true motion between their frames; others are left out."""
    accepted = [one for one in closures if one.accepted]
    errors = measure_errors(accepted, truth)
    known = np.isfinite(errors).all(axis=1)
    stamps = np.array([[one.other_stamp_ns, one.stamp_ns] for one in accepted], dtype=np.int64).reshape(-1, 2)[known]
    right = within_limits(errors[known], RIGHT_M, float(np.radians(RIGHT_DEG)))
    return JudgedClosures(stamps[:, 0], stamps[:, 1], right)


def find_closed_returns(judged: JudgedClosures, truth: Trajectory) -> Bools:
    """Return which returns (K,) of the true path to itself a right closure joins, in order of time.

    A return is a stretch of path along which the robot is near its earlier path (``find_all_revisits``). It is joined
    if one of its revisits is closed.
    """
    visits = find_all_revisits(truth)
    if len(visits) == 0:
        return np.zeros(0, dtype=np.bool_)
    order = np.argsort(visits.second_ns, kind="stable")
    path = _path_m(truth, visits.first_ns[order], visits.second_ns[order])
    starts = np.concatenate([[0], np.flatnonzero(np.diff(path[:, 1]) > CLOSED_WITHIN_M) + 1])
    return np.asarray(np.logical_or.reduceat(_find_closed(judged, path, truth), starts))


def _find_closed(judged: JudgedClosures, visits_m: Floats, truth: Trajectory) -> Bools:
    """Return which revisits (M,) a right closure joins; ``visits_m`` (M, 2): path to both visits, m."""
    from scipy.spatial import cKDTree

    if not judged.right.any():
        return np.zeros(len(visits_m), dtype=np.bool_)
    closures = _path_m(truth, judged.earlier_ns[judged.right], judged.later_ns[judged.right])
    apart, _ = cKDTree(closures).query(visits_m, p=np.inf)
    return np.asarray(apart <= CLOSED_WITHIN_M)


def find_corrections(run: RunResult) -> Bools | None:
    """Return at which steps (N,) a SLAM moved earlier poses; None where it does not say.

    As its updates report it; else at the frames of its accepted closures.
    """
    if (run.steps["corrected"] >= 0).any():
        return np.asarray(run.steps["corrected"] == 1)
    if not run.loop_closures:
        return None
    return np.isin(run.steps["stamp_ns"], [one.stamp_ns for one in run.loop_closures if one.accepted])


def _path_m(truth: Trajectory, first_ns: Stamps, second_ns: Stamps) -> Floats:
    """Return the true path (K, 2) in m from the start to both times."""
    steps = np.linalg.norm(np.diff(truth.poses[:, :2], axis=0), axis=1)
    path = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray(np.interp(np.stack([first_ns, second_ns], axis=1), truth.stamps_ns, path))


@cached
def _judge(evidence: Evidence) -> JudgedClosures | None:
    truth = evidence.truth.trajectory
    if truth is None or len(truth) < 2:
        return None
    return judge_closures(evidence.run.loop_closures, truth)


def _of_slam(measure: Callable[[Evidence], Score]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        return Score(None, reason=NO_FINAL) if evidence.run.final is None else measure(evidence)

    return compute


def _make_count(accepted: tuple[bool, ...]) -> Callable[[Evidence], Score]:
    def count(evidence: Evidence) -> Score:
        found = evidence.run.loop_closures
        return make_score(sum(one.accepted in accepted for one in found), len(evidence.run.steps))

    return _of_slam(count)


def _of_judged(measure: Callable[[JudgedClosures], float]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        judged = _judge(evidence)
        if judged is None:
            return Score(None, reason=NO_TRUE_TRAJECTORY)
        return make_score(measure(judged), len(judged.right)) if len(judged.right) else Score(None, reason=_NONE_JUDGED)

    return _of_slam(compute)


def _score_recall(evidence: Evidence) -> Score:
    judged, truth = _judge(evidence), evidence.truth.trajectory
    if judged is None or truth is None:
        return Score(None, reason=NO_TRUE_TRAJECTORY)
    closed = find_closed_returns(judged, truth)
    if len(closed) == 0:
        return Score(None, reason=NO_REVISIT)
    return make_score(100.0 * closed.mean(), len(closed))


def _count_recoveries(evidence: Evidence) -> Score:
    found = evidence.run.loop_closures
    if all(one.found_again is None for one in found):
        return Score(None, len(evidence.run.steps), _NO_RECOVERIES)
    return make_score(sum(one.accepted and one.found_again is True for one in found), len(evidence.run.steps))


def _score_corrections(evidence: Evidence) -> Score:
    corrected = find_corrections(evidence.run)
    if corrected is None:
        return Score(None, len(evidence.run.steps), _NOT_REPORTED)
    return make_score(corrected.sum(), len(corrected))


def _make_correction_ms(statistic: Callable[[Floats], np.floating]) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        corrected = find_corrections(evidence.run)
        if corrected is None:
            return Score(None, len(evidence.run.steps), _NOT_REPORTED)
        if not corrected.any():
            return Score(None, reason=_NO_CORRECTION)
        if not is_measured(evidence.run, "cpu_ns"):
            return Score(None, int(corrected.sum()), NOT_MEASURED["cpu_ns"])
        return make_score(statistic(evidence.run.steps["cpu_ns"][corrected] * 1e-6), int(corrected.sum()))

    return _of_slam(compute)


def _score_final_ms(evidence: Evidence) -> Score:
    if not is_measured(evidence.run, "cpu_ns"):
        return Score(None, reason=NOT_MEASURED["cpu_ns"])
    return make_score(evidence.run.final_cpu_ns * 1e-6, 1)


_NONE_JUDGED = "no loop closure was accepted between frames with true poses"
_NOT_REPORTED = "the back end reports neither corrections nor loop closures"
_NO_CORRECTION = "no update moved earlier poses"
_NO_RECOVERIES = "no loop closure reports whether it found a lost track again"

METRICS = make_metrics(
    "loop_closures",
    {
        "closure_candidates": _make_count((True, False)),
        "closures_accepted": _make_count((True,)),
        "closures_rejected": _make_count((False,)),
        "closures_wrong": _of_judged(lambda judged: float((~judged.right).sum())),
        "closure_precision_percent": _of_judged(lambda judged: 100.0 * float(judged.right.mean())),
        "closure_recall_percent": _of_slam(_score_recall),
        "recoveries_own": _of_slam(_count_recoveries),
        "corrections": _of_slam(_score_corrections),
        "correction_median_ms": _make_correction_ms(np.median),
        "correction_max_ms": _make_correction_ms(np.max),
        "final_cpu_ms": _of_slam(_score_final_ms),
    },
    RIGHT_M=RIGHT_M,
    RIGHT_DEG=RIGHT_DEG,
    CLOSED_WITHIN_M=CLOSED_WITHIN_M,
)
