"""A true trajectory in another unit, of another clock or of another frame is told before it decides a comparison."""

from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.trajectory import Trajectory
from evalkit.io.tum import format_tum, read_tum
from evalkit_datasets.commands.datasets.example_bag import write_example
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.suggested_config import best_lidar, choose_parameters
from evalkit_datasets.commands.inspect.truth_doubts import find_truth_doubts


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """The bag of a simulated drive with turns to both sides, its inspection, and its true poses."""
    example = write_example(tmp_path_factory.mktemp("drive") / "drive", "lab", {"laps": 0.5})
    return example.bag, inspect_recording(example.bag), read_tum(example.truth).trajectory


def doubt(drive, folder, poses=None, later_s=0.0, every=1):
    """Return what is said of a truth that differs from the true poses."""
    _, recording, true = drive
    stamps = true.stamps_ns + round(later_s * 1e9)
    rows = true.poses if poses is None else poses
    path = Path(folder) / "truth.tum"
    path.write_text(format_tum(Trajectory(stamps[::every], rows[::every]), "made"), encoding="utf-8")
    found = list(find_truth_doubts(recording, best_lidar(recording)[0], str(path)))
    assert all(one.warns and one.value is None for one in found)
    return [one.reason for one in found]


def test_the_true_poses_raise_no_doubt_also_at_a_low_rate_and_in_another_world_frame(drive, tmp_path):
    assert doubt(drive, tmp_path) == []
    assert doubt(drive, tmp_path, every=10) == []
    moved = se2.compose(np.array([[12.0, -7.0, 2.1]]), drive[2].poses)
    assert doubt(drive, tmp_path, moved) == []


@pytest.mark.parametrize(("factor", "unit"), [(1000, "mm"), (100, "cm")])
def test_a_truth_in_another_unit_is_a_problem_that_names_the_factor(drive, tmp_path, factor, unit):
    (said,) = doubt(drive, tmp_path, drive[2].poses * np.array([factor, factor, 1.0]))
    assert said.startswith(f"problem: ground truth truth.tum: its lengths are in {unit}, not in m: ")
    assert said.endswith(f"divide x and y by {factor}")


def test_a_truth_that_covers_few_scans_may_be_of_another_clock(drive, tmp_path):
    (said,) = doubt(drive, tmp_path, later_s=30.0)
    assert "it covers 25 % of the scans, and begins 30.0 s after them" in said
    assert doubt(drive, tmp_path, later_s=15.0) != [said]  # 62 %: its turns tell


@pytest.mark.parametrize(("later_s", "side"), [(0.3, "ahead of"), (-0.3, "behind")])
def test_a_truth_whose_clock_is_apart_by_less_than_a_second_is_found_by_the_turns(drive, tmp_path, later_s, side):
    (said,) = doubt(drive, tmp_path, later_s=later_s)
    assert "its clock is 0.3" in said or "its clock is 0.2" in said
    assert f" s {side} that of the scans" in said


def test_a_truth_whose_y_axis_points_to_the_right_is_a_problem(drive, tmp_path):
    (said,) = doubt(drive, tmp_path, drive[2].poses * np.array([1.0, -1.0, -1.0]))
    assert said.startswith("problem: ")
    assert "its y axis points to the right" in said


def test_the_path_of_a_marker_is_told_from_that_of_the_base(drive, tmp_path):
    (said,) = doubt(drive, tmp_path, se2.compose(drive[2].poses, np.array([[0.25, 0.10, 0.0]])))
    assert "it is the path of a point 0.27 m from that of /odom (x 0.25 m, y 0.10 m)" in said
    assert doubt(drive, tmp_path, se2.compose(drive[2].poses, np.array([[0.02, 0.0, 0.0]]))) == []
    (said,) = doubt(drive, tmp_path, se2.compose(drive[2].poses, np.array([[0.25, 0.10, 1.2]])))
    assert "its heading differs by 69 deg from that of the base" in said


def test_a_truth_without_headings_is_told(drive, tmp_path):
    (said,) = doubt(drive, tmp_path, drive[2].poses * np.array([1.0, 1.0, 0.0]))
    assert "its headings turn by 0 deg, those of /odom by 2" in said


def test_a_comparison_says_it_of_the_truth_that_it_takes(drive, tmp_path):
    bag, _, true = drive
    path = tmp_path / "mine.tum"
    in_mm = Trajectory(true.stamps_ns, true.poses * np.array([1e3, 1e3, 1.0]))
    path.write_text(format_tum(in_mm, ""), encoding="utf-8")
    chosen = choose_parameters("rosbag", {"path": str(bag), "ground_truth": str(path)})
    assert ["mine.tum: its lengths are in mm" in one.reason for one in chosen if one.name == "ground_truth"] == [True]
