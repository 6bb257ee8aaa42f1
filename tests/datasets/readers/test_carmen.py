"""CARMEN logs as sequences."""

import gzip
import math
import os
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import BadData, BadParameter, DataMissing
from evalkit.core.pose import Pose
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.readers.carmen import SPEC, Carmen

DATA = Path(os.environ.get("EVALKIT_DATA") or "absent")


def flaser(stamp, ranges=None, laser=(0.0, 0.0, 0.0), robot=(0.0, 0.0, 0.0), host="robot"):
    ranges = [2.0] * 180 if ranges is None else ranges
    words = ["FLASER", len(ranges), *ranges, *laser, *robot, stamp, host, "0.5"]
    return " ".join(map(str, words))


def robotlaser(stamp, ranges, robot=(1.0, 2.0, 0.5), step=0.5, remissions=(), fov=None):
    fov = step * (len(ranges) - 1) if fov is None else fov
    words = ["ROBOTLASER1", 0, -1.0, fov, step, 80.0, 0.01, 0, len(ranges), *ranges, len(remissions), *remissions]
    return " ".join(map(str, [*words, *robot, *robot, 0, 0, 0, 0, 0, stamp, "robot", "0.5"]))


def rawlaser(stamp, ranges, start=-1.0, step=0.5, remissions=()):
    words = ["RAWLASER1", 0, start, step * (len(ranges) - 1), step, 80.0, 0.01, 0, len(ranges), *ranges]
    return " ".join(map(str, [*words, len(remissions), *remissions, stamp, "robot", "0.5"]))


def odom(stamp, x=0.0, y=0.0, theta=0.0):
    return f"ODOM {x} {y} {theta} 0 0 0 {stamp} robot 0.5"


def log(tmp_path, *lines, name="some.log", pack=False):
    path = tmp_path / name
    content = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(content) if pack else content)
    return str(path)


def ranges_of(sequence, index=0):
    return list(sequence.frames())[index].scan.ranges


def beams(*values, fill=2.0):
    return [*values, *[fill] * (180 - len(values))]


# --- meaning of the lines


def test_the_stamp_is_the_ipc_time_to_the_nanosecond(tmp_path):
    frame = next(Carmen(log(tmp_path, flaser("976052857.337534001"))).frames())
    assert frame.scan.stamp_ns == 976052857337534001


def test_headers_and_comments_that_contain_flaser_are_not_scans(tmp_path):
    header = ["# message formats defined: PARAM ODOM FLASER", "# FLASER n r1 r2", "", "PARAM x y nohost 0"]
    sequence = Carmen(log(tmp_path, *header, flaser(1.0)))
    assert len(sequence) == 1
    assert sequence.notes() == {}


@pytest.mark.parametrize(("count", "last_deg"), [(180, 89.0), (181, 90.0), (360, 89.5), (361, 90.0)])
def test_the_number_of_beams_determines_the_angles(tmp_path, count, last_deg):
    angles = next(Carmen(log(tmp_path, flaser(1.0, [2.0] * count))).frames()).scan.angles
    assert math.degrees(angles[0]) == pytest.approx(-90.0)
    assert math.degrees(angles[-1]) == pytest.approx(last_deg)


def test_an_unknown_number_of_beams_requires_the_angle_step(tmp_path):
    path = log(tmp_path, flaser(1.0, [2.0] * 541))
    with pytest.raises(BadData, match=r"541 beams.*step_deg"):
        Carmen(path)
    angles = next(Carmen(path, start_deg=-135.0, step_deg=0.5).frames()).scan.angles
    assert math.degrees(angles[-1]) == pytest.approx(135.0)


def test_robotlaser_lines_contain_their_own_angles_and_optional_remissions(tmp_path):
    lines = [robotlaser(1.0, [2.0, 3.0, 4.0]), robotlaser(2.0, [2.0, 3.0, 4.0], remissions=(7, 8, 9))]
    first, second = Carmen(log(tmp_path, *lines)).frames()
    assert first.scan.angles.tolist() == second.scan.angles.tolist() == [-1.0, -0.5, 0.0]
    assert second.scan.ranges.tolist() == [2.0, 3.0, 4.0]
    assert second.scan.stamp_ns == 2 * 10**9


