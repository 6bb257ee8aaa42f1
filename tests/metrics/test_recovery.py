"""A lost run is found again where its poses are right to the end; in a known map a wrong place is a loss."""

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, LostTrack, RunResult
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Evidence
from evalkit.metrics.recovery import add_recovery
from evalkit.metrics.track import find_lost_track
from evalkit.metrics.trajectory import match_trajectories

STAMPS = np.arange(600) * 100_000_000  # a minute
TRUE = np.column_stack([0.2 * np.arange(600) * 0.1, np.zeros(600), np.zeros(600)])
LOST = LostTrack(20.0, "planted")


def judge(poses, lost=LOST, start=None, truth=True):
    steps = np.zeros(len(STAMPS), dtype=STEP)
    steps["stamp_ns"], (steps["x"], steps["y"], steps["theta"]) = STAMPS, poses.T
    run = RunResult(steps, len(steps), start=start)
    known = Trajectory(STAMPS, TRUE) if truth else None
    given = None if start is None else start.map_from_start
    matched = match_trajectories(run.estimate, known, map_from_start=given)
    return add_recovery(Evidence(run, Truth("exact", known), matched), lost)


def shifted(first, last, metres=3.0):
    poses = TRUE.copy()
    poses[first:last, 1] += metres
    return poses


def test_a_run_that_comes_back_is_found_at_its_first_right_pose():
    found = judge(shifted(195, 320))
    assert found == LostTrack(20.0, "planted", 32.0)


def test_a_run_that_stays_away_or_comes_back_too_late_is_not_found():
    assert judge(shifted(195, 600)) == LOST
    assert judge(shifted(195, 520)) == LOST  # 8 s before the end: less than a window
    assert judge(shifted(195, 320), truth=False) == LOST
    twice = shifted(195, 320)
    twice[400:450, 1] += 3.0
    assert judge(twice) == LostTrack(20.0, "planted", 45.0)


def test_a_wrong_place_of_the_map_is_a_loss_though_every_motion_is_right():
    wrong = MapStart(Pose(0.0, 4.0, 0.0), 1, 0.0, True, 0.9)
    found = judge(TRUE, None, wrong)
    assert found is not None
    assert (found.at_s, found.recovered_at_s) == (0.0, None)
    assert "4.00 m away from the ground truth in the known map" in found.reason
    right = MapStart(Pose(0.3, 0.0, 0.0), 1, 0.0, True, 0.9)
    assert judge(TRUE, None, right) is None
    again = judge(shifted(200, 300), None, right)
    assert again is not None
    assert (again.at_s, again.recovered_at_s) == (20.0, pytest.approx(30.0))


def test_a_map_of_another_place_does_not_move_a_frame():
    moved = MapStart(Pose(5.0, -2.0, 0.7), 1, 0.0, True, 0.9)
    poses = se2.compose(moved.map_from_start.inverse().row, TRUE)
    assert judge(poses, None, moved) is None


def judge_by_relations(poses, begin_s, end_s, lost=LOST, still=False):
    """Relations that the truth gives between times in seconds; without a true trajectory."""
    true = Trajectory(STAMPS, 0.0 * TRUE if still else TRUE)
    first, second = (np.asarray(each) * 1_000_000_000 for each in (begin_s, end_s))
    relations = Relations(first, second, se2.between(true.at(first), true.at(second)))
    steps = np.zeros(len(STAMPS), dtype=STEP)
    steps["stamp_ns"], (steps["x"], steps["y"], steps["theta"]) = STAMPS, poses.T
    run = RunResult(steps, len(steps))
    return add_recovery(
        Evidence(run, Truth("measured", relations=relations), match_trajectories(run.estimate, None)), lost
    )


def test_without_a_true_trajectory_relations_across_the_loss_tell_that_it_was_found_again():
    across = [0, 2, 4, 6], [25, 30, 35, 45]
    assert judge_by_relations(shifted(195, 320), *across) == LostTrack(20.0, "planted", 35.0)
    assert judge_by_relations(shifted(195, 600), *across) == LOST
    assert judge_by_relations(shifted(195, 320), [0], [55]) == LOST  # known for 5 s only: less than a window
    assert judge_by_relations(shifted(195, 320), [25, 40], [30, 50]) == LOST  # none of them spans the loss
    assert judge_by_relations(shifted(195, 320), [0, 25], [35, 45]) == LostTrack(20.0, "planted", 35.0)
    again = shifted(195, 320)
    again[400:, 1] += 3.0
    assert judge_by_relations(again, [*across[0], 38], [*across[1], 42]) == LOST


def test_a_relation_counts_from_ten_seconds_before_the_loss_on():
    assert judge_by_relations(shifted(195, 320), [10], [35]) == LostTrack(20.0, "planted", 35.0)
    assert judge_by_relations(shifted(195, 320), [11], [35]) == LOST
    assert judge_by_relations(TRUE, [0], [20]) == LOST  # ends with the loss
    assert judge_by_relations(TRUE, [0], [21]) == LostTrack(20.0, "planted", 21.0)
    assert judge_by_relations(TRUE, [32], [0]) == LostTrack(20.0, "planted", 32.0)  # in either order


def test_a_loss_that_was_none_is_found_again_at_the_next_pose():
    assert judge(TRUE) == LostTrack(20.0, "planted", 20.1)


