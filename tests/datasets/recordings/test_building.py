"""Recordings built from published files: clocks, stamps, odometry, and MRPT's rawlog."""

import gzip
import json
import math
import struct
import tarfile

import numpy as np
import pytest

from evalkit.core.errors import BadData
from evalkit_datasets.parsing import carmen_parser
from evalkit_datasets.recordings import catalog
from evalkit_datasets.recordings.building import fr079, graph_poses, intel, mrpt_rawlog
from evalkit_datasets.recordings.building.builders import iter_built
from evalkit_datasets.recordings.fetch import list_downloads

S = 1_000_000_000


def test_between_known_stamps_the_difference_of_the_clocks_is_interpolated():
    # differences 100 at 10 and 140 at 30: 120 at 20; outside, the nearest one
    assert fr079.interpolate_clock([0, 10, 20, 30, 40], {1: 110, 3: 170}) == [100, 110, 140, 170, 180]
    with pytest.raises(ValueError, match="no scan has a known stamp"):
        fr079.interpolate_clock([0, 1], {})


def test_stamps_are_spread_evenly_between_fixed_ones_and_within_their_limits():
    first = np.array([10, 0, 0, 0, 50, 0]) * S
    last = np.array([10, 99, 99, 15, 50, 55]) * S
    # 10 and 50 are single possibilities; 1 is known; 2 lies between 30 and 50 by index; 3 is limited to 15
    stamps = intel.spread_stamps(first, last, {1: 30 * S})
    assert (stamps // S).tolist() == [10, 30, 36, 15, 50, 50]
    assert stamps[5] == 50 * S + intel.PERIOD_NS


def test_without_a_fixed_stamp_scans_follow_each_other_by_the_period():
    stamps = intel.spread_stamps(np.zeros(3, dtype=np.int64), np.full(3, 99 * S), {})
    assert stamps.tolist() == [0, intel.PERIOD_NS, 2 * intel.PERIOD_NS]


def test_a_compass_heading_becomes_a_yaw(tmp_path):
    path = tmp_path / "pose.log"
    path.write_text("2.5, 0, 0, 0, 1.0, 2.0, 1.570796\n1.5, 0, 0, 0, 0.5, 0.0, 6.283185\n")
    (first, one), (second, two) = intel.read_odometry(path)
    assert (first, second) == (1_500_000_000, 2_500_000_000)
    assert float(two[2]) == pytest.approx(0.0, abs=1e-6)  # north is pi/2
    assert float(one[2]) == pytest.approx(math.pi / 2, abs=1e-6)  # a full turn later, wrapped


@pytest.mark.parametrize(("text", "part"), [("1 2 3\n", "line 1: 3 columns"), ("1,0,0,0,1,nan,0\n", "line 1: a value")])
def test_damaged_odometry_is_reported_with_its_line(tmp_path, text, part):
    path = tmp_path / "pose.log"
    path.write_text(text)
    with pytest.raises(BadData, match=part):
        intel.read_odometry(path)


@pytest.mark.parametrize("text", ["[]", "{}", '{"map": {"x": {"range": [1]}}}', '{"map": {"1": {"range": ["a"]}}}'])
def test_damaged_readings_are_reported(tmp_path, text):
    path = tmp_path / "readings.json"
    path.write_text(text)
    with pytest.raises(BadData, match=r"readings\.json: not a table of scans"):
        intel.read_readings(path)


def record(ranges, motion):
    """Return one record of a rawlog: the marks at their places, the values between them."""
    content = bytearray(1313)
    for at, mark in mrpt_rawlog._MARKS:
        content[at : at + len(mark)] = mark
    content[214 : 214 + 720] = struct.pack("<180f", *ranges)
    content[1204:1228] = struct.pack("<3d", *motion)
    return bytes(content)


def test_a_rawlog_is_decoded(tmp_path):
    path = tmp_path / "a.rawlog"
    path.write_bytes(gzip.compress(record([1.5] * 180, (0.1, 0.2, 0.3)) + record([2.5] * 180, (0.0, 0.0, -1.0))))
    ranges, motions = mrpt_rawlog.read_rawlog(path)
    assert ranges[:, [0, 179]].tolist() == [[1.5, 1.5], [2.5, 2.5]]
    assert motions.tolist() == [[0.1, 0.2, 0.3], [0.0, 0.0, -1.0]]


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (record([1.0] * 180, (0, 0, 0))[:-1], "record 1: cut short after 1312 bytes"),
        (record([1.0] * 180, (0, 0, 0)) + bytes(1313), "record 2: expected .*CSensoryFrame"),
        (record([math.nan] * 180, (0, 0, 0)), "a value is not finite"),
    ],
)
def test_a_damaged_rawlog_is_reported_with_the_record(tmp_path, content, part):
    path = tmp_path / "a.rawlog"
    path.write_bytes(content)
    with pytest.raises(BadData, match=part):
        mrpt_rawlog.read_rawlog(path)