def test_a_log_of_raw_scans_has_their_angles_and_the_odometry_of_its_odom_lines(tmp_path):
    lines = (odom(0.0), rawlaser(1.0, [2.0, 3.0, 4.0], remissions=(7, 8)), odom(2.0, x=1.0), rawlaser(2.0, [5.0] * 3))
    path = log(tmp_path, "PARAM robot_frontlaser_offset 0.2", *lines)
    frames = list(Carmen(path).frames())
    np.testing.assert_allclose([frame.scan.ranges for frame in frames], [[2.0, 3.0, 4.0], [5.0, 5.0, 5.0]])
    np.testing.assert_allclose(frames[0].scan.angles, [-1.0, -0.5, 0.0])
    assert [frame.odom_from_base.x for frame in frames] == [0.5, 1.0]
    assert frames[0].base_from_sensor.x == 0.2
    found = inspect_recording(Path(path))
    assert (found.lidars[0].topic, found.lidars[0].beams) == ("RAWLASER1", 3)
    assert next(Carmen(log(tmp_path, *lines[1::2])).frames()).odom_from_base is None


def test_raw_scans_beside_the_same_ones_with_poses_are_not_read_twice(tmp_path):
    path = log(tmp_path, rawlaser(1.0, [2.0] * 3), robotlaser(1.1, [3.0] * 3), rawlaser(2.0, [2.0] * 3))
    (frame,) = Carmen(path).frames()
    assert frame.scan.ranges[0] == 3.0
    assert Carmen(path).notes() == {}


def old_laser(kind, stamp, ranges):
    return " ".join(map(str, [kind, len(ranges), *ranges, stamp, "robot", "0.5"]))


def test_lines_of_the_old_format_are_read_where_no_other_line_has_a_scan(tmp_path):
    """``LASER3 n r1..rn ipc_t host logger_t``, 181 beams from -90 deg on (readlog.c); LASER4 is another lidar."""
    lines = [
        old_laser("LASER4", 1.0, [3.0] * 181), odom(1.0, 0.5), old_laser("LASER3", 1.5, [*[2.0] * 180, 4.0]),
        old_laser("LASER", 1.6, [9.0] * 181), odom(2.0, 1.5),
    ]  # fmt: skip
    path = log(tmp_path, *lines)
    (frame,) = Carmen(path).frames()
    assert frame.scan.stamp_ns == 1_500_000_000
    assert (frame.scan.ranges[0], frame.scan.ranges[-1]) == (2.0, 4.0)
    assert np.degrees(frame.scan.angles[[0, -1]]) == pytest.approx([-90.0, 90.0])
    assert frame.odom_from_base.x == pytest.approx(1.0)
    found = inspect_recording(Path(path))
    assert (found.lidars[0].topic, found.lidars[0].beams) == ("LASER3", 181)
    assert "LASER3 lines do not contain angles" in " ".join(one.what for one in found.findings)
    (raw,) = Carmen(log(tmp_path, *lines, rawlaser(3.0, [5.0] * 3))).frames()
    assert raw.scan.ranges[0] == 5.0


def test_a_laser_line_without_a_number_is_no_line_of_a_carmen_log(tmp_path):
    path = log(tmp_path, old_laser("LASER", 1.0, [200.0] * 180))
    with pytest.raises(BadData, match="no line begins with FLASER, ROBOTLASER1, RAWLASER1 or LASER3 to LASER5"):
        Carmen(path)
    with pytest.raises(BadData, match="no line begins with FLASER"):
        inspect_recording(Path(path))


def test_a_damaged_line_of_a_raw_scan_is_counted(tmp_path):
    path = log(tmp_path, rawlaser(1.0, [2.0] * 3), rawlaser(2.0, [2.0] * 3)[:-12])
    assert Carmen(path).notes() == {"damaged lines dropped": 1}


def test_a_robotlaser_line_uses_its_angle_step_not_its_field_of_view(tmp_path):
    angles = next(Carmen(log(tmp_path, robotlaser(1.0, [2.0] * 361, step=0.008727, fov=3.150319))).frames()).scan.angles
    assert angles[-1] == pytest.approx(-1.0 + 360 * 0.008727)


def test_gzip_is_detected_by_content_not_by_name(tmp_path):
    assert len(Carmen(log(tmp_path, flaser(1.0), pack=True, name="packed.log"))) == 1
    assert len(Carmen(log(tmp_path, flaser(1.0), name="plain.log.gz"))) == 1


# --- ranges


