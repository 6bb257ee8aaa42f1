"""Values are checked once, at construction, and errors name the wrong field."""

import dataclasses
import math

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Relations
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.pose_graph import PoseGraph
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.run_status import Cause
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.trajectory import Trajectory

NOTHING = np.zeros(0, dtype=STEP)


def scan(ranges, angles=None, increment_ns=0):
    angles = np.linspace(0.0, 1.0, len(ranges)) if angles is None else angles
    return Scan(1_000, np.asarray(ranges, dtype=float), np.asarray(angles), 0.15, 12.0, increment_ns)


def cloud(points):
    return Cloud(points)


def trajectory(stamps_ns, poses, *frames):
    return Trajectory(stamps_ns, poses, *frames)


def occupancy(log_odds, observed, *place):
    return OccupancyGrid(log_odds, observed, *place)


# construction


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        (Scan, (0, [[1.0]], [0.0], 0.1, 9.0), r"ranges: expected shape \(N,\), got \(1, 1\)"),
        (Scan, (0, [1.0, 2.0], [0.0], 0.1, 9.0), r"angles: expected shape \(2,\), got \(1,\)"),
        (Scan, (0, [1.0], [math.nan], 0.1, 9.0), "angles: not finite"),
        (Scan, (0, [1.0], [0.0], 9.0, 0.1), "range limits: .* got 9.0 and 0.1 m"),
        (Scan, (0, [1.0], [0.0], 0.1, math.nan), "range limits"),
        (Scan, (0, [1.0], [0.0], 0.1, 9.0, -1), "time_increment_ns: negative: -1"),
        (Cloud, (np.zeros((4, 3)),), r"points: expected shape \(N, 2\), got \(4, 3\)"),
        (Cloud, ([[0.0, 1.0], [2.0, math.inf]],), r"points: not finite at row 1: \[2.0, inf\]"),
        (Cloud, ([[0.0, 1.0]], "base", [1, 2]), r"support: expected shape \(1,\), got \(2,\)"),
        (Cloud, ([[0.0, 1.0]], "base", [0]), "support: expected whole numbers from 1 on, got 0 to 0"),
        (Cloud, ([[0.0, 1.0]], "base", [1.5]), "support: expected whole numbers from 1 on, got 1.5"),
        (Cloud, ([[0.0, 1.0]], "base", None, [[1.0, 0.0]] * 2), r"seen_from: expected shape \(1, 2\), got \(2, 2\)"),
        (Cloud, ([[0.0, 1.0]], "base", None, [[1.0, math.nan]]), "seen_from: not finite"),
        (Cloud, ([[0.0, 1.0]], "base", None, None, [0.0, math.inf]), "origin: not finite"),
        (Trajectory, ([0, 1], np.zeros((2, 4))), r"poses: expected shape \(2, 3\), got \(2, 4\)"),
        (Trajectory, ([0, 1], np.zeros((3, 3))), r"poses: expected shape \(2, 3\), got \(3, 3\)"),
        (Trajectory, ([[0]], np.zeros((1, 3))), r"stamps_ns: expected shape \(N,\), got \(1, 1\)"),
        (Trajectory, ([0, 5, 5, 4], np.zeros((4, 3))), "stamps_ns: not increasing at index 2"),
        (Trajectory, ([0, 1], [[0, 0, 0], [0, math.nan, 0]]), "poses: not finite at index 1"),
        (OccupancyGrid, (np.zeros(4), np.ones(4), 0.1, 0, 0), "log_odds: expected shape"),
        (OccupancyGrid, (np.zeros((2, 3)), np.ones((3, 2)), 0.1, 0, 0), r"observed: expected shape \(2, 3\)"),
        (OccupancyGrid, (np.zeros((2, 3)), np.ones((2, 3)), 0.0, 0, 0), "resolution_m: .* got 0.0"),
        (Relations, ([0], [1, 2], np.zeros((1, 3))), r"second_ns: expected shape \(1,\)"),
        (Pose, (0.0, math.inf, 0.0), "pose: not finite"),
        (LoopClosure, (5, 5, Pose(), True, "close"), "other_stamp_ns: expected a time before 5, got 5"),
        (LoopClosure, (5, 4, Pose(), True, ""), "reason: expected 1 to 200 characters, got 0"),
        (RunResult, (NOTHING, 3, Cause.TIME_LIMIT, ""), "reason: a run that is timeout needs one"),
        (Score, (None,), "reason: a score without a value needs one"),
        (Score, (math.nan, 3), "value: not finite: nan; use None with a reason"),
    ],
)
def test_an_invalid_field_is_named(kind, values, message):
    with pytest.raises(ValueError, match=message):
        kind(*values)


