"""Relative errors, compared with hand calculations, invariances, a literal KITTI loop and evo."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.se2 import Floats
from evalkit.metrics import drift
from evalkit.metrics.metric import Evidence, MatchedPoses


def integrate_steps(steps: Floats, start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Floats:
    """Return the poses (N + 1, 3) after each of the steps (N, 3)."""
    poses = [np.array(start)]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def match(estimate: Floats, truth: Floats) -> MatchedPoses:
    return MatchedPoses(np.arange(len(truth)) * 100_000_000, estimate, truth, "none", "equal stamps")


def score(name: str, found: MatchedPoses) -> Score:
    run = RunResult(np.zeros(0, STEP), 0)
    (metric,) = (metric for metric in drift.METRICS if metric.name == name)
    return metric.compute(Evidence(run, Truth("exact"), found))


def value(name: str, found: MatchedPoses) -> float:
    answer = score(name, found).value
    assert answer is not None
    return answer


def make_winding_path(count: int = 400, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return np.stack([rng.uniform(0.0, 0.2, count), np.zeros(count), rng.normal(0.0, 0.1, count)], axis=1)


def add_noise(steps: Floats, seed: int = 1) -> Floats:
    return se2.compose(steps, np.random.default_rng(seed).normal(0.0, 0.01, steps.shape))


STRAIGHT = np.tile([0.05, 0.0, 0.0], (500, 1))  # 25 m


def test_wheels_two_percent_too_large_drift_two_percent_at_every_length() -> None:
    found = match(integrate_steps(STRAIGHT * 1.02), integrate_steps(STRAIGHT))
    for name in ("drift_percent", *(f"drift_{length}m_percent" for length in (1, 2, 5, 10, 20)), "end_error_percent"):
        assert value(name, found) == pytest.approx(2.0), name
    assert value("rpe_1m_m", found) == pytest.approx(0.02)
    assert value("drift_deg_per_m", found) == pytest.approx(0.0, abs=1e-9)


def test_a_gyro_bias_of_one_degree_per_metre_is_measured() -> None:
    biased = np.add(STRAIGHT, [0.0, 0.0, np.radians(0.05)])
    found = match(integrate_steps(biased), integrate_steps(STRAIGHT))
    assert value("drift_deg_per_m", found) == pytest.approx(1.0)
    assert value("rpe_step_deg", found) == pytest.approx(0.05)


def test_a_gyro_one_percent_too_fast_errs_by_3_6_degrees_per_turn_in_both_directions() -> None:
    turn = np.tile([0.02, 0.0, np.radians(3.0)], (150, 1))
    both_ways = np.concatenate([turn, turn * [1, 1, -1]])
    assert value(
        "drift_deg_per_turn", match(integrate_steps(turn * [1, 1, 1.01]), integrate_steps(turn))
    ) == pytest.approx(3.6)
    right = turn * [1, 1, -1]
    assert value(
        "drift_deg_per_turn", match(integrate_steps(right * [1, 1, 1.01]), integrate_steps(right))
    ) == pytest.approx(3.6)
    assert (
        value("drift_deg_per_turn", match(integrate_steps(both_ways * [1, 1, 1.01]), integrate_steps(both_ways))) < 3.6
    )


def test_rpe_detects_one_wrong_step() -> None:
    wrong = STRAIGHT.copy()
    wrong[100, 1] = 0.3
    found = match(integrate_steps(wrong), integrate_steps(STRAIGHT))
    assert value("rpe_step_m", found) == pytest.approx(0.3 / np.sqrt(500))
    assert score("rpe_step_m", found).support == 500


def test_relative_errors_are_independent_of_the_frame() -> None:
    steps = make_winding_path()
    estimated = add_noise(steps)
    here = match(integrate_steps(estimated), integrate_steps(steps))
    there = match(integrate_steps(estimated, (5.0, -3.0, 2.0)), integrate_steps(steps, (0.0, 9.0, -1.0)))
    for metric in drift.METRICS:
        assert value(metric.name, there) == pytest.approx(value(metric.name, here)), metric.name


def test_segments_equal_those_of_a_literal_kitti_loop() -> None:
    steps = make_winding_path(120)
    truth = integrate_steps(steps)
    estimate = integrate_steps(add_noise(steps))
    found = match(estimate, truth)
    progress = drift.travelled_m(found)
    errors, start_from = [], 0.0
    for first in range(len(truth)):
        if progress[first] < start_from - 1e-9:
            continue
        start_from = (np.floor(progress[first] / 0.1 + 1e-9) + 1.0) * 0.1
        for last in range(first, len(truth)):
            if progress[last] - progress[first] >= 2.0 - 1e-9:
                true = np.linalg.inv(se2.to_matrix(truth[first])) @ se2.to_matrix(truth[last])
                mine = np.linalg.inv(se2.to_matrix(estimate[first])) @ se2.to_matrix(estimate[last])
                error = np.linalg.inv(true) @ mine
                errors.append(100.0 * np.hypot(error[0, 2], error[1, 2]) / (progress[last] - progress[first]))
                break
    answer = score("drift_2m_percent", found)
    assert answer.support == len(errors) > 20
    assert answer.value == pytest.approx(np.mean(errors))


def test_rpe_over_steps_and_seconds_equals_evo() -> None:
    pytest.importorskip("evo")
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D

    steps = make_winding_path()
    truth, estimate = integrate_steps(steps), integrate_steps(add_noise(steps))

    def as_evo(rows: Floats) -> PosePath3D:
        half, zero = 0.5 * rows[:, 2], np.zeros(len(rows))
        return PosePath3D(
            positions_xyz=np.column_stack([rows[:, :2], zero]),
            orientations_quat_wxyz=np.column_stack([np.cos(half), zero, zero, np.sin(half)]),
        )

    for relation, name, frames in (
        (metrics.PoseRelation.translation_part, "rpe_step_m", 1),
        (metrics.PoseRelation.rotation_angle_deg, "rpe_step_deg", 1),
        (metrics.PoseRelation.translation_part, "rpe_1s_m", 10),
        (metrics.PoseRelation.rotation_angle_deg, "rpe_1s_deg", 10),
    ):
        rpe = metrics.RPE(relation, delta=frames, delta_unit=metrics.Unit.frames, all_pairs=True)
        rpe.process_data((as_evo(truth), as_evo(estimate)))
        expected = rpe.get_statistic(metrics.StatisticsType.rmse)
        assert value(name, match(estimate, truth)) == pytest.approx(expected)


def test_standing_still_counts_once() -> None:
    rest = np.zeros((300, 3))
    slow = np.concatenate([STRAIGHT[:100], rest, STRAIGHT[:100]])
    with_rest = match(integrate_steps(slow * 1.02), integrate_steps(slow))
    without = match(integrate_steps(STRAIGHT[:200] * 1.02), integrate_steps(STRAIGHT[:200]))
    assert score("drift_1m_percent", with_rest) == score("drift_1m_percent", without)


def test_a_path_that_is_too_short_gives_a_reason() -> None:
    still = match(np.zeros((10, 3)), np.zeros((10, 3)))
    assert score("drift_percent", still).reason == "a path of 0.0 m is too short for segments of 1 m"
    assert score("end_error_percent", still).reason == "a path of 0.0 m is too short (1 m needed)"
    assert score("drift_deg_per_turn", still).reason == "a path that turns 0 deg has no segment of 360 deg"
    short = match(integrate_steps(STRAIGHT[:200]), integrate_steps(STRAIGHT[:200]))
    assert score("drift_20m_percent", short).reason == "a path of 10.0 m is too short for segments of 20 m"


def test_pairs_a_second_apart_are_found_by_time_not_by_count() -> None:
    stamps = np.array([0, 400, 800, 1210, 1400, 5000, 6010]) * 1_000_000
    first, last = drift.find_pairs_in_time(stamps, 1.0)
    assert list(zip(first.tolist(), last.tolist(), strict=True)) == [(0, 2), (1, 4), (5, 6)]
    still = match(np.zeros((5, 3)), np.zeros((5, 3)))
    assert score("rpe_1s_m", still) == Score(None, 0, "no two matched poses are 1 s apart")


def test_every_tenth_of_a_metre_and_every_ten_degrees_begin_a_segment_up_to_the_last_that_fits() -> None:
    """Of 25 m: starts at 0 to 25 - L; of 450 deg in steps of 3 deg: the first poses from 0, 10, ... and 90 deg on."""
    found = match(integrate_steps(STRAIGHT), integrate_steps(STRAIGHT))
    for length, count in ((1, 241), (2, 231), (5, 201), (10, 151), (20, 51)):
        assert score(f"drift_{length}m_percent", found).support == count
    assert score("drift_percent", found).support == 241 + 231 + 201 + 151 + 51
    assert score("rpe_1m_m", found).support == 241
    assert score("rpe_step_deg", found).support == score("rpe_step_m", found).support == 500
    assert score("end_error_percent", found).support == 501
    turn = integrate_steps(np.tile([0.02, 0.0, np.radians(3.0)], (150, 1)))
    assert score("drift_deg_per_turn", match(turn, turn)).support == 10


@pytest.mark.parametrize(("metres", "enough"), [(1.0, True), (0.99, False)])
def test_the_error_at_the_end_needs_a_path_of_a_metre(metres: float, enough: bool) -> None:
    line = np.column_stack([np.linspace(0.0, metres, 5), np.zeros((5, 2))])
    found = score("end_error_percent", match(line * [1.1, 1.0, 1.0], line))
    assert found.value == (pytest.approx(10.0) if enough else None)
    assert (score("rpe_1m_m", match(line, line)).reason == "") == enough
    if not enough:
        reason = "a path of 1.0 m is too short for segments of 1 m"
        assert score("rpe_1m_m", match(line, line)) == score("drift_deg_per_m", match(line, line))
        assert score("rpe_1m_m", match(line, line)).reason == reason


@pytest.mark.parametrize(
    ("milliseconds", "pairs"),
    [([0, 900, 1100], [(0, 2)]), ([0, 400, 800, 1200], [(0, 3), (1, 3)]), ([0, 400, 800, 1199], [(0, 3)])],
)
def test_a_pair_ends_at_the_nearest_stamp_the_later_of_two_to_half_a_median_step(milliseconds, pairs) -> None:
    """Steps of 400 ms: 200 ms early or late is near enough, 201 ms (of 1199 after 400 and 1000) is not."""
    first, last = drift.find_pairs_in_time(np.array(milliseconds) * 1_000_000, 1.0)
    assert list(zip(first.tolist(), last.tolist(), strict=True)) == pairs