@pytest.mark.parametrize("code", [81.83, 81.91, 50.0, 51.06, 51.25, 80.0, 32.767, math.inf])
def test_no_return_codes_become_inf(tmp_path, code):
    ranges = ranges_of(Carmen(log(tmp_path, flaser(1.0, beams(code, 49.9)))))
    assert np.isposinf(ranges[0])
    assert ranges[1] == 49.9


def test_millimetre_codes_apply_only_if_no_range_is_longer(tmp_path):
    short = Carmen(log(tmp_path, flaser(1.0, beams(8.19, 8.0)), name="short.log"))
    long = Carmen(log(tmp_path, flaser(1.0, beams(8.19, 12.0)), name="long.log"))
    assert np.isposinf(ranges_of(short)[0])
    assert ranges_of(long)[0] == 8.19


def test_the_maximum_range_is_a_parameter(tmp_path):
    ranges = ranges_of(Carmen(log(tmp_path, flaser(1.0, beams(30.0, 29.99))), range_max_m=30.0))
    assert np.isposinf(ranges[0])
    assert ranges[1] == 29.99


def test_ranges_below_the_minimum_are_invalid_and_counted(tmp_path):
    path = log(tmp_path, flaser(1.0, beams(0.29, 0.3, 81.83)))
    sequence = Carmen(path, range_min_m=0.3)
    np.testing.assert_equal(ranges_of(sequence)[:4], [math.nan, 0.3, math.inf, 2.0])
    assert next(sequence.frames()).scan.range_min_m == 0.3
    assert sequence.notes() == {"invalid ranges": 1}
    assert ranges_of(Carmen(path))[0] == 0.29
    with pytest.raises(BadParameter, match=r"carmen: parameter 'range_min_m': found '50', expected less than .* 50 m"):
        Carmen(path, range_min_m=50.0)


def test_nan_negative_and_zero_ranges_are_invalid_and_counted(tmp_path):
    sequence = Carmen(log(tmp_path, flaser(1.0, beams("NaN", -1.0, 0, "-inf", 3.0))))
    ranges = ranges_of(sequence)
    assert np.isnan(ranges[:4]).all()
    assert ranges[4] == 3.0
    assert sequence.notes() == {"invalid ranges": 4}


# --- time


