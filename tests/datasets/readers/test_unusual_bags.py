"""Bags without laser scans or without an index: point clouds, messages of other types, files cut short."""

import dataclasses
import json
import math
import re
import shlex
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import BadData, BadParameter
from evalkit_datasets.commands.inspect import lidar_findings
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.range_stats import RangeStats
from evalkit_datasets.commands.inspect.suggested_config import choose_parameters, suggest_config
from evalkit_datasets.commands.inspect.timing import measure_timing
from evalkit_datasets.parsing.cloud_slice import CloudSlice
from evalkit_datasets.readers.rosbag import RosBag

sys.path.insert(0, str(Path(__file__).parent))
from test_rosbag import KINDS, T0, Bag

typesys = pytest.importorskip("rosbags.typesys")
ros1 = pytest.importorskip("rosbags.rosbag1.reader")
ros2 = pytest.importorskip("rosbags.rosbag2")
PERIOD = 100_000_000


def cloud(bag, stamp, points, organised=False, big_endian=False):
    """Add a PointCloud2 of points (N, 3), with an intensity between y and z and padding behind every point."""
    layout = np.dtype({"names": ["x", "y", "i", "z"], "formats": [">f4" if big_endian else "<f4"] * 4,
                       "offsets": [0, 4, 8, 12], "itemsize": 20})  # fmt: skip
    packed = np.zeros(len(points), layout)
    packed["x"], packed["y"], packed["z"] = np.asarray(points, dtype=np.float64).T
    fields = [bag.make("sensor_msgs/msg/PointField", name, at, 7, 1)
              for name, at in (("x", 0), ("y", 4), ("intensity", 8), ("z", 12))]  # fmt: skip
    height = 2 if organised else 1
    width = len(points) // height
    row = packed.tobytes()
    rows = [row[k * width * 20 : (k + 1) * width * 20] + b"\0" * 8 for k in range(height)] if organised else [row]
    data = np.frombuffer(b"".join(rows), dtype=np.uint8)
    kind = "sensor_msgs/msg/PointCloud2"
    message = bag.make(
        kind, bag.header(stamp, "velodyne"), height, width, fields, big_endian, 20, len(rows[0]), data, True
    )
    return bag.add("/points", kind, message, stamp)


SQUARE = [(1.0, 0.0, 0.0), (3.0, 0.0, 0.0), (0.0, 2.0, 0.05), (0.0, 1.5, 0.5), (-4.0, 0.1, -0.05), (math.nan, 1.0, 0.0)]
"""Ahead the nearer of two points; left the one within the heights; behind one; one invalid."""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("organised", "big_endian"), [(False, False), (True, False), (False, True)])
def test_a_point_cloud_is_sliced_to_the_nearest_point_of_each_direction(tmp_path, kind, organised, big_endian):
    path = cloud(Bag(kind), T0, SQUARE, organised, big_endian).write(tmp_path)
    scan = next(RosBag(str(path), beams=8).frames()).scan
    hits = scan.hits
    assert scan.stamp_ns == T0
    assert hits.sum() == 3
    found = {(round(x, 5), round(y, 5)) for x, y in scan.points().tolist()}
    assert found == {(1.0, 0.0), (0.0, 2.0), (-4.0, 0.1)}
    assert np.isnan(scan.ranges[~hits]).all()  # unknown, not free
    higher = next(RosBag(str(path), beams=8, height_min_m=0.4, height_max_m=0.6).frames()).scan
    np.testing.assert_allclose(higher.points(), [[0.0, 1.5]], atol=1e-9)


def test_the_slice_does_not_depend_on_the_order_of_the_points_and_rotates_with_them():
    points = np.random.default_rng(0).uniform(-5, 5, (2000, 3)) * [1, 1, 0.05]
    first, second = CloudSlice().cut(points), CloudSlice().cut(points[::-1])
    np.testing.assert_array_equal(first, second)
    turned = points @ np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # by +90 deg: 180 of 720 directions
    np.testing.assert_allclose(np.roll(first[0], 180), CloudSlice().cut(turned)[0], atol=1e-9)


def test_a_band_of_heights_upside_down_is_refused(tmp_path):
    path = cloud(Bag("mcap"), T0, SQUARE).write(tmp_path)
    with pytest.raises(BadParameter, match=r"0\.5 to 0\.1 m.*less than height_max_m"):
        RosBag(str(path), height_min_m=0.5)


def test_a_cloud_that_claims_more_points_than_it_has_is_damaged(tmp_path):
    bag = cloud(Bag("ros1"), T0, SQUARE)
    topic, kind, message, stamp = cloud(Bag("ros1"), T0 + 1, SQUARE).messages[0]
    bag.add(
        topic, kind, bag.make(kind, message.header, 1, 10**9, message.fields, False, 20, 0, message.data, True), stamp
    )
    sequence = RosBag(str(bag.write(tmp_path)))
    assert (len(sequence), sequence.notes()["damaged messages dropped"]) == (1, 1)


def custom(bag, definition, kind="my_msgs/msg/Ranges", inner=()):
    """Register a message type of a stranger."""
    for text, name in (*inner, (definition, kind)):
        bag.store.register(typesys.get_types_from_msg(text, name))
    return kind


@pytest.mark.parametrize("kind", KINDS)
def test_messages_of_another_type_are_offered_and_read_with_varying_numbers_of_beams(tmp_path, kind):
    bag = Bag(kind)
    name = custom(bag, "std_msgs/Header header\nfloat32[] angles_deg\nuint16[] dist")
    for k, beams in enumerate((4, 6, 5)):
        angles, dist = np.linspace(0, 270, beams, dtype=np.float32), np.arange(1, beams + 1, dtype=np.uint16) * 1000
        bag.add("/lds", name, bag.make(name, bag.header(T0 + k * PERIOD, "laser"), angles, dist), T0 + k * PERIOD)
    path = bag.write(tmp_path)
    with pytest.raises(BadData, match=r"/lds \(Ranges, 3\).*--set 'fields=ranges=.* angles="):
        RosBag(str(path))
    advice = suggest_config(inspect_recording(path))
    assert advice.parameters["fields"] == "ranges=dist angles=angles_deg range_unit=mm angle_unit=deg"
    assert not advice.problem
    scans = [frame.scan for frame in RosBag(**advice.parameters).frames()]
    assert [len(scan.ranges) for scan in scans] == [4, 6, 5]
    assert scans[0].ranges.tolist() == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(scans[0].angles, np.radians([0, 90, 180, 270]), atol=1e-6)
    clockwise = next(RosBag(**{**advice.parameters, "fields": f"{advice.parameters['fields']} clockwise"}).frames())
    np.testing.assert_allclose(clockwise.scan.angles, -np.radians([0, 90, 180, 270]), atol=1e-6)


def test_points_in_a_list_and_even_angles_are_found(tmp_path):
    bag = Bag("mcap")
    points = custom(bag, "my_msgs/Point[] points", inner=[("float32 angle\nfloat32 range", "my_msgs/msg/Point")])
    beams = [bag.make("my_msgs/msg/Point", a, r) for a, r in ((0.0, 2.0), (0.5, 2.5), (1.0, 3.0))]
    bag.add("/points", points, bag.make(points, beams), T0)
    even = custom(bag, "float32 start_angle\nfloat32 angle_step\nfloat32[] distances", "my_msgs/msg/Even")
    bag.add("/even", even, bag.make(even, 90.0, -30.0, np.array([1.0, 2.0], dtype=np.float32)), T0)
    path = str(bag.write(tmp_path))
    one = next(RosBag(path, "/points", fields="ranges=points.range angles=points.angle").frames()).scan
    assert (one.ranges.tolist(), one.angles.tolist(), one.stamp_ns) == ([2.0, 2.5, 3.0], [0.0, 0.5, 1.0], T0)
    lasers = {laser.topic: laser.fields for laser in inspect_recording(Path(path)).streams.lasers}
    assert lasers == {
        "/points": "ranges=points.range angles=points.angle range_unit=m angle_unit=rad",
        "/even": "ranges=distances first=start_angle step=angle_step range_unit=m angle_unit=deg",
    }
    two = next(RosBag(path, "/even", fields=lasers["/even"]).frames()).scan
    np.testing.assert_allclose(two.angles, np.radians([90, 60]))


@pytest.mark.parametrize("text", ["ranges=a", "angles=b", "ranges=a angles=b unit=m", "ranges=a first=b", "nonsense",
                                  "ranges=a angles=b range_unit=inch"])  # fmt: skip
def test_fields_that_say_too_little_or_nonsense_are_refused_with_the_form(tmp_path, text):
    with pytest.raises(BadParameter, match="ranges=NAME angles=NAME"):
        RosBag(str(Bag("mcap").scan(T0, [1, 2]).write(tmp_path)), fields=text)


def test_a_field_that_is_not_there_is_named(tmp_path):
    path = Bag("mcap").scan(T0, [1, 2]).odom(T0, 0.0).write(tmp_path)
    with pytest.raises(BadData, match="no field 'dist' in the message"):
        RosBag(str(path), "/odom", fields="ranges=dist angles=angle")