def write_rawlog(folder, poses):
    """Write a rawlog whose scan k measures k + 1 m, at poses along x, and odometry rows a second apart."""
    motions = np.diff([*poses, poses[-1]])
    rawlog = folder / "a.rawlog"
    rawlog.write_bytes(b"".join(record([k + 1.0] * 180, (step, 0.0, 0.0)) for k, step in enumerate(motions)))
    return rawlog


def test_a_scan_of_the_rawlog_gets_the_time_of_the_odometry_row_with_its_pose(tmp_path):
    odometry = tmp_path / "pose.log"
    east = "1.570796326794896619"
    odometry.write_text("".join(f"{t}, 0, 0, 0, {x}, 0, {east}\n" for t, x in [(0, 0), (1, 0.5), (2, 1.0), (3, 1.5)]))
    rows = intel.read_odometry(odometry)
    rawlog = write_rawlog(tmp_path, [0.0, 1.0, 1.5])
    known = {intel.centimetres(np.full(180, 3.0)).tobytes(): 3 * S}  # the third scan is known exactly
    found = intel.stamp_rawlog(rawlog, rows, known)
    assert [scan.stamp_ns for scan in found] == [intel.AFTER_ROW_NS, 2 * S + intel.AFTER_ROW_NS]
    with pytest.raises(BadData, match="record 2: its pose is not in the raw odometry"):
        intel.stamp_rawlog(write_rawlog(tmp_path, [0.0, 0.7]), rows, {})


