from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.errors import BadParameter, UnknownName
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets.worlds import synthetic

SPECS = {name: getattr(synthetic, name.upper()) for name in ("room", "lab", "loop", "corridor", "office")}
FAULTLESS = {
    "noise_m": 0.0,
    "dropout": 0.0,
    "odometry_scale": 0.0,
    "velocity_noise_mps": 0.0,
    "gyro_bias_dps": 0.0,
    "gyro_noise_dps": 0.0,
}


@cache
def short(name, **parameters):
    return SPECS[name].make(**{"laps": 0.1} | parameters)


@cache
def full_sequence(name):
    return SPECS[name].make()


@cache
def exact(name):
    return SPECS[name].make(laps=0.3, rate_hz=5.0, **FAULTLESS)


def ranges(sequence):
    return np.stack([frame.scan.ranges for frame in sequence.frames()])


def odometry(sequence):
    return np.array([frame.odom_from_base.row for frame in sequence.frames()])


def in_world(world_from_sensor, scan):
    return se2.transform(world_from_sensor, scan.points())


@pytest.mark.parametrize("name", SPECS)
def test_a_spec_opens_a_sequence_with_its_own_defaults(name):
    spec = SPECS[name]
    assert isinstance(spec, DatasetSpec)
    assert spec.seeded
    assert spec.missing() == ""
    made = spec.make(**resolve_parameters(name, spec.parameters, {}))
    assert len(made) == len(full_sequence(name))
    assert (made.drive.laps, made.lidar, made.odometry) == (
        full_sequence(name).drive.laps,
        full_sequence(name).lidar,
        full_sequence(name).odometry,
    )


@pytest.mark.parametrize(("rate_hz", "beams"), [(5.0, 1600), (10.0, 800), (15.0, 533)])
def test_frames_have_the_rate_and_the_beams_of_the_lidar(rate_hz, beams):
    sequence = short("room", rate_hz=rate_hz)
    scans = [frame.scan for frame in sequence.frames()]
    assert len(scans) == len(sequence)
    assert {len(scan.ranges) for scan in scans} == {beams}
    assert {scan.time_increment_ns for scan in scans} == {125_000}
    period_ns = np.diff([scan.stamp_ns for scan in scans])
    assert np.abs(period_ns - 1e9 / rate_hz).max() <= 1.0
    assert all(later.stamp_ns > earlier.stamp_ns + earlier.duration_ns for earlier, later in pairwise(scans))


@pytest.mark.parametrize("name", SPECS)
def test_a_noise_free_beam_ends_on_a_boundary_as_seen_from_its_firing_pose(name):
    sequence = exact(name)
    for frame in list(sequence.frames())[::25]:
        stamps = frame.scan.stamp_ns + frame.scan.time_increment_ns * np.arange(len(frame.scan.ranges))
        fired_from = se2.compose(sequence.drive.poses(stamps), frame.base_from_sensor.row)
        hits = frame.scan.hits
        ends = se2.transform_each(fired_from[hits], frame.scan.points())
        assert sequence.plan.world.clearance(ends).max() < 1e-9


@pytest.mark.parametrize("name", ["room", "lab"])
def test_a_deskewed_scan_fits_the_walls_and_a_raw_one_does_not(name):
    sequence = exact(name)
    boundaries = np.cumsum(sequence.drive.route.sections[:, 4])
    cleared, raw = [], []
    for frame, pose in list(zip(sequence.frames(), sequence.truth().trajectory.poses, strict=True))[::2]:
        begin, end = sequence.drive.distance([frame.scan.stamp_ns, frame.scan.stamp_ns + frame.scan.duration_ns])
        cruising = end - begin > 0.3 * frame.scan.duration_ns * 1e-9 - 1e-9
        if not cruising or ((boundaries > begin) & (boundaries < end)).any():
            continue  # deskewing assumes constant motion: skip scans in which the curvature or the speed changes
        world_from_sensor = se2.compose(pose, frame.base_from_sensor.row)
        deskewed = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
        cleared.append(sequence.plan.world.clearance(in_world(world_from_sensor, deskewed)).max())
        raw.append(sequence.plan.world.clearance(in_world(world_from_sensor, frame.scan)).max())
    assert len(cleared) > 20
    assert max(cleared) < 1e-6
    assert min(raw) > 0.02  # the robot moves 6 cm during a scan
    assert max(raw) > 0.2  # and turns by up to 13 degrees


def test_error_free_odometry_equals_the_true_motion():
    sequence = exact("lab")
    true = sequence.truth().trajectory.poses
    np.testing.assert_allclose(odometry(sequence), se2.between(true[:1], true), atol=1e-9)
    frame = list(sequence.frames())[20]
    ends = sequence.drive.poses([frame.scan.stamp_ns, frame.scan.stamp_ns + frame.scan.duration_ns])
    np.testing.assert_allclose(frame.start_from_end.row, se2.between(ends[0], ends[1]), atol=1e-9)