FIELDS = "ranges=ranges first=angle_min step=angle_increment"


def write_drive(folder, turn, tf=False, beams=360):
    """Write a drive in a room of 8 m by 5 m by a robot whose lidar lies upside down; ``turn``: rad a scan."""
    bag, step = Bag("mcap"), 2.0 * math.pi / beams
    if tf:
        bag.tf(T0, "base_link", "laser", quaternion=(1.0, 0.0, 0.0, 0.0))
    for k in range(40):
        yaw = turn * k
        x, y = (3.0 + math.sin(yaw), 2.0 - math.cos(yaw)) if turn else (2.0 + 0.05 * k, 1.0)
        ways = 1e-6 + yaw - (step * np.arange(beams) - math.pi)  # the angles of a lidar upside down grow clockwise
        cos, sin = np.cos(ways), np.sin(ways)
        ranges = np.minimum(np.where(cos > 0, 8 - x, -x) / cos, np.where(sin > 0, 5 - y, -y) / sin)
        bag.odom(T0 + k * PERIOD, x, y, yaw)
        bag.scan(T0 + k * PERIOD, ranges, angle_min=-math.pi, angle_max=math.pi, angle_increment=step)
    return bag.write(folder)


def directions(path, **given):
    found = choose_parameters("rosbag", {"path": str(path), **given})
    return [(one.reason.split(":")[0], one.warns) for one in found if "mirrored" in one.reason]


def test_a_lidar_upside_down_without_a_transform_is_a_problem_on_arcs_and_the_advice_mends_it(tmp_path):
    path = write_drive(tmp_path, turn=0.07)
    assert directions(path) == [("warning", True)]
    assert directions(path, fields=f"{FIELDS} clockwise") == []
    (turn,) = inspect_recording(path, given={"fields": f"{FIELDS} clockwise"}).turns.values()
    assert turn.scale == pytest.approx(1.0, abs=0.1)


def test_a_direction_that_cannot_be_checked_is_a_warning_unless_something_states_it(tmp_path):
    path = write_drive(tmp_path, turn=0.0)
    (warning,) = [one for one in inspect_recording(path).findings if "mirrored" in one.what]
    assert warning.level == "warning"
    assert "/scan: whether the angles are mirrored (a lidar upside down) could not be checked" in warning.what
    assert "the odometry does not turn measurably" in warning.what
    assert directions(path) == [("warning", True)]
    assert directions(path, base_from_sensor="0 0 0") == directions(path, fields=FIELDS) == []
    stated = tmp_path / "stated"
    stated.mkdir()
    assert directions(write_drive(stated, turn=0.0, tf=True)) == []


@pytest.mark.parametrize(
    ("scale", "period", "said"),
    [(1.0, PERIOD, ""), (1000.0, PERIOD, "millimetres or centimetres taken for metres"),
     (0.001, PERIOD, "metres taken for millimetres"), (1.0, PERIOD // 1000, "stamps in another unit"),
     (1.0, PERIOD * 1000, "stamps in another unit")],
)  # fmt: skip
def test_wrong_units_of_ranges_and_times_are_noticed_and_said_before_a_comparison(tmp_path, scale, period, said):
    bag = Bag("mcap")
    for k in range(12):
        given = {"range_min": 0.001 * scale, "range_max": 30.0 * scale, "angle_increment": 0.01}
        bag.scan(T0 + k * period, scale * np.linspace(2.0, 4.0 + 0.01 * k, 200), time_increment=0.0005, **given)
    path = bag.write(tmp_path)
    recording = inspect_recording(path)
    found = [finding for finding in recording.findings if finding.level == "problem"]
    assert [said in finding.what for finding in found] == ([True] if said else [])
    assert all(finding.advice for finding in found)
    chosen = choose_parameters("rosbag", {"path": str(path)})
    told = [one.reason for one in chosen if one.name == "fields" or "problem" in one.reason]
    if scale > 1.0:  # the advice mends it
        mended = found[0].advice.replace("give", "mended by")
        assert told == [f"warning: {one.about}: {one.what}; {mended}" for one in found]
        fields = found[0].advice.split("'")[1].removeprefix("fields=")
        scan = next(RosBag(str(path), fields=fields).frames()).scan
        np.testing.assert_allclose(scan.ranges, np.linspace(2.0, 4.0, 200), atol=1e-4)
    else:
        assert told == [f"problem: {one.about}: {one.what}; {one.advice}" for one in found]


def test_ranges_in_millimetres_beside_limits_in_metres_are_mended(tmp_path):
    bag = Bag("mcap")
    for k in range(12):
        given = {"angle_increment": 0.01, "time_increment": 0.0005}  # limits: 0.125 to 12 m
        bag.scan(T0 + k * PERIOD, 1000.0 * np.linspace(2.0, 4.0 + 0.01 * k, 200), **given)
    path = bag.write(tmp_path)
    (found,) = [one.what for one in inspect_recording(path).findings if one.level == "problem"]
    assert found == ("100 % of the ranges lie beyond the maximum of 12 m: millimetres or centimetres taken for metres?")
    mend = {"fields": f"{FIELDS} range_unit=mm"}
    assert suggested(path) == (mend, 0)
    scan = next(RosBag(str(path), **mend).frames()).scan
    np.testing.assert_allclose([scan.range_min_m, scan.range_max_m], [0.125, 12.0])
    assert scan.hits.all()


def suggested(path):
    """Return the parameters of the suggested command that mend something, and how many problems are left with them."""
    advice = suggest_config(inspect_recording(path))
    words = dict(word.partition("=")[::2] for word in shlex.split(advice.command) if "=" in word)
    mends = {name: value for name, value in advice.parameters.items() if name in words and name != "odometry"}
    found = choose_parameters("rosbag", {"path": str(path), **mends})
    return mends, sum(one.reason.startswith("problem") for one in found)


def test_the_suggested_command_mends_what_has_one_mend(tmp_path):
    folders = [tmp_path / name for name in ("scans", "mirrored", "clocks", "sweep")]
    for folder in folders:
        folder.mkdir()
    bag = Bag("mcap")
    for k in range(12):  # in mm and deg
        given = {"angle_min": -99.5, "angle_increment": 1.0, "range_max": 30000.0, "time_increment": 0.0005}
        bag.scan(T0 + k * PERIOD, np.linspace(2000.0, 4000.0 + 10.0 * k, 200), **given)
    path = bag.write(folders[0])
    assert suggested(path) == ({"fields": f"{FIELDS} range_unit=mm angle_unit=deg"}, 0)
    assert "[mapper]" not in suggest_config(inspect_recording(path)).table  # no cells by wrong ranges and angles
    assert suggested(mirrored_turn()[0].write(folders[1])) == ({"fields": f"{FIELDS} clockwise"}, 0)
    assert suggested(write_two_clocks(folders[2], 37.0)) == ({"stamp_shift_s": 37.0}, 0)
    assert suggested(turn_to_and_fro(folders[3], 0.1, time_increment=0.2)) == ({"sweep_s": 0.2}, 0)


def test_the_suggested_command_mends_nothing_where_the_mend_is_not_known(tmp_path):
    """Ranges of 800 may be 0.8 m or 8 m; an odometry that contradicts the other is not mended by the lidar's angles."""
    bag = Bag("mcap")
    for k in range(12):
        given = {"angle_increment": 0.03, "range_max": 30000.0, "time_increment": 0.0005}
        bag.scan(T0 + k * PERIOD, np.linspace(700.0, 900.0 + k, 200), **given)
    (tmp_path / "unit").mkdir()
    path = bag.write(tmp_path / "unit")
    assert suggested(path) == ({}, 1)
    assert "[mapper]" not in suggest_config(inspect_recording(path)).table
    bag, _ = mirrored_turn()
    for k in range(40):
        bag.odom(T0 + k * PERIOD, 0.0, yaw=-math.radians(4.0) * k, topic="/visual")
    assert suggested(bag.write(tmp_path)) == ({}, 1)


@pytest.mark.parametrize("reader", ["rosbag", "columns", "carmen"])
def test_the_advice_on_units_is_that_of_the_reader(reader):
    stats = {one.name: 0 for one in dataclasses.fields(LidarStats)}
    ranges = {one.name: 0 for one in dataclasses.fields(RangeStats)} | {"median_m": 3000.0}
    lidar = LidarStats(**{**stats, "topic": "/scan", "beams": 360, "step_deg": 57.3, "returns": RangeStats(**ranges),
                          "timing": measure_timing(np.arange(20) * 10)})  # fmt: skip
    said = [one.advice for one in lidar_findings._check_units(lidar, reader)]
    assert len(said) == 3
    for advice in said:
        assert bool(advice) is (reader != "carmen")
        assert ("--set" in advice or "recording" in advice) is (reader == "rosbag")
        assert ("layout" in advice) is (reader == "columns")


def mirrored_turn(base="base_link"):
    """A lidar turns on the spot in a room, with clockwise angles written as if they were counter-clockwise."""
    bag = Bag("mcap")
    directions = np.linspace(-1.5, 1.5, 301)
    for k in range(40):
        way = -directions + math.radians(4.0) * k
        room = 3.0 + np.cos(2 * way) + 0.5 * np.sin(5 * way) + 0.3 * np.cos(11 * way + 1.0)
        bag.scan(T0 + k * PERIOD, room, angle_min=-1.5, angle_max=1.5, angle_increment=0.01, time_increment=0.0)
        bag.odom(T0 + k * PERIOD, 0.0, yaw=math.radians(4.0) * k, child=base)
    return bag, directions


def test_mirrored_angles_are_noticed_against_the_odometry_and_the_advice_mends_them(tmp_path):
    bag, directions = mirrored_turn()
    path = bag.write(tmp_path)
    (found,) = [one for one in inspect_recording(path).findings if one.level == "problem"]
    assert found.what.startswith("the scans rotate -1.0")
    assert "the lidar's angles are mirrored" in found.what
    scan = next(RosBag(str(path), fields=found.advice.split("'")[1].removeprefix("fields=")).frames()).scan
    np.testing.assert_allclose(scan.angles, -directions, atol=1e-6)


@pytest.mark.parametrize("base", ["base_link", "chassis"])
def test_angles_that_the_mounting_of_a_lidar_upside_down_mirrors_are_no_problem(tmp_path, base):
    bag, directions = mirrored_turn(base)
    path = bag.tf(T0, base, "laser", quaternion=(1.0, 0.0, 0.0, 0.0)).write(tmp_path)
    found = inspect_recording(path)
    assert [one.what for one in found.findings if one.level == "problem"] == []
    assert next(iter(found.turns.values())).scale == pytest.approx(1.0, rel=0.03)
    np.testing.assert_allclose(next(RosBag(str(path)).frames()).scan.angles, -directions, atol=1e-6)


def test_the_mounting_is_that_on_the_base_of_the_odometry_that_is_used(tmp_path):
    """A camera has odometry, too; the frame of its lens and the base have another distance to the lidar."""
    bag = Bag("mcap").tf(T0, "chassis", "laser", 0.2).tf(T0, "chassis", "lens", 0.5)
    for k in range(20):
        bag.scan(T0 + k * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0])
        bag.odom(T0 + k * PERIOD, 0.1 * k, topic="/camera/odom", child="lens").odom(
            T0 + k * PERIOD, 0.1 * k, child="chassis"
        )
    path = bag.write(tmp_path)

    def mountings(**given):
        return [(one.base, round(one.x_m, 6)) for one in inspect_recording(path, given=given).frames.mountings]

    assert mountings() == mountings(odometry="/odom") == [("chassis", 0.2)]
    assert mountings(odometry="/camera/odom") == mountings(base_frame="lens") == [("lens", -0.3)]
    assert mountings(odometry="none") == []  # the reader then takes the lidar as the base


