"""Whether a run lost the track, and when: motion over short windows against the truth, the odometry and the scans.

A track is lost where its motion over a window differs from a reference by more than ``MAX_M`` and ``MAX_SHARE`` of the
path, or by ``MAX_TURN`` and ``MAX_SHARE`` of the turns: far beyond the drift of a working method. References, as far
as they exist: the true trajectory, the relations, the wheel odometry. The odometry may be wrong itself (slip, a lifted
robot), so a difference from it counts only where the scans at both ends of the window fit the odometry better. Without
all three, long steps count where the scans fit the motion before them better. Measured references have wrong entries:
a window or a relation does not count where the scans fit the estimate better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import islice

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.ground_truth import Relations
from evalkit.core.run_result import LostTrack
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Evidence
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.relations import compute_estimated_motions, symmetric_errors
from evalkit.metrics.trajectory import MAX_GAP_S, can_interpolate

WINDOW_M, WINDOW_S = 2.0, 10.0
"""A window ends after this path or this time, whichever comes first."""

MAX_M, MAX_TURN, MAX_SHARE = 1.0, np.radians(45.0), 0.5
"""Limits of the error over a window; the share is that of the path, or of the sum of all turns, in the window."""

LONG_M, MAX_LONG_SHARE = 10.0, 0.25
"""From this path on, the error since the start of the track is limited to this share of the path as well."""

JUMP, MIN_JUMP_M, MIN_JUMP_TURN = 5.0, 0.5, np.radians(30.0)
"""A step is a jump if it is longer than these and faster than ``JUMP`` times the 95th percentile of all steps."""

NEAR_M, MIN_FIT, MIN_BETTER = 0.15, 0.3, 0.1
"""A motion fits two scans by the share of the second's points that it moves to within ``NEAR_M`` of the first's.

