import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.plugins import registry
from evalkit_baselines.slam.observability import Pairs
from evalkit_baselines.slam.sweep_times import SURE_M2, SweepTimes, deskew
from evalkit_datasets.worlds.lidar import LidarModel
from evalkit_datasets.worlds.synthetic import Synthetic

BEAMS, PERIOD_NS = 360, 100_000_000
ANGLES = np.radians(np.arange(-180.0, 180.0))
MOUNT = Pose(0.2, -0.1, 0.5)
STEP = Pose(0.05, 0.0, 0.2)


class Counterclockwise(LidarModel):
    def angles(self):
        return -super().angles()


def frame(number, angles=ANGLES, **changed):
    scan = Scan(number * PERIOD_NS, np.linspace(1.0, 2.0, len(angles)), angles, 0.1, 12.0, **changed)
    return Frame(scan, MOUNT, None, Pose())


def bent_pairs(share):
    """Return pairs on the walls of a room of 6 x 4 m, as a sweep that takes a share of the period has them."""
    angles = ANGLES[::2]
    cos, sin = np.cos(angles), np.sin(angles)
    along_x = np.abs(cos) / 3.0 > np.abs(sin) / 2.0
    seen = np.column_stack([cos, sin]) / np.maximum(np.abs(cos) / 3.0, np.abs(sin) / 2.0)[:, None]
    points = MOUNT.transform(seen)
    outwards = np.column_stack([np.sign(cos) * along_x, np.sign(sin) * ~along_x])
    normals = Pose(0.0, 0.0, MOUNT.theta).transform(outwards)
    times = (np.arange(0, BEAMS, 2) + 0.5) / BEAMS - 0.5
    moved = np.array([STEP.x, STEP.y]) + STEP.theta * np.column_stack([-points[:, 1], points[:, 0]])
    return Pairs(points, normals, points + share * times[:, None] * moved)


def observe(sweeps, share, count):
    """Give scans whose residuals tell this share of the period."""
    for number in range(count):
        given = frame(number)
        sweeps.take(given)
        if sweeps.is_informative(given, STEP):
            sweeps.observe(given.scan.angles, MOUNT, STEP, bent_pairs(share))
    return sweeps


@pytest.mark.parametrize(("share", "order"), [(1.0, 1), (-1.0, -1), (0.35, 1), (-0.35, -1), (0.0, 0)])
def test_a_share_of_the_period_is_found_from_the_residuals(share, order):
    """Twice the share is taken at once: 0.7 of the period is enough."""
    assert observe(SweepTimes(), share, 60).take(frame(60)) == order * PERIOD_NS


def test_a_little_noise_is_forgotten():
    """Each time 0.02 is added, and a tenth forgotten: the sum stays below 0.2."""
    sweeps = observe(SweepTimes(), 0.01, 2000)
    assert SURE_M2 == 1.0
    assert sweeps.take(frame(2000)) == 0


@pytest.mark.parametrize("order", [1, -1])
def test_a_sweep_takes_the_shorter_of_the_last_two_intervals(order):
    sweeps = observe(SweepTimes(), order, 60)
    for number, expected in ((60, 1), (63, 1), (64, 1), (68, 1), (73, 4)):  # periods; 4 and 5 at the end
        assert sweeps.take(frame(number)) == order * expected * PERIOD_NS


def test_times_that_are_told_and_a_part_of_a_circle_stay():
    sweeps = observe(SweepTimes(), 1.0, 60)
    for given in (frame(60, time_increment_ns=1000), frame(61, ANGLES[:300])):
        assert sweeps.take(given) == 0
        assert not sweeps.is_informative(given, STEP)


def test_the_middle_of_a_sweep_stays_and_its_ends_turn_by_half_the_motion():
    """Beams at -90, 0 and 90 deg of a base that turns by 0.2 rad from the first to the last."""
    scan = Scan(0, np.ones(3), np.radians([-90.0, 0.0, 90.0]), 0.1, 12.0)
    found = deskew(Frame(scan, Pose(), None, None), Pose(0.0, 0.0, 0.2)).scan
    np.testing.assert_allclose(found.angles, scan.angles + np.array([-0.1, 0.0, 0.1]), atol=1e-12)
    np.testing.assert_allclose(found.ranges, 1.0)
    assert found.stamp_ns == 0
    assert found.time_increment_ns == 0


def test_scans_between_which_the_robot_hardly_turns_tell_nothing():
    sweeps = observe(SweepTimes(), 0.0, 3)
    assert sweeps.is_informative(frame(3), Pose(0.3, 0.0, 0.036))
    assert not sweeps.is_informative(frame(3), Pose(0.3, 0.0, 0.034))


@pytest.mark.parametrize("method", ["paper-slam", "embedded-slam"])
def test_a_hand_held_lidar_without_times_of_beams_does_not_bend_the_map(method):
    """Range noise of 1 %, turns of 10 deg a scan: 30 to 40 cm if the scans stay bent."""
    ate = runpy.run_path(str(Path(__file__).with_name("false_loops.py")))["ate"]
    office = registry.dataset("office").make(seed=41, speed_mps=0.5)
    lidar = Counterclockwise(5.5, 0.0, 0.01, samples_per_s=1980)
    drive = Synthetic(office.plan, office.drive, lidar, office.odometry, office.base_from_sensor, office.seed)
    rng = np.random.default_rng(41)
    spec = registry.backend(method)
    slam = spec.make(**{each.name: each.default for each in spec.parameters})
    for one in drive.frames():
        ranges = one.scan.ranges * (1.0 + 0.01 * rng.standard_normal(len(one.scan.ranges)))
        ranges[ranges > 12.0] = np.inf
        scan = replace(one.scan, ranges=ranges, time_increment_ns=0)
        slam.update(replace(one, scan=scan, odom_from_base=None, start_from_end=None))
    true = drive.truth().trajectory.poses
    assert ate(slam.trajectory().poses, true) < 0.1
