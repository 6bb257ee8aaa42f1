import numpy as np
import pytest

from evalkit.core.odometry_estimate import StageEstimate
from evalkit.core.pose import Pose
from evalkit_baselines.slam.keyframes import DriftModel
from evalkit_baselines.slam.match_doubt import Doubt, MatchDoubt
from evalkit_baselines.slam.observability import Openness


def observe(doubt, residual_m, inliers=100, gap=(0.3, 0.4, 0.2)):
    doubt.observe(
        Pose(1.0, 1.0, 0.1), Pose(1.0, 1.0, 0.1) @ Pose(*gap), StageEstimate(True, True, 5, residual_m, inliers), 100
    )


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
    observe(doubt, residual_m, inliers)
    assert doubt.take() == pytest.approx((share**2 * 0.25, share**2 * 0.04))
    assert doubt.take() == (0.0, 0.0)  # of the next step


def test_without_odometry_no_gap_is_doubted_and_of_a_far_larger_error_twice_the_usual_one_counts():
    doubt = MatchDoubt()
    assert doubt.usual_m == 0.0
    for residual_m in (0.1, 0.3):
        doubt.observe(None, Pose(), StageEstimate(True, True, 5, residual_m, 10), 100)
    assert doubt.usual_m == pytest.approx(0.1 + (0.2 - 0.1) / 50.0)
    assert doubt.take() == (0.0, 0.0)


def test_the_doubts_of_several_scans_add_up_and_a_bad_stretch_does_not_become_usual_soon():
    doubt = MatchDoubt()
    observe(doubt, 0.02)
    for _ in range(5):
        observe(doubt, 0.2)
    assert doubt.take() == pytest.approx((5 * 0.25, 5 * 0.04))


def test_the_doubt_is_added_to_the_variance_of_the_drift_in_all_directions():
    room = Openness(np.array([1.0, 0.0]), 1.0)
    information = DriftModel(0.02, 0.005).information(1.0, room, Doubt(0.01, 0.001))
    np.testing.assert_allclose(np.linalg.inv(information), np.diag([0.0104, 0.0104, 0.001025]), atol=1e-12)