@pytest.mark.parametrize(
    ("speed", "level", "what"),
    [
        (0.2, "problem", "1 jump, such as 0.60 m and 0 deg at 3.1 s: a guess across a jump is wrong"),
        (0.5, "warning", "1 jump, such as 1.50 m and 0 deg at 3.1 s: taken out when the recording is read, as if the "
         "robot had stood meanwhile"),
    ],
)  # fmt: skip
def test_an_odometry_that_restarts_is_said_once_before_a_comparison_that_uses_it(tmp_path, speed, level, what):
    """It drives at a speed (m/s) along x, and its driver starts again at the origin after 3 s."""
    bag = Bag("mcap")
    for k in range(60):
        x = 0.1 * speed * (k % 31)
        bag.scan(T0 + k * PERIOD, np.linspace(2.0, 4.0 + 0.01 * k, 200), time_increment=0.0, angle_increment=0.01)
        bag.odom(T0 + k * PERIOD, x).tf(T0 + k * PERIOD, "odom", "base_link", x, static=False)
    path = bag.tf(T0, "base_link", "laser").write(tmp_path)
    found = inspect_recording(path).findings
    jumps = [one for one in found if "jump" in one.what]
    assert {(one.level, one.what) for one in jumps} == {(level, what)}
    parameters = {"path": str(path)}
    told = [one.reason for one in choose_parameters("rosbag", parameters) if "jump" in one.reason]
    assert told == [f"problem: {jumps[0].about}: {jumps[0].what}; {jumps[0].advice}"] * (level == "problem")
    assert not [one for one in choose_parameters("rosbag", parameters | {"odometry": "none"}) if one.name == "problem"]
    (swept,) = [one.what for one in found if "time_increment" in one.what]
    assert swept == "time_increment is 0 or less: the motion within the scans, 0.1 s apart, is not corrected"


def test_the_time_of_a_revolution_a_scan_is_suggested(tmp_path):
    """360 beams over a full turn, five turns a second."""
    bag, beams = Bag("mcap"), np.full(360, 2.0)
    for k in range(12):
        angles = {"angle_min": 0.0, "angle_increment": math.radians(1.0)}
        bag.scan(T0 + k * 2 * PERIOD, beams, "/zero", time_increment=0.0, **angles)
        bag.scan(T0 + k * 2 * PERIOD, beams, "/stated", time_increment=1 / 1800, **angles)
        bag.scan(T0 + k * 6 * PERIOD, beams, "/thinned", time_increment=0.0, **angles)
    (found,) = [one for one in inspect_recording(bag.write(tmp_path)).findings if "time_increment" in one.what]
    assert found.about == "/zero"
    assert "set sweep_s = 0.2 of the reader" in found.advice


def drive_straight(folder, speed_m_s, **scan):
    """Write a full turn of beams, five scans a second, of a robot that drives ahead without turning."""
    bag, angles = Bag("mcap").tf(T0, "base_link", "laser"), np.radians(np.arange(-180.0, 180.0))
    stated = {"angle_min": -math.pi, "angle_increment": math.radians(1.0), "time_increment": 0.0, **scan}
    for k in range(40):
        x = 0.2 * speed_m_s * k
        room = 3.0 + np.cos(2.0 * angles) + 0.01 * x
        bag.odom(T0 + 2 * k * PERIOD, x).scan(T0 + 2 * k * PERIOD, room, **stated)
    return bag.write(folder)


def tell_skew(path, **given):
    return [one.reason for one in choose_parameters("rosbag", {"path": str(path), **given}) if "fired" in one.reason]


def test_a_comparison_says_that_scans_may_be_skewed_where_no_turn_shows_it_and_the_motion_is_large(tmp_path):
    """0.8 m/s for 0.2 s are 0.16 m."""
    path = drive_straight(tmp_path, 0.8)
    (said,) = tell_skew(path)
    assert said.startswith("warning: /scan: its time_increment is 0 or less, and no turn shows")
    assert "the robot moves by up to 0.16 m and 0 deg within a scan" in said
    assert said.endswith("; then use --set sweep_s=0.2")
    assert tell_skew(path, sweep_s=0.2) == tell_skew(path, odometry="none") == []


@pytest.mark.parametrize(("speed_m_s", "time_increment"), [(0.3, 0.0), (0.8, 1 / 1800)])
def test_a_slow_robot_or_a_lidar_that_states_its_time_has_no_skew_to_tell(tmp_path, speed_m_s, time_increment):
    assert tell_skew(drive_straight(tmp_path, speed_m_s, time_increment=time_increment)) == []


def test_turns_that_show_scans_taken_at_their_stamps_leave_no_doubt(tmp_path):
    assert tell_skew(turn_to_and_fro(tmp_path, 0.0, time_increment=0.0)) == []


# --- the robot's own body


def test_a_comparison_warns_of_the_body_in_view_of_the_lidar_that_it_uses(tmp_path):
    """40 of 200 beams of the front lidar, through the border of the full turn, end at posts of the robot."""
    bag, rng = Bag("mcap"), np.random.default_rng(5)
    turn = {"angle_min": -math.pi, "angle_increment": math.radians(1.8), "angle_max": math.pi}
    for k in range(40):
        walls = rng.uniform(1.0, 8.0, 200)
        posts = np.where(np.arange(200) < 20, 0.24, np.where(np.arange(200) >= 180, 0.27, walls))
        bag.scan(T0 + k * PERIOD, posts, "/front", **turn).scan(T0 + k * PERIOD, walls, "/rear", **turn)
    path = bag.write(tmp_path)
    (found,) = [one for one in inspect_recording(path).findings if "own body" in one.what]
    assert (found.level, found.about) == ("warning", "/front")
    assert found.what.startswith("20 % of the beams (144 to 214 deg) always have the same range, 0.24 to 0.27 m:")
    assert found.advice.startswith("set range_min_m = 0.3 (m; of a text log")
    for topic, count in (("/front", 1), ("/rear", 0)):
        choices = choose_parameters("rosbag", {"path": str(path), "topic": topic})
        assert sum(one.warns and "own body" in one.reason for one in choices) == count
    assert not any(
        np.nanmin(frame.scan.ranges) < 0.3 for frame in RosBag(str(path), "/front", range_min_m=0.3).frames()
    )


