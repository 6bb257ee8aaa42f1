"""Matching, alignment and absolute errors, compared with hand calculations, invariances and evo."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import trajectory
from evalkit.metrics.metric import Evidence, MatchedPoses, Unmatched

SECOND = 1_000_000_000


def make_random_walk(seed: int = 0, count: int = 60, period_ns: int = SECOND // 10) -> Trajectory:
    """Return a smooth random walk from a random start."""
    rng = np.random.default_rng(seed)
    steps = np.stack([rng.uniform(0.0, 0.1, count), np.zeros(count), rng.normal(0.0, 0.1, count)], axis=1)
    poses = [np.array([3.0, -2.0, 2.5])]
    for step in steps[1:]:
        poses.append(se2.compose(poses[-1], step))
    return Trajectory(np.arange(count) * period_ns, np.array(poses))


def disturb(truth: Trajectory, seed: int = 1, sigma_m: float = 0.05) -> Trajectory:
    """Return the ground truth with noise on every pose, expressed in the frame of its own first pose."""
    noise = np.random.default_rng(seed).normal(0.0, sigma_m, (len(truth), 3))
    start_from_base = se2.between(truth.poses[0], se2.compose(truth.poses, noise))
    return Trajectory(truth.stamps_ns, start_from_base, "start")


def match(estimate: Trajectory, truth: Trajectory, **how: object) -> MatchedPoses:
    found = trajectory.match_trajectories(estimate, truth, **how)  # type: ignore[arg-type]
    assert isinstance(found, MatchedPoses)
    return found


def ate(estimate: Trajectory, truth: Trajectory) -> float:
    return trajectory.rms(trajectory.position_errors(match(estimate, truth)))


def evidence_of(estimate: Trajectory, truth: Trajectory | None, expected: int) -> Evidence:
    steps = np.zeros(len(estimate), STEP)
    steps["stamp_ns"] = estimate.stamps_ns
    for column, name in enumerate(("x", "y", "theta")):
        steps[name] = estimate.poses[:, column]
    run = RunResult(steps, expected)
    return Evidence(run, Truth("exact", truth), trajectory.match_trajectories(estimate, truth))


def values(evidence: Evidence) -> dict[str, float | None]:
    return {metric.name: metric.compute(evidence).value for metric in trajectory.METRICS}


def test_rigid_alignment_recovers_the_applied_motion() -> None:
    points = np.random.default_rng(0).normal(size=(20, 2))
    motion = np.array([4.0, 5.0, np.radians(150.0)])
    assert trajectory.align_rigidly(points, se2.transform(motion, points)) == pytest.approx(motion)


def test_rigid_alignment_is_the_least_squares_optimum() -> None:
    rng = np.random.default_rng(0)
    source, target = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    best = trajectory.align_rigidly(source, target)

    def cost(row: Floats) -> float:
        return float(np.sum((se2.transform(row, source) - target) ** 2))

    nearby = best + rng.normal(0.0, 0.05, (200, 3))
    assert all(cost(row) >= cost(best) for row in nearby)


def test_a_rigidly_moved_copy_of_the_ground_truth_has_no_error() -> None:
    truth = make_random_walk()
    estimate = truth.moved(Pose(-7.0, 3.0, 1.0))
    found = values(evidence_of(estimate, truth, len(truth)))
    assert found["ate_max_m"] == pytest.approx(0.0, abs=1e-9)
    assert found["heading_rmse_deg"] == pytest.approx(0.0, abs=1e-9)


def test_errors_of_a_square_with_one_displaced_corner_equal_a_hand_calculation() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    shifted = np.add(corners, [[0.3, 0.4, 0.1], [0, 0, 0], [0, 0, 0], [0, 0, 0]])
    stamps = np.arange(4) * SECOND
    found = match(Trajectory(stamps, shifted), Trajectory(stamps, corners), alignment="none")
    assert trajectory.position_errors(found) == pytest.approx([0.5, 0, 0, 0])
    assert trajectory.rms(trajectory.position_errors(found)) == pytest.approx(0.25)
    assert np.degrees(trajectory.rms(trajectory.heading_errors(found))) == pytest.approx(np.degrees(0.05))


def test_ate_is_independent_of_the_frame_and_of_the_time_origin() -> None:
    truth = make_random_walk()
    estimate = disturb(truth)
    here = ate(estimate, truth)
    assert here > 0.01
    assert ate(estimate.moved(Pose(10.0, -4.0, 2.0)), truth.moved(Pose(1.0, 1.0, -1.0))) == pytest.approx(here)
    later = [Trajectory(t.stamps_ns + 1_700_000_000 * SECOND, t.poses) for t in (estimate, truth)]
    assert ate(*later) == pytest.approx(here)


def test_ate_equals_evo() -> None:
    pytest.importorskip("evo")
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    truth = make_random_walk()
    estimate = disturb(truth)

    def as_evo(planar: Trajectory) -> PoseTrajectory3D:
        half = 0.5 * planar.poses[:, 2]
        zero = np.zeros(len(planar))
        return PoseTrajectory3D(
            positions_xyz=np.column_stack([planar.poses[:, :2], zero]),
            orientations_quat_wxyz=np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
            timestamps=planar.stamps_ns * 1e-9,
        )

    reference, aligned = as_evo(truth), as_evo(estimate)
    aligned.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, aligned))
    found = values(evidence_of(estimate, truth, len(truth)))
    assert found["ate_rmse_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse))
    assert found["ate_median_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.median))
    assert found["ate_max_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max))


def test_a_dense_estimate_is_interpolated_at_the_stamps_of_sparse_ground_truth() -> None:
    stamps = np.arange(101) * SECOND // 10
    line = np.array([[1e-9 * stamp, 0.0, 0.0] for stamp in stamps])
    sparse = np.array([0, 1.05 * SECOND, 5.51 * SECOND, 12 * SECOND], dtype=np.int64)
    truth = Trajectory(sparse, np.array([[1e-9 * stamp, 0.0, 0.0] for stamp in sparse]))
    found = match(Trajectory(stamps, line), truth)
    assert found.stamps_ns.tolist() == sparse[:3].tolist()
    assert trajectory.position_errors(found) == pytest.approx(np.zeros(3), abs=1e-12)
    assert found.rule == "estimate interpolated at 3 stamps of the ground truth, gaps up to 1 s"


def test_long_gaps_are_not_interpolated() -> None:
    stamps = np.array([0, 1, 2, 7, 8], dtype=np.int64) * SECOND
    at = np.array([-1, 0, 1, 1.5, 2, 4, 7, 7.9, 8, 9]) * SECOND
    inside = trajectory.can_interpolate(stamps, at.astype(np.int64), 1.0)
    assert inside.tolist() == [False, True, True, True, True, False, True, True, True, False]


def test_a_stationary_robot_is_aligned_by_its_first_pose() -> None:
    stamps = np.arange(5) * SECOND
    truth = Trajectory(stamps, np.tile([2.0, 1.0, np.pi / 2], (5, 1)))
    jitter = np.random.default_rng(0).normal(0.0, 0.001, (5, 3))
    found = match(Trajectory(stamps, jitter), truth)
    assert found.alignment.startswith("first pose (the true path spreads only 0.00 m")
    assert np.abs(trajectory.heading_errors(found)).max() < 0.01


def test_unmatched_trajectories_give_a_reason() -> None:
    truth = make_random_walk()
    nothing = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
    later = Trajectory(truth.stamps_ns + 3600 * SECOND, truth.poses)
    assert trajectory.match_trajectories(truth, None) == Unmatched("no ground-truth trajectory")
    assert trajectory.match_trajectories(nothing, truth) == Unmatched("the run has no poses")
    too_few = Unmatched("estimate and ground truth share 0 stamps, at least 2 are needed")
    assert trajectory.match_trajectories(later, truth) == too_few


def test_errors_over_time_are_nan_without_ground_truth() -> None:
    truth = Trajectory(np.array([1, 2, 9]) * SECOND, np.array([[1.0, 0, 0], [2.0, 0, 0], [9.0, 0, 0]]))
    stamps = np.array([0, 1, 1.5, 5, 9]) * SECOND
    poses = np.array([[0.0, 0, 0], [1, 0.2, 0], [1.5, 0, 0], [5, 0, 0], [9, 0, 0]])
    estimate = Trajectory(stamps.astype(np.int64), poses)
    errors = trajectory.compute_errors_m(estimate, truth)
    assert errors == pytest.approx([np.nan, 0.2, 0.0, np.nan, 0.0], nan_ok=True)


def test_a_run_that_ends_half_way_covers_half_of_the_sequence() -> None:
    truth = make_random_walk(count=61)
    half = Trajectory(truth.stamps_ns[:31], truth.poses[:31])
    found = values(evidence_of(half, truth, 61 + 1))
    assert found["covered_percent"] == pytest.approx(50.0)
    assert found["answered_percent"] == pytest.approx(50.0)


def test_a_gap_in_the_answers_is_not_covered() -> None:
    stamps = np.array([0, 1, 2, 6, 7, 8, 9, 10]) * SECOND
    poses = np.zeros((8, 3))
    whole = Trajectory(np.arange(11) * SECOND, np.zeros((11, 3)))
    assert trajectory.covered_share(Trajectory(stamps, poses), whole) == pytest.approx(0.6)


def test_the_answers_of_a_sequence_of_unknown_length_and_a_truth_of_one_pose_have_no_share() -> None:
    truth = make_random_walk()
    (answered,) = (metric for metric in trajectory.METRICS if metric.name == "answered_percent")
    (covered,) = (metric for metric in trajectory.METRICS if metric.name == "covered_percent")
    assert answered.compute(evidence_of(truth, truth, 0)).reason == "the number of scans in the sequence is unknown"
    assert answered.compute(evidence_of(truth, truth, 80)).support == 80
    one = Trajectory(truth.stamps_ns[:1], truth.poses[:1])
    assert covered.compute(evidence_of(truth, one, 60)).reason == "the ground-truth trajectory has no duration"
    assert covered.compute(evidence_of(truth, None, 60)).reason == "no ground-truth trajectory"


@pytest.mark.parametrize(("gap_s", "share"), [(1.0, 1.0), (1.001, 0.0)])
def test_gaps_of_a_second_are_covered_and_interpolated(gap_s: float, share: float) -> None:
    ends = Trajectory(np.array([0, round(gap_s * SECOND)]), np.zeros((2, 3)))
    assert trajectory.covered_share(ends, ends) == share
    errors = trajectory.compute_errors_m(Trajectory(np.array([0, SECOND // 2]), np.ones((2, 3))), ends)
    assert np.isfinite(errors).tolist() == [True, share == 1.0]


def test_two_common_stamps_are_enough_and_an_empty_truth_is_named() -> None:
    truth = make_random_walk()
    two = Trajectory(truth.stamps_ns[:2], truth.poses[:2])
    assert match(two, truth).rule == "2 equal stamps"
    one = Trajectory(truth.stamps_ns[:1], truth.poses[:1])
    too_few = Unmatched("estimate and ground truth share 1 stamps, at least 2 are needed")
    assert trajectory.match_trajectories(one, truth) == too_few
    empty = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
    assert trajectory.match_trajectories(truth, empty) == Unmatched("the ground-truth trajectory is empty")


@pytest.mark.parametrize(("spread_m", "how"), [(0.049, "first pose"), (0.051, "least squares")])
def test_a_path_that_spreads_less_than_five_centimetres_is_aligned_by_its_first_pose(spread_m: float, how: str) -> None:
    """Two positions on either side of the middle spread by their distance from it."""
    poses = np.array([[-spread_m, 0.0, 0.0], [spread_m, 0.0, 0.0]])
    line = Trajectory(np.array([0, SECOND]), poses)
    assert match(line, line).alignment.startswith(how)
    assert match(line, line, alignment="first pose").alignment == "first pose"


def test_in_a_known_map_nothing_is_fitted() -> None:
    truth = make_random_walk()
    start = Pose(1.0, 2.0, 0.5)
    found = match(truth, truth, map_from_start=start)
    np.testing.assert_allclose(found.estimate, se2.compose(start.row, truth.poses))
    assert (found.is_in_map, found.world_from_start) == (True, start)
    assert not match(truth, truth).is_in_map