@pytest.mark.parametrize("bad", [0.0, -1.0, 12.001, 0.149, -math.inf])
def test_a_range_outside_the_limits_is_reported_with_its_beam(bad):
    with pytest.raises(ValueError, match=r"at beam 2 lies outside \[0.15, 12.0\] m; mark no return as inf") as caught:
        scan([1.0, math.inf, bad, math.nan, bad])
    assert str(bad) in str(caught.value)


@pytest.mark.parametrize(
    ("value", "field"),
    [
        (scan([1.0]), "ranges"),
        (scan([1.0]), "angles"),
        (cloud([[0.0, 0.0]]), "points"),
        (trajectory([0], [[0, 0, 0]]), "stamps_ns"),
        (trajectory([0], [[0, 0, 0]]), "poses"),
        (occupancy(np.zeros((1, 1)), np.ones((1, 1)), 0.1, 0, 0), "log_odds"),
        (RunResult(np.zeros(1, dtype=STEP), 1), "steps"),
    ],
)
def test_values_are_frozen_and_their_arrays_read_only(value, field):
    with pytest.raises(ValueError, match="read-only"):
        getattr(value, field)[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, field, None)


def test_the_array_of_the_caller_stays_writable():
    points = np.zeros((2, 2))
    kept = cloud(points)
    points[0, 0] = 9.0
    assert kept.points[0, 0] == 0.0


def test_empty_values_are_valid():
    assert cloud([]).points.shape == (0, 2)
    assert trajectory([], []).poses.shape == (0, 3)
    assert (trajectory([], []).duration_s, trajectory([], []).path_m) == (0.0, 0.0)
    assert scan([]).points().shape == (0, 2)
    assert scan([]).duration_ns == 0


# poses


def test_compose_cancels_the_adjacent_frame_names():
    a_from_b, b_from_c = Pose(1.0, 2.0, math.pi / 2), Pose(3.0, 0.0, math.pi)
    a_from_c = a_from_b @ b_from_c
    assert a_from_c.row == pytest.approx([1.0, 5.0, -math.pi / 2])
    np.testing.assert_allclose(a_from_c.transform([[1.0, 0.0]]), a_from_b.transform(b_from_c.transform([[1.0, 0.0]])))
    assert (a_from_b @ a_from_b.inverse()).row == pytest.approx([0.0, 0.0, 0.0])


def test_a_pose_keeps_its_angle_within_half_a_turn():
    assert Pose(0.0, 0.0, 1.5 * math.pi).theta == pytest.approx(-0.5 * math.pi)


# scans


def test_hits_are_converted_to_points_by_equation_1():
    ranges, angles = [2.0, math.inf, 3.0, math.nan, 1.0], [0.0, 0.1, math.pi / 2, 0.2, math.pi]
    made = scan(ranges, angles)
    np.testing.assert_allclose(made.points(), [[2, 0], [0, 3], [-1, 0]], atol=1e-12)
    assert made.hits.tolist() == [True, False, True, False, True]
    assert made.no_returns.tolist() == [False, True, False, False, False]


def test_a_scan_lasts_from_its_first_beam_to_its_last():
    assert scan([1.0, 1.0, 1.0], increment_ns=50).duration_ns == 100


def test_deskewing_changes_nothing_without_motion_or_with_simultaneous_beams():
    slow, at_once = scan([1.0, 2.0], increment_ns=10), scan([1.0, 2.0])
    assert slow.deskewed(Pose(), None) is slow
    assert at_once.deskewed(Pose(), Pose(1.0, 0.0, 0.0)) is at_once