def test_odometry_starts_at_the_identity_and_drifts():
    sequence = full_sequence("lab")
    true = sequence.truth().trajectory.poses
    found = odometry(sequence)
    np.testing.assert_array_equal(found[0], [0.0, 0.0, 0.0])
    off = np.linalg.norm(se2.between(se2.between(true[0], true[-1]), found[-1])[:2])
    assert 0.01 < off < 5.0


def test_frames_are_repeatable():
    first, again = list(short("lab").frames()), list(short("lab").frames())
    assert [a.scan.ranges.tobytes() for a in first] == [b.scan.ranges.tobytes() for b in again]


@pytest.mark.parametrize("name", SPECS)
def test_the_same_seed_gives_identical_scans_and_another_seed_different_ones(name):
    first, again, other = (SPECS[name].make(laps=0.05, seed=seed) for seed in (5, 5, 6))
    assert ranges(first).tobytes() == ranges(again).tobytes()
    assert odometry(first).tobytes() == odometry(again).tobytes()
    assert not np.array_equal(ranges(first), ranges(other), equal_nan=True)
    assert not np.array_equal(odometry(first)[1:], odometry(other)[1:])


def test_changing_one_error_keeps_the_others():
    usual, quiet, straight = short("lab"), short("lab", noise_m=0.0), short("lab", gyro_bias_dps=5.0)
    np.testing.assert_array_equal(np.isnan(ranges(usual)), np.isnan(ranges(quiet)))
    assert odometry(usual).tobytes() == odometry(quiet).tobytes()
    assert ranges(usual).tobytes() == ranges(straight).tobytes()


def test_range_errors_have_the_standard_deviation_of_the_paper():
    error = ranges(short("lab", dropout=0.0)) - ranges(short("lab", dropout=0.0, noise_m=0.0))
    assert error.std() == pytest.approx(0.0483, rel=4.0 / np.sqrt(2.0 * error.size))


def test_notes_count_invalid_and_no_return_ranges():
    sequence = short("corridor")
    found = ranges(sequence)
    assert sequence.notes() == {
        "beams without return": int(np.isposinf(found).sum()),
        "invalid ranges": int(np.isnan(found).sum()),
    }
    assert sequence.notes()["beams without return"] > 0
    assert np.isnan(found).mean() == pytest.approx(0.01, abs=4.0 * np.sqrt(0.01 / found.size))


@pytest.mark.parametrize(
    ("name", "path_m"), [("room", 22.7), ("lab", 23.5), ("loop", 43.0), ("corridor", 20.9), ("office", 34.8)]
)
def test_the_true_path_has_the_given_length_and_speed(name, path_m):
    truth = full_sequence(name).truth()
    assert len(truth.trajectory) == len(full_sequence(name))
    steps = np.linalg.norm(np.diff(truth.trajectory.poses[:, :2], axis=0), axis=1)
    assert truth.how.startswith("exact")
    assert truth.trajectory.path_m == pytest.approx(path_m, abs=0.1)
    assert (steps / np.diff(truth.trajectory.stamps_ns) * 1e9).max() <= 0.3 + 1e-6


def test_the_loop_ends_at_a_place_visited_before():
    poses = full_sequence("loop").truth().trajectory.poses
    back = np.linalg.norm(poses[-200:, None, :2] - poses[None, :200, :2], axis=2).min(axis=1)
    assert back[-1] < 0.02
    assert np.linalg.norm(poses[-1, :2] - poses[0, :2]) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("name", ["room", "lab", "corridor", "office"])
def test_ideal_beams_end_on_the_true_map(name):
    sequence = full_sequence(name)
    grid = sequence.truth().grid
    stamps = sequence.lidar.beam_stamps(sequence.stamps_ns[::20])
    fired_from = se2.compose(sequence.drive.poses(stamps.ravel()), sequence.base_from_sensor.row)
    fired_from[:, 2] += np.tile(sequence.lidar.angles(), len(stamps))
    distance = sequence.plan.world.cast(fired_from[:, :2], fired_from[:, 2])
    met = distance <= 12.0
    ends = fired_from[met, :2] + distance[met, None] * np.column_stack(
        [np.cos(fired_from[met, 2]), np.sin(fired_from[met, 2])]
    )
    columns, rows = np.floor((ends - [grid.origin_x, grid.origin_y]) / grid.resolution_m).astype(int).T
    assert grid.occupied()[rows, columns].mean() > 0.999


def test_only_the_corridor_is_degenerate():
    assert [name for name, spec in SPECS.items() if spec.degenerate] == ["corridor"]


def test_lidars_are_mounted_off_centre_and_some_are_rotated():
    mounts = [SPECS[name].make(laps=0.1).base_from_sensor for name in SPECS]
    assert all((mount.x, mount.y) != (0.0, 0.0) for mount in mounts)
    assert any(mount.theta != 0.0 for mount in mounts)


