"""Odometries in millimetres or centimetres are told from those in metres, and the key that mends them is named."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evalkit_datasets.commands.datasets.example_bag import write_example
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.odometry_stats import measure_odometry
from evalkit_datasets.commands.inspect.odometry_unit import compare_lengths, find_length_unit
from evalkit_datasets.commands.inspect.streams import ScanSample
from evalkit_datasets.commands.inspect.suggested_config import choose_parameters
from evalkit_datasets.readers.rosbag import RosBag

sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "readers"))
from test_mounting_angle import ANGLES, drive
from test_rosbag import T0, Bag


def read_as_metres(wheels, factor):
    return replace(wheels, poses=wheels.poses * np.array([factor, factor, 1.0]))


def find_unit(wheels, laser):
    return find_length_unit(wheels, laser, measure_odometry(wheels).driving_m_s)


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "mm"), (100.0, "cm")])
def test_the_scans_tell_the_unit_of_the_odometry(factor, unit):
    """The robot drives at 1 m/s."""
    wheels, laser = drive(0.0)
    found = find_unit(read_as_metres(wheels, factor), laser)
    assert (found.unit, found.driving_m_s) == (unit, pytest.approx(factor, rel=0.2))


def test_an_odometry_in_metres_has_no_other_unit():
    wheels, laser = drive(0.0)
    assert find_unit(wheels, laser) is None
    assert find_unit(wheels, None) is None
    assert find_unit(read_as_metres(wheels, 20.0), laser) is None  # a fast vehicle, or another fault


def test_a_speed_beyond_all_vehicles_is_no_speed_in_metres_whatever_the_scans_show():
    wheels, laser = drive(0.0)
    noise = np.random.default_rng(0).uniform(1.0, 8.0, (len(wheels.stamps_ns), len(ANGLES)))
    for scans in (None, replace(laser, scans=ScanSample(noise))):
        assert find_unit(read_as_metres(wheels, 1000.0), scans).unit == ""


def test_few_jumps_of_an_odometry_are_no_other_unit():
    wheels, _ = drive(0.0)
    wheels.poses[30:, 0] += 500.0
    assert find_unit(wheels, None) is None


def describe_units(findings):
    return [f"{one.level}: {one.about}: {one.what}; {one.advice}" for one in findings if "m/s, median" in one.what]


def test_the_odometry_of_a_bag_in_millimetres_is_a_problem_with_its_key(tmp_path):
    wheels, laser = drive(0.0)
    bag = Bag("mcap").tf(T0, "base_link", "laser", quaternion=(0.0, 0.0, 0.0, 1.0))
    for stamp, (x, y, yaw), row in zip(wheels.stamps_ns, wheels.poses, laser.ranges, strict=True):
        bag.odom(T0 + int(stamp), 1000.0 * x, 1000.0 * y, yaw)
        bag.scan(T0 + int(stamp), row, angle_min=0.0, angle_increment=float(ANGLES[1]))
    path = bag.write(tmp_path)
    recording = inspect_recording(path)
    (said,) = describe_units(recording.findings)
    assert said.startswith("problem: odometry /odom: its lengths are in mm, not in m: the scans move 1000 times less")
    assert said.endswith("; give --set odometry_unit=mm")
    assert not [one for one in recording.findings if "jump" in one.what]
    (taken,) = [one for one in choose_parameters("rosbag", {"path": str(path)}) if one.name == "odometry_unit"]
    assert (taken.value, taken.warns) == ("mm", True)  # a comparison mends it, and the page tells
    what = said.removeprefix("problem").removesuffix("; give --set odometry_unit=mm")
    assert taken.reason == f"warning{what}; mended by --set odometry_unit=mm"
    given = {"path": str(path), "odometry_unit": "mm"}
    assert not [one for one in choose_parameters("rosbag", given) if "median" in one.reason]
    poses = [frame.odom_from_base.row for frame in RosBag(**given, limit=13).frames()]  # the first straight drive
    np.testing.assert_allclose(poses, wheels.poses[:13], atol=1e-6)


def test_the_odometry_of_a_text_log_in_millimetres_is_a_problem_with_its_key(tmp_path):
    wheels, laser = drive(0.0)
    path = tmp_path / "drive.csv"
    path.write_text("".join(
        f"{stamp * 1e-9:.3f},{1000.0 * x:.2f},{1000.0 * y:.2f},{yaw:.6f},{','.join(f'{r:.3f}' for r in row)}\n"
        for stamp, (x, y, yaw), row in zip(wheels.stamps_ns, wheels.poses, laser.ranges, strict=True)
    ))  # fmt: skip
    scan = "[scan]\nfirst = 5\nstep_deg = 0.5\nfirst_angle_deg = 0\n"
    layout = f"[time]\ncolumn = 1\n{scan}[pose]\nx = 2\ny = 3\nheading = 4\n"
    path.with_name("drive.csv.toml").write_text(layout)
    (said,) = describe_units(inspect_recording(path).findings)
    assert "its lengths are in mm, not in m" in said
    assert 'write unit = "mm" in [pose] of the layout' in said
    path.with_name("drive.csv.toml").write_text(layout + 'unit = "mm"\n')
    assert describe_units(inspect_recording(path).findings) == []


@pytest.mark.parametrize(("factor", "differs"), [(1.0, False), (1.2, False), (3.281, True), (0.5, True)])
def test_straight_drives_tell_a_wrong_wheel_diameter_or_lengths_in_feet(factor, differs):
    wheels, laser = drive(30.0, noise_m=0.01)
    found = compare_lengths(read_as_metres(wheels, factor), laser)
    assert found.differs is differs
    assert found.scale == pytest.approx(1.0 / factor, rel=0.1)


def test_directions_that_the_scans_do_not_see_tell_no_length():
    wheels, laser = drive(0.0)
    turned = np.array([1.0, 1.0, 0.0]) * wheels.poses + np.array([0.0, 0.0, 1.0]) * wheels.poses[:, ::-1]
    assert compare_lengths(replace(wheels, poses=np.zeros_like(wheels.poses)), laser) is None
    assert compare_lengths(replace(wheels, poses=turned), laser) is None


@pytest.mark.parametrize("world", ["corridor", "office", "doors", "long-loop", "random-home"])
def test_a_drive_along_a_corridor_does_not_look_like_another_length(world, tmp_path):
    recording = inspect_recording(write_example(tmp_path / "drive", world, {"laps": 0.1}).bag)
    assert not [one for one in recording.findings if "straight drives" in one.what]


def test_an_odometry_in_feet_is_a_problem_of_the_recording(tmp_path):
    wheels, laser = drive(0.0)
    bag = Bag("mcap").tf(T0, "base_link", "laser", quaternion=(0.0, 0.0, 0.0, 1.0))
    for stamp, (x, y, yaw), row in zip(wheels.stamps_ns, wheels.poses, laser.ranges, strict=True):
        bag.odom(T0 + int(stamp), 3.281 * x, 3.281 * y, yaw)
        bag.scan(T0 + int(stamp), row, angle_min=0.0, angle_increment=float(ANGLES[1]))
    (said,) = [one for one in inspect_recording(bag.write(tmp_path)).findings if "straight drives" in one.what]
    assert (said.level, said.about) == ("problem", "odometry /odom")
    assert said.what.startswith("the scans move 0.3")
    assert said.advice == "record it in m, or use odometry = 'none'"
