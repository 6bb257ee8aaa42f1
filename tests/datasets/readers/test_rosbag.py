"""ROS bags as sequences, compared with bags written by the tests."""

import math
import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import BadData, BadParameter, DataMissing
from evalkit.core.pose import Pose
from evalkit_datasets.readers.rosbag import SPEC, RosBag

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

DATA = Path(os.environ.get("EVALKIT_DATA") or "absent")
KINDS = ("ros1", "sqlite3", "mcap")
T0 = 1663967375_000000001  # not representable as a float of seconds


class Bag:
    """Messages of one ROS version, written in the order they were added."""

    def __init__(self, kind):
        self.kind = kind
        one = kind == "ros1"
        self.store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC if one else typesys.Stores.ROS2_HUMBLE)
        self.messages = []

    def make(self, name, *values, **named):
        return self.store.types[name](*values, **named)

    def header(self, stamp, frame):
        time = self.make("builtin_interfaces/msg/Time", stamp // 10**9, stamp % 10**9)
        named = {"seq": 0} if self.kind == "ros1" else {}
        return self.make("std_msgs/msg/Header", **named, stamp=time, frame_id=frame)

    def add(self, topic, kind, message, recorded):
        self.messages.append((topic, kind, message, recorded))
        return self

    def scan(self, stamp, ranges, topic="/scan", frame="laser", recorded=None, **changes):
        values = {
            "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5, "time_increment": 0.01, "scan_time": 0.1,
            "range_min": 0.125, "range_max": 12.0, **changes,
        }  # fmt: skip
        array = np.array(ranges, dtype=np.float32)
        none = np.array([], dtype=np.float32)
        message = self.make(
            "sensor_msgs/msg/LaserScan", header=self.header(stamp, frame), ranges=array, intensities=none, **values
        )
        return self.add(topic, "sensor_msgs/msg/LaserScan", message, recorded or stamp)

    def echoes(self, stamp, *beams):
        many = [self.make("sensor_msgs/msg/LaserEcho", np.array(beam, dtype=np.float32)) for beam in beams]
        kind = "sensor_msgs/msg/MultiEchoLaserScan"
        values = (-1.0, 1.0, 0.5, 0.0, 0.1, 0.125, 12.0)
        return self.add("/echoes", kind, self.make(kind, self.header(stamp, "laser"), *values, many, []), stamp)

    def pose(self, x, y, yaw):
        return (
            self.make("geometry_msgs/msg/Point", x, y, 0.0),
            self.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)),
        )

    def odom(self, stamp, x, y=0.0, yaw=0.0, topic="/odom", child="base_link", recorded=None):
        nothing = np.zeros(36)
        pose = self.make("geometry_msgs/msg/Pose", *self.pose(x, y, yaw))
        twist = self.make(
            "geometry_msgs/msg/Twist",
            self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0),
            self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0),
        )  # fmt: skip
        message = self.make(
            "nav_msgs/msg/Odometry", self.header(stamp, "odom"), child,
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, nothing),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, nothing),
        )  # fmt: skip
        return self.add(topic, "nav_msgs/msg/Odometry", message, recorded or stamp)

    def tf(self, stamp, parent, child, x=0.0, y=0.0, quaternion=(0.0, 0.0, 0.0, 1.0), static=True, space=""):
        transform = self.make(
            "geometry_msgs/msg/TransformStamped", self.header(stamp, parent), child,
            self.make(
                "geometry_msgs/msg/Transform", self.make("geometry_msgs/msg/Vector3", x, y, 0.1),
                self.make("geometry_msgs/msg/Quaternion", *quaternion),
            ),
        )  # fmt: skip
        if "tf2_msgs/msg/TFMessage" not in self.store.types:
            definition = typesys.get_types_from_msg(
                "geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"
            )
            self.store.register(definition)
        message = self.make("tf2_msgs/msg/TFMessage", [transform])
        topic = f"{space}/tf{'_static' if static else ''}"
        return self.add(topic, "tf2_msgs/msg/TFMessage", message, max(stamp, T0))

    def write(self, folder, packed=""):
        """Write the bag, messages of bytes as they are; returns its path.

        ``packed``: bz2 or lz4 for ROS 1, file, message or storage for ROS 2.
        """
        if self.kind == "ros1":
            path, serialize = folder / "made.bag", self.store.serialize_ros1
            writer = rosbag1.Writer(path)
        else:
            path, serialize = folder / "made", self.store.serialize_cdr
            writer = rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[self.kind.upper()])
        if packed and self.kind == "ros1":
            writer.set_compression(writer.CompressionFormat[packed.upper()])
        elif packed:
            writer.set_compression(rosbag2.CompressionMode[packed.upper()], rosbag2.CompressionFormat.ZSTD)
        with writer:
            connections = {}
            for topic, kind, message, recorded in self.messages:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
                content = message if isinstance(message, bytes) else serialize(message, kind)
                writer.write(connections[topic], recorded, content)
        return path


