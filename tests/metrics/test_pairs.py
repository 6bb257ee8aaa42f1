"""The pair error: closed forms for rotations and translations, and independence of the scale of the scene."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Scan
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import pairs
from evalkit.metrics.metric import Evidence, MatchedPoses
from evalkit.metrics.trajectory import match_trajectories

ANGLES = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
CIRCLE = 4.0 * np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


@given(st.floats(-3.0, 3.0), st.floats(0.01, 100.0))
def test_a_pure_rotation_about_the_centroid_costs_its_chord_at_any_scale(turn: float, scale: float) -> None:
    assert pairs.pair_error(scale * CIRCLE, np.zeros(3), np.array([0.0, 0.0, turn])) == pytest.approx(
        2.0 * abs(np.sin(turn / 2.0)), abs=1e-9
    )


@given(st.floats(-2.0, 2.0), st.floats(-2.0, 2.0))
def test_a_pure_translation_of_a_circle_costs_its_length_over_the_radius(x: float, y: float) -> None:
    assert pairs.pair_error(CIRCLE, np.zeros(3), np.array([x, y, 0.0])) == pytest.approx(np.hypot(x, y) / 4.0)


def test_the_error_is_independent_of_the_position_of_the_target() -> None:
    points = np.random.default_rng(0).normal(0.0, [3.0, 1.0], (200, 2))
    true, off, away = np.array([0.3, -0.1, 0.2]), np.array([0.32, -0.12, 0.23]), np.array([5.0, 7.0, 2.0])
    here = pairs.pair_error(points, true, off)
    assert pairs.pair_error(points, se2.compose(away, true), se2.compose(away, off)) == pytest.approx(here)
    by_hand = se2.transform(true, points), se2.transform(off, points)
    reach = np.linalg.norm(by_hand[0] - by_hand[0].mean(axis=0), axis=1)
    assert here == pytest.approx(np.mean(np.linalg.norm(by_hand[1] - by_hand[0], axis=1) / reach))


def test_coincident_points_have_no_error() -> None:
    assert np.isnan(pairs.pair_error(np.ones((5, 2)), np.zeros(3), np.array([1.0, 0.0, 0.0])))


def test_points_at_the_centroid_are_left_out() -> None:
    """A point 1 um from the middle of a circle of 4 m, nearer than a millionth of the radius, changes nothing."""
    points = np.concatenate([CIRCLE, [[1e-6, 0.0]]])
    assert pairs.pair_error(points, np.zeros(3), np.array([0.3, 0.4, 0.0])) == pytest.approx(0.125)


def compute_pair_error(estimated_step, sensor=(0.1, 0.0, 0.5), known=11, hits=()):
    """Score ten steps, each estimated as given where the ground truth moves 0.2 m ahead; the lidar is mounted off-
    centre. ``known``: true poses; ``hits``: number of hits of some scans, of others 90.
    """
    stamps = np.arange(11) * 100_000_000
    base_from_sensor = np.array(sensor)
    estimate, true = ([np.zeros(3)], [np.array([5.0, 2.0, 1.0])])
    for _ in range(10):
        estimate.append(se2.compose(estimate[-1], estimated_step))
        true.append(se2.compose(true[-1], [0.2, 0.0, 0.0]))
    steps = np.zeros(11, STEP)
    steps["stamp_ns"] = stamps
    steps["x"], steps["y"], steps["theta"] = np.array(estimate).T
    run, truth = RunResult(steps, 11), Truth("exact", Trajectory(stamps[:known], np.array(true)[:known]))
    matched = match_trajectories(run.estimate, truth.trajectory)
    assert isinstance(matched, MatchedPoses)
    start = matched.world_from_start.row
    counts = dict(hits)
    scan = [
        Scan(int(stamp), np.where(np.arange(90) < counts.get(k, 90), 4.0, np.inf), ANGLES, 0.0, 10.0)
        for k, stamp in enumerate(stamps)
    ]
    placed = [(s, se2.compose(se2.compose(start, e), base_from_sensor)) for s, e in zip(scan, estimate, strict=True)]
    evidence = Evidence(run, truth, matched, successive=tuple(pairwise(placed)))
    (metric,) = pairs.METRICS
    return metric.compute(evidence)


def test_steps_are_compared_with_the_true_motion_of_the_sensor() -> None:
    assert compute_pair_error([0.2, 0.0, 0.0]).value == pytest.approx(0.0, abs=1e-9)
    found = compute_pair_error([0.24, 0.0, 0.0])
    assert (found.value, found.support) == (pytest.approx(0.01), 10)  # 4 cm on a circle of 4 m


def test_steps_without_a_true_pose_at_either_end_or_with_one_hit_are_left_out() -> None:
    assert compute_pair_error([0.24, 0.0, 0.0], known=6).support == 5
    assert compute_pair_error([0.24, 0.0, 0.0], known=6, hits={2: 1, 4: 0}).support == 3
    assert compute_pair_error([0.24, 0.0, 0.0], hits={2: 2, 10: 1}).support == 9
    assert compute_pair_error([0.24, 0.0, 0.0], hits=dict.fromkeys(range(11), 1)).reason == (
        "no two successive scans with hits have true poses"
    )


def test_missing_ground_truth_gives_a_reason() -> None:
    (metric,) = pairs.METRICS
    bare = Evidence(RunResult(np.zeros(0, STEP), 0), Truth("none"))
    assert metric.compute(bare).reason == "no ground-truth trajectory"