def test_a_metre_from_its_place_in_the_map_a_run_is_not_lost_yet():
    near = MapStart(Pose(0.0, 1.0, 0.0), 1, 0.0, True, 0.9)
    assert judge(TRUE, None, near) is None
    assert judge(TRUE, LOST, near) == LOST  # and half a metre is right
    earlier = shifted(100, 600, 3.0)
    assert judge(earlier, LOST, MapStart(Pose(), 1, 0.0, True, 0.9)).at_s == pytest.approx(10.0)
    assert judge(earlier, LostTrack(5.0, "planted"), MapStart(Pose(), 1, 0.0, True, 0.9)).at_s == 5.0


@pytest.mark.parametrize(("degrees", "again_s"), [(9.9, 35.0), (-9.9, 35.0), (10.1, None)])
def test_a_relation_of_a_robot_that_stands_is_right_within_ten_degrees(degrees, again_s):
    turned = np.where(STAMPS[:, None] < 30 * 10**9, 0.0, [[0.0, 0.0, np.radians(degrees)]])
    assert judge_by_relations(turned, [5], [35], still=True).recovered_at_s == again_s


@pytest.mark.parametrize(
    ("metres", "degrees", "again_s", "by_relation_s"),
    [(1.7, 0.0, 50.0, 50.0), (1.9, 0.0, 52.3, None), (0.0, 9.9, 50.0, None), (0.0, 10.1, None, None)],
)
def test_a_pose_is_right_within_five_percent_of_the_path_and_ten_degrees(metres, degrees, again_s, by_relation_s):
    """At 0.9 m/s, from 10 s before the loss at 20 s on: 36 m at 50 s, when the robot is right again, 38 m at 52.3 s.

    The error of a relation is the mean of both orders: 9.9 deg over 36 m are 3.1 m.
    """
    true = np.column_stack([np.minimum(0.09 * np.arange(1200), 54.0), np.zeros((1200, 2))])
    stamps, poses = np.arange(1200) * 100_000_000, true.copy()
    poses[500:] += [0.0, metres, np.radians(degrees)]
    known = Trajectory(stamps, true)
    begin, end = np.array([10]) * 10**9, np.array([50]) * 10**9
    relations = Relations(begin, end, se2.between(known.at(begin), known.at(end)))
    for truth, expected in ((Truth("exact", known), again_s), (Truth("measured", relations=relations), by_relation_s)):
        steps = np.zeros(len(stamps), dtype=STEP)
        steps["stamp_ns"], (steps["x"], steps["y"], steps["theta"]) = stamps, poses.T
        if truth.trajectory is not None:
            steps["y"][150:500] += 50.0
        run = RunResult(steps, len(steps))
        found = add_recovery(Evidence(run, truth, match_trajectories(run.estimate, truth.trajectory)), LOST)
        assert found is not None
        assert found.recovered_at_s == (expected and pytest.approx(expected))


def test_a_truth_at_other_times_says_nothing_about_the_loss():
    steps = np.zeros(len(STAMPS), dtype=STEP)
    steps["stamp_ns"] = STAMPS + 10**12
    run = RunResult(steps, len(steps))
    known = Trajectory(STAMPS, TRUE)
    matched = match_trajectories(run.estimate, known)
    assert add_recovery(Evidence(run, Truth("exact", known), matched), LOST) == LOST
    later = Relations(STAMPS[:1], STAMPS[-1:], np.zeros((1, 3)))
    assert add_recovery(Evidence(run, Truth("measured", relations=later), matched), LOST) == LOST


def test_a_run_is_not_found_again_whose_wrong_motion_began_more_than_a_window_before_the_loss():
    early = shifted(50, 600)  # away from 5 s on and never back, noticed at 20 s: the motion since 10 s is right
    assert judge(early) == LostTrack(20.0, "planted", 20.1)
    assert judge(early, LostTrack(20.0, "planted", since_s=4.0)) == LOST
    assert judge(shifted(50, 320), LostTrack(20.0, "planted", since_s=4.0)) == LostTrack(20.0, "planted", 32.0)


def test_a_relation_counts_only_if_it_begins_before_the_wrong_motion():
    lost = LostTrack(20.0, "planted", since_s=4.0)
    assert judge_by_relations(shifted(50, 600), [8], [35], lost) == LOST
    assert judge_by_relations(shifted(50, 320), [4], [35], lost) == LostTrack(20.0, "planted", 35.0)


def test_a_slip_between_scans_that_are_seconds_apart_is_not_found_again():
    stamps = np.concatenate([STAMPS[:100], STAMPS[220:]])  # 12 s without a scan: longer than a window
    true = Trajectory(stamps, np.concatenate([TRUE[:100], TRUE[220:] - [[2.4, 0.0, 0.0]]]))
    steps = np.zeros(len(stamps), dtype=STEP)
    steps["stamp_ns"], (steps["x"], steps["y"], steps["theta"]) = stamps, true.poses.T
    steps["y"][100:] += 3.0
    run = RunResult(steps, len(steps))
    evidence = Evidence(run, Truth("exact", true), match_trajectories(run.estimate, true))
    lost = find_lost_track(evidence, tuple)
    assert lost is not None
    assert lost.at_s == pytest.approx(22.0)
    assert add_recovery(evidence, lost).recovered_at_s is None