Another motion fits better if its share is at least ``MIN_FIT`` and larger by ``MIN_BETTER``.
"""

MIN_KNOWN = 0.95
"""Where the truth is known at fewer of the scans, the other references count too."""

NO_POINTS = np.zeros((0, 2))

MAX_JUDGED = 200
"""Largest number of windows that are judged by their scans."""


def find_lost_track(evidence: Evidence, frames: Callable[[], Iterable[Frame]]) -> LostTrack | None:
    """Return when and why a run lost the track, None if it did not as far as is known.

    ``frames``: the frames of the sequence, read only where scans decide.
    """
    estimate, truth = evidence.run.estimate, evidence.truth
    if len(estimate) < 2:
        return None
    described: list[LostTrack] = []
    differences: list[_Difference] = []
    tracks = None if truth.trajectory is None else _make_tracks(estimate, truth.trajectory)
    known = 0 if tracks is None else len(tracks.stamps_ns)
    if tracks is not None and known:  # an excerpt may lie between the true poses
        long = islice(_find_long_windows(tracks), 1)
        described += [_describe(estimate, tracks, *window, "the ground truth") for window in long]
        windows = islice(_find_windows(tracks), MAX_JUDGED)
        differences += [_compare(estimate, tracks, *window, "the ground truth") for window in windows]
    if known < MIN_KNOWN * len(estimate):
        differences += [] if truth.relations is None else _find_wrong_relations(estimate, truth.relations)
        described += _find_contradicted_by_scans(estimate, evidence.odometry, frames)
    described += _find_supported(differences, frames)
    return min(described, key=lambda lost: lost.at_s, default=None)


@dataclass(frozen=True, eq=False)
class _Difference:
    """A motion (3,) of the estimate between two scans beside that of a measured reference, and what it would mean."""

    first_ns: int
    last_ns: int
    own: Floats
    reference: Floats
    lost: LostTrack


def _compare(estimate: Trajectory, tracks: _Tracks, first: int, last: int, name: str) -> _Difference:
    own, reference = (se2.between(poses[first], poses[last]) for poses in (tracks.estimate, tracks.reference))
    described = _describe(estimate, tracks, first, last, name)
    return _Difference(int(tracks.stamps_ns[first]), int(tracks.stamps_ns[last]), own, reference, described)


def _find_supported(differences: list[_Difference], frames: Callable[[], Iterable[Frame]]) -> list[LostTrack]:
    """The first difference, of the first ``MAX_JUDGED``, that the scans do not decide in favour of the estimate."""
    judged = sorted(differences, key=lambda one: one.lost.at_s)[:MAX_JUDGED]
    fits = _measure_fits(judged, frames)
    return next(([one.lost] for one, own, reference in fits if not _is_better(own, reference)), [])


def _measure_fits(
    differences: list[_Difference], frames: Callable[[], Iterable[Frame]]
) -> Iterator[tuple[_Difference, float, float]]:
    """Yield each difference with how well the motions of the estimate and of the reference fit its two scans."""
    points = _collect_points(frames, {stamp for one in differences for stamp in (one.first_ns, one.last_ns)})
    for one in differences:
        target, source = (points.get(stamp, NO_POINTS) for stamp in (one.first_ns, one.last_ns))
        yield one, _fit(target, source, one.own), _fit(target, source, one.reference)


def _is_better(fit: float, other: float) -> bool:
    return fit >= max(MIN_FIT, other + MIN_BETTER)


IndexWindow = tuple[int, int]
"""Indices of its first and last scan."""


@dataclass(frozen=True, eq=False)
class _Tracks:
    """Poses (N, 3) of the estimate and of a reference at the same times (N,)."""

    stamps_ns: Stamps
    estimate: Floats
    reference: Floats

    @cached_property
    def steps(self) -> Floats:
        """Steps (N - 1, 3) of the reference."""
        return se2.between(self.reference[:-1], self.reference[1:])

    @cached_property
    def path_m(self) -> Floats:
        """Path (N,) of the reference since the first pose."""
        return _sum_up(np.hypot(self.steps[:, 0], self.steps[:, 1]))

    @cached_property
    def turned(self) -> Floats:
        """Sum (N,) of the turns of the reference since the first pose in rad, left and right ones positive."""
        return _sum_up(np.abs(self.steps[:, 2]))

    @cached_property
    def part(self) -> Ints:
        """Number (N,) of the jumps of the reference so far: a robot carried away, or an odometry reset."""
        return np.cumsum(np.append(False, _find_jumps(self.steps, self.stamps_ns)))

    @cached_property
    def part_ends(self) -> Ints:
        """Index (N,) of the last pose before the next jump of the reference."""
        return np.searchsorted(self.part, self.part, side="right") - 1

    def errors(self, first: Ints, last: Ints) -> Floats:
        """Errors (K, 2) of the estimated motions from ``first`` to ``last`` (K,): m and rad."""
        true = se2.between(self.reference[first], self.reference[last])
        wrong = se2.between(true, se2.between(self.estimate[first], self.estimate[last]))
        return np.stack([np.hypot(wrong[:, 0], wrong[:, 1]), np.abs(wrong[:, 2])], axis=1)

    def are_wrong(self, first: Ints, last: Ints) -> Bools:
        """Which estimated motions (K,) exceed the limits of a window."""
        metres, turn = self.errors(first, last).T
        metres -= 1e-9  # sums of steps are not exact
        too_far = metres > np.maximum(MAX_M, MAX_SHARE * (self.path_m[last] - self.path_m[first]))
        return np.asarray(too_far | (turn > np.maximum(MAX_TURN, MAX_SHARE * (self.turned[last] - self.turned[first]))))


def _make_tracks(estimate: Trajectory, reference: Trajectory) -> _Tracks:
    known = can_interpolate(reference.stamps_ns, estimate.stamps_ns, MAX_GAP_S)
    stamps = estimate.stamps_ns[known]
    return _Tracks(stamps, estimate.poses[known], reference.at(stamps))


def _find_windows(tracks: _Tracks) -> Iterator[IndexWindow]:
    """Yield wrong windows in the order of time, without overlap, each cut at the first scan where it is wrong.

    Where the last step alone is wrong, the window is that step.
    """
    first = np.arange(len(tracks.stamps_ns))
    by_path = np.searchsorted(tracks.path_m, tracks.path_m + WINDOW_M)
    by_time = np.searchsorted(tracks.stamps_ns, tracks.stamps_ns + round(WINDOW_S * 1e9))
    last = np.minimum(np.minimum(by_path, by_time), tracks.part_ends)
    free_from = 0
    for start in np.flatnonzero(tracks.are_wrong(first, last)).tolist():
        if start >= free_from:
            ends = np.arange(start + 1, last[start] + 1)
            free_from = int(ends[np.argmax(tracks.are_wrong(np.full_like(ends, start), ends))])
            step = np.array([free_from - 1]), np.array([free_from])
            yield free_from - 1 if tracks.are_wrong(*step)[0] else start, free_from


def _find_long_windows(tracks: _Tracks) -> Iterator[IndexWindow]:
    """Yield the windows from the start of a part of the track whose error exceeds its share of the path."""
    first = np.searchsorted(tracks.part, tracks.part)
    last = np.arange(len(tracks.part))
    path = tracks.path_m[last] - tracks.path_m[first]
    wrong = (path >= LONG_M) & (tracks.errors(first, last)[:, 0] > MAX_LONG_SHARE * path)
    yield from ((int(first[end]), int(end)) for end in np.flatnonzero(wrong))


def _find_wrong_relations(estimate: Trajectory, relations: Relations) -> list[_Difference]:
    """The relations that the estimate misses by the limits of a window, or long ones by their share of the path."""
    motions, covered = compute_estimated_motions(estimate, relations)
    metres, turn = symmetric_errors(motions, relations.first_from_second[covered]).T
    ends = np.sort(np.stack([relations.first_ns[covered], relations.second_ns[covered]], axis=1), axis=1)
    steps = np.diff(estimate.poses[:, :2], axis=0)
    path = np.diff(np.interp(ends, estimate.stamps_ns, _sum_up(np.hypot(steps[:, 0], steps[:, 1]))), axis=1)[:, 0]
    short = np.diff(ends, axis=1)[:, 0] <= WINDOW_S * 1e9
    too_far = metres > np.where(short, MAX_M, np.maximum(LONG_M, path) * MAX_LONG_SHARE)
    wrong = np.flatnonzero(too_far | (short & (turn > MAX_TURN)))
    wrong = wrong[np.argsort(ends[wrong, 1], kind="stable")][:MAX_JUDGED]
    differences = []
    for one in wrong.tolist():
        begin_s, end_s = (ends[one] - estimate.stamps_ns[0]) * 1e-9
        where = f"from {begin_s:.1f} s to {end_s:.1f} s"
        away = f"{metres[one]:.2f} m and {np.degrees(turn[one]):.0f} deg"
        lost = LostTrack(float(end_s), f"{where}, {away} away from the measured relation", since_s=float(begin_s))
        first = _nearest(estimate.stamps_ns, int(relations.first_ns[covered][one]))
        second = _nearest(estimate.stamps_ns, int(relations.second_ns[covered][one]))
        measured = relations.first_from_second[covered][one]
        differences.append(_Difference(first, second, motions[one], measured, lost))
    return differences


def _nearest(stamps_ns: Stamps, stamp_ns: int) -> int:
    """Return the stamp (N,) nearest to a time."""
    return int(stamps_ns[np.argmin(np.abs(stamps_ns - stamp_ns))])


def _find_contradicted_by_scans(
    estimate: Trajectory, odometry: Trajectory | None, frames: Callable[[], Iterable[Frame]]
) -> list[LostTrack]:
    """The first window whose scans fit another motion better: that of the odometry, or without it the one before."""
    reference = _without_jumps(estimate) if odometry is None else odometry
    tracks = _make_tracks(estimate, reference)
    steps = np.arange(len(tracks.stamps_ns))
    long_steps = np.flatnonzero(tracks.are_wrong(steps[:-1], steps[1:])).tolist()  # no motion lasts for a whole window
    found = ((first, first + 1) for first in long_steps) if odometry is None else _find_windows(tracks)
    name = f"{'the motion before' if odometry is None else 'the wheel odometry'}, which fits the scans better"
    judged = [_compare(estimate, tracks, *window, name) for window in islice(found, MAX_JUDGED)]
    fits = _measure_fits(judged, frames)
    return next(([one.lost] for one, own, other in fits if _is_better(other, own)), [])


def _without_jumps(estimate: Trajectory) -> Trajectory:
    """The track with the speed before each long step kept during that step."""
    steps = se2.between(estimate.poses[:-1], estimate.poses[1:])
    seconds = np.diff(estimate.stamps_ns) * 1e-9
    jumps = _find_jumps(steps, estimate.stamps_ns, 0.0)  # any long step; the scans tell a fast robot from a lost one
    before = np.maximum.accumulate(np.where(jumps, -1, np.arange(len(steps))))  # the last step that was no jump
    kept = np.where((before >= 0)[:, None], steps[before] * (seconds / seconds[before])[:, None], 0.0)
    steps[jumps] = kept[jumps]
    headings = _sum_up(steps[:, 2]) + estimate.poses[0, 2]
    moved = se2.compose(np.stack([np.zeros(len(steps)), np.zeros(len(steps)), headings[:-1]], axis=1), steps)
    positions = np.stack([_sum_up(moved[:, 0]), _sum_up(moved[:, 1])], axis=1) + estimate.poses[0, :2]
    return Trajectory(estimate.stamps_ns, np.column_stack([positions, se2.wrap(headings)]))


def _find_jumps(steps: Floats, stamps_ns: Stamps, factor: float = JUMP) -> Bools:
    """Which steps (N - 1, 3) are jumps. ``factor``: how many times faster than others."""
    seconds = np.diff(stamps_ns) * 1e-9
    jumps = np.zeros(len(steps), dtype=np.bool_)
    for size, shortest in ((np.hypot(steps[:, 0], steps[:, 1]), MIN_JUMP_M), (np.abs(steps[:, 2]), MIN_JUMP_TURN)):
        speed = size / seconds
        jumps |= (size > shortest) & (speed > factor * np.percentile(speed, 95)) if len(speed) else jumps
    return jumps


def _collect_points(frames: Callable[[], Iterable[Frame]], wanted: set[int]) -> dict[int, Floats]:
    """The points (K, 2) of the scans with these stamps, in the base frame."""
    found: dict[int, Floats] = {}
    for frame in frames() if wanted else ():
        if frame.scan.stamp_ns in wanted:
            found[frame.scan.stamp_ns] = frame.base_from_sensor.transform(frame.scan.points())
            if len(found) == len(wanted):
                break
    return found


def _fit(target: Floats, source: Floats, target_from_source: Floats) -> float:
    """The share of the points of the source that lie near a point of the target."""
    if len(target) == 0 or len(source) == 0:
        return 0.0
    distance, _ = build_kd_tree(target).query(se2.transform(target_from_source, source), distance_upper_bound=NEAR_M)
    return float(np.mean(distance < np.inf))


def _describe(estimate: Trajectory, tracks: _Tracks, first: int, last: int, reference: str) -> LostTrack:
    ends = tracks.stamps_ns[[first, last]]
    begin_s, end_s = ((ends - estimate.stamps_ns[0]) * 1e-9).tolist()
    if np.diff(np.searchsorted(estimate.stamps_ns, ends))[0] == 1:  # the reference may not know the scans in between
        own, true = (se2.between(poses[first], poses[last]) for poses in (tracks.estimate, tracks.reference))
        moves, turns = _format_motion(own)
        its_moves, its_turns = _format_motion(true)
        reason = f"moves {moves} and turns {turns} in one scan, against {its_moves} and {its_turns} by {reference}"
        return LostTrack(end_s, reason, since_s=begin_s)
    metres, turn = tracks.errors(np.array([first]), np.array([last]))[0]
    path = tracks.path_m[last] - tracks.path_m[first]
    where = f"from {begin_s:.1f} s to {end_s:.1f} s, on a path of {path:.1f} m"
    away = f"{metres:.2f} m and {np.degrees(turn):.0f} deg away from {reference}"
    return LostTrack(end_s, f"{where}, {away}", since_s=begin_s)


def _format_motion(motion: Floats) -> tuple[str, str]:
    return f"{np.hypot(motion[0], motion[1]):.2f} m", f"{np.degrees(abs(motion[2])):.0f} deg"


def _sum_up(steps: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(steps)])