def test_scans_are_sorted_and_repeated_stamps_dropped(tmp_path):
    lines = [flaser(3.0), flaser(1.0), flaser(2.0), flaser(3.0, beams(9.0)), flaser(4.0)]
    sequence = Carmen(log(tmp_path, *lines))
    assert [frame.scan.stamp_ns // 10**9 for frame in sequence.frames()] == [1, 2, 3, 4]
    assert ranges_of(sequence, 2)[0] == 2.0
    for first in range(5):
        assert [frame.scan.stamp_ns // 10**9 for frame in sequence.frames_from(first)] == [1, 2, 3, 4][first:]
    assert sequence.notes() == {"scans out of order": 1, "scans with a repeated stamp dropped": 1}


def test_start_every_and_limit_choose_scans(tmp_path):
    path = log(tmp_path, *(flaser(float(stamp)) for stamp in range(10)))
    chosen = Carmen(path, start=1, every=3, limit=2)
    assert [frame.scan.stamp_ns // 10**9 for frame in chosen.frames()] == [1, 4]
    assert len(chosen) == 2
    with pytest.raises(BadData, match="start 10 lies beyond its 10 scans"):
        Carmen(path, start=10)


@pytest.mark.parametrize("tail", [[], ["NEFF 3"]])
def test_scans_without_usable_stamps_are_placed_in_line_order_in_every_log(tmp_path, tail):
    lines = [flaser(0, robot=(float(at), 0, 0)) for at in range(3)]
    sequence = Carmen(log(tmp_path, "ODOM 9 9 9 0 0 0 0 h 0", *lines, *tail))
    frames = list(sequence.frames())
    assert [frame.scan.stamp_ns // 10**9 for frame in frames] == [0, 1, 2]
    assert sequence.notes()["scans with unusable stamps, placed one second apart in line order"] == 3
    # raw poses are odometry: those in the lines of the scans, since an ODOM line cannot be related to a scan
    assert [frame.odom_from_base and frame.odom_from_base.x for frame in frames] == ([None] * 3 if tail else [0, 1, 2])


def test_odometry_lines_without_usable_stamps_cannot_be_chosen(tmp_path):
    path = log(tmp_path, "ODOM 9 9 9 0 0 0 0 h 0", *[flaser(0)] * 3)
    with pytest.raises(BadData, match="odometry 'odom-lines': no usable stamps; use 'scan-poses'"):
        Carmen(path, odometry="odom-lines")


def test_frames_can_be_iterated_again(tmp_path):
    sequence = Carmen(log(tmp_path, flaser(1.0), flaser(2.0)))
    assert [f.scan.stamp_ns for f in sequence.frames()] == [f.scan.stamp_ns for f in sequence.frames()]


# --- odometry and mounting


def test_odometry_is_interpolated_at_the_scan_along_the_shorter_rotation(tmp_path):
    lines = [odom(1.0, 0.0, 0.0, 3.1), flaser(1.5), odom(2.0, 1.0, -2.0, -3.1)]
    pose = next(Carmen(log(tmp_path, *lines)).frames()).odom_from_base
    assert (pose.x, pose.y) == (0.5, -1.0)
    assert abs(pose.theta) == pytest.approx(np.pi)


def test_odometry_is_not_extrapolated(tmp_path):
    lines = [flaser(1.0), odom(2.0, 1.0), flaser(2.5), odom(3.0, 2.0), flaser(3.04), flaser(4.0)]
    sequence = Carmen(log(tmp_path, *lines))
    poses = [frame.odom_from_base for frame in sequence.frames()]
    assert poses == [None, Pose(1.5), Pose(2.0), None]
    assert sequence.notes() == {
        "scans without odometry at their time": 2,
        "scans up to 50 ms outside the odometry, given its nearest pose": 1,
    }


def test_scans_in_an_odometry_gap_are_counted_if_the_robot_moved(tmp_path):
    lines = [odom(0.0), flaser(1.0), odom(5.0), flaser(6.0), odom(9.0, 3.0), flaser(9.5), odom(10.0, 3.1)]
    assert Carmen(log(tmp_path, *lines)).notes() == {"scans in a gap of the odometry over 1 s": 1}


def test_without_odom_lines_the_robot_pose_of_the_scan_is_the_odometry(tmp_path):
    path = log(tmp_path, flaser(1.0), flaser(2.0, robot=(1.0, 2.0, 0.3)))
    assert list(Carmen(path).frames())[1].odom_from_base == Pose(1.0, 2.0, 0.3)
    assert list(Carmen(path, odometry="none").frames())[1].odom_from_base is None


RESTART = [(1.0, 2.0), (2.0, 2.5), (2.1, 0.0), (3.0, 0.4)]
"""Time (s) and x (m) of a robot whose odometry begins again at the origin."""


@pytest.mark.parametrize("source", ["odom-lines", "scan-poses"])
def test_odometry_goes_on_where_it_was_after_it_began_again_at_the_origin(tmp_path, source):
    lines = [line for t, x in RESTART for line in (odom(t, x), flaser(t, robot=(x, 0.0, 0.0)))]
    sequence = Carmen(log(tmp_path, *lines), odometry=source)
    np.testing.assert_allclose([frame.odom_from_base.x for frame in sequence.frames()], [2.0, 2.5, 2.5, 2.9])
    assert list(sequence.notes().values()) == [1]


def test_no_jump_is_taken_out_of_a_log_whose_times_are_not_known(tmp_path):
    """20 m in a second, as the scans are placed, would be a jump: see the test above."""
    places = (20.0, 20.5, 0.0, 0.4)
    lines = [flaser(0.0, robot=(x, 0.0, 0.0)) for x in places]
    sequence = Carmen(log(tmp_path, *lines))
    assert [frame.odom_from_base.x for frame in sequence.frames()] == list(places)


def test_a_log_with_a_constant_robot_pose_has_no_odometry(tmp_path):
    assert next(Carmen(log(tmp_path, flaser(1.0), flaser(2.0))).frames()).odom_from_base is None


def test_required_but_missing_odom_lines_are_an_error(tmp_path):
    with pytest.raises(BadData, match="no ODOM line"):
        Carmen(log(tmp_path, flaser(1.0)), odometry="odom-lines")


def test_the_two_poses_of_a_scan_determine_the_mounting(tmp_path):
    heading = 1.0
    robot = (5.0, 6.0, heading)
    laser = (5.0 - 0.04 * math.cos(heading), 6.0 - 0.04 * math.sin(heading), heading)
    path = log(tmp_path, flaser(1.0, laser=laser, robot=robot))
    assert next(Carmen(path).frames()).base_from_sensor == Pose(-0.04, 0.0, 0.0)


def test_otherwise_param_lines_determine_the_mounting_and_a_parameter_overrides(tmp_path):
    path = log(tmp_path, "PARAM robot_frontlaser_offset -0.04 nohost 0", flaser(1.0))
    assert next(Carmen(path).frames()).base_from_sensor == Pose(-0.04)
    assert next(Carmen(path, base_from_sensor="0.1 0.2 0.3").frames()).base_from_sensor == Pose(0.1, 0.2, 0.3)
    with pytest.raises(BadData, match="three numbers"):
        Carmen(path, base_from_sensor="0.1 0.2")


# --- corrected logs and .gfs


def corrected(*stamps):
    for index, stamp in enumerate(stamps):
        pose = (0.5 * index, 0.0, 0.0)
        yield from (odom(stamp, *pose), flaser(stamp, laser=pose, robot=pose, host="pippo"), "NEFF 29.1", odom(8.9e-67))


def test_the_poses_of_a_corrected_log_are_ground_truth_not_odometry(tmp_path):
    sequence = Carmen(log(tmp_path, *corrected("21.0199", "23.8599")))
    assert all(frame.odom_from_base is None for frame in sequence.frames())
    assert sequence.truth().trajectory.poses[:, 0].tolist() == [0.0, 0.5]
    assert "GMapping" in sequence.truth().how


@pytest.mark.parametrize("source", ["odom-lines", "scan-poses"])
def test_the_poses_of_a_corrected_log_are_rejected_as_odometry(tmp_path, source):
    with pytest.raises(BadData, match="are not odometry"):
        Carmen(log(tmp_path, *corrected("1.0", "2.0")), odometry=source)


def test_unusable_stamps_of_a_corrected_log_are_replaced_by_line_order(tmp_path):
    sequence = Carmen(log(tmp_path, *corrected(*["1.13486e+09"] * 4)))
    assert len(sequence) == 4
    assert sequence.truth().trajectory.poses[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5]
    name = "scans with unusable stamps, placed one second apart in line order"
    assert sequence.notes() == {name: 4}


def test_poses_of_graph_vertices_are_treated_as_optimised(tmp_path):
    lines = [
        "VERTEX2 0 1 2 0.5",
        robotlaser(1.0, [2.0] * 3),
        "VERTEX2 1 2 2 0.5",
        robotlaser(2.0, [2.0] * 3, (2, 2, 0.5)),
    ]
    sequence = Carmen(log(tmp_path, *lines))
    assert "graph-optimised" in sequence.truth().how
    assert sequence.truth().trajectory.poses.tolist() == [[1.0, 2.0, 0.5], [2.0, 2.0, 0.5]]
    assert next(sequence.frames()).odom_from_base is None


def test_gfs_readings_contain_odometry_and_the_adjacent_odom_line_is_skipped(tmp_path):
    reading = " ".join(map(str, ["LASER_READING", 180, *[2.0] * 180]))
    lines = [f"{reading} 0 0 0 1.0", "ODOM 9 9 9 2.0", f"{reading} 1 2 0.3 2.0", "NEFF 20"]
    sequence = Carmen(log(tmp_path, *lines, name="some.gfs"))
    assert list(sequence.frames())[1].odom_from_base == Pose(1.0, 2.0, 0.3)
    assert sequence.notes() == {}


# --- ground truth in files


def test_relations_and_reference_are_cropped_to_the_selected_scans(tmp_path):
    path = log(tmp_path, *(flaser(float(stamp)) for stamp in range(10)))
    (tmp_path / "r").write_text("0 2 1 0 0 0 0 0\n1 8 1 0 0 0 0 0\n")
    (tmp_path / "t").write_text("0 0 0 0 0 0 0 1\n4.05 1 0 0 0 0 0 1\n7 2 0 0 0 0 0 1\n")
    sequence = Carmen(path, str(tmp_path / "r"), str(tmp_path / "t"), limit=5)
    assert sequence.truth().relations.second_ns.tolist() == [2 * 10**9]
    assert sequence.truth().trajectory.poses[:, 0].tolist() == [0.0, 1.0]
    assert sequence.notes() == {"relations outside the scans": 1, "ground-truth poses outside the scans": 1}
    assert "Kuemmerle" in sequence.truth().how


@pytest.mark.parametrize("what", ["relations", "ground_truth"])
def test_ground_truth_of_another_data_set_is_rejected(tmp_path, what):
    line = "976052896.7 976052905.1 1 0 0 0 0 0" if what == "relations" else "976052896.7 1 0 0 0 0 0 1"
    (tmp_path / "other").write_text(line + "\n")
    with pytest.raises(BadData, match=r"other: its times.*do not overlap the recording"):
        Carmen(log(tmp_path, flaser(1.0), flaser(2.0)), **{what: str(tmp_path / "other")})


# --- damage


def test_damaged_lines_are_dropped_and_counted(tmp_path):
    lines = [
        flaser(1.0), flaser(2.0)[:200], flaser(3.0).replace("FLASER 180", "FLASER 179"), flaser(4.0, beams("x")),
        flaser("nan"), flaser(5.0, robot=("nan", 0, 0)), "ODOM 1 2", "FLASER", "FLASER many 1 2",
        robotlaser(6.0, [2.0] * 3)[:40], "ROBOTLASER1 0", robotlaser(7.0, [2.0] * 3, step=0.0),
        robotlaser(7.5, [2.0] * 3, step="nan"), flaser(8.0),
    ]  # fmt: skip
    sequence = Carmen(log(tmp_path, *lines))
    assert [frame.scan.stamp_ns for frame in sequence.frames()] == [10**9, 8 * 10**9]
    assert sequence.notes() == {"damaged lines dropped": 12}


@pytest.mark.parametrize(
    ("content", "parts"),
    [
        (b"", ["empty"]),
        (b"\n\n", ["no line begins with FLASER"]),
        (bytes(range(256)) * 20, ["no line begins with FLASER"]),
        (b"PARAM a b c 0\nODOM 0 0 0 0 0 0 1 r 1\n", ["no line begins with FLASER"]),
        (flaser(1.0).encode()[:300], ["line 1", "180 beams declared", "no valid scan"]),
        (gzip.compress(flaser(1.0).encode() * 50)[:-20], ["cut short"]),
        (b"\x1f\x8b\x08\x00" + b"garbage" * 30, ["damaged gzip"]),
    ],
)
def test_a_log_without_a_usable_scan_is_reported_with_place_and_cause(tmp_path, content, parts):
    (tmp_path / "bad.clf").write_bytes(content)
    with pytest.raises(BadData) as caught:
        Carmen(str(tmp_path / "bad.clf"))
    assert all(part in str(caught.value) for part in ["bad.clf", *parts])


def test_a_missing_log_raises_data_missing_before_and_when_opening(tmp_path):
    path = str(tmp_path / "none.log")
    assert SPEC.missing(path=path) == f"carmen: parameter 'path': no file {path}; check the path"
    assert "give a path" in SPEC.missing()
    with pytest.raises(DataMissing, match="no file"):
        Carmen(path)


# --- the published recordings


@pytest.mark.skipif(not (DATA / "radish-corrected").is_dir(), reason="EVALKIT_DATA holds no radish-corrected logs")
@pytest.mark.parametrize(
    ("name", "scans", "count", "offset", "backwards"),
    [
        ("aces", 440, 180, 0.0, {}),
        ("freiburg-101", 292, 360, -0.04, {}),
        ("intel", 910, 180, 0.0, {"scans out of order": 4}),
    ],
)
def test_the_radish_logs_are_read_as_corrected_logs(name, scans, count, offset, backwards):
    sequence = Carmen(str(DATA / "radish-corrected" / f"{name}-corrected.log.gz"))
    first = next(sequence.frames())
    assert (len(sequence), len(first.scan.ranges)) == (scans, count)
    assert first.base_from_sensor == Pose(offset)
    assert first.odom_from_base is None
    assert len(sequence.truth().trajectory) == scans
    assert sequence.notes() == backwards


def test_a_log_that_changes_while_it_is_read_is_rejected(tmp_path):
    sequence = Carmen(log(tmp_path, flaser(1.0), flaser(2.0)))
    log(tmp_path, flaser(1.0))
    with pytest.raises(BadData, match="has changed since it was first read"):
        list(sequence.frames())
