"""Whether a run that lost the track found it again, and whether it was in the wrong place of a known map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evalkit.core import se2
from evalkit.core.ground_truth import Relations
from evalkit.core.run_result import LostTrack
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Evidence, MatchedPoses
from evalkit.metrics.relations import compute_estimated_motions, symmetric_errors
from evalkit.metrics.track import MAX_M, WINDOW_S
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate

RIGHT_M, RIGHT_RAD, RIGHT_SHARE = 0.5, np.radians(10.0), 0.05
"""A pose is right again within these, or this share of the true path since the track was right."""


def find_right_s(lost: LostTrack) -> float:
    """Return until when (s) the track was right: ``WINDOW_S`` before a loss, or where the wrong motion begins.

    A wrong motion may last longer: it is counted from the start of the track, or scans are seconds apart.
    """
    before_s = max(lost.at_s - WINDOW_S, 0.0)
    return before_s if lost.since_s is None else min(before_s, lost.since_s)


def add_recovery(evidence: Evidence, lost: LostTrack | None) -> LostTrack | None:
    """Return the loss with the time from which on the poses were right again until the end of the run.

    In a known map a pose is right near the truth, and a run is lost where it is farther than ``MAX_M`` from it.
    Elsewhere the motion since the track was right (``find_right_s``) must agree with the true one. The last
    ``WINDOW_S`` at least must be right. Without a true trajectory the measured relations decide, without both nothing
    is known.
    """
    in_map = isinstance(evidence.matched, MatchedPoses) and evidence.matched.is_in_map
    if lost is not None and evidence.truth.trajectory is None and evidence.truth.relations is not None:
        return _find_again_by_relations(evidence.run.estimate, evidence.truth.relations, lost)
    if evidence.truth.trajectory is None or (lost is None and not in_map):
        return lost
    estimate = evidence.run.estimate
    stamps = estimate.stamps_ns[can_interpolate(evidence.truth.trajectory.stamps_ns, estimate.stamps_ns, MAX_GAP_S)]
    if not len(stamps):
        return lost
    seconds = (stamps - estimate.stamps_ns[0]) * 1e-9
    true, own = evidence.truth.trajectory.at(stamps), estimate.at(stamps)
    if in_map:
        own = se2.compose(evidence.matched.world_from_start.row, own)  # type: ignore[union-attr]  # matched: in_map
        metres = np.hypot(*(own - true)[:, :2].T)
        lost = _find_earlier(lost, metres, seconds)
        if lost is None:
            return None
        right = metres <= RIGHT_M
    else:
        assert lost is not None
        right = _is_motion_right(own, true, seconds, lost)
    wrong = np.flatnonzero(np.logical_not(right) & (seconds >= lost.at_s))
    after = int(wrong[-1]) + 1 if len(wrong) else int(np.searchsorted(seconds, lost.at_s)) + 1
    if after >= len(seconds) or seconds[-1] - seconds[after] < WINDOW_S or seconds[after] <= lost.at_s:
        return lost
    return replace(lost, recovered_at_s=float(seconds[after]))


def _find_earlier(lost: LostTrack | None, metres: Floats, seconds: Floats) -> LostTrack | None:
    """Return the first scan that is in the wrong place of the map, or what was found, whichever is earlier."""
    far = np.flatnonzero(metres > MAX_M)
    if not len(far) or (lost is not None and lost.at_s <= seconds[far[0]]):
        return lost
    return LostTrack(float(seconds[far[0]]), f"{metres[far[0]]:.2f} m away from the ground truth in the known map")


def _find_again_by_relations(estimate: Trajectory, relations: Relations, lost: LostTrack) -> LostTrack:
    """Return the loss with the end of the first right relation that spans it and that no wrong one follows.

    A relation spans the loss if it begins while the track was right (``find_right_s``) and ends later. Wrong ones
    count if they span it too or begin after that end: what begins in between says nothing about the time after.
    """
    motions, covered = compute_estimated_motions(estimate, relations)
    if not covered.any():
        return lost
    metres, turn = symmetric_errors(motions, relations.first_from_second[covered]).T
    ends = np.sort(np.stack([relations.first_ns[covered], relations.second_ns[covered]], axis=1), axis=1)
    steps = np.hypot(*np.diff(estimate.poses[:, :2], axis=0).T)
    path = np.diff(np.interp(ends, estimate.stamps_ns, np.concatenate([[0.0], np.cumsum(steps)])), axis=1)[:, 0]
    begin_s, end_s = ((ends - estimate.stamps_ns[0]) * 1e-9).T
    right = (metres <= np.maximum(RIGHT_M, RIGHT_SHARE * path)) & (turn <= RIGHT_RAD)
    spans = (begin_s <= find_right_s(lost)) & (end_s > lost.at_s)
    within = (begin_s >= lost.at_s) & ~right
    after_s = max(end_s[spans & ~right].max(initial=lost.at_s), begin_s[within].max(initial=lost.at_s))
    found = end_s[spans & right & (end_s > after_s)]
    last_s = (estimate.stamps_ns[-1] - estimate.stamps_ns[0]) * 1e-9
    if not len(found) or last_s - found.min() < WINDOW_S:
        return lost
    return replace(lost, recovered_at_s=float(found.min()))


def _is_motion_right(own: Floats, true: Floats, seconds: Floats, lost: LostTrack) -> Floats:
    """Return for each pose whether the motion to it from a pose before the loss is the true one."""
    anchor = max(int(np.searchsorted(seconds, find_right_s(lost), side="right")) - 1, 0)
    steps = np.hypot(*np.diff(true[:, :2], axis=0).T)
    path = np.abs(np.concatenate([[0.0], np.cumsum(steps)]) - steps[:anchor].sum())
    wrong = se2.between(se2.between(true[anchor], true), se2.between(own[anchor], own))
    near = np.hypot(wrong[:, 0], wrong[:, 1]) <= np.maximum(RIGHT_M, RIGHT_SHARE * path)
    return np.asarray(near & (np.abs(wrong[:, 2]) <= RIGHT_RAD))
