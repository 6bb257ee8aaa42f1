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
from evalkit.metrics.table import Evidence
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