# --- damaged indexes


def damage_of(sequence):
    """Return the notes on the bag as a whole."""
    return {name: count for name, count in sequence.notes().items() if "bag" in name}


def long_bag(kind, packed, folder):
    bag = Bag(kind)
    for k in range(40):
        bag.scan(T0 + k * PERIOD, np.full(20_000, 1.0 + k)).odom(T0 + k * PERIOD, 0.1 * k)
    path = bag.write(folder, packed)
    return path if path.is_file() else next(path.glob("*.mcap"))


@pytest.mark.parametrize(
    ("kind", "packed"), [("ros1", ""), ("ros1", "lz4"), ("ros1", "bz2"), ("mcap", ""), ("mcap", "storage")]
)
def test_a_bag_without_its_index_is_read_up_to_the_damage(tmp_path, kind, packed):
    whole = long_bag(kind, packed, tmp_path)
    expected = [frame.scan.ranges[0] for frame in RosBag(str(whole)).frames()]
    content = whole.read_bytes()
    broken = tmp_path / f"broken{whole.suffix}"
    for kept in (0.95, 0.5):
        broken.write_bytes(content[: int(len(content) * kept)])
        try:
            sequence = RosBag(str(broken))
        except BadData:  # one packed chunk holds all: nothing whole is left
            assert packed
            continue
        found = [frame.scan.ranges[0] for frame in sequence.frames()]
        assert found == expected[: len(found)]
        assert packed or len(found) >= 40 * (kept - 0.4)
        (told,) = (
            what for what in inspect_recording(broken).findings if "cut short" in what.what or "index" in what.what
        )
        assert ("how much was cut off" in told.what) is (kind == "mcap" and len(found) < 40)  # ROS 1 states it


