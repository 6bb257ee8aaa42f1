"""A drive that is simulated and written as a bag is read back unchanged."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.core.errors import BadParameter, StoreError, UnknownName
from evalkit.io.map_server import read_map
from evalkit.io.tum import read_tum
from evalkit.plugins import registry
from evalkit_datasets.commands.datasets import command, example_bag
from evalkit_datasets.readers.rosbag import RosBag

SHORT = {"laps": 0.03, "rate_hz": 5.0}


@pytest.fixture(scope="module")
def make_bag(tmp_path_factory):
    return example_bag.write_example(tmp_path_factory.mktemp("bags") / "new" / "drive", "lab", SHORT)


def test_the_bag_contains_the_simulated_scans_wheels_and_mounting(make_bag):
    simulated = list(example_bag.WORLDS["lab"].make(**SHORT).frames())
    read = list(RosBag(str(make_bag.bag)).frames())
    assert len(read) == len(simulated) == make_bag.scans
    for one, other in zip(read, simulated, strict=True):
        assert one.scan.stamp_ns - other.scan.stamp_ns == 10**9
        assert np.allclose(one.scan.ranges, other.scan.ranges, atol=1e-6, equal_nan=True)
        assert np.allclose(one.scan.angles, other.scan.angles, atol=1e-4)
        assert one.base_from_sensor.row == pytest.approx(other.base_from_sensor.row, abs=1e-9)
        assert one.odom_from_base.row == pytest.approx(other.odom_from_base.row, abs=1e-9)


def test_the_ground_truth_file_has_the_stamps_of_the_bag(make_bag):
    true = example_bag.WORLDS["lab"].make(**SHORT).truth().trajectory
    written = read_tum(make_bag.truth).trajectory
    assert make_bag.truth.name == "drive.tum"
    assert np.array_equal(written.stamps_ns, true.stamps_ns + 10**9)
    assert np.allclose(written.poses, true.poses, atol=1e-9)


def test_the_true_map_lies_in_the_frame_of_the_true_poses(make_bag):
    true = example_bag.WORLDS["lab"].make(**SHORT).truth().grid
    written = read_map(make_bag.map)
    assert make_bag.map.name == "drive.yaml"
    assert (written.resolution_m, written.origin_x, written.origin_y) == (0.05, true.origin_x, true.origin_y)
    assert np.array_equal(written.occupied(), true.occupied())
    assert np.array_equal(written.free(), true.free())


def test_every_synthetic_data_set_can_be_an_example_and_is_named_in_the_help():
    seeded = {name for name in registry.names("datasets") if registry.dataset(name).seeded}
    assert set(example_bag.WORLDS) == seeded
    assert all(example_bag.WORLDS[name] is registry.dataset(name) for name in seeded)
    told = CliRunner().invoke(command.app, ["example", "--help"], env={"COLUMNS": "300"}).output
    assert all(re.search(rf"[ ,]{name}[ ,.]", told) for name in seeded)


def test_existing_files_are_not_replaced(make_bag):
    with pytest.raises(StoreError, match="drive: exists already; delete it"):
        example_bag.write_example(make_bag.bag, "lab", {})
    make_bag.bag.with_name("other.tum").touch()
    with pytest.raises(StoreError, match="exists already; delete it"):
        example_bag.write_example(make_bag.bag.with_name("other"), "lab", {})


def test_an_unknown_world_or_parameter_is_answered_with_the_known_ones(tmp_path):
    with pytest.raises(
        UnknownName,
        match="known: corridor, doors, lab, long-loop, loop, office, random-home, random-office, random-warehouse, "
        "room, symmetric-office, wings",
    ):
        example_bag.write_example(tmp_path / "drive", "moon", {})
    with pytest.raises(BadParameter, match="laps"):
        example_bag.write_example(tmp_path / "drive", "room", {"laps": 0.0})
    assert not list(tmp_path.iterdir())


def test_the_command_prints_the_written_files(tmp_path):
    words = ["example", str(tmp_path / "drive"), "--world", "room", "--set", "laps=0.03", "--set", "rate_hz=5"]
    told = json.loads(CliRunner().invoke(command.app, [*words, "--json"]).output)
    files = {"bag": "drive", "truth": "drive.tum", "map": "drive.yaml"}
    assert {name: told[name] for name in files} == {name: str(tmp_path / file) for name, file in files.items()}
    assert {path.name for path in tmp_path.iterdir()} == {*files.values(), "drive.pgm"}
    assert told["scans"] == pytest.approx(5 * told["duration_s"], abs=1.5)
