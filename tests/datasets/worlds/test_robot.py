import numpy as np
import pytest

from evalkit.core import se2
from evalkit_datasets.worlds import robot
from evalkit_datasets.worlds.disturbances import Episodes
from evalkit_datasets.worlds.robot import Route, RouteDrive, WheelOdometryModel

SQUARE = Route.from_corners([(0, 0, 1), (4, 0, 1), (4, 4, 1), (0, 4, 1)])
FAULTLESS = WheelOdometryModel(0.0, 0.0, 0.0, 0.0)


def every(drive, step_ns=10_000_000):
    return np.arange(0, drive.duration_ns + 1, step_ns)


def odometry(errors, drive, stamps, seed=0):
    return errors.poses(drive, stamps, np.random.default_rng(seed))


def test_a_square_with_rounded_corners_has_its_hand_computed_length():
    assert SQUARE.length_m == pytest.approx(4 * 2.0 + 2.0 * np.pi)


def test_a_route_passes_the_points_of_its_geometry():
    quarter = 0.25 * SQUARE.length_m
    expected = [(2, 0, 0), (3, 0, 0), (3 + np.sin(np.pi / 4), 1 - np.cos(np.pi / 4), np.pi / 4), (4, 2, np.pi / 2)]
    np.testing.assert_allclose(SQUARE.poses_at([0.0, 1.0, 1.0 + np.pi / 4, quarter]), expected, atol=1e-12)


def test_a_route_closes_and_repeats():
    np.testing.assert_allclose(SQUARE.poses_at([0.3 + 2.0 * SQUARE.length_m]), SQUARE.poses_at([0.3]), atol=1e-9)
    np.testing.assert_allclose(SQUARE.poses_at([SQUARE.length_m - 1e-9]), SQUARE.poses_at([0.0]), atol=1e-8)


def test_a_route_moves_along_its_heading_and_turns_by_its_curvature():
    route = Route.from_corners([(0, 0, 0.5), (5, -1, 0.8), (6, 4, 0.3), (3, 2, 0.4), (-1, 5, 0.25)])
    ends = np.cumsum(route.sections[:, 4])
    distance = np.linspace(0.0, route.length_m, 3000)
    distance = distance[np.abs(distance[:, None] - ends).min(axis=1) > 1e-3]  # the curvature is discontinuous there
    ahead = se2.between(route.poses_at(distance), route.poses_at(distance + 1e-6)) / 1e-6
    np.testing.assert_allclose(
        ahead, np.column_stack([np.ones_like(distance), np.zeros_like(distance), route.curvature(distance)]), atol=1e-4
    )


def test_corner_radii_too_large_for_the_sides_are_rejected():
    with pytest.raises(ValueError, match="between corners 0 and 1"):
        Route.from_corners([(0, 0, 2), (3, 0, 2), (3, 9, 0.1), (0, 9, 0.1)])


def test_a_drive_accelerates_cruises_and_stops():
    drive = RouteDrive(SQUARE, speed_mps=1.0, laps=10.0 / SQUARE.length_m, acceleration_mps2=0.5)
    assert drive.duration_ns == pytest.approx(12e9, abs=2)
    seconds = np.array([0.0, 1.0, 2.0, 7.0, 10.0, 11.0, 12.0])
    np.testing.assert_allclose(drive.distance((seconds * 1e9).astype(int)), [0, 0.25, 1, 6, 9, 9.75, 10], atol=1e-8)


def test_a_drive_too_short_for_its_speed_brakes_from_the_middle():
    drive = RouteDrive(SQUARE, speed_mps=5.0, laps=2.0 / SQUARE.length_m, acceleration_mps2=0.5)
    assert drive.top_speed_mps == pytest.approx(1.0)
    np.testing.assert_allclose(drive.distance([2_000_000_000, 4_000_000_000]), [1.0, 2.0], atol=1e-8)


