"""The fit of a scan to a known map: the predicted error is the planted one, a bare corridor fixes nothing along it."""

import math

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.run_result import Score
from evalkit.metrics.localisation import OPEN_M, _score_predicted, _score_ratio, _score_within, measure_fit
from evalkit.metrics.neighbourhoods import build_kd_tree

CELL_M = 0.05
SIDE = np.arange(-3.0, 3.0 + 1e-9, CELL_M)
ENDS = np.linspace(-2.0, 2.0, 81)
ROOM = np.concatenate(
    [
        *(np.column_stack([SIDE, np.full_like(SIDE, y)]) for y in (-2.0, 2.0)),
        *(np.column_stack([np.full_like(ENDS, x), ENDS]) for x in (-3.0, 3.0)),
    ]
)


@pytest.mark.parametrize("moved_m", [0.02, 0.05, 0.1, 0.15])
@pytest.mark.parametrize("heading", [0.0, 2.0])
def test_the_predicted_error_is_how_far_the_scan_was_moved(moved_m, heading):
    scan = se2.transform([moved_m * math.cos(heading), moved_m * math.sin(heading), 0.0], ROOM)
    predicted, share = measure_fit(scan, build_kd_tree(ROOM), CELL_M)
    assert predicted == pytest.approx(moved_m, abs=0.006)
    assert share == pytest.approx(1.0, abs=0.1)


def test_a_turned_scan_about_its_middle_is_not_displaced():
    predicted, _ = measure_fit(se2.transform([0.0, 0.0, 0.02], ROOM), build_kd_tree(ROOM), CELL_M)
    assert predicted < 0.015


def test_a_scan_of_another_place_has_no_prediction():
    predicted, share = measure_fit(se2.transform([0.8, 0.9, 0.0], ROOM), build_kd_tree(ROOM), CELL_M)
    assert math.isnan(predicted)
    assert share < 0.5
    assert math.isnan(measure_fit(np.zeros((0, 2)), build_kd_tree(ROOM), CELL_M)[0])


def test_between_two_bare_walls_the_position_along_them_is_unknown():
    walls = ROOM[np.abs(ROOM[:, 1]) > 1.99]
    predicted, _ = measure_fit(walls[np.abs(walls[:, 0]) < 2.0], build_kd_tree(walls), CELL_M)
    assert predicted == pytest.approx(OPEN_M, rel=0.05)


def test_the_predicted_error_of_a_run_is_the_median_of_the_scans_that_have_one():
    """Rows: predicted error (m), true error (m), share of the points that fit."""
    rows = np.array([[0.1, 9.0, 1.0], [0.3, np.nan, 1.0], [0.2, 9.0, 1.0], [np.nan, 0.5, 0.1]])
    assert _score_predicted(rows) == Score(0.2, 3)
    ratio = _score_ratio(rows)
    assert (ratio.value, ratio.support) == (pytest.approx(9.0 / np.sqrt((0.01 + 0.04) / 2)), 2)


def test_without_a_predicted_or_a_true_error_there_is_no_ratio():
    unknown = np.full((3, 3), np.nan)
    assert (_score_ratio(unknown).value, _score_within(unknown).value) == (None, None)
    fit = np.array([[0.1, 0.1, 1.0], [0.1, 0.5, 1.0], [0.1, np.nan, 1.0]])
    assert _score_within(fit) == Score(50.0, 2)  # 0.5 m is more than twice the predicted 0.1 m


def test_the_uncertainty_grows_with_the_scatter_of_the_points_to_both_sides_of_the_walls():
    """At r = 5 cm cells: with d = 5 cm of scatter, of weight 0.8, the root of (d2 + r2/12) / (0.8 r2/12) = 16.25."""
    middles = ROOM[(np.abs(ROOM[:, 0]) < 2.5) | (np.abs(ROOM[:, 1]) < 1.5)]
    inward = np.where(np.abs(middles[:, :1]) > 2.99, [[1.0, 0.0]], [[0.0, 1.0]]) * -np.sign(middles)
    sides = np.where(np.arange(len(middles)) % 2, 0.05, -0.05)[:, None]
    exact, scattered = (
        measure_fit(points, build_kd_tree(ROOM), CELL_M)[0] for points in (middles, middles + sides * inward)
    )
    assert scattered / exact == pytest.approx(math.sqrt(16.25), rel=0.05)