def frames_of(bag, folder, **parameters):
    return list(RosBag(str(bag.write(folder)), **parameters).frames())


# --- exact round trip


@pytest.mark.parametrize("kind", KINDS)
def test_a_scan_is_read_back_exactly(tmp_path, kind):
    sequence = RosBag(
        str(Bag(kind).scan(T0, [1.5, 2.25, math.inf, 11.5, 3.0], recorded=T0 + 240_000_000).write(tmp_path))
    )
    frame = next(sequence.frames())
    assert frame.scan.stamp_ns == T0
    assert frame.scan.ranges.tolist() == [1.5, 2.25, math.inf, 11.5, 3.0]
    assert frame.scan.angles.tolist() == [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert (frame.scan.range_min_m, frame.scan.range_max_m) == (0.125, 12.0)
    assert frame.scan.time_increment_ns == 10_000_000
    assert (frame.odom_from_base, frame.start_from_end, frame.base_from_sensor) == (None, None, Pose())
    assert len(sequence) == 1


@pytest.mark.parametrize("kind", KINDS)
def test_odometry_is_interpolated_at_the_first_and_the_last_beam(tmp_path, kind):
    bag = Bag(kind).odom(T0, 0.0).odom(T0 + 100_000_000, 0.1, 0.2, 0.2).scan(T0 + 50_000_000, [1.0] * 5)
    frame = frames_of(bag, tmp_path)[0]
    np.testing.assert_allclose(frame.odom_from_base.row, [0.05, 0.1, 0.1], atol=1e-12)
    end = Pose(0.09, 0.18, 0.18)  # 4 increments of 10 ms later
    np.testing.assert_allclose((frame.odom_from_base @ frame.start_from_end).row, end.row, atol=1e-12)


def test_odometry_goes_on_where_it_was_after_it_began_again_at_the_origin(tmp_path):
    ahead = [(3.0, 0.0, 0.0), (3.0, 0.0, 0.5 * math.pi), (0.0, 0.0, 0.0), (0.2, 0.0, 0.0), (0.9, 0.0, 0.0)]
    bag = Bag("mcap")
    for at, (x, y, yaw) in enumerate(ahead):
        bag.odom(T0 + at * 10**9 // 10 * 3, x, y, yaw).scan(T0 + at * 10**9 // 10 * 3, [1.0, 2.0])
    read = RosBag(str(bag.write(tmp_path)))
    found = np.array([frame.odom_from_base.row for frame in read.frames()])
    up = 0.5 * math.pi  # it had turned to the left, and 0.9 m in 0.6 s is no jump
    expected = [[3.0, 0.0, 0.0], [3.0, 0.0, up], [3.0, 0.0, up], [3.0, 0.2, up], [3.0, 0.9, up]]
    np.testing.assert_allclose(found, expected, atol=1e-12)
    (name,) = [each for each in read.notes() if each.startswith("jumps of the odometry")]
    assert read.notes()[name] == 1


def test_a_given_time_of_a_sweep_replaces_that_of_the_scans(tmp_path):
    bag = Bag("mcap").odom(T0, 0.0).odom(T0 + 10**9, 1.0)
    path = str(bag.scan(T0, [1.0] * 5, time_increment=0.0).scan(T0 + 5 * 10**8, [1.0] * 5).write(tmp_path))
    assert [frame.scan.time_increment_ns for frame in RosBag(path).frames()] == [0, 10_000_000]  # as recorded
    silent, stated = RosBag(path, sweep_s=0.2).frames()
    assert silent.scan.time_increment_ns == stated.scan.time_increment_ns == 50_000_000
    assert silent.start_from_end.row == pytest.approx([0.2, 0.0, 0.0])


def test_stamps_of_another_clock_are_shifted(tmp_path):
    bag = Bag("mcap").odom(T0, 0.0).odom(T0 + 10**9, 1.0).scan(T0 + 3_600 * 10**9, [1.0] * 5)
    (frame,) = frames_of(bag, tmp_path, stamp_shift_s=-3599.5)
    assert frame.scan.stamp_ns == T0 + 500_000_000
    assert frame.odom_from_base.x == pytest.approx(0.5)


def test_motion_within_a_scan_is_not_extrapolated_beyond_the_odometry(tmp_path):
    bag = Bag("sqlite3").odom(T0, 0.0).odom(T0 + 20_000_000, 1.0).scan(T0 + 10_000_000, [1.0] * 5)
    frame = frames_of(bag, tmp_path)[0]
    assert frame.odom_from_base == Pose(0.5)
    assert frame.start_from_end is None


# --- ranges, angles, echoes


def test_ranges_follow_rep_117_and_the_limits_of_the_message(tmp_path):
    bag = Bag("ros1").scan(T0, [0.0, -1.0, math.nan, -math.inf, 0.1, 0.125, math.inf, 12.0, 12.5, 11.0])
    sequence = RosBag(str(bag.write(tmp_path)))
    ranges = next(sequence.frames()).scan.ranges
    assert np.isnan(ranges[:5]).all()
    assert ranges[5:].tolist() == [0.125, math.inf, math.inf, math.inf, 11.0]
    assert sequence.notes()["invalid ranges (nan, zero, negative or below the minimum)"] == 5


def test_ranges_below_a_given_minimum_are_invalid_unless_the_message_states_a_larger_one(tmp_path):
    bag = Bag("mcap").scan(T0, [0.1, 0.125, 0.25, 0.5, math.inf]).scan(T0 + 10**9, [0.5, 1.0, 2.0], range_min=0.75)
    path, name = str(bag.write(tmp_path)), "invalid ranges (nan, zero, negative or below the minimum)"
    assert RosBag(path).notes()[name] == 2
    sequence = RosBag(path, range_min_m=0.3)
    first, second = (frame.scan for frame in sequence.frames())
    np.testing.assert_equal(first.ranges, [math.nan, math.nan, math.nan, 0.5, math.inf])
    np.testing.assert_equal(second.ranges, [math.nan, 1.0, 2.0])
    assert [scan.range_min_m for scan in (first, second)] == [0.3, 0.75]
    assert sequence.notes()[name] == 4
    with pytest.raises(BadParameter, match=r"rosbag: parameter 'range_min_m': found '12', expected less than .* 12 m"):
        RosBag(path, range_min_m=12.0)


def test_a_scan_that_turns_clockwise_keeps_its_firing_order(tmp_path):
    frame = frames_of(Bag("ros1").scan(T0, [1, 2, 3], angle_min=1.0, angle_increment=-0.5), tmp_path)[0]
    assert frame.scan.angles.tolist() == [1.0, 0.5, 0.0]
    assert frame.scan.ranges.tolist() == [1, 2, 3]


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_of_several_echoes_is_used_and_no_echo_is_no_return(tmp_path, kind):
    ranges = frames_of(Bag(kind).echoes(T0, [2.5], [1.5, 4.0], []), tmp_path)[0].scan.ranges
    assert ranges.tolist() == [2.5, 1.5, math.inf]


def test_messages_with_implausible_geometry_are_dropped_and_counted(tmp_path):
    bag = Bag("sqlite3").scan(T0, [1, 2]).scan(T0 + 1, [1, 2], angle_increment=0.0).scan(T0 + 2, [1, 2], range_max=0.1)
    bag.scan(T0 + 3, []).scan(T0 + 4, [1, 2], time_increment=1e30)
    sequence = RosBag(str(bag.write(tmp_path)))
    assert len(sequence) == 1
    assert sequence.notes()["damaged messages dropped"] == 4


@pytest.mark.parametrize("stated", [0.0, math.inf])
def test_a_maximum_that_is_not_stated_is_100_m(tmp_path, stated):
    bag = Bag("mcap").scan(T0, [1.0, 45.0, 120.0, math.inf], range_max=stated)
    scan = frames_of(bag, tmp_path)[0].scan
    assert scan.range_max_m == 100.0
    assert scan.ranges.tolist() == [1.0, 45.0, math.inf, math.inf]


# --- time


def test_scans_are_sorted_by_header_time_and_repeated_ones_dropped(tmp_path):
    bag = Bag("sqlite3")
    for recorded, stamp in enumerate([3, 1, 2, 3, 4]):
        bag.scan(T0 + stamp, [float(stamp), recorded + 1], recorded=T0 + 10 + recorded)
    sequence = RosBag(str(bag.write(tmp_path)))
    assert [frame.scan.ranges.tolist() for frame in sequence.frames()] == [[1, 2], [2, 3], [3, 1], [4, 5]]
    assert sequence.notes() == {"scans out of order": 1, "scans with a repeated stamp dropped": 1}


def test_a_header_without_a_time_gets_the_recording_time(tmp_path):
    sequence = RosBag(str(Bag("ros1").scan(0, [1, 2], recorded=T0).write(tmp_path)))
    assert next(sequence.frames()).scan.stamp_ns == T0
    assert sequence.notes() == {"scans without a stamp, given the time of recording": 1}


def test_start_every_and_limit_choose_scans(tmp_path):
    bag = Bag("mcap")
    for index in range(8):
        bag.scan(T0 + index, [1.0 + index, 1.0])
    chosen = frames_of(bag, tmp_path, start=1, every=2, limit=3)
    assert [frame.scan.ranges[0] for frame in chosen] == [2.0, 4.0, 6.0]


# --- frames


def test_the_mounting_is_found_in_the_transform_tree(tmp_path):
    bag = (
        Bag("sqlite3")
        .tf(T0, "base_link", "plate", 0.25)
        .tf(T0, "plate", "laser", 0.0, 0.5, (0, 0, math.sqrt(0.5), math.sqrt(0.5)))
    )
    found = frames_of(bag.scan(T0, [1, 2]), tmp_path)[0].base_from_sensor
    np.testing.assert_allclose(found.row, [0.25, 0.5, math.pi / 2], atol=1e-12)


def test_frame_names_with_and_without_a_slash_are_equal(tmp_path):
    bag = Bag("ros1").tf(T0, "/base_link", "/laser", 0.25).scan(T0, [1, 2], frame="laser")
    assert frames_of(bag, tmp_path)[0].base_from_sensor == Pose(0.25)


def test_a_lidar_upside_down_gets_mirrored_angles(tmp_path):
    bag = Bag("sqlite3").tf(T0, "base_link", "laser", 0.25, 0.0, (1.0, 0.0, 0.0, 0.0)).scan(T0, [1, 2])
    frame = frames_of(bag, tmp_path)[0]
    assert frame.scan.angles.tolist() == [1.0, 0.5]
    assert frame.base_from_sensor == Pose(0.25)


def test_a_lidar_on_its_side_is_rejected(tmp_path):
    bag = Bag("sqlite3").tf(T0, "base_link", "laser", 0.0, 0.0, (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)))
    with pytest.raises(BadData, match="tilted by 90 deg"):
        frames_of(bag.scan(T0, [1, 2]), tmp_path)


def test_without_transforms_the_lidar_is_the_base_and_a_parameter_overrides(tmp_path):
    path = str(Bag("ros1").odom(T0, 1.0).scan(T0, [1, 2]).write(tmp_path))
    sequence = RosBag(path)
    assert next(sequence.frames()).base_from_sensor == Pose()
    assert sequence.notes() == {"no transform from the base to the lidar, identity used": 1}
    assert next(RosBag(path, base_from_sensor="0.1 0 1").frames()).base_from_sensor == Pose(0.1, 0.0, 1.0)


def test_tf_serves_as_odometry_with_preference_for_base_link(tmp_path):
    bag = Bag("sqlite3")
    for stamp, x in [(T0, 1.0), (T0 + 10, 2.0)]:
        bag.tf(stamp, "odom", "base_footprint", x + 100, static=False).tf(stamp, "odom", "base_link", x, static=False)
    path = str(bag.scan(T0 + 5, [1, 2], time_increment=0.0, frame="base_link").write(tmp_path))
    assert next(RosBag(path).frames()).odom_from_base == Pose(1.5)
    assert next(RosBag(path, base_frame="base_footprint").frames()).odom_from_base == Pose(101.5)
    assert next(RosBag(path, odometry="none").frames()).odom_from_base is None


def test_tf_fills_gaps_of_the_odometry_topic(tmp_path):
    bag = Bag("sqlite3").odom(T0 + 10**9, 1.0).odom(T0 + 2 * 10**9, 2.0).tf(T0, "odom", "base_link", 0.0, static=False)
    path = str(bag.scan(T0 + 5 * 10**8, [1, 2], frame="base_link").write(tmp_path))
    assert next(RosBag(path).frames()).odom_from_base == Pose(0.5)
    assert next(RosBag(path, odometry="/odom").frames()).odom_from_base is None


def test_another_base_frame_transforms_the_odometry(tmp_path):
    bag = (
        Bag("sqlite3")
        .odom(T0, 1.0, 0.0, math.pi / 2)
        .tf(T0, "base_link", "tail", -0.5)
        .tf(T0, "base_link", "laser", 0.5)
    )
    frame = frames_of(bag.scan(T0, [1, 2]), tmp_path, base_frame="tail")[0]
    np.testing.assert_allclose(frame.odom_from_base.row, [1.0, -0.5, math.pi / 2], atol=1e-12)
    np.testing.assert_allclose(frame.base_from_sensor.row, [1.0, 0.0, 0.0], atol=1e-12)


# --- errors for the user to fix


def test_several_laser_topics_are_listed_with_their_counts(tmp_path):
    path = str(
        Bag("ros1")
        .scan(T0, [1, 2], "/left")
        .scan(T0 + 1, [1, 2], "/right")
        .scan(T0 + 2, [1, 2], "/right")
        .write(tmp_path)
    )
    with pytest.raises(
        BadData, match=r"2 topics.*/left \(LaserScan, 1\), /right \(LaserScan, 2\).*choose one with topic: /left"
    ):
        RosBag(path)
    with pytest.raises(BadData, match=r"no laser scans on topic '/up'.*choose one with topic: /left, /right"):
        RosBag(path, topic="/up")
    with pytest.raises(BadData, match=r"no laser scans on topic '/rigth' \(did you mean '/right'\?\); topics: "):
        RosBag(path, topic="/rigth")
    assert len(RosBag(path, topic="right")) == 2


def test_a_bag_without_laser_scans_is_reported(tmp_path):
    with pytest.raises(BadData, match=r"0 topics with laser scans; topics: /odom \(Odometry, 1\).*LaserScan messages"):
        RosBag(str(Bag("sqlite3").odom(T0, 0.0).write(tmp_path)))


def test_wrong_odometry_and_frame_names_list_the_known_ones(tmp_path):
    path = str(Bag("ros1").odom(T0, 0.0, topic="/a").odom(T0, 0.0, topic="/b").scan(T0, [1, 2]).write(tmp_path))
    with pytest.raises(BadData, match="topics with odometry: /a, /b"):
        RosBag(path)
    with pytest.raises(BadData, match="odometry '/c'"):
        RosBag(path, odometry="/c")
    with pytest.raises(BadData, match="no moving transform"):
        RosBag(path, odometry="tf")
    with pytest.raises(BadData, match=r"base_frame 'wagon'.*frames: none"):
        RosBag(path, odometry="/a", base_frame="wagon")


def test_relations_of_another_data_set_are_rejected(tmp_path):
    (tmp_path / "r").write_text("1 2 0 0 0 0 0 0\n")
    with pytest.raises(BadData, match="do not overlap the recording"):
        RosBag(str(Bag("ros1").scan(T0, [1, 2]).write(tmp_path)), relations=str(tmp_path / "r"))


def test_a_ros2_bag_without_type_definitions_is_read(tmp_path):
    path = Bag("sqlite3").scan(T0, [1.5, 2.5]).write(tmp_path)
    with sqlite3.connect(path / "made.db3") as database:
        database.execute("DROP TABLE schema")
        database.execute("DROP TABLE message_definitions")
    assert next(RosBag(str(path)).frames()).scan.ranges.tolist() == [1.5, 2.5]


@pytest.mark.parametrize(("kind", "ending"), [("sqlite3", "db3"), ("mcap", "mcap")])
def test_a_file_inside_a_ros2_bag_opens_the_bag_or_itself_alone(tmp_path, kind, ending):
    path = Bag(kind).scan(T0, [1.5, 2.5]).write(tmp_path)
    assert len(RosBag(str(path / f"made.{ending}"))) == 1
    (path / "metadata.yaml").unlink()
    assert len(RosBag(str(path / f"made.{ending}"))) == 1
    with pytest.raises(BadData, match=r"without metadata\.yaml"):
        RosBag(str(path))


@pytest.mark.parametrize(
    ("kind", "share"),
    [("sqlite3", 0.02), ("sqlite3", 0.5), ("sqlite3", 0.9), ("mcap", 0.02), ("mcap", 0.5), ("ros1", 0.02)],
)
def test_a_bag_without_a_whole_message_or_page_is_reported_with_a_remedy(tmp_path, kind, share):
    bag = Bag(kind)
    for index in range(200):
        bag.scan(T0 + index, np.full(300, 1.0))
    path = bag.write(tmp_path)
    file = path if path.is_file() else next(file for file in path.iterdir() if file.suffix != ".yaml")
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    with pytest.raises(BadData, match=r"not a readable bag.*fetch the bag again"):
        RosBag(str(path))


@pytest.mark.parametrize("name", ["x.bag", "x.db3", "x.mcap"])
@pytest.mark.parametrize(
    "content", [b"", b"#ROSBAG V2.0\n" + bytes(range(256)) * 9, b"nothing of the kind", bytes(5000)]
)
def test_a_file_of_random_bytes_is_not_a_bag(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadData, match=name):
        RosBag(str(tmp_path / name))


def test_other_suffixes_and_absent_files_are_rejected(tmp_path):
    (tmp_path / "scans.txt").write_text("hello")
    with pytest.raises(BadData, match=r"'\.txt' is not the suffix of a bag"):
        RosBag(str(tmp_path / "scans.txt"))
    with pytest.raises(DataMissing, match="no file"):
        RosBag(str(tmp_path / "absent.bag"))
    assert SPEC.missing(path=str(tmp_path / "absent.bag")).endswith("check the path")


# --- bounded memory


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_in_order_after_a_clock_was_set_back_by_hundreds_of_scans(tmp_path, kind):
    bag = Bag(kind)
    stamps = [*range(700, 1400), *range(700)]
    for recorded, stamp in enumerate(stamps):
        bag.scan(T0 + stamp * 10**8, [1.0 + stamp / 1000, 2.0], recorded=T0 + recorded * 10**8)
    sequence = RosBag(str(bag.write(tmp_path)), every=7)
    frames = list(sequence.frames())
    assert [frame.scan.stamp_ns for frame in frames] == [T0 + stamp * 10**8 for stamp in range(0, 1400, 7)]
    assert [frame.scan.ranges[0] for frame in frames] == pytest.approx([1.0 + s / 1000 for s in range(0, 1400, 7)])
    assert sequence.notes() == {"scans out of order": 1}


def test_a_bag_that_changes_while_it_is_read_is_rejected(tmp_path):
    path = Bag("ros1").scan(T0, [1.0, 2.0]).scan(T0 + 10**8, [1.0, 2.0]).write(tmp_path)
    sequence = RosBag(str(path))
    path.unlink()
    Bag("ros1").scan(T0, [1.0, 2.0]).scan(T0 + 2 * 10**8, [1.0, 2.0]).write(tmp_path)
    with pytest.raises(BadData, match="has changed since it was first read"):
        list(sequence.frames())


def test_a_moving_mounting_uses_the_transform_nearest_to_the_first_selected_scan(tmp_path):
    bag = Bag("sqlite3").scan(T0, [1.0, 2.0]).scan(T0 + 10 * 10**9, [1.0, 2.0])
    for second, x in ((1, 0.1), (9, 0.9), (14, 1.4)):
        bag.tf(T0 + second * 10**9, "base_link", "laser", x=x, static=False)
    path = str(bag.write(tmp_path))
    assert next(RosBag(path).frames()).base_from_sensor.x == pytest.approx(0.1)
    assert next(RosBag(path, start=1).frames()).base_from_sensor.x == pytest.approx(0.9)
