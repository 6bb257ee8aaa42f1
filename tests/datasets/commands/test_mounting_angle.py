"""The heading of a lidar on its base, measured on drives whose mounting is known."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit_datasets.commands.datasets.example_bag import write_example
from evalkit_datasets.commands.inspect.frame_tree import FrameTree
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.mounting_angle import estimate_motion, estimate_mounting_angle
from evalkit_datasets.commands.inspect.reader_trial import ReaderTrial
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, ScanSample
from evalkit_datasets.commands.inspect.suggested_config import _choose_mounting, best_lidar, choose_parameters
from evalkit_datasets.commands.inspect.turn_comparison import compare_turns

sys.path.insert(0, str(Path(__file__).parents[1] / "readers"))
from test_rosbag import T0, Bag

ANGLES = np.radians(np.arange(0.0, 360.0, 0.5))


def ranges_in_room(x, y, theta, width=6.0, depth=4.0):
    """Exact ranges (B,) from a pose inside a rectangle with its lower left corner at the origin."""
    directions = ANGLES + theta
    with np.errstate(divide="ignore"):
        to_sides = np.where(np.cos(directions) > 0.0, width - x, -x) / np.cos(directions)
        to_ends = np.where(np.sin(directions) > 0.0, depth - y, -y) / np.sin(directions)
    return np.minimum(to_sides, to_ends)


def drive(heading_deg, backwards=False, noise_m=0.0):
    """Straight drives in four directions with a lidar turned by ``heading_deg``; wheels and scans."""
    rng = np.random.default_rng(1)
    poses, rows = [], []
    for direction in np.radians([20.0, 110.0, 200.0, 290.0]):
        for along in np.linspace(0.0, 1.2, 13):
            base = np.array([3.0 + along * math.cos(direction), 2.0 + along * math.sin(direction), direction])
            rows.append(ranges_in_room(base[0], base[1], direction + math.radians(heading_deg)))
            poses.append(base if not backwards else [*base[:2], base[2] + math.pi])
    stamps = np.arange(len(poses)) * 100_000_000
    scans = [row + rng.normal(0.0, noise_m, len(row)) for row in rows]
    laser = LaserStream("/scan", "LaserScan", "laser", stamps, None, ScanSample(scans), ANGLES, 0.1, 12.0)
    return OdometryStream("/odom", "odom", "base", stamps, np.array(poses)), laser


def test_a_translation_is_seen_by_the_scans():
    seen = estimate_motion(ranges_in_room(3.0, 2.0, 0.3), ranges_in_room(3.0, 2.0, 0.3), ANGLES)
    assert seen == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
    moved = se2.between(np.array([[3.0, 2.0, 0.3]]), np.array([[3.1, 2.06, 0.3]]))[0]
    seen = estimate_motion(ranges_in_room(3.0, 2.0, 0.3), ranges_in_room(3.1, 2.06, 0.3), ANGLES)
    assert seen[:2] == pytest.approx(moved[:2], abs=5e-3)


def test_one_direction_of_walls_shows_no_translation_along_them():
    wall = np.where(np.sin(ANGLES) > 0.2, 2.0 / np.maximum(np.sin(ANGLES), 0.2), np.inf)
    assert estimate_motion(wall, wall, ANGLES) is None


@pytest.mark.parametrize("heading_deg", [0.0, 37.0, 90.0, -135.0, 180.0])
def test_the_heading_of_the_lidar_is_measured(heading_deg):
    found = estimate_mounting_angle(*drive(heading_deg, noise_m=0.01))
    assert abs(se2.wrap(math.radians(found.heading_deg - heading_deg))) < math.radians(2.0)
    assert found.pairs >= 12


def test_a_drive_backwards_gives_the_same_heading():
    found = estimate_mounting_angle(*drive(0.0, backwards=True))  # the base looks the other way
    assert abs(found.heading_deg) == pytest.approx(180.0, abs=1.0)


def test_a_robot_that_stands_or_wheels_that_contradict_the_scans_give_no_heading():
    wheels, laser = drive(30.0)
    assert estimate_mounting_angle(replace(wheels, poses=np.zeros_like(wheels.poses)), laser) is None
    far = np.array([3.0, 3.0, 1.0])
    assert estimate_mounting_angle(replace(wheels, poses=wheels.poses * far), laser) is None


def test_the_heading_is_applied_where_nothing_states_it(tmp_path):
    """The lidar of the laboratory is turned by -30 deg."""
    bag = write_example(tmp_path / "drive", "lab", {"laps": 0.15}).bag
    found = inspect_recording(bag)
    lidar = best_lidar(found)[0]
    (stated,) = found.frames.mountings
    recorded = ReaderTrial(mounting=Pose(0.0, 0.0, math.radians(stated.theta_deg)))
    assert list(_choose_mounting(found, lidar, recorded)) == []
    lasers = [replace(laser, angles=-laser.angles) for laser in found.streams.lasers]  # as sent by one upside down
    frames = replace(found.frames, mountings=(replace(stated, mirrored=True),))
    upside_down = replace(found, frames=frames, streams=replace(found.streams, lasers=lasers))
    assert list(_choose_mounting(upside_down, lidar, recorded)) == []
    (choice,) = _choose_mounting(replace(found, frames=FrameTree((), (), (), ())), lidar, ReaderTrial())
    x, y, theta = map(float, str(choice.value).split())
    assert (choice.name, x, y) == ("base_from_sensor", 0.0, 0.0)
    assert math.degrees(theta) == pytest.approx(-30.0, abs=1.5)
    assert "no transform states the mounting" in choice.reason
    assert "; x and y are unknown, taken as 0; give base_from_sensor if you know it: else" in choice.reason
    assert choice.warns  # on the page, too: nothing in the recording shows them
    (warning,) = _choose_mounting(found, lidar, ReaderTrial(mounting=Pose(0.0, 0.0, math.pi / 2.0)))
    assert (warning.value, warning.warns) == (None, True)
    assert "warning: lidar heading 90 deg, as recorded, but the scans show -30 deg" in warning.reason
    assert "; if they are right, give --set 'base_from_sensor=0 0 -0.5" in warning.reason
    absent = str(tmp_path / "nothing.tum")  # the bag is not opened: what it says of the mounting is unknown
    chosen = choose_parameters("rosbag", {"path": str(bag), "ground_truth": absent})
    assert not [one.reason for one in chosen if one.name == "base_from_sensor"]


@pytest.mark.parametrize(("heading_deg", "value"), [(90.0, "0 0 1.5708"), (0.0, "0 0 0.0000")])
def test_a_mounting_on_another_base_than_that_of_the_odometry_is_not_called_recorded(tmp_path, heading_deg, value):
    wheels, laser = drive(heading_deg)
    half = math.radians(heading_deg) / 2.0
    bag = Bag("mcap").tf(T0, "base_link", "laser", 0.2, quaternion=(0.0, 0.0, math.sin(half), math.cos(half)))
    for stamp, (x, y, yaw), row in zip(wheels.stamps_ns, wheels.poses, laser.ranges, strict=True):
        bag.odom(T0 + int(stamp), x, y, yaw, child="base_footprint")
        bag.scan(T0 + int(stamp), row, angle_min=0.0, angle_increment=float(ANGLES[1]))
    found = choose_parameters("rosbag", {"path": str(bag.write(tmp_path))})
    (said,) = [one for one in found if one.name == "base_from_sensor"]
    why = "no transform from 'base_footprint' to 'laser' (it is on 'base_link'); the scans show a heading of"
    assert said.reason.startswith(f"base_from_sensor {value}: {why} {heading_deg:.0f} deg")
    assert (said.value, said.warns) == (value, True)


def test_scans_with_another_number_of_beams_than_the_first_are_left_out():
    wheels, laser = drive(37.0)
    rows = [row if at % 26 < 13 else row[:-1] for at, row in enumerate(laser.ranges)]  # every other straight drive
    found, whole = (
        estimate_mounting_angle(wheels, replace(laser, scans=ScanSample(each))) for each in (rows, laser.ranges)
    )
    assert found.heading_deg == pytest.approx(37.0, abs=2.0)
    assert 12 <= found.pairs < whole.pairs
    wheels, laser = drive_arcs(-1.0)
    assert (
        compare_turns(
            wheels, replace(laser, scans=ScanSample(row[: -1 - at // 6] for at, row in enumerate(laser.ranges)))
        )
        is None
    )


def test_scans_that_do_not_tell_have_no_translation():
    room = ranges_in_room(3.0, 2.0, 0.0)
    assert estimate_motion(room, room[:-1], ANGLES) is None
    assert estimate_motion(room[:5], room[:5], ANGLES[:5]) is None
    assert estimate_motion(np.full_like(room, np.nan), room, ANGLES) is None


def test_a_lidar_that_turns_on_the_robot_has_no_mounting_angle():
    wheels, laser = drive(0.0)
    rng, rows = np.random.default_rng(3), list(laser.ranges)
    turned = [np.roll(row, at) for row, at in zip(rows, rng.integers(0, 720, len(rows)), strict=True)]
    assert estimate_mounting_angle(wheels, laser) is not None
    assert estimate_mounting_angle(wheels, replace(laser, scans=ScanSample(turned))) is None


def drive_arcs(sign, turn_deg=4.0, count=60):
    """Drive a circle of 1 m radius in the room; ``sign`` -1: the lidar lies upside down and nothing says so."""
    turns = np.radians(turn_deg) * np.arange(count)
    poses = np.column_stack([3.0 + np.sin(turns), 2.0 - np.cos(turns), turns])
    rng = np.random.default_rng(2)
    rows = [ranges_in_room(*pose) + rng.normal(0.0, 0.01, len(ANGLES)) for pose in poses]
    stamps = np.arange(count) * 180_000_000
    laser = LaserStream("/scan", "LaserScan", "laser", stamps, None, ScanSample(rows), sign * ANGLES, 0.1, 12.0)
    return OdometryStream("/odom", "odom", "base", stamps, poses), laser


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_mirrored_angles_are_found_on_arcs_too(sign):
    found = compare_turns(*drive_arcs(sign))
    assert (found.driving, found.differs) == (True, sign < 0.0)
    assert found.scale == pytest.approx(sign, abs=0.1)


def test_an_odometry_that_turns_at_random_shows_no_direction():
    wheels, laser = drive_arcs(1.0)
    turns = np.radians(4.0) * np.cumsum(np.random.default_rng(5).choice([-1.0, 1.0], len(wheels.poses)))
    assert compare_turns(replace(wheels, poses=np.column_stack([wheels.poses[:, :2], turns])), laser) is None
    assert compare_turns(*drive(0.0)) is None  # straight drives
