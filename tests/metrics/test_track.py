"""The check of the track: planted losses are found at the planted scan, honest runs are not called lost."""

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, LostTrack, RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.core.world import World, closed_outline
from evalkit.metrics import track
from evalkit.metrics.metric import Evidence
from evalkit.metrics.track import _find_jumps, _fit, find_lost_track

ROOM = World(closed_outline([[-2, -3], [8, -3], [8, 1], [6, 1], [6, 4], [-2, 4]]), np.array([[1.0, 2.5, 0.4]]))
OTHER = World(closed_outline([[-20, -9], [25, -9], [25, 14], [-20, 30]]))
ANGLES = np.linspace(-np.pi, np.pi, 240, endpoint=False)
JUMP = [4.89 * np.cos(0.3), 4.89 * np.sin(0.3), np.radians(111.0)]
KINDS = ["truth", "odometry", "scans alone"]


def drive(steps, start=(0.0, 0.0, 0.0)):
    """Return the poses (N + 1, 3) after steps (N, 3)."""
    poses = [np.array(start)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def steps_of(poses):
    return se2.between(poses[:-1], poses[1:])


def walk(count=120, step_m=0.05):
    """Return a walk (count + 1, 3) of 6 m in a gentle curve."""
    return drive(np.tile([step_m, 0.0, 0.008], (count, 1)))


def frames(stamps, poses, odometry, world_at=lambda index: ROOM):
    for index, (stamp, pose) in enumerate(zip(stamps, poses, strict=True)):
        ranges = world_at(index).cast(np.tile(pose[:2], (len(ANGLES), 1)), ANGLES + pose[2])
        scan = Scan(int(stamp), np.where(ranges < 60.0, ranges, np.inf), ANGLES, 0.0, 60.0)
        yield Frame(scan, Pose(), None if odometry is None else Pose.of(odometry[index]))


def judge(kind, true, estimate, stamps=None, odometry=None, world_at=lambda index: ROOM):
    """Return what is found with the true trajectory, with odometry (by default true) and scans, or with scans alone."""
    stamps = (np.arange(len(true)) * 100_000_000 if stamps is None else stamps) + 5_000_000_000
    odometry = true if odometry is None else odometry
    steps = np.zeros(len(true), dtype=STEP)
    steps["stamp_ns"] = stamps
    steps["x"], steps["y"], steps["theta"] = estimate.T
    truth = Truth("exact", Trajectory(stamps, true) if kind == "truth" else None)
    wheels = Trajectory(stamps, odometry) if kind == "odometry" else None
    evidence = Evidence(RunResult(steps, len(steps)), truth, odometry=wheels)
    return find_lost_track(evidence, lambda: frames(stamps, true, None if wheels is None else odometry, world_at))


def with_jump(true, at, jump=JUMP):
    steps = steps_of(true)
    steps[at - 1] = se2.compose(jump, steps[at - 1])
    return drive(steps)


@pytest.mark.parametrize("kind", KINDS)
def test_a_jump_of_metres_in_one_scan_of_a_walk_is_lost_at_that_scan(kind):
    true = walk()
    lost = judge(kind, true, with_jump(true, 70))
    assert lost.at_s == pytest.approx(7.0)
    assert lost.reason.startswith("moves 4.89 m")
    assert "turns 111 deg in one scan, against 0.05 m and 0 deg by " in lost.reason


@pytest.mark.parametrize("kind", KINDS)
def test_a_turn_on_the_spot_that_never_was_is_lost(kind):
    true = walk()
    assert judge(kind, true, with_jump(true, 40, [0.0, 0.0, np.radians(60.0)])).at_s == pytest.approx(4.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", ["walk", "fast", "stop", "gap", "turning"])
def test_an_honest_run_with_drift_is_not_lost(kind, case):
    stamps = None
    slow = np.tile([0.05, 0.0, 0.01], (60, 1))
    steps = {
        "walk": np.tile([0.05, 0.0, 0.008], (120, 1)),
        "fast": np.tile([1.2, 0.0, 0.0], (8, 1)),  # 12 m/s: 1.2 m in a scan
        "stop": np.concatenate([slow, np.zeros((150, 3)), slow]),
        "gap": np.concatenate([slow, [[1.5, 0.0, 0.3]], slow]),
        "turning": np.tile([0.0, 0.0, 0.2], (100, 1)),
    }[case]
    true = drive(steps)
    if case == "gap":
        stamps = np.arange(len(true)) * 100_000_000
        stamps[61:] += 2_900_000_000  # 30 scans are missing
    noise = np.random.default_rng(1).normal(0.0, [0.01, 0.01, 0.01], (len(steps), 3))
    estimate = drive(steps * [1.05, 1.05, 1.03] + noise)
    assert judge(kind, true, estimate, stamps) is None


@pytest.mark.parametrize("follows", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_that_is_carried_away_is_no_error_of_the_method(kind, follows):
    """The truth and the scans jump to another room; the wheels do not turn."""
    before, carried = walk(60), np.array([5.0, 6.0, 1.0])
    true = np.concatenate([before, se2.compose(carried, before)])
    odometry = np.concatenate([before, drive(steps_of(before), before[-1])])
    estimate = true if follows else odometry
    found = judge(kind, true, estimate, odometry=odometry, world_at=lambda index: ROOM if index < 61 else OTHER)
    assert found is None


def test_odometry_that_slips_does_not_make_a_right_track_wrong():
    true = walk()
    odometry = drive(np.concatenate([steps_of(true)[:50], np.tile([0.29, 0.0, 0.0], (20, 1)), steps_of(true)[70:]]))
    assert judge("odometry", true, true, odometry=odometry) is None
    assert judge("odometry", true, odometry, odometry=true).at_s == pytest.approx(5.5)  # 5 steps of 0.24 m


@pytest.mark.parametrize("kind", ["truth", "odometry"])
def test_a_track_that_stands_still_while_the_robot_drives_is_lost_after_a_metre(kind):
    true = drive(np.tile([0.05, 0.0, 0.0], (100, 1)))
    assert judge(kind, true, np.zeros_like(true)).at_s == pytest.approx(2.1)  # 21 steps are the first beyond 1 m
    assert judge(kind, np.zeros_like(true), true).at_s == pytest.approx(2.1)


def test_a_track_that_bends_slowly_is_lost_where_it_is_a_quarter_of_the_path_away():
    """A bend of 0.04 rad/m is s^2 / 50 m away after s metres: a quarter of the path at 12.5 m."""
    true = drive(np.tile([0.1, 0.0, 0.0], (300, 1)))
    bent = drive(np.tile([0.1, 0.0, 0.004], (300, 1)))
    assert judge("truth", true, bent).at_s == pytest.approx(12.5, abs=0.3)
    assert judge("truth", true, drive(np.tile([0.1, 0.0, 0.001], (300, 1)))) is None


def test_relations_judge_a_track_without_a_true_trajectory():
    true = walk()
    stamps = np.arange(len(true)) * 100_000_000
    firsts, seconds = np.array([0, 30, 60, 90]), np.array([25, 55, 85, 115])
    relations = Relations(stamps[firsts], stamps[seconds], se2.between(true[firsts], true[seconds]))
    for estimate, expected in ((true, None), (with_jump(true, 70), 8.5)):
        steps = np.zeros(len(true), dtype=STEP)
        steps["stamp_ns"] = stamps
        steps["x"], steps["y"], steps["theta"] = estimate.T
        evidence = Evidence(RunResult(steps, len(steps)), Truth("relations", relations=relations))
        lost = find_lost_track(evidence, lambda: ())
        assert (lost and lost.at_s) == (expected and pytest.approx(expected))


@pytest.mark.parametrize("reference", ["trajectory", "relation"])
def test_a_reference_that_the_scans_refute_does_not_make_a_track_lost(reference):
    true = walk()
    wrong = with_jump(true, 70, [0.0, 0.0, np.radians(50.0)])
    stamps = np.arange(len(true)) * 100_000_000 + 5_000_000_000
    relation = Relations(stamps[60:61], stamps[80:81], se2.between(wrong[60:61], wrong[80:81]))
    if reference == "trajectory":
        wrong_truth, true_truth = (Truth("survey", Trajectory(stamps, poses)) for poses in (wrong, true))
    else:
        right = Relations(stamps[60:61], stamps[80:81], se2.between(true[60:61], true[80:81]))
        wrong_truth, true_truth = Truth("survey", relations=relation), Truth("survey", relations=right)
    steps = np.zeros(len(true), dtype=STEP)
    steps["stamp_ns"] = stamps
    for poses, truth, expected in ((true, wrong_truth, False), (wrong, true_truth, True)):
        steps["x"], steps["y"], steps["theta"] = poses.T
        lost = find_lost_track(Evidence(RunResult(steps, len(steps)), truth), lambda: frames(stamps, true, None))
        assert (lost is not None) == expected


def test_a_run_of_one_scan_is_not_lost_and_a_loss_has_a_reason():
    assert judge("truth", np.zeros((1, 3)), np.zeros((1, 3))) is None
    with pytest.raises(ValueError, match="expected a finite time and a reason"):
        LostTrack(1.0, "")


def test_a_run_between_the_true_poses_has_no_known_loss():
    stamps = np.arange(20) * 100_000_000
    steps = np.zeros(len(stamps), dtype=STEP)
    steps["stamp_ns"] = stamps
    far = Trajectory(np.array([-(10**12), 10**12]), np.zeros((2, 3)))
    assert find_lost_track(Evidence(RunResult(steps, len(steps)), Truth("sparse", far)), lambda: ()) is None


def test_the_longer_step_after_missing_scans_is_no_jump_and_one_as_long_without_a_gap_is():
    """10 cm in 0.1 s, once 2 m in 2 s: always 1 m/s."""
    gap = np.full(60, 0.1)
    gap[30] = 2.0
    stamps = np.concatenate([[0], np.cumsum(gap * 1e9)]).astype(np.int64)
    steps = np.column_stack([gap, np.zeros(60), np.zeros(60)])
    assert not _find_jumps(steps, stamps).any()
    assert np.flatnonzero(_find_jumps(steps, np.arange(61) * 100_000_000)).tolist() == [30]


def test_no_points_fit_nowhere():
    some, none, same = np.zeros((3, 2)), np.zeros((0, 2)), np.zeros(3)
    assert [_fit(*pair, same) for pair in ((some, some), (some, none), (none, some), (none, none))] == [1.0, 0, 0, 0]


def tracks(reference, estimate, period_ns=100_000_000):
    return track._Tracks(np.arange(len(reference)) * period_ns, np.asarray(estimate), np.asarray(reference))


@pytest.mark.parametrize(
    ("path_m", "off_m", "off_deg", "wrong"),
    [(0.0, 0.99, 0.0, False), (0.0, 1.0, 0.0, False), (0.0, 1.01, 0.0, True), (4.0, 1.99, 0.0, False),
     (4.0, 2.01, 0.0, True), (4.0, 0.0, 44.0, False), (4.0, 0.0, -46.0, True)],
)  # fmt: skip
def test_a_motion_is_wrong_beyond_a_metre_and_half_of_the_path_or_beyond_45_degrees(path_m, off_m, off_deg, wrong):
    true = np.array([[0.0, 0.0, 0.0], [path_m, 0.0, 0.0]])
    found = tracks(true, np.add(true, [[0.0, 0.0, 0.0], [0.0, off_m, np.radians(off_deg)]]))
    assert found.are_wrong(np.array([0]), np.array([1])).tolist() == [wrong]


@pytest.mark.parametrize(("off_deg", "wrong"), [(89.0, False), (91.0, True)])
def test_after_turns_of_180_degrees_to_and_fro_a_motion_is_wrong_beyond_90(off_deg, wrong):
    true = np.column_stack([np.zeros((7, 2)), np.radians([0.0, 30.0, 0.0, 30.0, 0.0, 30.0, 0.0])])
    estimate = true.copy()
    estimate[-1, 2] += np.radians(off_deg)
    assert tracks(true, estimate).are_wrong(np.array([0]), np.array([6])).tolist() == [wrong]


@pytest.mark.parametrize(
    ("usual", "longest", "column", "jumps"),
    [(0.0, 0.49, 0, False), (0.0, 0.51, 0, True), (0.11, 0.54, 0, False), (0.11, 0.56, 0, True),
     (0.0, np.radians(29.0), 2, False), (0.0, np.radians(31.0), 2, True), (0.2, 0.99, 2, False), (0.2, 1.01, 2, True)],
)  # fmt: skip
def test_a_jump_is_longer_than_half_a_metre_or_30_degrees_and_five_times_as_fast_as_usual(
    usual, longest, column, jumps
):
    steps = np.zeros((60, 3))
    steps[:, column], steps[40, column] = usual, longest
    found = _find_jumps(steps, np.arange(61) * 100_000_000)
    assert np.flatnonzero(found).tolist() == [40] * jumps


def test_the_usual_speed_is_that_of_95_percent_of_the_steps():
    steps = np.zeros((100, 3))
    steps[:5, 0], steps[5:, 0] = 0.6, 0.05  # 5 %: the 95th percentile is 0.05 + 0.05 (0.6 - 0.05) = 0.0775 m
    assert _find_jumps(steps, np.arange(101) * 100_000_000).sum() == 5
    steps[5, 0] = 0.6
    assert not _find_jumps(steps, np.arange(101) * 100_000_000).any()


@pytest.mark.parametrize(("off_m", "windows"), [(2.4, []), (2.6, [(0, 10)])])
def test_from_ten_metres_on_the_error_since_the_start_is_limited_to_a_quarter_of_the_path(off_m, windows):
    true = np.column_stack([np.arange(21.0), np.zeros((21, 2))])
    estimate = np.where(true[:, :1] > 3.0, np.add(true, [0.0, off_m, 0.0]), true)
    assert list(track._find_long_windows(tracks(true, estimate))) == windows


@pytest.mark.parametrize(
    ("step_m", "drift_m", "jump_m", "lost"),
    [(0.01, 0.0099, 0.0, False), (0.01, 0.0101, 0.0, True), (0.1, 0.043, 0.13, False), (0.1, 0.043, 0.15, True)],
)
def test_a_window_ends_after_ten_seconds_or_two_metres(step_m, drift_m, jump_m, lost):
    """At 10 Hz. Slowly, 100 steps of a window drift to 1 m. Else 20 steps drift 0.86 m: more within the limit of half
    of the path, 1 m; with 30 steps and 1.5 m it would not."""
    steps = np.tile([step_m, 0.0, 0.0], (250, 1))
    wrong = np.add(steps, [0.0, drift_m, 0.0])
    wrong[100, 1] += jump_m
    assert (next(track._find_windows(tracks(drive(steps), drive(wrong))), None) is not None) == lost


@pytest.mark.parametrize(
    ("seconds", "step_m", "off_m", "off_deg", "wrong"),
    [(10, 0.0, 0.99, 0.0, False), (10, 0.0, 1.01, 0.0, True), (10, 0.0, 0.0, 44.0, False), (10, 0.0, 0.0, 46.0, True),
     (11, 0.0, 2.4, 0.0, False), (11, 0.0, 2.6, 0.0, True), (11, 0.0, 0.0, 170.0, False), (20, 1.0, 4.9, 0.0, False),
     (20, 1.0, 5.1, 0.0, True)],
)  # fmt: skip
@pytest.mark.parametrize("order", [1, -1])
def test_a_relation_is_wrong_by_the_limits_of_a_window_or_over_ten_seconds_by_its_path(
    seconds, step_m, off_m, off_deg, wrong, order
):
    estimate = Trajectory(np.arange(31) * 10**9, np.column_stack([step_m * np.arange(31.0), np.zeros((31, 2))]))
    ends = np.array([3, 3 + seconds])[::order] * 10**9
    own = se2.between(*estimate.at(ends))
    measured = se2.compose(own, [0.0, off_m, np.radians(off_deg)])
    relations = Relations(ends[:1], ends[1:], measured[None])
    found = track._find_wrong_relations(estimate, relations)
    assert [(one.first_ns, one.last_ns, one.lost.at_s) for one in found] == [(*ends.tolist(), 3.0 + seconds)] * wrong


def frames_that_fit(first_ns, last_ns, shares, motions):
    """Return two frames: each motion moves its share of the second one's 100 points onto points of the first one."""
    source = np.column_stack([np.full(100, 5.0), 0.4 * np.arange(100)])
    moved = (se2.transform(motion, source[: round(100 * share)]) for share, motion in zip(shares, motions, strict=True))
    clouds = {first_ns: np.concatenate([[[-500.0, 0.0]], *moved]), last_ns: source}
    return [Frame(Scan(stamp, np.hypot(x, y), np.arctan2(y, x), 0.0, 1e3), Pose(), None)
            for stamp, (x, y) in ((stamp, points.T) for stamp, points in clouds.items())]  # fmt: skip


@pytest.mark.parametrize(
    ("own", "reference", "lost"),
    [(0.29, 0.0, True), (0.31, 0.1, False), (0.55, 0.5, True), (0.65, 0.5, False), (0.0, 0.0, True)],
)
def test_a_difference_counts_unless_the_scans_fit_the_estimate_better_by_a_tenth_and_at_least_by_0_3(
    own, reference, lost
):
    one = track._Difference(0, 1, np.zeros(3), np.array([0.0, 0.0, 2.0]), LostTrack(1.0, "planted"))
    seen = frames_that_fit(0, 1, (own, reference), (one.own, one.reference))
    assert track._find_supported([one], lambda: seen) == [one.lost] * lost


@pytest.mark.parametrize(
    ("own", "other", "lost"),
    [(0.0, 0.29, False), (0.0, 0.31, True), (0.5, 0.59, False), (0.5, 0.61, True), (0.9, 0.5, False)],
)
def test_a_long_step_counts_where_the_scans_fit_the_motion_before_better_by_a_tenth_and_at_least_by_0_3(
    own, other, lost
):
    poses = with_jump(walk(), 70, [3.0, 0.0, 0.0])
    estimate = Trajectory(np.arange(len(poses)) * 100_000_000, poses)
    motions = [3.05, 0.0, 0.008], [0.05, 0.0, 0.008]  # the step, and the one before
    seen = frames_that_fit(6_900_000_000, 7_000_000_000, (own, other), motions)
    found = track._find_contradicted_by_scans(estimate, None, lambda: seen)
    assert [one.at_s for one in found] == [pytest.approx(7.0)] * lost


@pytest.mark.parametrize("first", [False, True])
def test_a_jump_is_replaced_by_the_speed_before_it_and_in_the_first_step_by_none(first):
    """From (1, 2) at 0.5 rad: 0.1 m in 0.1 s, and a jump of 3 m in 0.3 s becomes one of 0.3 m."""
    steps, seconds = np.tile([0.1, 0.0, 0.0], (9, 1)), np.full(9, 0.1)
    steps[0 if first else 5] = [3.0, 1.0, 0.7]
    seconds[0 if first else 5] = 0.3
    stamps = np.concatenate([[0], np.cumsum(np.round(seconds * 1e9))]).astype(np.int64)
    found = track._without_jumps(Trajectory(stamps, drive(steps, (1.0, 2.0, 0.5))))
    smooth = np.tile([0.1, 0.0, 0.0], (9, 1))
    smooth[0 if first else 5] = [0.0 if first else 0.3, 0.0, 0.0]
    assert found.stamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(found.poses, drive(smooth, (1.0, 2.0, 0.5)), atol=1e-9)


@pytest.mark.parametrize(("off_m", "share"), [(0.149, 1.0), (0.151, 0.0)])
def test_points_fit_within_15_cm(off_m, share):
    points = np.array([[1.0, 0.0], [3.0, 1.0]])
    assert _fit(points, points, np.array([off_m, 0.0, 0.0])) == share


def test_a_run_of_two_scans_may_be_lost():
    true = np.zeros((2, 3))
    lost = judge("truth", true, np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    assert lost.at_s == pytest.approx(0.1)


def test_a_wrong_motion_over_scans_without_true_poses_is_not_called_one_of_a_single_scan():
    stamps, true = np.arange(121) * 100_000_000, walk()
    estimate = true.copy()
    estimate[50:70, 1] += np.linspace(0.0, 3.0, 20)  # over 20 scans, 0.16 m each
    estimate[70:, 1] += 3.0
    known = np.r_[0:50, 70:121]
    steps = np.zeros(121, dtype=STEP)
    steps["stamp_ns"], (steps["x"], steps["y"], steps["theta"]) = stamps, estimate.T
    truth = Truth("exact", Trajectory(stamps[known], true[known]))
    lost = find_lost_track(Evidence(RunResult(steps, 121), truth), lambda: frames(stamps, true, None))
    assert lost is not None
    assert lost.reason.startswith("from 4.9 s to 7.0 s, on a path of 1.0 m, 3.00 m and 0 deg away")
    assert (lost.at_s, lost.since_s) == (pytest.approx(7.0), pytest.approx(4.9))
