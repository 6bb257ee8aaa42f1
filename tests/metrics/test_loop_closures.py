"""Loop closures and corrections of a run with a known truth: two laps of a square of 10 m, one frame a metre."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.ground_truth import Truth
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import loop_closures
from evalkit.metrics.evaluate import collect_evidence
from evalkit.metrics.metric import NO_FINAL, NO_TRUE_TRAJECTORY, Evidence

LAP, FRAMES = 40, 80
STAMPS = np.arange(FRAMES) * 1_000_000_000


def square():
    """Two laps, counter-clockwise, heading along the side."""
    at = np.arange(FRAMES) % LAP
    side, along = np.divmod(at, 10)
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
    heading = side * np.pi / 2.0
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return Trajectory(STAMPS, np.column_stack([corners[side] + along[:, None] * ahead, heading]))


def closure(later, earlier, error=(0.0, 0.0, 0.0), accepted=True):
    """A closure between two frames whose motion is the true one and then an error (m, m, deg)."""
    rows = [Pose.of(row) for row in square().poses[[earlier, later]]]
    wrong = Pose(error[0], error[1], np.radians(error[2]))
    return LoopClosure(int(STAMPS[later]), int(STAMPS[earlier]), rows[0].inverse() @ rows[1] @ wrong, accepted, "test")


def run(closures=(), corrected=(), final=True, cpu_ms=None, final_cpu_ns=0):
    steps = np.zeros(FRAMES, STEP)
    steps["stamp_ns"], steps["corrected"] = STAMPS, -1
    steps["x"], steps["y"], steps["theta"] = square().poses.T
    if len(corrected):
        steps["corrected"] = 0
        steps["corrected"][list(corrected)] = 1
    if cpu_ms is not None:
        steps["cpu_ns"] = np.asarray(cpu_ms) * 1e6
    found = Trajectory(STAMPS, square().poses, "start", "base") if final else None
    return RunResult(steps, FRAMES, final=found, loop_closures=tuple(closures), final_cpu_ns=final_cpu_ns)


def values(result, truth=None):
    evidence = Evidence(result, truth or Truth("exact", square()))
    return {metric.name: metric.compute(evidence) for metric in loop_closures.METRICS}


def test_candidates_are_counted_and_only_accepted_ones_are_judged():
    wrong = closure(50, 12, (0.3, 0.0, 0.0))
    rejected = closure(60, 3, (5.0, 0.0, 0.0), accepted=False)
    found = values(run([closure(42, 2), closure(45, 5, (0.1, 0.1, 4.0)), wrong, rejected]))
    assert found["closure_candidates"] == Score(4.0, FRAMES)
    assert (found["closures_accepted"].value, found["closures_rejected"].value) == (3.0, 1.0)
    assert found["closures_wrong"] == Score(1.0, 3)
    assert found["closure_precision_percent"] == Score(100.0 * (2 / 3), 3)


def test_recoveries_are_the_accepted_closures_that_say_so_and_unknown_where_none_says_anything():
    silent, declared = closure(42, 2), replace(closure(45, 5), found_again=True)
    withdrawn, other = replace(declared, accepted=False), replace(silent, found_again=False)
    assert values(run([silent, declared, withdrawn, other, declared]))["recoveries_own"] == Score(2.0, FRAMES)
    assert values(run([silent, other]))["recoveries_own"] == Score(0.0, FRAMES)
    for unknown in ([silent, silent], []):
        assert values(run(unknown))["recoveries_own"].reason.startswith("no loop closure reports")
    assert values(run([declared], final=False))["recoveries_own"].reason == NO_FINAL


@pytest.mark.parametrize(
    ("error", "right"),
    [((0.19, 0.0, 0.0), True), ((0.0, 0.21, 0.0), False), ((0.0, 0.0, 4.9), True), ((0.0, 0.0, -5.1), False)],
)
def test_a_closure_is_right_within_20_cm_and_5_degrees(error, right):
    assert values(run([closure(40, 0, error)]))["closure_precision_percent"].value == 100.0 * right


def two_returns():
    """A lap of the square, its first side again, 20 m to the right and back, its second side again; a metre a frame."""
    lap, right = square().poses[:41], np.column_stack([np.arange(11.0, 31.0), np.zeros((20, 2))])
    there = [*lap, *lap[1:11], *right, *right[-2::-1], lap[10], *lap[11:21]]
    return Trajectory(np.arange(len(there)) * 1_000_000_000, np.array(there))


def recall(truth, *pairs, error=(0.0, 0.0, 0.0)):
    """The recall of right closures, or of one with an error (m, m, rad), between pairs of frames."""
    poses = [[Pose.of(truth.poses[at]) for at in pair] for pair in pairs]
    loops = [
        LoopClosure(later * 10**9, earlier * 10**9, second.inverse() @ first @ Pose(*error), True, "test")
        for (later, earlier), (first, second) in zip(pairs, poses, strict=True)
    ]
    return values(run(loops), Truth("exact", truth))["closure_recall_percent"]


def test_recall_is_the_share_of_the_returns_to_earlier_path_that_a_right_closure_joins():
    truth = two_returns()
    assert recall(truth) == Score(0.0, 2)
    assert recall(truth, (45, 5)) == Score(50.0, 2)
    assert recall(truth, (45, 5), (44, 4)) == Score(50.0, 2)
    assert recall(truth, (45, 5), (95, 15)) == Score(100.0, 2)
    assert recall(truth, (45, 5), error=(1.0, 0.0, 0.0)) == Score(0.0, 2)
    assert recall(truth, (70, 20)) == Score(0.0, 2)  # not the same place


def test_a_second_lap_is_one_return():
    assert values(run([closure(60, 20)]))["closure_recall_percent"] == Score(100.0, 1)
    assert values(run())["closure_recall_percent"] == Score(0.0, 1)


def test_a_return_is_joined_within_five_metres_of_path_of_both_visits():
    """It begins at frame 40, where the robot is as at frame 0."""
    truth = two_returns()
    assert [recall(truth, (at, 0)).value for at in (34, 35)] == [0.0, 50.0]


def test_corrections_are_those_reported_else_the_frames_of_accepted_closures():
    cpu = np.ones(FRAMES)
    cpu[[41, 50]] = 7.0, 30.0
    reported = values(run([closure(42, 2)], corrected=(41, 50), cpu_ms=cpu, final_cpu_ns=2_500_000))
    assert reported["corrections"] == Score(2.0, FRAMES)
    assert (reported["correction_median_ms"], reported["correction_max_ms"]) == (Score(18.5, 2), Score(30.0, 2))
    assert reported["final_cpu_ms"] == Score(2.5, 1)
    cpu[42] = 9.0
    inferred = values(run([closure(42, 2), closure(50, 10, accepted=False)], cpu_ms=cpu))
    assert inferred["corrections"] == Score(1.0, FRAMES)
    assert inferred["correction_max_ms"] == Score(9.0, 1)


def test_missing_evidence_is_a_reason():
    assert {score.reason for score in values(run(final=False)).values()} == {NO_FINAL}
    silent = values(run())
    assert silent["closure_candidates"].value == 0.0
    assert silent["corrections"].reason == "the back end reports neither corrections nor loop closures"
    assert silent["closure_precision_percent"].reason == "no loop closure was accepted between frames with true poses"
    assert silent["final_cpu_ms"].reason == "not measured on this machine: no CPU time"
    assert values(run([closure(42, 2, accepted=False)], cpu_ms=np.ones(FRAMES)))["correction_max_ms"].reason == (
        "no update moved earlier poses"
    )
    without = values(run([closure(42, 2)]), Truth("none"))
    assert {without[name].reason for name in ("closures_wrong", "closure_recall_percent")} == {NO_TRUE_TRAJECTORY}
    assert without["closures_accepted"].value == 1.0


class OnlyTruth:
    """A sequence of which only the truth is needed."""

    def truth(self):
        return Truth("exact", square())


def test_corrected_poses_have_metrics_of_their_own_and_leave_those_of_the_answers():
    result = run()
    steps = result.steps.copy()
    steps["y"] += np.linspace(0.0, 2.0, FRAMES)  # the answers drift, the corrected poses do not
    drifting = RunResult(steps, FRAMES, final=result.final)
    found = metrics.compute_scores(collect_evidence(drifting, OnlyTruth()))
    alone = metrics.compute_scores(collect_evidence(RunResult(steps, FRAMES), OnlyTruth()))
    final = {metric.counterpart: metric.name for metric in metrics.METRICS if metric.counterpart}
    assert {"ate_rmse_m", "drift_percent", "relations_all_mean_m", "revisit_mean_m", "pair_error"} <= set(final)
    assert found["ate_rmse_m"].value > 0.3
    assert found["final_ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    slam_only = {metric.name for metric in metrics.METRICS if metric.slam_only}
    assert {name: found[name] for name in found.keys() - slam_only} == {
        name: alone[name] for name in alone.keys() - slam_only
    }
    assert {alone[name].reason for name in slam_only} == {NO_FINAL}
    assert [metric.name for metric in metrics.METRICS if metric.counterpart and metric.headline] == []


def test_reports_of_no_correction_are_corrections_all_the_same_and_a_truth_of_one_pose_is_none():
    steps = run().steps.copy()
    steps["corrected"] = 0
    assert values(replace(run([closure(42, 2)]), steps=steps))["corrections"] == Score(0.0, FRAMES)
    one = Truth("exact", Trajectory(STAMPS[:1], square().poses[:1]))
    found = values(run([closure(42, 2)]), one)
    for name in ("closures_wrong", "closure_recall_percent"):
        assert found[name] == Score(None, 0, NO_TRUE_TRAJECTORY)
    straight = Truth("exact", Trajectory(STAMPS, np.column_stack([np.arange(80.0), np.zeros((80, 2))])))
    recall = values(run([closure(42, 2)]), straight)["closure_recall_percent"]
    assert recall.reason == "the true path does not revisit a place"
    partly = Truth("exact", Trajectory(STAMPS[:42], square().poses[:42]))
    assert values(run([closure(42, 2), closure(41, 1)]), partly)["closures_wrong"].support == 1
