import numpy as np
import pytest

from evalkit.core.odometry_estimate import StageEstimate
from evalkit.core.pose import Pose
from evalkit_baselines.slam.keyframes import DriftModel
from evalkit_baselines.slam.match_doubt import Doubt, MatchDoubt
from evalkit_baselines.slam.observability import Openness

PREDICTED = Pose(1.0, 1.0, 0.1)


def observe(doubt, residual_m, inliers=100, gap=(0.3, 0.4, 0.2), step_m=4.0):
    last = PREDICTED @ Pose(0.0, -step_m, 1.0)
    match = StageEstimate(True, True, 5, residual_m, inliers)
    return doubt.observe(last, PREDICTED, PREDICTED @ Pose(*gap), match, 100)


@pytest.mark.parametrize(
    ("residual_m", "inliers", "share"),
    [(0.02, 100, 0.0), (0.04, 100, 0.0), (0.06, 100, 0.5), (0.08, 100, 1.0), (0.5, 80, 1.0), (0.01, 79, 1.0)],
)
def test_a_step_is_doubted_by_the_gap_to_the_prediction_where_its_match_fits_worse_than_usual(
    residual_m, inliers, share
):
    doubt = MatchDoubt()
    observe(doubt, 0.02)  # the first match is the usual one
    assert doubt.take() == (0.0, 0.0)
    assert observe(doubt, residual_m, inliers) == (share == 0.0)
    assert doubt.take() == pytest.approx((share**2 * 0.25, share**2 * 0.04))
    assert doubt.take() == (0.0, 0.0)  # of the next step


def test_without_odometry_no_gap_is_doubted_and_of_a_far_larger_error_twice_the_usual_one_counts():
    doubt = MatchDoubt()
    assert doubt.usual_m == doubt.usual_points == 0.0
    for residual_m, inliers, points, fits in ((0.1, 80, 100, True), (0.3, 80, 50, False)):
        match = StageEstimate(True, True, 5, residual_m, inliers)
        assert doubt.observe(Pose(), None, Pose(), match, points) == fits
    assert doubt.usual_points == pytest.approx(100.0 - 50.0 / 50.0)
    assert doubt.usual_m == pytest.approx(0.1 + (0.2 - 0.1) / 50.0)
    assert not doubt.observe(Pose(), None, Pose(), StageEstimate(True, True, 5, 0.1, 79), 100)
    assert doubt.take() == (0.0, 0.0)


def test_the_doubts_of_several_scans_add_up_and_a_bad_stretch_does_not_become_usual_soon():
    doubt = MatchDoubt()
    observe(doubt, 0.02)
    for _ in range(5):
        observe(doubt, 0.2)
    assert doubt.take() == pytest.approx((5 * 0.25, 5 * 0.04))


@pytest.mark.parametrize(
    ("gap_m", "share"),
    # odometry is thought to be no better than 0.01 m and 5 % of its step of 0.6 m: 0.04 m
    [(0.12, 0.0), (0.18, 0.5), (0.24, 1.0), (0.6, 1.0)],
)
def test_a_match_is_doubted_where_it_is_three_times_as_far_from_the_prediction_as_usual(gap_m, share):
    doubt = MatchDoubt()
    observe(doubt, 0.02, gap=(gap_m, 0.0, 0.3), step_m=0.6)
    assert doubt.take() == pytest.approx((share**2 * gap_m**2, 0.0))  # nothing is said of the heading


def test_a_gap_that_is_usual_is_not_doubted_and_one_that_is_larger_by_far_becomes_usual_slowly():
    doubt = MatchDoubt()
    for _ in range(400):
        observe(doubt, 0.02, gap=(0.0, 0.1, 0.0), step_m=0.6)
    assert doubt.take() == (0.0, 0.0)
    observe(doubt, 0.02, gap=(0.0, 0.29, 0.0), step_m=0.6)
    assert doubt.take() == (0.0, 0.0)
    fresh = MatchDoubt()
    for _ in range(10):
        observe(fresh, 0.02, gap=(0.0, 0.6, 0.0), step_m=0.6)
    assert fresh.take() == pytest.approx((10 * 0.36, 0.0))


def test_the_usual_gap_is_known_after_fifty_scans_with_odometry_and_a_larger_one_counts_twice():
    doubt = MatchDoubt()
    for scan in range(400):
        assert (doubt.usual_gap is None) == (scan < 50)
        observe(doubt, 0.02, gap=(0.0, 0.1, -0.02))
    assert doubt.usual_gap == pytest.approx((0.1, 0.02), rel=1e-3)
    before_m, before_rad = doubt.usual_gap
    observe(doubt, 0.02, gap=(9.0, 0.0, 3.0), step_m=0.6)
    assert doubt.usual_gap == pytest.approx((before_m * 51 / 50, before_rad * 51 / 50))


def test_the_doubt_is_added_to_the_variance_of_the_drift_in_all_directions():
    room = Openness(np.array([1.0, 0.0]), 1.0)
    information = DriftModel(0.02, 0.005).information(1.0, room, Doubt(0.01, 0.001))
    np.testing.assert_allclose(np.linalg.inv(information), np.diag([0.0104, 0.0104, 0.001025]), atol=1e-12)