def test_a_drive_respects_its_speed_and_yaw_rate_limits():
    drive = RouteDrive(SQUARE, speed_mps=0.3, laps=1.3)
    steps = se2.between(drive.poses(every(drive))[:-1], drive.poses(every(drive))[1:]) / 0.01
    assert np.hypot(steps[:, 0], steps[:, 1]).max() <= 0.3 + 1e-9
    assert np.abs(steps[:, 2]).max() == pytest.approx(0.3)


@pytest.mark.parametrize("wrong", [{"speed_mps": 0.0}, {"laps": -1.0}, {"acceleration_mps2": 0.0}])
def test_a_drive_of_zero_length_is_rejected(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        RouteDrive(**{"route": SQUARE, "speed_mps": 1.0} | wrong)


def test_odometry_without_errors_equals_the_ground_truth():
    drive = RouteDrive(SQUARE, speed_mps=0.5, laps=2.2)
    stamps = every(drive, 33_333_333)  # between the readings
    true = se2.between(drive.poses([0]), drive.poses(stamps))
    np.testing.assert_allclose(odometry(FAULTLESS, drive, stamps), true, atol=1e-9)


def test_a_scale_error_alone_scales_the_path_and_keeps_the_heading():
    drive = RouteDrive(SQUARE, speed_mps=0.5)
    stamps = every(drive)
    true = se2.between(drive.poses([0]), drive.poses(stamps))
    found = odometry(WheelOdometryModel(0.1, 0.0, 0.0, 0.0), drive, stamps)
    share = found[100, 0] / true[100, 0]
    assert share != pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(found, true * [share, share, 1.0], atol=1e-9)


def test_a_gyro_bias_alone_rotates_the_heading_in_proportion_to_time():
    drive = RouteDrive(SQUARE, speed_mps=0.5)
    stamps = every(drive)
    found = odometry(WheelOdometryModel(0.0, 0.0, 0.01, 0.0), drive, stamps)
    error = se2.wrap(found[:, 2] - se2.between(drive.poses([0]), drive.poses(stamps))[:, 2])
    assert abs(error[-1]) > 1e-4
    np.testing.assert_allclose(error, error[-1] * stamps / stamps[-1], atol=1e-9)


def test_slipping_wheels_measure_a_path_that_was_not_driven():
    drive = RouteDrive(SQUARE, speed_mps=0.5, laps=0.06)  # straight ahead
    stamps = every(drive)
    slipping = WheelOdometryModel(0.0, 0.0, 0.0, 0.0, Episodes(every_s=1.0, lasts_s=0.2), slip_mps=0.4)
    too_far = odometry(slipping, drive, stamps)[:, 0] - odometry(FAULTLESS, drive, stamps)[:, 0]
    seconds = stamps * 1e-9
    slips = np.clip(seconds[:, None] - [0.5, 1.5, 2.5, 3.5], 0.0, 0.2).sum(axis=1)
    np.testing.assert_allclose(too_far, 0.4 * slips, atol=1e-9)


def test_errors_of_many_runs_have_the_given_standard_deviations():
    drive = RouteDrive(SQUARE, speed_mps=1.0, laps=0.25)
    end = [drive.duration_ns]
    seconds, runs = end[0] * 1e-9, 400
    true = se2.between(drive.poses([0]), drive.poses(end))[0]

    def spread(errors, column):
        return np.std([odometry(errors, drive, end, seed)[0, column] - true[column] for seed in range(runs)])

    within = 4.0 / np.sqrt(2.0 * runs)  # four standard errors of a standard deviation
    assert spread(WheelOdometryModel(0.0, 0.0, 0.004, 0.0), 2) == pytest.approx(0.004 * seconds, rel=within)
    assert spread(WheelOdometryModel(0.0, 0.0, 0.0, 0.01), 2) == pytest.approx(
        0.01 * np.sqrt(0.01 * seconds), rel=within
    )
    assert spread(WheelOdometryModel(0.01, 0.0, 0.0, 0.0), 0) == pytest.approx(0.01 * true[0], rel=within)


def test_the_same_seed_gives_the_same_odometry_and_another_seed_another():
    drive = RouteDrive(SQUARE, speed_mps=0.5)
    first, again, other = (odometry(WheelOdometryModel(), drive, every(drive), seed) for seed in (3, 3, 4))
    assert first.tobytes() == again.tobytes()
    assert not np.allclose(first, other)
    np.testing.assert_array_equal(first[0], [0.0, 0.0, 0.0])


def test_sampling_at_more_times_does_not_change_the_readings():
    drive = RouteDrive(SQUARE, speed_mps=0.5)
    few, many = every(drive, 100_000_000), every(drive, 7_000_000)
    both = np.union1d(few, many)
    found = odometry(WheelOdometryModel(), drive, both)[np.searchsorted(both, few)]
    np.testing.assert_allclose(found, odometry(WheelOdometryModel(), drive, few), atol=1e-5)


CORNERED = Route.from_corners([(0, 0, 0.5), (6, 0, 0.25), (6, 4, 5.0), (4, 6, 0.25), (0, 6, 0.25)])


def yaw_rates(drive):
    stamps = every(drive)
    poses = drive.poses(stamps)
    return np.abs(se2.between(poses[:-1], poses[1:])[:, 2]) / 0.01


def test_a_tightened_route_keeps_its_corners_and_its_gentle_curves():
    tight = CORNERED.tighten(0.1)
    assert tight.corners[:, 2].tolist() == [0.1, 0.1, 5.0, 0.1, 0.1]
    turns = np.radians([90.0, 90.0, 45.0, 45.0, 90.0])
    shortcuts = 2.0 * np.tan(0.5 * turns) - turns  # the saving of a rounded corner, in radii
    assert tight.length_m - CORNERED.length_m == pytest.approx(shortcuts @ [0.4, 0.15, 0.0, 0.15, 0.15])


@pytest.mark.parametrize("degrees", [20.0, 90.0, 180.0])
def test_a_drive_turns_every_corner_at_the_given_yaw_rate(degrees):
    drive = RouteDrive.turning_at(CORNERED, 0.3, 1.0, np.radians(degrees))
    found = np.degrees(yaw_rates(drive))
    assert found.max() == pytest.approx(degrees, rel=1e-6)
    assert 350.0 < found.sum() * 0.01 < 361.0  # one revolution at any speed
    turning = found > 0.9 * degrees
    assert np.count_nonzero(np.diff(turning.astype(int)) == 1) == 4  # the four turns, not the gentle curve


def test_a_drive_decelerates_steadily():
    drive = RouteDrive(SQUARE, speed_mps=2.0, laps=2.0, max_yaw_rate=0.5)  # radius 1 m: 0.5 m/s on the arcs
    poses = drive.poses(every(drive))
    speed = np.hypot(*se2.between(poses[:-1], poses[1:])[:, :2].T) / 0.01
    assert np.abs(np.diff(speed)).max() < 0.5 * 0.01 * 1.01
    assert speed.max() == pytest.approx(np.sqrt(0.5**2 + 2.0 * 0.5 * 1.0), abs=0.01)  # 1 m after an arc, 1 m to go
    np.testing.assert_allclose(drive.distance([0, drive.duration_ns]), [0.0, drive.path_m], atol=1e-8)


def test_odometry_is_independent_of_the_number_of_readings_integrated_at_once(monkeypatch):
    drive = RouteDrive(SQUARE, 0.5)
    stamps = np.array([0, 3, 10_000_000, 999_999_999, 1_000_000_000, 1_000_000_001, drive.duration_ns])
    errors = WheelOdometryModel(slips=Episodes(2.0, 0.5))
    whole = errors.poses(drive, stamps, np.random.default_rng(1))
    for ticks in (13, 100):
        monkeypatch.setattr(robot, "_TICKS_AT_ONCE", ticks)
        np.testing.assert_array_equal(errors.poses(drive, stamps, np.random.default_rng(1)), whole)
    np.testing.assert_array_equal(errors.poses(drive, stamps[::-1], np.random.default_rng(1)), whole[::-1])
