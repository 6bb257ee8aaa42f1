"""Results out of bags: trajectories of topics and of transforms, maps; evo reads the same poses from the same files."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.config.forms import SEQUENCE
from evalkit.config.localisation import list_map_files, read_localisation
from evalkit.config.toml_tables import TomlTable
from evalkit.core.errors import BadData, BadExperiment, EvalkitError
from evalkit.core.pose import Pose
from evalkit.external.maps import load_map
from evalkit.plugins import registry
from evalkit.plugins.known_map import load_known_map
from evalkit.plugins.result_files import parse_address, read_trajectory
from evalkit_datasets.parsing.truth_files import TruthPaths, load_truth
from evalkit_datasets.readers import bag_results
from evalkit_datasets.readers.bag_results import read_grid

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

KINDS = ("ros1", "sqlite3", "mcap")
T0 = 1663967375_000000001  # not representable as a float of seconds
STEP = 100_000_000
POSES = [(0.0, 0.0, 0.0), (0.5, 0.1, 0.2), (1.0, 0.3, -3.0)]
STAMPS = [T0 + k * STEP for k in range(3)]


class Bag:
    """A bag with results, written by rosbags."""

    def __init__(self, path, kind):
        self.kind, one = kind, kind == "ros1"
        self.path = path / ("results.bag" if one else "results")
        self.store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if one else typesys.Stores.ROS2_HUMBLE)
        if "tf2_msgs/msg/TFMessage" not in self.store.types:
            text = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(typesys.get_types_from_msg(text, "tf2_msgs/msg/TFMessage"))
        self.messages = []

    def make(self, name, *values):
        return self.store.types[name](*values)

    def header(self, stamp, frame):
        time = self.make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
        return self.make("std_msgs/msg/Header", *([0] if self.kind == "ros1" else []), time, frame)

    def pose(self, x, y, yaw):
        turn = self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        return self.make("geometry_msgs/msg/Pose", self.make("geometry_msgs/msg/Point", x, y, 0.0), turn)

    def transform(self, stamp, parent, child, x, y, yaw):
        pose = self.pose(x, y, yaw)
        moved = self.make("geometry_msgs/msg/Vector3", x, y, 0.0)
        inner = self.make("geometry_msgs/msg/Transform", moved, pose.orientation)
        return self.make("geometry_msgs/msg/TransformStamped", self.header(stamp, parent), child, inner)

    def message(self, kind, stamp, row):
        head, pose = self.header(stamp, "map"), self.pose(*row)
        if kind == "PoseStamped":
            return self.make("geometry_msgs/msg/PoseStamped", head, pose)
        covered = self.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
        if kind == "PoseWithCovarianceStamped":
            return self.make("geometry_msgs/msg/PoseWithCovarianceStamped", head, covered)
        if kind == "TransformStamped":
            return self.transform(stamp, "map", "base_link", *row)
        zero = [self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0) for _ in range(2)]
        twist = self.make("geometry_msgs/msg/Twist", *zero)
        covered_twist = self.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
        return self.make("nav_msgs/msg/Odometry", head, "base_link", covered, covered_twist)

    def add(self, topic, kind, message, stamp):
        self.messages.append((topic, kind, message, stamp))
        return self

    def poses(self, topic, kind):
        package = "nav_msgs" if kind == "Odometry" else "geometry_msgs"
        for stamp, row in zip(STAMPS, POSES, strict=True):
            self.add(topic, f"{package}/msg/{kind}", self.message(kind, stamp, row), stamp)
        return self

    def path_message(self, stamp, rows):
        poses = [self.message("PoseStamped", each, row) for each, row in zip(STAMPS, rows, strict=False)]
        return self.add(
            "/path", "nav_msgs/msg/Path", self.make("nav_msgs/msg/Path", self.header(stamp, "map"), poses), stamp
        )

    def tf(self, topic, stamp, parent, child, *row):
        message = self.make("tf2_msgs/msg/TFMessage", [self.transform(stamp, parent, child, *row)])
        return self.add(topic, "tf2_msgs/msg/TFMessage", message, max(stamp, T0))

    def map(self, cells, columns, origin, size=0.5):
        time = self.make("builtin_interfaces/msg/Time", 0, 0)
        info = self.make("nav_msgs/msg/MapMetaData", time, size, columns, len(cells) // columns, self.pose(*origin))
        grid = self.make("nav_msgs/msg/OccupancyGrid", self.header(T0, "map"), info, np.array(cells, dtype=np.int8))
        return self.add("/map", "nav_msgs/msg/OccupancyGrid", grid, T0)

    def write(self):
        if self.kind == "ros1":
            writer, serialize = rosbag1.Writer(self.path), self.store.serialize_ros1
        else:
            plugin = rosbag2.StoragePlugin[self.kind.upper()]
            writer, serialize = rosbag2.Writer(self.path, version=9, storage_plugin=plugin), self.store.serialize_cdr
        with writer:
            connections = {}
            for topic, kind, message, stamp in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                content = message if isinstance(message, bytes) else serialize(message, kind)
                writer.write(connections[topic], stamp, content)
        return self.path


@pytest.mark.parametrize("bag_kind", KINDS)
@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry"])
def test_poses_of_a_topic_equal_those_written_and_those_that_evo_reads(tmp_path, bag_kind, kind):
    path = Bag(tmp_path, bag_kind).poses("/result", kind).write()
    read = read_trajectory(f"{path}?topic=/result")
    assert read.trajectory.stamps_ns.tolist() == STAMPS
    np.testing.assert_allclose(read.trajectory.poses, POSES, atol=1e-12)
    assert read.notes == {}

    file_interface = pytest.importorskip("evo.tools.file_interface")
    reader = rosbag1.Reader(path) if bag_kind == "ros1" else rosbag2.Reader(path)
    with reader:
        evo = file_interface.read_bag_trajectory(reader, "/result")
    np.testing.assert_allclose(evo.positions_xyz[:, :2], read.trajectory.poses[:, :2], atol=1e-12)
    yaws = [2.0 * math.atan2(w[3], w[0]) for w in evo.orientations_quat_wxyz]
    np.testing.assert_allclose(yaws, read.trajectory.poses[:, 2], atol=1e-12)


@pytest.mark.parametrize("row", [(math.nan, 0.0, 0.0), (1.0, 0.0, math.nan)])
def test_a_pose_that_is_none_is_left_out_and_counted(tmp_path, row):
    bag = Bag(tmp_path, "ros1").poses("/result", "PoseStamped")
    stamp = STAMPS[-1] + STEP
    bag.add("/result", "geometry_msgs/msg/PoseStamped", bag.message("PoseStamped", stamp, row), stamp)
    read = read_trajectory(f"{bag.write()}?topic=/result")
    assert (read.trajectory.stamps_ns.tolist(), read.notes) == (STAMPS, {"invalid poses": 1})


def test_a_message_that_cannot_be_decoded_is_left_out_and_counted_unless_it_is_the_one_that_is_wanted(tmp_path):
    bag = Bag(tmp_path, "mcap").poses("/result", "PoseStamped").path_message(STAMPS[1], POSES)
    stamp = STAMPS[-1] + STEP
    for topic, kind in (("/result", "geometry_msgs/msg/PoseStamped"), ("/path", "nav_msgs/msg/Path")):
        bag.add(topic, kind, b"\0\1\0\0cut", stamp)
    path = bag.write()
    read = read_trajectory(f"{path}?topic=/result")
    assert (read.trajectory.stamps_ns.tolist(), read.notes) == (STAMPS, {"damaged messages dropped": 1})
    said = (
        rf"{path.name}: /path: its last message cannot be decoded: message 2 of /path, recorded at {stamp // 10**9}\."
    )
    with pytest.raises(BadData, match=said):
        read_trajectory(f"{path}?topic=/path")


def test_the_last_path_holds_the_corrected_poses(tmp_path):
    bag = Bag(tmp_path, "ros1").path_message(STAMPS[1], [(9.0, 9.0, 0.0)] * 2).path_message(STAMPS[2], POSES)
    np.testing.assert_allclose(read_trajectory(f"{bag.write()}?topic=path").trajectory.poses, POSES, atol=1e-12)


def test_the_only_topic_needs_no_name_and_several_are_listed(tmp_path):
    one = Bag(tmp_path, "ros1").poses("/slam", "PoseStamped").write()
    assert len(read_trajectory(str(one)).trajectory) == 3
    (tmp_path / "b").mkdir()
    two = Bag(tmp_path / "b", "mcap").poses("/slam", "PoseStamped").poses("/odom", "Odometry").write()
    with pytest.raises(BadData, match=r"2 topics with results; choose one with \?topic=...: /odom \(Odometry\), /slam"):
        read_trajectory(str(two))
    with pytest.raises(BadData, match=r"no topic 'pose' with results; choose one"):
        read_trajectory(f"{two}?topic=pose")
    with pytest.raises(BadData, match="give a bag with OccupancyGrid"):
        read_grid(two, "")


@pytest.mark.parametrize("bag_kind", KINDS)
def test_a_chain_of_frames_is_composed_and_corrections_are_told_from_motion(tmp_path, bag_kind):
    bag = Bag(tmp_path, bag_kind).tf("/tf_static", 0, "base_link", "laser", 0.2, 0.0, math.pi / 2)
    for k in range(5):  # 0.5 m a step along x of odom; map->odom jumps by 1 m at the third
        bag.tf("/tf", T0 + k * STEP, "odom", "base_link", 0.5 * k, 0.0, 0.0)
    for k in (0, 2, 3, 4):
        bag.tf("/tf", T0 + k * STEP, "map", "odom", 0.0, 1.0 if k >= 3 else 0.0, 0.0)
    path = bag.write()
    read = read_trajectory(f"{path}?tf=map,laser")
    assert read.trajectory.stamps_ns.tolist() == [T0 + k * STEP for k in range(5)]
    expected = [[0.5 * k + 0.2, 1.0 if k >= 3 else 0.0, math.pi / 2] for k in range(5)]
    np.testing.assert_allclose(read.trajectory.poses, expected, atol=1e-9)
    assert read.notes == {"corrections above 0.1 m or 5 deg": 1}
    back = read_trajectory(f"{path}?tf=laser,map").trajectory
    both = [(Pose.of(a) @ Pose.of(b)).row for a, b in zip(back.poses, read.trajectory.poses, strict=True)]
    np.testing.assert_allclose(both, np.zeros((5, 3)), atol=1e-9)
    with pytest.raises(BadData, match="no transforms connect them; frames of the bag: base_link, laser, map, odom"):
        read_trajectory(f"{path}?tf=map,camera")


def test_a_slower_transform_is_interpolated_and_nothing_is_extrapolated(tmp_path):
    bag = Bag(tmp_path, "ros1")
    for k in range(5):
        bag.tf("/tf", T0 + k * STEP, "odom", "base_link", 0.0, 0.0, 0.0)
    bag.tf("/tf", T0 + STEP, "map", "odom", 0.0, 0.0, 0.0).tf("/tf", T0 + 3 * STEP, "map", "odom", 0.04, 0.0, 0.02)
    read = read_trajectory(f"{bag.write()}?tf=map,base_link")
    np.testing.assert_allclose(read.trajectory.poses, [[0, 0, 0], [0.02, 0, 0.01], [0.04, 0, 0.02]], atol=1e-9)
    assert read.notes == {"transforms outside the time of the others": 2}


def test_a_map_out_of_a_bag_stands_where_its_rotated_origin_says(tmp_path):
    path = Bag(tmp_path, "mcap").map([100, 0, -1, 50, 0, 100], 3, (2.0, 1.0, math.pi / 2)).write()
    grid, map_from_grid = read_grid(path, "map")
    assert grid.observed.tolist() == [[True, True, False], [True, True, True]]
    assert grid.occupied().tolist() == [[True, False, False], [False, False, True]]
    assert float(grid.log_odds[1, 0]) == 0.0
    assert map_from_grid.row.tolist() == pytest.approx([2.0, 1.0, math.pi / 2])
    placed = load_map(path, "/map", x_m=0.0, y_m=0.0, yaw_deg=0.0)
    # the cell (column 0, row 0) has its centre at (0.25, 0.25) of the grid, which is (2 - 0.25, 1 + 0.25) of the map
    walls = placed.centres(placed.occupied())
    np.testing.assert_allclose(sorted(map(tuple, walls)), [(1.25, 2.25), (1.75, 1.25)], atol=1e-9)


def test_a_map_in_a_bag_is_a_known_map_with_an_absolute_address(tmp_path, monkeypatch):
    path = Bag(tmp_path, "mcap").map([100, 0, -1, 50, 0, 100], 3, (2.0, 1.0, math.pi / 2)).write()
    known = load_known_map({"map": f"{path}?map=/map"}, None)
    np.testing.assert_allclose(sorted(map(tuple, known.walls)), [(1.25, 2.25), (1.75, 1.25)], atol=1e-9)
    monkeypatch.chdir(path.parent)
    read = read_localisation(TomlTable({"map": f"{path.name}?map=/map"}, "x.toml", form=SEQUENCE))
    assert read == {"map": f"{path}?map=/map"}
    assert list_map_files(read) == [str(path)]
    with pytest.raises(BadExperiment, match=r"no map is meant by '.*give a map_server file"):
        read_localisation(TomlTable({"map": f"{path.name}?topic=/map"}, "x.toml", form=SEQUENCE))


def test_a_map_that_does_not_fit_its_size_is_damaged(tmp_path):
    path = Bag(tmp_path, "ros1").map([0, 0, 0, 0], 3, (0.0, 0.0, 0.0)).write()
    with pytest.raises(BadData, match="4 cells for 3 x 1"):
        read_grid(path, "")


def test_a_bag_is_a_method_and_a_ground_truth(tmp_path):
    path = Bag(tmp_path, "sqlite3").poses("/slam", "PoseStamped").map([100], 1, (0.0, 0.0, 0.0)).write()
    spec = registry.backend(f"file:{path}?topic=/slam")
    assert (spec.kind, spec.recorded, spec.missing()) == ("odometry", True, "")
    assert spec.summary.endswith("results?topic=/slam")
    assert registry.backend(f"file:{path}?topic=/other").digest != spec.digest
    assert registry.backend(f"file:{path}?map=/map").kind == "map"
    truth, _ = load_truth(TruthPaths(ground_truth=f"{path}?topic=slam"), np.array(STAMPS), (STAMPS[0], STAMPS[-1]))
    assert truth.how == "files given by the user"
    np.testing.assert_allclose(truth.trajectory.poses, POSES, atol=1e-12)


@pytest.mark.parametrize(
    "text", ["run.bag?topic", "run.bag?pose=/x", "run.bag?topic=", "run.bag?topic=/a&tf=b,c", "run.tum?topic=/a"]
)
def test_a_wrong_address_names_the_right_ones(text):
    with pytest.raises(EvalkitError, match=r"\?topic=/pose|a TUM file without a question mark"):
        read_trajectory(text)


def test_a_file_with_a_question_mark_in_its_name_is_a_file(tmp_path):
    file = tmp_path / "is it?topic=this"
    file.write_text("0 0 0 0 0 0 0 1\n")
    assert parse_address(str(file)).query == {}
    assert len(read_trajectory(str(file)).trajectory) == 1


def map_message(cells, columns, rows, size):
    origin = SimpleNamespace(position=SimpleNamespace(x=0.0, y=0.0, z=0.0),
                             orientation=SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0))  # fmt: skip
    info = SimpleNamespace(height=rows, width=columns, resolution=size, origin=origin)
    return SimpleNamespace(info=info, data=cells)


@pytest.mark.parametrize("size", [0.0, -0.05, float("nan"), float("inf")])
def test_the_cells_of_a_map_have_a_size(size):
    with pytest.raises(BadData, match=r"resolution .*expected metres per cell, more than 0"):
        bag_results._parse_grid(Path("x.bag"), "/map", map_message([0, 100], 2, 1, size))


def test_frames_are_two_and_move_together(tmp_path):
    path = Bag(tmp_path, "ros1").poses("/slam", "PoseStamped").write()
    for words in ("map", "map,", "a,b,c"):
        with pytest.raises(BadData, match="expected two frames, such as tf=map,base_link"):
            bag_results._read_chain(path, None, words)
    edges = [(("map", "odom"), True), (("odom", "base"), True)]
    early, late, none = bag_results._Samples(), bag_results._Samples(), bag_results._Samples()
    for samples, stamp in ((early, 1), (late, 10**10)):
        position, rotation = SimpleNamespace(x=0.0, y=0.0, z=0.0), SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        assert samples.append(stamp, position, rotation)
    for second, static, message in (
        (late, set(), "the transforms of the chain have no time in common"),
        (none, set(), "no moving transform between these frames"),
        (late, {edge for edge, _ in edges}, "no moving transform between these frames"),
    ):
        samples = {edges[0][0]: early, edges[1][0]: second}
        with pytest.raises(BadData, match=message):
            bag_results._compose_chain(path, "map,base", edges, samples, static, 0)