def test_a_ros_1_bag_cut_short_tells_how_much_of_it_is_lost(tmp_path):
    """Its header states where its index begins, which is the size of its records."""
    whole = long_bag("ros1", "", tmp_path)
    content = whole.read_bytes()
    at = content.index(b"index_pos=") + len("index_pos=")
    records = int.from_bytes(content[at : at + 8], "little")
    whole.write_bytes(content[: records // 4])
    assert damage_of(RosBag(str(whole))) == {"percent of the bag lost, as it is cut short or damaged": 76}  # rounded up
    (told,) = (finding.what for finding in inspect_recording(whole).findings if finding.about == "file")
    lost = f"{(records - records // 4) / 1e6:.2f} of {records / 1e6:.2f} MB (76 %)"
    assert told == f"it is cut short or damaged: {lost} are lost"


def test_an_mcap_file_cut_short_tells_what_of_it_is_not_read(tmp_path):
    """In the middle of its second chunk: the bytes of that chunk are lost, and all that was cut off."""
    whole = long_bag("mcap", "", tmp_path)
    with closing(ros2.Reader(whole)) as reader:
        reader.open()
        second = reader.storage.chunks[1].chunk_start_offset
    whole.write_bytes(whole.read_bytes()[: second + second // 10])
    assert damage_of(RosBag(str(whole))) == {"percent of the bag lost, besides all that was cut off": 10}
    whole.write_bytes(whole.read_bytes()[:second])
    assert damage_of(RosBag(str(whole))) == {"bags without an index, read to the last whole record": 1}


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_bag_of_which_the_index_alone_is_damaged_has_lost_nothing(tmp_path, kind):
    whole = long_bag(kind, "", tmp_path)
    content = bytearray(whole.read_bytes())
    at = content.index(b"index_pos=") + len("index_pos=") + 6 if kind == "ros1" else len(content) - 8
    content[at] ^= 0x10  # the place of the index beyond the end of the file, or the end of the file
    whole.write_bytes(bytes(content))
    assert len(RosBag(str(whole))) == 40
    (told,) = (finding.what for finding in inspect_recording(whole).findings if finding.about == "file")
    assert told == "its index is damaged or missing: all records in it were read"


def test_messages_out_of_order_are_read_in_the_order_of_their_times_also_without_the_index(tmp_path):
    bag = Bag("mcap")
    for k in (0, 2, 1, 3):
        bag.scan(T0 + k * PERIOD, [1.0 + k, 2.0])
    path = next(bag.write(tmp_path).glob("*.mcap"))
    content = bytearray(path.read_bytes())
    content[-8] ^= 0x10  # the end of the file
    path.write_bytes(bytes(content))
    sequence = RosBag(str(path))
    assert [frame.scan.ranges[0] for frame in sequence.frames()] == [1.0, 2.0, 3.0, 4.0]
    assert sequence.notes() == {"bags without an index, read to the last whole record": 1}


def test_a_chunk_that_cannot_be_unpacked_is_counted_and_the_scans_of_the_others_are_read(tmp_path):
    whole = long_bag("ros1", "bz2", tmp_path)
    expected = [frame.scan.ranges[0] for frame in RosBag(str(whole)).frames()]
    with closing(ros1.Reader(whole)) as reader:
        reader.open()
        chunks = [reader.chunks[info.pos] for info in reader.chunk_infos]
        begin = reader.chunk_infos[1].pos
        counts = [sum(c for i, c in info.connection_counts.items() if reader.connections[i].topic == "/scan")
                  for info in reader.chunk_infos]  # fmt: skip
    content = bytearray(whole.read_bytes())
    content[chunks[1].datapos : chunks[1].datapos + 4] = b"none"  # instead of the beginning of bzip2
    at = content.index(b"index_pos=") + len("index_pos=")
    content[at : at + 8] = bytes(8)
    whole.write_bytes(bytes(content))
    sequence = RosBag(str(whole))
    before, lost = counts[:2]
    assert lost
    assert [frame.scan.ranges[0] for frame in sequence.frames()] == expected[:before] + expected[before + lost :]
    share = math.ceil(100 * (chunks[1].datapos + chunks[1].datasize - begin) / len(content))
    assert damage_of(sequence) == {"percent of the bag lost, as it is cut short or damaged": share}
    findings = [finding.what for finding in inspect_recording(whole).findings]
    assert any(f" MB ({share} %) are lost" in what for what in findings)


@pytest.mark.parametrize(("kind", "packed", "kept"), [("ros1", "bz2", 4200), ("mcap", "storage", 200)])
def test_a_bag_cut_short_within_its_first_chunk_tells_that_no_message_is_left(tmp_path, kind, packed, kept):
    whole = long_bag(kind, packed, tmp_path)
    whole.write_bytes(whole.read_bytes()[:kept])
    with pytest.raises(BadData, match=r"; no whole chunk of messages lies before the damage\); record or fetch"):
        RosBag(str(whole))


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
@pytest.mark.parametrize("content", [b"", b"\0" * 5000, b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\0" * 9])
def test_files_that_hold_nothing_are_refused_with_what_to_do(tmp_path, suffix, content):
    path = tmp_path / f"broken{suffix}"
    path.write_bytes(content)
    with pytest.raises(BadData, match="record or fetch the bag again") as refused:
        RosBag(str(path))
    begins = {".bag": b"#ROSBAG", ".mcap": b"\x89MCAP"}.get(suffix)
    assert ("lies before the damage" in str(refused.value)) is bool(begins and content.startswith(begins))


def test_zeros_behind_the_middle_of_a_ros_1_bag_are_counted_as_lost(tmp_path):
    """A download whose file has its size before its content; one chunk holds all of it."""
    bag = Bag("ros1")
    for k in range(40):
        bag.scan(T0 + k * PERIOD, np.full(2_000, 1.0 + k))
    whole = bag.write(tmp_path)
    content = whole.read_bytes()
    whole.write_bytes(content[: len(content) // 2].ljust(len(content), b"\0"))
    sequence = RosBag(str(whole))
    assert 18 <= len(sequence) <= 21
    (share,) = damage_of(sequence).values()
    assert 47 <= share <= 53


def test_an_mcap_file_that_holds_fewer_messages_than_its_index_lists_tells_how_many(tmp_path):
    """Zeros hide them: the reader of MCAP skips records of an unknown kind without a word."""
    bag = Bag("mcap")
    for k in range(40):
        bag.scan(T0 + k * PERIOD, [1.0 + k, 2.0])
    (path,) = bag.write(tmp_path).glob("*.mcap")
    content = bytearray(path.read_bytes())
    with closing(ros2.Reader(path)) as reader:
        reader.open()
        (chunk,) = reader.storage.chunks
    at = chunk.chunk_start_offset + 9 + 40 + len(chunk.compression)
    messages = []
    while at < chunk.chunk_start_offset + chunk.chunk_length:
        messages += [at] if content[at] == 5 else []  # the kind of a message
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    for at in messages[30:]:
        content[at] = 0
    path.write_bytes(bytes(content))
    sequence = RosBag(str(path))
    assert len(sequence) == 30
    assert sequence.notes() == {"laser messages that the index lists and the bag does not hold": 10}
    found = [finding.what for finding in inspect_recording(path).findings]
    assert "10 messages that its index lists cannot be found in it" in found
    for at in messages:
        content[at] = 0
    path.write_bytes(bytes(content))
    with pytest.raises(BadData, match="/scan: none of the 40 messages that its index lists is in it; record or fetch"):
        RosBag(str(path))


def damaged_drive(kind, damage, every=4):
    """Eight scans, 16 poses and one mounting; ``damage``: of the bytes of every ``every``-th scan, pose and transform.

    The odometry moves by 0.1 m per scan.
    """
    bag = Bag(kind).tf(T0, "base_link", "laser", x=0.5)
    for k in range(8):
        stamp = T0 + k * PERIOD
        bag.scan(stamp, [1.0 + k, 2.0, 3.0]).odom(stamp, 0.1 * k).odom(stamp + PERIOD // 2, 0.1 * k + 0.05)
        bag.tf(stamp, "map", "odom", static=False)
    serialize = bag.store.serialize_ros1 if kind == "ros1" else bag.store.serialize_cdr
    seen = dict.fromkeys(("/scan", "/odom", "/tf"), 0)
    for at, (topic, name, message, stamp) in enumerate(bag.messages):
        if topic in seen:
            seen[topic] += 1
            if seen[topic] % every == 0:
                bag.messages[at] = topic, name, damage(bytes(serialize(message, name))), stamp
    return bag


DAMAGES = {
    "cut": lambda content: content[:-9],
    "longer": lambda content: content + bytes(8),
    "empty": lambda content: b"",
    "frame of 4 GB": lambda content: content.replace(b"\x06\0\0\0laser", b"\xff" * 4 + b"laser")
    .replace(b"\x05\0\0\0laser", b"\xff" * 4 + b"laser").replace(b"odom", b"\xff" * 4),
    "3 * 10^9 ranges": lambda content: content.replace(bytes.fromhex("03000000"), bytes.fromhex("00ca9ab3"))[:-1],
}  # fmt: skip


@pytest.mark.parametrize("damage", [*DAMAGES, "encapsulation"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_few_messages_that_cannot_be_decoded_are_left_out_and_counted(tmp_path, kind, damage):
    if damage == "encapsulation" and kind == "ros1":
        pytest.skip("messages of ROS 1 have none")
    damaged = DAMAGES.get(damage, lambda content: b"\0\x07" + content[2:])
    path = damaged_drive(kind, damaged).write(tmp_path)
    sequence = RosBag(str(path))
    frames = list(sequence.frames())
    assert [frame.scan.ranges[0] for frame in frames] == [1.0, 2.0, 3.0, 5.0, 6.0, 7.0]
    assert frames[0].base_from_sensor.x == 0.5
    # poses 4, 8, ... are at half the period, and interpolated
    np.testing.assert_allclose([frame.odom_from_base.x for frame in frames], [0.0, 0.1, 0.2, 0.4, 0.5, 0.6], atol=1e-6)
    assert sequence.notes()["damaged messages dropped"] == 2 + 4 + 2
    (finding,) = [one for one in inspect_recording(path).findings if "damaged" in one.what]
    assert finding.level == "warning"
    said = "8 damaged messages, dropped; the first that cannot be decoded is message 4 of /odom, recorded at "
    assert finding.what.startswith(f"{said}1663967375.150000001: ")


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_which_most_messages_of_a_topic_cannot_be_decoded_is_refused_with_the_place(tmp_path, kind):
    path = damaged_drive(kind, DAMAGES["cut"], every=1).write(tmp_path)
    said = (
        rf"{path.name}: /scan: 8 of 8 messages cannot be decoded; the first is message 1 of /scan, recorded at "
        r"1663967375\.000000001: .*length 3 at offset 5.; record or fetch the bag again, or copy it without this topic"
    )
    with pytest.raises(BadData, match=said):
        RosBag(str(path))
    (problem,) = [one for one in inspect_recording(path).findings if one.level == "problem"]
    assert problem.what.startswith("no scan in it can be read: 32 damaged messages, dropped; the first that cannot")


def test_a_mounting_that_cannot_be_decoded_is_not_taken_for_none(tmp_path):
    bag = Bag("mcap").scan(T0, [1.0, 2.0]).tf(T0, "base_link", "laser")
    bag.messages[1] = (*bag.messages[1][:2], b"\0\1\0\0", T0)
    with pytest.raises(BadData, match="/tf_static: 1 of 1 messages cannot be decoded"):
        RosBag(str(bag.write(tmp_path)))


def test_a_bag_cut_short_before_its_first_scan_says_so(tmp_path):
    path = Bag("ros1").tf(T0, "base_link", "laser").scan(T0 + PERIOD, np.full(9_000, 1.0)).write(tmp_path)
    path.write_bytes(path.read_bytes()[:-20_000])
    said = r"it is cut short or damaged: .* are lost; before the damage, 0 topics with laser scans; .*; record or fetch"
    with pytest.raises(BadData, match=said):
        RosBag(str(path))


# --- folders of ROS 2 bags that are damaged or not whole


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("left", [0, 0.5])
def test_the_only_file_of_a_bag_is_read_without_metadata_that_are_damaged(tmp_path, kind, left):
    """A recorder that is killed leaves them empty, a full disk a part of them."""
    folder = Bag(kind).scan(T0, [1, 2]).write(tmp_path)
    metadata = folder / "metadata.yaml"
    metadata.write_bytes(metadata.read_bytes()[: int(left * metadata.stat().st_size)])
    for path in (folder, next(folder.glob("made.*"))):
        assert damage_of(RosBag(str(path))) == {"bags with a damaged metadata.yaml, read without it": 1}
    (told,) = (finding.what for finding in inspect_recording(folder).findings if finding.about == "file")
    assert told == "its metadata.yaml is damaged: the file of the bag was read without it"


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("quote", ["", "'"])
def test_a_folder_that_lacks_a_file_of_its_bag_is_refused_and_the_file_alone_is_read(tmp_path, kind, quote):
    folder = Bag(kind).scan(T0, [1, 2]).write(tmp_path)
    (file,), metadata = folder.glob("made.*"), folder / "metadata.yaml"
    listed, absent = f"- {file.name}\n", f"{quote}made_1{file.suffix}{quote}"
    assert listed in metadata.read_text()
    metadata.write_text(metadata.read_text().replace(listed, f"{listed}  - {absent}\n"))
    said = rf"metadata\.yaml: names made_1\{file.suffix}, not in the folder; copy the whole folder, or give one file: "
    for read in (RosBag, lambda path: inspect_recording(Path(path))):
        with pytest.raises(BadData, match=said + re.escape(str(file))):
            read(str(folder))
    assert len(RosBag(str(file))) == 1


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
def test_a_file_beside_another_bag_is_read_and_not_that_bag(tmp_path, kind):
    folder = Bag(kind).scan(T0, [1, 2]).scan(T0 + PERIOD, [1, 2]).write(tmp_path)
    (tmp_path / "other").mkdir()
    (file,) = (Bag(kind).scan(T0, [3, 4]).write(tmp_path / "other")).glob("made.*")
    other = file.rename(folder / f"other{file.suffix}")
    assert [frame.scan.ranges.tolist() for frame in RosBag(str(other)).frames()] == [[3.0, 4.0]]
    assert len(RosBag(str(folder / file.name))) == 2


@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_sqlite3_bag_that_was_cut_short_is_refused_with_what_to_do(tmp_path, with_metadata):
    folder = Bag("sqlite3").scan(T0, np.linspace(1, 5, 5000)).write(tmp_path)
    base = folder / "made.db3"
    base.write_bytes(base.read_bytes()[:-5000])
    if not with_metadata:
        (folder / "metadata.yaml").unlink()
    for read in (RosBag, lambda path: inspect_recording(Path(path))):
        with pytest.raises(BadData, match=r"not a readable bag \(.*malformed\); record or fetch the bag again"):
            read(str(base))


def test_the_proposal_for_a_name_that_begins_like_an_option_can_be_run(tmp_path, monkeypatch):
    bag = Bag("mcap").scan(T0, [1, 2]).scan(T0 + PERIOD, [1, 2]).write(tmp_path).rename(tmp_path / "-run")
    monkeypatch.chdir(tmp_path)
    advice = suggest_config(inspect_recording(Path(bag.name)))
    assert advice.command.startswith("evalkit compare ./-run ")
    assert 'label = "run"' in advice.table


def killed_recorder(folder):
    """Return a bag whose second of two scans is in the log beside the database, not in the database."""
    written = Bag("sqlite3").scan(T0, [1, 2]).scan(T0 + PERIOD, [3, 4]).write(folder)
    with closing(sqlite3.connect(written / "made.db3")) as base:
        last = base.execute("SELECT * FROM messages ORDER BY timestamp DESC LIMIT 1").fetchone()
        base.execute("DELETE FROM messages WHERE id = ?", last[:1])
        base.commit()
        base.execute("PRAGMA journal_mode = WAL")
        base.execute(f"INSERT INTO messages VALUES ({', '.join('?' * len(last))})", last)
        base.commit()
        return shutil.copytree(written, folder / "killed")  # closing removes the log


def test_messages_that_a_killed_recorder_left_in_a_log_are_read(tmp_path):
    bag = killed_recorder(tmp_path)
    assert [frame.scan.ranges.tolist() for frame in RosBag(str(bag)).frames()] == [[1, 2], [3, 4]]


def test_a_log_of_messages_that_cannot_be_read_is_named_and_not_ignored(tmp_path):
    bag = killed_recorder(tmp_path)
    (bag / "made.db3-shm").unlink()
    (bag / "made.db3-shm").symlink_to("missing/index")  # as in a read-only folder: SQLite cannot create it
    with pytest.raises(BadData, match=r"last messages lie in made\.db3-wal.*copy both files to a folder"):
        RosBag(str(bag))


def test_a_sqlite3_bag_may_lie_below_names_that_an_address_would_quote(tmp_path):
    bag = Bag("sqlite3").scan(T0, [1, 2]).write(tmp_path).rename(tmp_path / "run #3 50% of 2?")
    assert len(RosBag(str(bag))) == 1


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x FROM n WHERE x < 0"


@pytest.mark.parametrize("form", ["folder", "file", "compressed"])
@pytest.mark.parametrize(
    ("computed", "changes"),
    [("topics", ["DROP TABLE topics", f"CREATE VIEW topics(id) AS {ENDLESS}"]),
     ("schema", ["DROP TABLE schema", f"CREATE VIEW schema(schema_version) AS {ENDLESS}"]),
     ("messages.data", ["DROP TABLE messages", "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
      "timestamp INTEGER, data BLOB AS (zeroblob(900000000)))", "INSERT INTO messages VALUES (1, 1, 1)"])],
)  # fmt: skip
def test_a_database_that_computes_for_ever_is_refused_before_it_is_asked(tmp_path, form, computed, changes):
    folder = Bag("sqlite3").scan(T0, [1, 2]).write(tmp_path)
    base, metadata = folder / "made.db3", folder / "metadata.yaml"
    with closing(sqlite3.connect(base)) as opened, opened:
        for change in changes:
            opened.execute(change)
    if form == "file":
        metadata.unlink()
    elif form == "compressed":
        (folder / "made.db3.zstd").write_bytes(pytest.importorskip("zstandard").compress(base.read_bytes()))
        base.unlink()
        text = metadata.read_text().replace("made.db3", "made.db3.zstd")
        text = re.sub("compression_format:.*", "compression_format: zstd", text)
        metadata.write_text(re.sub("compression_mode:.*", "compression_mode: file", text))
    for read in (RosBag, lambda path: inspect_recording(Path(path))):
        with pytest.raises(BadData, match=f"its database computes '{computed}' instead of storing it"):
            read(str(base if form == "file" else folder))


def test_a_database_whose_damage_cannot_be_described_in_utf_8_is_refused(tmp_path):
    folder = Bag("sqlite3").scan(T0, [1, 2]).write(tmp_path)
    (folder / "metadata.yaml").unlink()
    with closing(sqlite3.connect(folder / "made.db3")) as base, base:
        base.execute("PRAGMA writable_schema = 1")
        base.execute("UPDATE sqlite_master SET name = CAST(x'a0' AS TEXT), sql = 'nothing' WHERE name = 'topics'")
    with pytest.raises(BadData, match="not a readable bag"):
        RosBag(str(folder / "made.db3"))


# --- very many topics


def million_of_ros_1(folder):
    path = Bag("ros1").scan(T0, [1, 2]).write(folder)
    content = path.read_bytes()
    at = content.index(b"conn_count=") + len(b"conn_count=")
    path.write_bytes(content[:at] + (10**6).to_bytes(4, "little") + content[at + 4 :])
    return path


def many_of_sqlite(folder):
    path = Bag("sqlite3").scan(T0, [1, 2]).write(folder)
    (path / "metadata.yaml").unlink()
    with closing(sqlite3.connect(path / "made.db3")) as base, base:
        base.execute("DROP TABLE topics")
        base.execute(
            "CREATE TABLE topics AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n WHERE id < 200000)"
            " SELECT id, '/t' || id AS name FROM n"
        )
    return path / "made.db3"


def million_in_metadata(folder):
    path = Bag("mcap").scan(T0, [1, 2]).write(folder)
    with (path / "metadata.yaml").open("a") as file:
        file.write(
            "  # of a topic, as long as its entry, a hundred bytes and more, for a million of them ......\n" * 100_000
        )
    return path


@pytest.mark.parametrize(
    ("write", "said"),
    [(million_of_ros_1, "it has 1,000,000 topics, and at most 100,000 are read"),
     (many_of_sqlite, "it has 200,000 topics, and at most 100,000 are read"),
     (million_in_metadata, "its metadata.yaml has 9 MiB: more topics than the 8 MiB that are read")],
)  # fmt: skip
def test_a_bag_with_too_many_topics_is_refused_at_once_with_what_to_do(tmp_path, call_count, write, said):
    """An MCAP file numbers its topics with two bytes. Each topic that is read takes several calls."""
    path = write(tmp_path)
    for read in (RosBag, lambda place: inspect_recording(Path(place))):
        with (
            call_count.counting(),
            pytest.raises(BadData, match=f"{said}.*; copy the topics you need: rosbags-convert"),
        ):
            read(str(path))
    assert call_count.calls < 100_000


MERGED = "a0: &a0 {x: 1}\n" + "".join(f"a{k}: &a{k} {{<<: [{', '.join(12 * [f'*a{k - 1}'])}]}}\n" for k in range(1, 12))
"""Merge keys multiply: a key is copied 12 to the power of 11 times."""


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_metadata_that_multiply_are_not_read(tmp_path, kind, nested):
    """Also the text with the quality of service of a topic is YAML. The file of the bag is read without them."""
    path = Bag(kind).scan(T0, [1, 2]).write(tmp_path)
    file = (path if path.is_dir() else path.parent) / "metadata.yaml"
    text = file.read_text()
    assert "offered_qos_profiles: []" in text
    if nested:
        text = text.replace("offered_qos_profiles: []", f"offered_qos_profiles: {json.dumps(MERGED)}")
    file.write_text(text if nested else MERGED + text)
    assert len(RosBag(str(path))) == 1


def two_robots(folder):
    """A bag of two robots whose frames have the same names: only the namespaces of the topics tell them apart."""
    bag = Bag("mcap")
    for space, x in (("/robot1", 0.1), ("/robot2", 0.2)):
        bag.tf(T0, "base_link", "laser", x, space=space)
    for at in range(30):
        for space, speed in (("/robot1", 1.0), ("/robot2", -2.0)):
            stamp = T0 + at * PERIOD + (space == "/robot2")
            bag.odom(stamp, speed * 0.1 * at, topic=f"{space}/odom")
            bag.tf(stamp, "odom", "base_link", speed * 0.1 * at, static=False, space=space)
            bag.scan(stamp, [2.0, 3.0, math.inf, 4.0, 5.0] if speed > 0 else [2.0] * 5, topic=f"{space}/scan")
    return bag.write(folder)


@pytest.mark.parametrize(("robot", "mounted", "speed"), [("robot1", 0.1, 1.0), ("robot2", 0.2, -2.0)])
def test_a_lidar_gets_the_odometry_and_the_transforms_of_its_own_robot(tmp_path, robot, mounted, speed):
    path = two_robots(tmp_path)
    for odometry in ("auto", "tf"):
        last = list(RosBag(str(path), topic=f"/{robot}/scan", odometry=odometry).frames())[-1]
        assert last.base_from_sensor.x == pytest.approx(mounted)
        assert last.odom_from_base.x == pytest.approx(2.9 * speed)
    chosen = choose_parameters("rosbag", {"path": str(path), "topic": f"/{robot}/scan"})
    assert any(f"odometry /{robot}/odom" in one.reason for one in chosen)


def test_the_inspection_of_a_bag_of_several_robots_is_of_one_and_names_the_topics_of_the_others(tmp_path):
    found = inspect_recording(two_robots(tmp_path))
    advice = suggest_config(found)
    assert [one.topic for one in found.odometries] == ["/robot2/odom", "tf"]  # its lidar has more hits
    assert all(one.jump_count == 0 for one in found.odometries)
    assert advice.parameters["topic"] == "/robot2/scan"
    (said,) = [one.what for one in found.findings if "several robots" in one.what]
    assert said.endswith("left out: /robot1/odom, /robot1/scan, /robot1/tf, /robot1/tf_static")


def test_an_odometry_of_another_namespace_is_taken_where_the_user_names_it(tmp_path):
    given = {"path": str(two_robots(tmp_path)), "topic": "/robot1/scan", "odometry": "/robot2/odom"}
    assert list(RosBag(**given).frames())[-1].odom_from_base.x == pytest.approx(-5.8, abs=0.01)
    assert inspect_recording(Path(given["path"]), given=given).odometries[0].topic == "/robot1/odom"
    assert inspect_recording(Path(given["path"]), given=given).odometries[1].topic == "/robot2/odom"


def test_of_robots_with_the_same_frames_the_odometry_in_the_namespace_of_the_lidar_is_chosen(tmp_path):
    """The first robot has no lidar in the bag."""
    bag = Bag("mcap")
    for at in range(30):
        for space, speed in (("/robot0", -1.0), ("/robot1", 1.0)):
            bag.odom(T0 + at * PERIOD, speed * 0.1 * at, topic=f"{space}/odom")
        bag.scan(T0 + at * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0], topic="/robot1/scan")
    chosen = choose_parameters("rosbag", {"path": str(bag.write(tmp_path))})
    assert [one.value for one in chosen if one.name == "odometry"] == ["/robot1/odom"]


def test_of_a_recording_whose_clock_was_set_back_the_longer_part_is_taken(tmp_path):
    bag = Bag("mcap")
    for at in range(100):
        stamp = T0 + at * PERIOD - (2 * 10**9 + PERIOD // 2 if at >= 50 else 0)
        bag.scan(stamp, [2.0 + 0.01 * at, 3.0, 4.0, 5.0, 6.0], recorded=T0 + at * PERIOD)
    path = bag.write(tmp_path)
    (said,) = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "go back" in one.reason]
    assert "warning: clock set back: the stamps of /scan go back by 1.95 s at 4.9 s (once)" in said
    assert said.endswith("scans of different places mix; mended by --set limit=30")
    assert suggest_config(inspect_recording(path)).parameters["limit"] == 30
    mended = choose_parameters("rosbag", {"path": str(path), "limit": 30})
    assert not [one for one in mended if "go back" in one.reason]
    (found,) = [one for one in inspect_recording(path).findings if "go back" in one.what]
    assert (found.level, found.advice.split(": ")[1]) == ("problem", "--set limit=30 or --set start=70")
    assert RosBag(str(path), limit=30).stamps_ns[-1] == T0 + 29 * PERIOD
    assert RosBag(str(path), start=70).stamps_ns[0] == T0 + 49 * PERIOD + PERIOD // 2


def test_a_scan_that_comes_late_is_no_clock_that_was_set_back(tmp_path):
    bag = Bag("mcap")
    for at in range(40):
        bag.scan(T0 + at * PERIOD, [2.0, 3.0, 4.0], recorded=T0 + at * PERIOD + (10 * PERIOD if at == 20 else 0))
    recording = inspect_recording(bag.write(tmp_path))
    assert recording.lidars[0].timing.backwards == 1
    assert not [one for one in recording.findings if one.level == "problem"]


@pytest.mark.parametrize("apart_s", [3600, -1_600_000_000])
def test_an_odometry_with_another_clock_is_taken_with_the_shift_of_its_times(tmp_path, apart_s):
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(50):
        stamp = T0 + at * PERIOD
        bag.scan(stamp + apart_s * 10**9, [2.0, 3.0, 4.0, 5.0, 6.0], recorded=stamp).odom(stamp, 0.1 * at)
    path = bag.write(tmp_path)
    chosen = choose_parameters("rosbag", {"path": str(path)})
    assert [one.value for one in chosen if one.name in ("odometry", "stamp_shift_s")] == [-apart_s, None]
    side = "before" if apart_s > 0 else "after"
    (said,) = [one.reason for one in chosen if "two clocks" in one.reason and one.reason.startswith("warning")]
    assert f"it begins {abs(apart_s)} s {side} the scans" in said
    mended = choose_parameters("rosbag", {"path": str(path), "stamp_shift_s": -apart_s})
    assert not [one for one in mended if one.value == "none" or "two clocks" in one.reason]
    last = list(RosBag(str(path), stamp_shift_s=-apart_s).frames())[-1]
    assert last.odom_from_base.x == pytest.approx(4.9)


def write_two_clocks(folder, ahead_s, tf=False, late_s=0.0):
    """Write 60 s of a robot that drives straight; the odometry's clock is ahead, a scan is recorded late."""
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(300):
        stamp = T0 + 2 * at * PERIOD
        bag.scan(stamp - round(ahead_s * 1e9), [2.0, 3.0, 4.0, 5.0, 6.0], recorded=stamp + round(late_s * 1e9))
        if tf:
            bag.tf(stamp, "odom", "base_link", 0.1 * at, static=False)
        else:
            bag.odom(stamp, 0.1 * at)
    return bag.write(folder)


@pytest.mark.parametrize(("ahead_s", "tf"), [(37.0, False), (37.0, True), (-0.9, False), (0.4, False)])
def test_clocks_whose_times_overlap_are_told_apart_by_the_times_of_recording(tmp_path, ahead_s, tf):
    path = write_two_clocks(tmp_path, ahead_s, tf)
    said = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "two clocks" in one.reason]
    if abs(ahead_s) < 0.5:  # a recorder may get scans that late
        assert said == []
        return
    side = f"{abs(ahead_s):.2f} s {'ahead of' if ahead_s > 0 else 'behind'} those of the scans: two clocks"
    topic = "tf" if tf else "/odom"
    mend = f"mended by --set stamp_shift_s={ahead_s}"
    assert said == [f"warning: odometry {topic}: by the times of recording, its stamps are {side}; {mend}"]
    mended = choose_parameters("rosbag", {"path": str(path), "stamp_shift_s": ahead_s})
    assert not [one for one in mended if one.name == "problem" and "clocks" in one.reason]
    last = list(RosBag(str(path), stamp_shift_s=ahead_s).frames())[-1]
    assert last.odom_from_base.x == pytest.approx(29.9)


@pytest.mark.parametrize(("late_s", "ahead_s"), [(0.8, 0.0), (0.1, 37.0)])
def test_turns_tell_the_time_of_scans_better_than_the_times_of_recording(tmp_path, late_s, ahead_s):
    """Scans that are recorded late have right stamps."""
    path = turn_to_and_fro(tmp_path, -ahead_s, recorded_s=late_s - ahead_s, time_increment=0.0)
    chosen = choose_parameters("rosbag", {"path": str(path)})
    if not ahead_s:
        assert not [one for one in chosen if "stamp_shift_s" in one.reason]
        return
    (shift_s,) = [one.value for one in chosen if one.name == "stamp_shift_s"]
    assert shift_s == pytest.approx(-ahead_s, abs=0.02)


@pytest.mark.parametrize(("first", "said"), [(0, 0), (4, 0), (6, 1)])
def test_scans_without_odometry_are_a_warning_where_they_are_many(tmp_path, first, said):
    """Of 50 scans, ``first`` are taken before the odometry begins."""
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(50):
        bag.scan(T0 + at * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0])
        if at > first - 1:
            bag.odom(T0 + at * PERIOD, 0.1 * at)
    found = [
        one for one in choose_parameters("rosbag", {"path": str(bag.write(tmp_path))}) if "at their time" in one.reason
    ]
    assert [(one.reason.split(":")[0], one.warns) for one in found] == [
        ("6 of 50 scans have no odometry at their time", True)
    ] * said


@pytest.mark.parametrize(("given", "start", "scans"), [({}, 3, 47), ({"every": 2}, 4, 23), ({"start": 1}, None, 49)])
def test_the_few_scans_before_the_odometry_begins_are_left_out(tmp_path, given, start, scans):
    """Wheel odometry alone, the baseline, cannot start there. Of every second scan, 0 and 2 are before it, 4 is not."""
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(50):
        bag.scan(T0 + at * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0])
        if at >= 3:
            bag.odom(T0 + at * PERIOD, 0.1 * at)
    path = bag.write(tmp_path)
    chosen = choose_parameters("rosbag", {"path": str(path), **given})
    assert [one.value for one in chosen if one.name == "start"] == [start] * (start is not None)
    suggested = suggest_config(inspect_recording(path, "rosbag", given), given)
    assert (suggested.scans, suggested.parameters.get("start")) == (scans, start or given.get("start"))
    read = next(iter(RosBag(**suggested.parameters).frames()))
    assert (read.odom_from_base is None) is (start is None)


def test_an_odometry_with_another_clock_is_no_problem_beside_one_that_can_be_used(tmp_path):
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(50):
        stamp = T0 + at * PERIOD
        bag.scan(stamp, [2.0, 3.0, 4.0, 5.0, 6.0]).odom(stamp, 0.1 * at, topic="/wheels")
        bag.odom(stamp + 3600 * 10**9, 0.1 * at, topic="/visual")
    path = bag.write(tmp_path)
    chosen = choose_parameters("rosbag", {"path": str(path)})
    assert [one.value for one in chosen if one.name == "odometry"] == ["/wheels"]
    assert not [one for one in chosen if "two clocks" in one.reason]
    assert [one.level for one in inspect_recording(path).findings if "two clocks" in one.what] == ["warning"]


def turn_to_and_fro(folder, late_s, other="", recorded_s=0.0, **scan):
    """Write a lidar that turns to and fro on the spot, five scans a second, each seen ``late_s`` after its stamp.

    The odometry of the topic ``other`` has the times of the scans, which are recorded ``recorded_s`` after them.
    """
    bag, angles = Bag("mcap"), np.radians(np.arange(-180.0, 180.0))
    for k in range(1500):
        bag.odom(T0 + k * PERIOD * 2 // 5, 0.0, yaw=math.sin(0.7 * 0.04 * k))
        if other:
            bag.odom(T0 + k * PERIOD * 2 // 5, 0.0, yaw=math.sin(0.7 * (0.04 * k + late_s)), topic=other)
    for k in range(10, 290):
        ways = angles + math.sin(0.7 * (0.2 * k + late_s))
        room = 3.0 + np.cos(2 * ways) + 0.5 * np.sin(5 * ways) + 0.3 * np.cos(11 * ways + 1.0)
        stated = {"angle_min": -math.pi, "angle_increment": math.radians(1.0), **scan}
        stamp = T0 + 2 * k * PERIOD
        bag.scan(stamp, room, recorded=stamp + round(recorded_s * 1e9), **stated)
    return bag.write(folder)


def test_half_a_revolution_whose_time_is_not_stated_is_no_wrong_stamp(tmp_path):
    path = turn_to_and_fro(tmp_path, 0.1, time_increment=0.0)
    (said,) = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "stamps of" in one.reason]
    assert float(re.search(r"taken (.*) s later than their stamps say", said)[1]) == pytest.approx(0.1, abs=0.021)
    assert said.endswith("if the lidar turns once a scan: --set sweep_s=0.2")
    mended = choose_parameters("rosbag", {"path": str(path), "sweep_s": 0.2})
    assert not [one for one in mended if "stamps of" in one.reason]


def test_a_time_increment_that_cannot_be_right_is_a_problem_and_no_wrong_stamp(tmp_path):
    """Its driver writes the time of a revolution as that between two beams."""
    path = turn_to_and_fro(tmp_path, 0.1, time_increment=0.2)

    def tell(**given):
        found = choose_parameters("rosbag", {"path": str(path), **given})
        return [one.reason for one in found if "time_increment" in one.reason or "stamps of" in one.reason]

    what = "a scan takes 71.8 s by its time_increment, but the next begins after 0.2 s"
    assert tell() == [f"warning: /scan: {what}; mended by --set sweep_s=0.2"]
    assert tell(sweep_s=0.2) == []


def test_scans_that_agree_with_one_odometry_have_no_wrong_stamps(tmp_path):
    path = turn_to_and_fro(tmp_path, 0.3, "/wheels", time_increment=0.0)
    (said,) = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "stamps of" in one.reason]
    assert said.endswith("but /wheels agrees with them; use --set odometry=/wheels")


@pytest.mark.parametrize("late_s", [0.3, -0.2])
def test_the_shift_that_is_suggested_for_wrong_stamps_mends_them(tmp_path, late_s):
    path = turn_to_and_fro(tmp_path, late_s, time_increment=0.0)
    (said,) = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "stamps of" in one.reason]
    assert "if the stamps of the scans are wrong, not those of the odometry" in said
    shift_s = float(said.rpartition("--set stamp_shift_s=")[2])
    assert shift_s == pytest.approx(late_s, abs=0.02)
    (turn,) = inspect_recording(path, given={"stamp_shift_s": shift_s}).turns.values()
    assert turn.shift_s == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize(("robot", "mounted", "speed"), [("robot1", 0.1, 1.0), ("robot2", 0.2, -2.0)])
def test_frames_with_the_prefix_of_a_robot_are_odometry_and_base(tmp_path, robot, mounted, speed):
    bag = Bag("mcap")
    for name, x in (("robot1", 0.1), ("robot2", 0.2)):  # all in /tf, and no odometry messages
        bag.tf(T0, f"{name}/base_link", f"{name}/laser", x, quaternion=(1.0, 0.0, 0.0, 0.0))
    for at in range(30):
        for name, pace in (("robot1", 1.0), ("robot2", -2.0)):
            stamp = T0 + at * PERIOD
            bag.tf(stamp, f"{name}/odom", f"{name}/base_link", pace * 0.1 * at, static=False)
            bag.scan(stamp, [2.0, 3.0, 4.0, 5.0, 6.0], topic=f"/{name}/scan", frame=f"{name}/laser")
    path = bag.write(tmp_path)
    given = {"path": str(path), "topic": f"/{robot}/scan"}
    chosen = {one.name: one.value for one in choose_parameters("rosbag", given)}
    assert chosen["base_frame"] == f"{robot}/base_link"
    for parameters in (given, given | {"base_frame": chosen["base_frame"]}):
        last = list(RosBag(**parameters).frames())[-1]
        assert last.base_from_sensor.x == pytest.approx(mounted)
        assert last.odom_from_base.x == pytest.approx(2.9 * speed)
        assert last.scan.angles[0] == pytest.approx(1.0)  # upside down
    found = inspect_recording(path)
    assert {seat.sensor: (seat.base, seat.mirrored) for seat in found.frames.mountings} == {
        f"{name}/laser": (f"{name}/base_link", True) for name in ("robot1", "robot2")
    }


def test_angles_in_degrees_are_a_problem_that_the_parameter_of_the_unit_mends(tmp_path):
    bag = Bag("mcap")
    for at in range(20):
        bag.scan(T0 + at * PERIOD, [2.0 + 0.01 * at] * 360, angle_min=-180.0, angle_max=179.0, angle_increment=1.0)
    path = bag.write(tmp_path)
    (said,) = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if "degrees" in one.reason]
    assert "360 beams 57.3 deg apart are more than a full turn: degrees taken for radians?" in said
    fields = re.search(r"fields=(.*)'$", said)[1]
    angles = next(RosBag(str(path), fields=fields).frames()).scan.angles
    np.testing.assert_allclose(np.degrees(angles[[0, -1]]), [-180.0, 179.0])
    assert next(RosBag(str(path), fields=fields).frames()).scan.time_increment_ns == 10_000_000  # as without fields
    mended = choose_parameters("rosbag", {"path": str(path), "fields": fields})
    assert not [one for one in mended if "degrees" in one.reason]


def test_a_lidar_without_a_mounting_is_said_to_be_taken_as_the_base(tmp_path):
    told = "the lidar is taken as the base"
    bare, seated = tmp_path / "bare", tmp_path / "seated"
    for folder in (bare, seated):
        folder.mkdir()
        bag = Bag("mcap")
        if folder is seated:
            bag.tf(T0, "base_link", "laser")
        for at in range(20):
            bag.scan(T0 + at * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0])
        chosen = choose_parameters("rosbag", {"path": str(bag.write(folder))})
        assert any(one.reason.startswith(told) for one in chosen) is (folder is bare)


@pytest.mark.parametrize("stamped", [False, True])
def test_an_odometry_without_any_stamp_has_the_times_of_recording_as_the_scans_have(tmp_path, stamped):
    """A clock of a simulation begins at 0: its first stamp is one."""
    bag = Bag("mcap").tf(T0, "base_link", "laser")
    for at in range(50):
        stamp = at * PERIOD if stamped else 0
        bag.odom(stamp, 0.1 * at, recorded=T0 + at * PERIOD)
        bag.scan(stamp or stamped, [2.0, 3.0, 4.0, 5.0, 6.0], recorded=T0 + at * PERIOD)
    path = bag.write(tmp_path)
    recording = RosBag(str(path))
    assert list(recording.frames())[-1].odom_from_base.x == pytest.approx(4.9)
    assert (
        recording.notes().get("odometry poses without a stamp, given the time of recording", 0) == (0, 50)[not stamped]
    )
    assert not [one for one in inspect_recording(path).findings if one.level == "problem"]


def test_scans_with_one_stamp_are_not_said_to_be_placed_apart(tmp_path):
    bag = Bag("mcap")
    for at in range(20):
        bag.scan(T0, [2.0, 3.0, 4.0, 5.0, 6.0], recorded=T0 + at * PERIOD)
    path = bag.write(tmp_path)
    (said,) = [one for one in inspect_recording(path).findings if "stamp of another scan" in one.what]
    assert said.advice == "the reader keeps the first of equal stamps; record the time of each scan"
    assert len(RosBag(str(path))) == 1


def test_a_lidar_whose_frame_no_transform_names_is_told_which_frames_there_are(tmp_path):
    bag = Bag("mcap").tf(T0, "base_link", "lidar_link", 0.2)
    for at in range(20):
        bag.odom(T0 + at * PERIOD, 0.1 * at).scan(T0 + at * PERIOD, [2.0, 3.0, 4.0, 5.0, 6.0], frame="laser")
    path = bag.write(tmp_path)
    (said,) = [one for one in inspect_recording(path).findings if one.about == "lidar frame laser"]
    assert said.what == "no transform leads to it; those in the recording have the frames base_link, lidar_link"
    reasons = [one.reason for one in choose_parameters("rosbag", {"path": str(path)}) if one.name == "base_from_sensor"]
    assert ["of 'laser', but those of base_link, lidar_link" in reason for reason in reasons] == [True]