def test_lost_scans_are_missing_and_the_others_unchanged():
    usual, thinned = short("lab"), short("lab", drop_every_s=3.0, drop_s=0.35)
    kept = np.isin(usual.stamps_ns, thinned.stamps_ns)
    missing = usual.stamps_ns[~kept] * 1e-9
    np.testing.assert_allclose(missing, [1.5, 1.6, 1.7, 1.8, 4.5, 4.6, 4.7, 4.8, 7.5, 7.6, 7.7, 7.8], atol=1e-6)
    assert ranges(thinned).tobytes() == ranges(usual)[kept].tobytes()
    assert odometry(thinned).tobytes() == odometry(usual)[kept].tobytes()
    assert len(thinned.truth().trajectory) == len(thinned) == len(usual) - 12
    assert thinned.notes()["scans lost"] == 12


def test_pedestrians_hide_walls_and_change_nothing_else():
    empty, busy = short("room", noise_m=0.0), short("room", noise_m=0.0, people=2)
    before, after = ranges(empty), ranges(busy)
    hidden = ~np.isclose(before, after, equal_nan=True)
    assert (after[hidden] < before[hidden]).all()
    assert 0.005 < hidden.mean() < 0.3
    assert odometry(busy).tobytes() == odometry(empty).tobytes()
    np.testing.assert_array_equal(busy.truth().grid.log_odds, empty.truth().grid.log_odds)


def test_slips_affect_only_the_odometry():
    usual, slipping = short("lab"), short("lab", slip_every_s=4.0, slip_mps=1.0)
    assert ranges(usual).tobytes() == ranges(slipping).tobytes()
    steps = [np.hypot(*np.diff(odometry(each), axis=0)[:, :2].T) for each in (usual, slipping)]
    longer = np.flatnonzero(steps[1] - steps[0] > 0.05)
    assert longer.tolist() == [20, 21, 22, 23, 24, 60, 61, 62, 63, 64]


TODAY = [  # scans, invalid ranges, sum of the others (m), the last odometry pose
    ("room", 81, 703, 303837.664910, [2.250688867, -0.02610002, -0.022688902]),
    ("lab", 84, 724, 236079.611691, [2.323129756, -0.161805775, -0.165427769]),
    ("loop", 142, 1185, 246712.175834, [4.047829788, -0.328444252, -0.151043841]),
    ("corridor", 75, 645, 117342.014641, [2.072015723, -0.022276646, -0.021198021]),
    ("office", 121, 988, 285751.081182, [1.935847522, 1.884125706, 1.537825194]),
]


@pytest.mark.parametrize(("name", "scans", "invalid", "metres", "last"), TODAY)
def test_published_sequences_do_not_change(name, scans, invalid, metres, last):
    sequence = short(name, seed=3)
    found = ranges(sequence)
    assert (len(sequence), np.isnan(found).sum()) == (scans, invalid)
    assert found[np.isfinite(found)].sum() == pytest.approx(metres, abs=1e-5)
    np.testing.assert_allclose(odometry(sequence)[-1], last, atol=1e-8)


@pytest.mark.parametrize(("speed_mps", "turn_dps"), [(0.2, 90.0), (1.0, 30.0)])
def test_turns_have_the_given_yaw_rate_at_any_speed(speed_mps, turn_dps):
    drive = SPECS["lab"].make(speed_mps=speed_mps, turn_dps=turn_dps).drive
    poses = drive.poses(np.arange(0, drive.duration_ns, 10_000_000))
    steps = se2.between(poses[:-1], poses[1:]) / 0.01
    assert np.degrees(np.abs(steps[:, 2]).max()) == pytest.approx(turn_dps, rel=1e-6)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() == pytest.approx(speed_mps, rel=1e-6)


def test_unknown_and_invalid_parameters_are_rejected():
    with pytest.raises(UnknownName, match="speed_mps"):
        SPECS["lab"].make(speed=1.0)
    with pytest.raises(BadParameter, match="rate_hz"):
        SPECS["lab"].make(rate_hz=20.0)


def test_a_drive_too_long_to_be_cached_gives_the_same_scans_and_counts(monkeypatch):
    settings = {"laps": 0.05, "drop_every_s": 3.0, "seed": 4}
    kept = SPECS["lab"].make(**settings)
    known = ranges(kept), odometry(kept), kept.notes()
    assert next(kept.frames()) is next(kept.frames())
    monkeypatch.setattr(synthetic, "_MAX_KEPT_BYTES", 0)
    simulated = SPECS["lab"].make(**settings)
    assert simulated.notes() == known[2]
    for _ in range(2):
        np.testing.assert_array_equal(ranges(simulated), known[0])
        np.testing.assert_array_equal(odometry(simulated), known[1])
    assert next(simulated.frames()) is not next(simulated.frames())


def test_a_sequence_of_a_day_at_10_hz_starts_at_once():
    day = SPECS["lab"].make(laps=1110.0, rate_hz=10.0)
    assert len(day) > 864_000
    assert day.stamps_ns[-1] > 24 * 3600 * 10**9
    poses = day.truth().trajectory.poses
    assert len(poses) == len(day)
    np.testing.assert_array_equal(day.truth().grid.occupied(), SPECS["lab"].make(laps=2.0).truth().grid.occupied())
