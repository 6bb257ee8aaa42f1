"""The faults of simulated drives change what they say and nothing else; the true pose of a scan fits the map."""

import math

import numpy as np
import pytest

from evalkit.commands.map_fit.drives import FAULTS, MEASURED, measure_drive, read_drive
from evalkit.core import se2
from evalkit.core.errors import BadData
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.odometry import frontend
from evalkit.plugins import registry

WORLD = {"laps": 0.06, "rate_hz": 5.0, "seed": 0}


@pytest.fixture(scope="module")
def drive():
    return read_drive(registry.dataset("room").open(WORLD), "room")


def changed(drive, fault, seed=0):
    return FAULTS[fault](drive, np.random.default_rng(seed))


def ranges(drive):
    return np.array([frame.scan.ranges for frame in drive.frames()])


def walls(drive):
    return drive.grid.centres(drive.grid.occupied())


def test_without_a_fault_the_drive_starts_at_its_first_true_pose(drive):
    assert changed(drive, "none") is drive
    assert drive.start.row == pytest.approx(drive.poses[0])
    assert len(drive.truth().grid.log_odds) == len(drive.grid.log_odds)


def test_a_wrong_start_is_40_cm_to_150_cm_and_up_to_30_deg_off(drive):
    off = [drive.start.inverse() @ changed(drive, "wrong start", seed).start for seed in range(200)]
    away = [math.hypot(one.x, one.y) for one in off]
    assert 0.4 <= min(away) < 0.45 < 1.45 < max(away) <= 1.5
    assert 29.0 < math.degrees(max(abs(one.theta) for one in off)) <= 30.0


def test_a_kidnapped_robot_misses_a_third_of_the_scans_and_its_wheels_do_not_notice(drive):
    moved = changed(drive, "kidnapped")
    assert len(moved) == len(moved.poses) == len(drive) - len(drive) // 3
    odometry = np.array([frame.odom_from_base.row for frame in moved.frames()])
    steps = se2.between(odometry[:-1], odometry[1:])
    true = se2.between(moved.poses[:-1], moved.poses[1:])
    gone = int(np.argmax(np.hypot(*true[:, :2].T)))
    assert np.hypot(*true[gone, :2]) > 0.3
    assert steps[gone] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    before = np.array([frame.odom_from_base.row for frame in drive.frames()])
    assert np.delete(steps, gone, axis=0) == pytest.approx(
        np.delete(se2.between(before[:-1], before[1:]), range(gone, gone + len(drive) // 3 + 1), axis=0), abs=1e-9
    )


def test_moved_furniture_takes_walls_away_and_puts_them_elsewhere(drive):
    moved = changed(drive, "moved furniture")
    before, after = (set(map(tuple, np.round(walls(one), 3).tolist())) for one in (drive, moved))
    assert 0.08 < len(before - after) / len(before) < 0.6
    distance, _ = build_kd_tree(walls(drive)).query(np.array(sorted(after - before)))
    assert distance.max() <= 1.0 + 0.05
    assert np.array_equal(ranges(moved), ranges(drive), equal_nan=True)


def test_glass_returns_nothing_and_other_beams_stay(drive):
    seen, before = ranges(changed(drive, "glass")), ranges(drive)
    lost = np.isposinf(seen) & np.isfinite(before)
    assert 0.05 < lost.mean() < 0.6
    assert np.array_equal(seen[~lost], before[~lost], equal_nan=True)


def test_dirt_hides_one_sector_behind_short_ranges(drive):
    seen, before = ranges(changed(drive, "dirty lidar")), ranges(drive)
    dirty = (seen != before) & ~(np.isnan(seen) & np.isnan(before))
    sectors = dirty.any(axis=0)
    assert 30.0 / 360.0 - 0.01 < sectors.mean() < 150.0 / 360.0 + 0.01
    assert (np.diff(np.concatenate([sectors, sectors[:1]]).astype(int)) == 1).sum() == 1
    assert 0.2 <= seen[dirty].min() <= seen[dirty].max() <= 0.6


def test_wheel_odometry_fits_until_it_drifts_and_a_refused_start_has_no_scans():
    spec = registry.backend("wheel-odometry")
    values = {each.name: each.default for each in frontend.settable_parameters(spec)}
    exact = {"odometry_scale": 0.0, "velocity_noise_mps": 0.0, "gyro_bias_dps": 0.0, "gyro_noise_dps": 0.0}
    found = measure_drive("room", {**WORLD, **exact}, "wheel-odometry", values, "none", 0)
    assert 1 < len(found["fit_m"]) == len(found["points"]) == len(found["error_m"]) <= MEASURED
    assert found["error_m"].max() < 0.05  # the given start is corrected on cells of 2 cm
    assert found["fit_m"].max() < 0.05
    assert found["cell_m"] == 0.05
    refused = [measure_drive("room", WORLD, "wheel-odometry", values, "wrong start", seed) for seed in range(4)]
    assert 0 in [len(one["fit_m"]) for one in refused]


def test_a_recording_without_a_true_map_is_refused():
    class Recording:
        def frames(self):
            return iter(())

        def truth(self):
            from evalkit.core.ground_truth import Truth

            return Truth("none")

    with pytest.raises(BadData, match="name a simulated world"):
        read_drive(Recording(), "mine")
