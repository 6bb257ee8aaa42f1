"""The fit of a scan to a known map: the predicted error is the planted one, a bare corridor fixes nothing along it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.known_map import KnownMap
from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import localisation
from evalkit.metrics.fit_calibration import load_calibration
from evalkit.metrics.localisation import OPEN_M, _score_predicted, _score_ratio, _score_within, measure_fit
from evalkit.metrics.metric import Evidence
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.metrics.trajectory import match_trajectories

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
    assert _score_within(np.array([[0.1, 0.173, 1.0], [0.1, 0.174, 1.0]])) == Score(50.0, 2)
    assert _score_predicted(unknown) == Score(None, 3, "no scan fits the map")
    assert _score_ratio(unknown) == Score(None, 0, "no scan that fits has a true position in the map")


def test_the_uncertainty_grows_with_the_scatter_of_the_points_to_both_sides_of_the_walls():
    """At r = 5 cm cells: with d = 5 cm of scatter, of weight 0.8, the root of (d2 + r2/12) / (0.8 r2/12) = 16.25."""
    middles = ROOM[(np.abs(ROOM[:, 0]) < 2.5) | (np.abs(ROOM[:, 1]) < 1.5)]
    inward = np.where(np.abs(middles[:, :1]) > 2.99, [[1.0, 0.0]], [[0.0, 1.0]]) * -np.sign(middles)
    sides = np.where(np.arange(len(middles)) % 2, 0.05, -0.05)[:, None]
    exact, scattered = (
        measure_fit(points, build_kd_tree(ROOM), CELL_M)[0] for points in (middles, middles + sides * inward)
    )
    assert scattered / exact == pytest.approx(math.sqrt(16.25), rel=0.05)


@pytest.mark.parametrize(("off_m", "near"), [(0.19, 1.0), (0.21, 0.0)])
def test_a_point_within_20_cm_of_a_wall_lies_on_it(off_m, near):
    """Two walls along x, displaced across; without half of the points on walls nothing is predicted."""
    walls = ROOM[np.abs(ROOM[:, 1]) > 1.99]
    predicted, share = measure_fit(np.add(walls, [0.0, off_m]), build_kd_tree(walls), CELL_M)
    assert (share, math.isnan(predicted)) == (near, near == 0.0)


@pytest.mark.parametrize(("outside", "fits"), [(0, True), (100, True), (101, False)])
def test_half_of_the_points_on_walls_are_enough(outside, fits):
    away = np.column_stack([np.zeros(outside), np.linspace(-1.0, 1.0, outside)])
    predicted, share = measure_fit(np.concatenate([ROOM[:100], away]), build_kd_tree(ROOM), CELL_M)
    assert share == pytest.approx(100 / (100 + outside))
    assert math.isnan(predicted) != fits


def test_a_scan_that_fits_exactly_has_the_uncertainty_of_its_cells():
    """100 points on walls that fix x and 100 that fix y, of each three count as one: 2 * 3 r2 / (12 100), and an
    open position of 1 m changes it by a hundredth of a percent."""
    upright = np.column_stack(
        [np.full(100, 3.0) * np.where(np.arange(100) % 2, 1.0, -1.0), np.linspace(-1.5, 1.5, 100)]
    )
    level = np.column_stack([np.linspace(-2.5, 2.5, 100), np.full(100, 2.0) * np.where(np.arange(100) % 2, 1.0, -1.0)])
    walls = np.concatenate([ROOM, upright, level])
    predicted, share = measure_fit(np.concatenate([upright, level]), build_kd_tree(walls), CELL_M)
    assert share == 1.0
    assert predicted == pytest.approx(math.sqrt(2.0 * 3.0 * CELL_M**2 / 12.0 / 100.0), rel=0.02)


def test_along_a_corridor_of_one_wall_position_is_open_to_a_metre_and_heading_to_20_degrees_by_few_points():
    """Three points on one line: their position along it is open; the bound of the heading keeps it finite."""
    wall = np.column_stack([np.linspace(-3.0, 3.0, 121), np.zeros(121)])
    predicted, _ = measure_fit(np.array([[-0.1, 0.0], [0.0, 0.0], [0.1, 0.0]]), build_kd_tree(wall), CELL_M)
    assert predicted == pytest.approx(OPEN_M, rel=0.01)


def scores(*args, **kwargs):
    """Score the run of ``in_room``."""
    evidence = in_room(*args, **kwargs)
    return {metric.name: metric.compute(evidence) for metric in localisation.METRICS}


def in_room(off, count=5, placed=True, matched_in_map=True, start_searched=True):
    """Return a run that stands in the room, ``off`` (m) beside its true place, with a scan a pose."""
    stamps = np.arange(count) * 100_000_000
    steps = np.zeros(count, STEP)
    steps["stamp_ns"] = stamps
    start = MapStart(Pose(*off, 0.0), 3, 0.2, start_searched, 0.9)
    run = RunResult(steps, count, start=start)
    truth = Trajectory(stamps, np.zeros((count, 3)))
    matched = match_trajectories(run.estimate, truth, map_from_start=start.map_from_start if matched_in_map else None)
    ranges, angles = np.hypot(*ROOM.T), np.arctan2(ROOM[:, 1], ROOM[:, 0])
    scans = tuple((Scan(int(stamp), ranges, angles, 0.0, 20.0), np.array([*off, 0.0])) for stamp in stamps)
    known = KnownMap(ROOM, CELL_M, "room")
    return Evidence(run, Truth("exact", truth), matched, mapped=scans if placed else (), known_map=known)


def test_a_run_beside_its_place_in_the_map_is_predicted_to_be_there():
    found = scores((0.1, 0.0))
    assert found["map_fit_m"].value == pytest.approx(0.1, abs=0.006)
    assert found["map_fit_ratio"].value == pytest.approx(1.0, abs=0.06)
    assert found["map_fit_within_percent"] == Score(100.0, 5)
    assert found["map_misfit_percent"] == Score(0.0, 5)
    assert found["map_fit_percent"] == Score(100.0, 5)
    doubt = 100.0 * load_calibration().predict(found["map_fit_m"].value, len(ROOM), CELL_M)
    assert found["map_wrong_percent"].value == pytest.approx(float(doubt))
    assert found["map_truly_wrong_percent"].support == 5
    assert (found["localised_after_s"], found["localised_after_scans"]) == (Score(0.2, 3), Score(3.0, 3))
    away = scores((0.8, 0.9))
    assert (away["map_misfit_percent"], away["map_fit_m"].reason) == (Score(100.0, 5), "no scan fits the map")
    assert away["map_fit_percent"].value < 50.0
    assert away["map_wrong_percent"].value == pytest.approx(100.0 * load_calibration().misfit)
    assert away["map_truly_wrong_percent"] == Score(100.0, 5)
    assert scores((0.05, 0.0))["map_truly_wrong_percent"] == Score(0.0, 5)
    assert [scores((0.1, 0.0), count)["map_misfit_percent"].support for count in (1, 100, 101)] == [1, 100, 100]


def test_without_scans_a_truth_in_the_map_or_a_search_there_is_a_reason():
    no_scans = scores((0.1, 0.0), placed=False)
    assert {no_scans[name].reason for name in ("map_fit_m", "map_fit_ratio")} == {"no scan has a pose in the map"}
    aligned = scores((0.1, 0.0), matched_in_map=False)
    assert aligned["map_fit_m"].value == pytest.approx(0.1, abs=0.006)
    assert aligned["map_fit_ratio"].reason == "no scan that fits has a true position in the map"
    assert aligned["map_truly_wrong_percent"].reason == "no scan has a true position in the map"
    assert scores((0.1, 0.0), start_searched=False)["localised_after_s"].reason == "the start was given"
    bare = Evidence(RunResult(np.zeros(0, STEP), 0), Truth("none"))
    reasons = {metric.compute(bare).reason for metric in localisation.METRICS}
    assert reasons == {"no known map"}


def test_a_map_of_larger_cells_than_the_calibration_knows_has_no_probability():
    (metric,) = (one for one in localisation.METRICS if one.name == "map_wrong_percent")
    coarse = 2.0 * load_calibration().cells_m[1]
    found = metric.compute(replace(in_room((0.1, 0.0)), known_map=KnownMap(ROOM, coarse, "room")))
    assert (found.value, found.support) == (None, 5)
    assert found.reason in metric.no_value


def test_the_cards_state_the_limits_of_the_fit():
    cards = {metric.name: metric for metric in localisation.METRICS}
    assert "within 0.2 m of an occupied cell" in cards["map_fit_percent"].definition
    assert "fewer than 50 % of the points" in cards["map_misfit_percent"].definition
    assert "at most 1.73 times" in cards["map_fit_within_percent"].definition
    assert "more than 10 cm off" in cards["map_wrong_percent"].definition