def test_a_pure_rotation_turns_each_beam_by_its_time_share_and_keeps_ranges():
    made = scan([2.0, 2.0, math.inf, math.nan, 2.0], np.zeros(5), increment_ns=10)
    still = made.deskewed(Pose(), Pose(0.0, 0.0, 0.4))
    np.testing.assert_allclose(still.angles, [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-12)
    np.testing.assert_allclose(still.ranges, [2.0, 2.0, math.inf, math.nan, 2.0], rtol=1e-12)
    assert (still.stamp_ns, still.time_increment_ns) == (1_000, 0)


def test_a_pure_translation_moves_each_hit_by_its_time_share():
    made = scan([2.0, 2.0, 2.0], np.zeros(3), increment_ns=10)
    still = made.deskewed(Pose(), Pose(0.5, 0.0, 0.0))
    np.testing.assert_allclose(still.points(), [[2.0, 0.0], [2.25, 0.0], [2.5, 0.0]], atol=1e-12)


def test_the_motion_refers_to_the_base_not_to_the_sensor():
    """A base that turns on the spot moves a sensor mounted 1 m ahead sideways."""
    made = scan([2.0, 2.0], np.zeros(2), increment_ns=10)
    still = made.deskewed(Pose(1.0, 0.0, 0.0), Pose(0.0, 0.0, math.pi / 2))
    np.testing.assert_allclose(still.points(), [[2.0, 0.0], [-1.0, 3.0]], atol=1e-12)  # in the base: (0, 3)


def test_a_wall_seen_by_a_moving_rotated_sensor_is_straight_after_deskewing():
    """The wall is y = 3 in the start frame; the base drives an arc while 90 beams are fired."""
    base_from_sensor, start_from_end = Pose(0.2, -0.1, math.radians(40.0)), Pose(0.3, 0.05, math.radians(25.0))
    angles = np.linspace(math.radians(10.0), math.radians(80.0), 90)
    start_from_sensor = se2.compose(se2.fraction(start_from_end.row, np.linspace(0, 1, 90)), base_from_sensor.row)
    ranges = (3.0 - start_from_sensor[:, 1]) / np.sin(angles + start_from_sensor[:, 2])
    made = scan(ranges, angles, increment_ns=1_000)
    seen = base_from_sensor.transform(made.points())
    straight = base_from_sensor.transform(made.deskewed(base_from_sensor, start_from_end).points())
    assert np.ptp(seen[:, 1]) > 0.3
    np.testing.assert_allclose(straight[:, 1], 3.0, atol=1e-12)


def test_a_deskewed_hit_may_exceed_the_sensor_limits():
    still = scan([12.0, 12.0], np.zeros(2), increment_ns=10).deskewed(Pose(), Pose(0.5, 0.0, 0.0))
    assert (still.ranges[1], still.range_max_m) == (12.5, 12.5)
    near = scan([0.15, 0.15], np.zeros(2), increment_ns=10).deskewed(Pose(), Pose(-0.1, 0.0, 0.0))
    assert near.range_min_m == pytest.approx(0.05)


def test_a_frame_has_no_odometry_by_default():
    frame = Frame(scan([1.0]))
    assert (frame.base_from_sensor, frame.odom_from_base, frame.start_from_end) == (Pose(), None, None)


# trajectories


def test_a_trajectory_has_a_length_a_duration_and_interpolated_poses():
    lap = trajectory([0, 10**9, 3 * 10**9], [[0, 0, 0], [3, 4, 0], [3, 0, 0]])
    assert (len(lap), lap.path_m, lap.duration_s) == (3, 9.0, 3.0)
    assert lap.at([5 * 10**8, 2 * 10**9]).tolist() == [[1.5, 2.0, 0.0], [3.0, 2.0, 0.0]]


def test_a_trajectory_in_another_frame_keeps_its_steps():
    lap = trajectory([0, 1], [[0, 0, 0], [1, 0, 0.5]], "start", "base")
    moved = lap.moved(Pose(5.0, 0.0, math.pi / 2), "world")
    np.testing.assert_allclose(moved.poses, [[5, 0, math.pi / 2], [5, 1, math.pi / 2 + 0.5]], atol=1e-12)
    assert (moved.parent, moved.child) == ("world", "base")


# grids


def test_cell_centres_start_at_row_0_at_the_bottom():
    grid = occupancy(np.zeros((2, 3)), np.ones((2, 3)), 0.5, -1.0, 10.0)
    cells = np.zeros((2, 3), dtype=bool)
    cells[0, 0] = cells[1, 2] = True
    assert grid.shape == (2, 3)
    assert grid.centres(cells).tolist() == [[-0.75, 10.25], [0.25, 10.75]]


def test_a_point_lies_in_the_cell_around_it_or_beside_the_grid():
    """Three cells of 0.5 m from (1, 2) in each of two rows; a cell holds its lower and left border."""
    grid = OccupancyGrid(np.zeros((2, 3)), np.ones((2, 3)), 0.5, 1.0, 2.0)
    assert grid.extent == (1.0, 2.5, 2.0, 3.0)
    points = np.array([[1.0, 2.0], [2.4, 2.9], [1.6, 2.5], [2.5, 2.1], [0.9, 2.1], [1.1, 3.0]])
    rows, columns, inside = grid.find_cells(points)
    assert inside.tolist() == [True, True, True, False, False, False]
    assert list(zip(rows.tolist(), columns.tolist(), strict=True)) == [(0, 0), (1, 2), (1, 1), (0, 0), (0, 0), (0, 0)]


def test_occupied_and_free_are_observed_cells_beyond_the_thresholds():
    """The thresholds 0.65 and 0.196 of map_server as log-odds: 0.619 and -1.412."""
    log_odds = np.array([[0.62, 0.61, 0.0, -1.41, -1.42, 9.0, -9.0]])
    grid = occupancy(log_odds, np.array([[1, 1, 1, 1, 1, 0, 0]]), 0.05, 0.0, 0.0)
    assert grid.occupied().tolist() == [[True, False, False, False, False, False, False]]
    assert grid.free().tolist() == [[False, False, False, False, True, False, False]]
    assert grid.occupied(0.6)[0].tolist() == [True, True, False, False, False, False, False]


def test_log_odds_without_bounds_convert_to_probabilities():
    grid = occupancy(np.array([[-3000.0, 0.0, math.log(3.0), 3000.0]]), np.ones((1, 4)), 0.05, 0.0, 0.0)
    np.testing.assert_allclose(grid.probability(), [[0.0, 0.5, 0.75, 1.0]], atol=1e-7)


# runs


def test_the_estimate_of_a_run_is_the_trajectory_of_its_answers():
    steps = np.zeros(2, dtype=STEP)
    steps["stamp_ns"], steps["x"], steps["y"], steps["theta"] = [7, 9], [0, 1], [0, 2], [0, 0.5]
    estimate = RunResult(steps, 2).estimate
    assert estimate.stamps_ns.tolist() == [7, 9]
    assert estimate.poses.tolist() == [[0, 0, 0], [1, 2, 0.5]]
    assert (estimate.parent, estimate.child) == ("start", "base")


def test_a_score_without_a_value_has_a_reason():
    assert Score(None, 0, "no truth").value is None
    assert Score(0.0).support == 0


def pose_graph(**changes):
    fields = {"poses": np.zeros((2, 3)), "first": [0], "second": [1], "first_from_second": [[1.0, 0.0, 0.0]],
              "information": [np.diag([4.0, 4.0, 9.0])]}  # fmt: skip
    return PoseGraph(**{**fields, **changes})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"poses": [[0.0, 0.0, 0.0], [math.inf, 0.0, 0.0]]}, "poses: not finite"),
        ({"information": [np.full((3, 3), math.nan)]}, "information: not finite"),
        ({"second": [2]}, "second: expected rows of 2 poses, got 2 to 2"),
        ({"first": [-1]}, "first: expected rows of 2 poses, got -1 to -1"),
        ({"first": [1]}, "second: edge 0 connects pose 1 with itself"),
        ({"information": [[[1.0, 2.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]}, "information: not symmetric"),
    ],
)
def test_a_pose_graph_is_checked_at_construction(changes, message):
    assert pose_graph().chi_squares().tolist() == [4.0]  # 1 m short, weighed by 4 per square metre
    with pytest.raises(ValueError, match=message):
        pose_graph(**changes)