def test_the_exact_log_of_intel_has_the_scans_of_graph_and_readings_and_all_odometry(tmp_path):
    graph, readings, odometry = (tmp_path / name for name in ("g.log", "r.json", "o.log"))
    graph.write_text(graph_line(102.5, (9, 8, 0.5), [2.0] * 180))
    readings.write_text(json.dumps({"map": {"101.25": {"range": [1.5] * 180}}}))
    odometry.write_text("".join(f"{100 + k} 0 0 0 {k} 0 {math.pi / 2}\n" for k in range(4)))
    log = tmp_path / "exact.clf"
    log.write_text("".join(intel.build_exact_log(graph, readings, odometry)))
    content = carmen_parser.Log((-90.0, 0.0))
    found = [(reading.stamp_ns, reading.ranges[0]) for _, reading in carmen_parser.iter_readings(log, content)]
    assert found == [(101 * S + S // 4, 1.5), (102 * S + S // 2, 2.0)]
    assert [row[0] for row in content.odometry.poses] == [0.0, 1.0, 2.0, 3.0]


def graph_line(stamp, pose, ranges):
    words = " ".join(f"{one:.2f}" for one in ranges)
    x, y, theta = pose
    poses = f"{x} {y} {theta} {x} {y} {theta}"
    return f"ROBOTLASER1 0 -1.57 3.14 0.0175 50 0.1 0 {len(ranges)} {words} 0 {poses} 0 0 0 0 0 {stamp} x 0\n"


def test_the_log_has_all_scans_and_no_pose(tmp_path):
    scans = [[1.0 + 0.01 * k] * 180 for k in range(3)]
    corrected, graph = tmp_path / "c.log", tmp_path / "g.log"
    corrected.write_text(
        "".join(f"FLASER 180 {' '.join(map(str, s))} 1 2 3 1 2 3 {t} pippo {t}\n" for t, s in enumerate(scans))
    )
    graph.write_text(
        "VERTEX2 0 0 0 0\n" + graph_line(100.0, (7, 8, 0.5), scans[0]) + graph_line(102.5, (9, 8, 0.5), scans[2])
    )
    log = tmp_path / "built.clf"
    log.write_text("".join(fr079.build_log(corrected, graph)))
    content = carmen_parser.Log((-90.0, 0.0))
    readings = [reading for _, reading in carmen_parser.iter_readings(log, content)]
    assert [reading.stamp_ns for reading in readings] == [100 * S, 101 * S + S // 4, 102 * S + S // 2]
    assert [reading.ranges[0] for reading in readings] == [1.0, 1.01, 1.02]
    assert {reading.robot for reading in readings} == {(0.0, 0.0, 0.0)}
    assert content.parameters["robot_frontlaser_offset"] == "-0.04"
    assert (
        list(graph_poses.build_trajectory(graph))[1] == "100.000000 7.000000 8.000000 0 0 0 0.247403959 0.968912422\n"
    )


def test_a_damaged_source_is_reported_with_its_line(tmp_path):
    graph = tmp_path / "g.log"
    graph.write_text("ROBOTLASER1 0 -1.57\n")
    with pytest.raises(BadData, match=r"g\.log: line 1"):
        list(graph_poses.build_trajectory(graph))


def test_a_member_of_an_archive_is_unpacked(tmp_path):
    (tmp_path / "a.log").write_bytes(b"1 2 3\n")
    archive = tmp_path / "a.tar.gz"
    with tarfile.open(archive, "w:gz") as file:
        file.add(tmp_path / "a.log", "in/a.log")
    assert b"".join(iter_built("in/a.log", [archive])) == b"1 2 3\n"
    for name, path in (("in/b.log", archive), ("in/a.log", tmp_path / "a.log")):
        with pytest.raises(BadData, match="cannot be unpacked"):
            list(iter_built(name, [path]))


def test_the_downloads_of_a_built_file_are_its_sources(tmp_path, monkeypatch):
    monkeypatch.setenv(catalog.VARIABLE, str(tmp_path))
    monkeypatch.setattr(catalog, "cache_folder", lambda: tmp_path / "cache")
    assert [card.name for card in list_downloads(["fr079-built.clf", "fr079-reference-flirtlib.tum"])] == [
        "freiburg-079-corrected.log.gz", "flirtlib-fr079.log",
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, card in catalog.load_catalog().items() if card.build])
def test_a_built_file_equals_its_catalogue_entry(name, tmp_path):
    card = catalog.get_file(name)
    sources = [catalog.find_local(catalog.get_file(source)) for source in card.sources]
    if None in sources:
        pytest.skip(f"no source of {name} at hand (set EVALKIT_DATA)")
    path = tmp_path / "built"
    path.write_bytes(b"".join(iter_built(card.build, sources)))
    catalog.verify(card, path)


def test_json_of_readings_is_read(tmp_path):
    path = tmp_path / "readings.json"
    path.write_text(json.dumps({"map": {"976052890.244111": {"range": [1.09, 81.83], "x": 0, "y": 0, "theta": 0}}}))
    (scan,) = intel.read_readings(path)
    assert scan.stamp_ns == 976052890_244111000
    assert scan.ranges_cm.tolist() == [109, 8183]
