"""Logs in columns: units, wraps, angles, odometry of wheels, and errors of the log and of its description."""

import gzip

import numpy as np
import pytest

from evalkit.core.errors import BadData, DataMissing
from evalkit.plugins import registry
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.parsing.columns_layout import TickColumns, layout_from_table
from evalkit_datasets.readers.columns import Columns, integrate_ticks

SCAN = {"first": 2, "step_deg": 90.0, "range_max_m": 8.0}
PLAIN = {"time": {"column": 1}, "scan": SCAN}


def read(tmp_path, text, layout, **parameters):
    path = tmp_path / "a.txt"
    path.write_text(text)
    sequence = Columns(str(path), layout, **parameters)
    return sequence, list(sequence.frames())


def test_units_no_return_and_limits(tmp_path):
    layout = {
        "time": {"column": 5, "unit": "us"},
        "scan": {"first": 1, "beams": 4, "step_deg": 1.0, "unit": "mm", "no_return": [0], "range_min_m": 0.1,
                 "range_max_m": 6.0, "turned_s": 0.03},
    }  # fmt: skip
    _, (frame,) = read(tmp_path, "0,50;2500\t6000 1500000\n", layout)
    assert frame.scan.stamp_ns == 1_500_000_000
    np.testing.assert_array_equal(frame.scan.ranges, [np.inf, np.nan, 2.5, np.inf])
    assert frame.scan.time_increment_ns == 10_000_000
    assert frame.odom_from_base is None


@pytest.mark.parametrize(("separator", "point"), [(";", ","), ("\t", ","), (";", "."), (",", ".")])
def test_a_decimal_comma_is_an_error_that_names_it(tmp_path, separator, point):
    numbers = [["0.5", "2.25", "3", "-0.75"], ["1.5", "2.5", "3.5", "0"]]
    text = "".join(separator.join(row).replace(".", point) + "\n" for row in numbers)
    if point == ",":
        with pytest.raises(BadData, match=r"line 1: its numbers have a decimal comma; .* sed 's/,/\./g' \S*a\.txt"):
            read(tmp_path, text, PLAIN)
        with pytest.raises(BadData, match="its numbers have a decimal comma"):
            inspect_recording(tmp_path / "a.txt")
    else:
        np.testing.assert_array_equal(read(tmp_path, text, PLAIN)[1][0].scan.ranges[:2], [2.25, 3.0])


def test_pairs_separated_by_commas_between_semicolons_have_no_decimal_comma(tmp_path):
    _, (frame,) = read(tmp_path, "1;2,3,4;5,6\n", PLAIN)
    assert frame.scan.ranges.tolist() == [2.0, 3.0, 4.0, 5.0, 6.0]


def test_clockwise_angles_become_counter_clockwise(tmp_path):
    scan = {**SCAN, "first_angle_deg": 180.0, "clockwise": True}
    _, (frame,) = read(tmp_path, "1 1 1 1 1\n", {"time": {"column": 1}, "scan": scan, "base_from_sensor": [1, 2, 90]})
    np.testing.assert_allclose(np.degrees(frame.scan.angles), [180, 90, 0, -90])
    np.testing.assert_allclose(frame.base_from_sensor.row, [1, 2, np.pi / 2])


def test_a_clock_of_16_bits_continues_over_its_wraps(tmp_path):
    layout = {"time": {"column": 1, "unit": "ms", "wraps_at": 65536}, "scan": SCAN}
    sequence, frames = read(tmp_path, "65000 1 1\n65500 1 1\n100 1 1\n100 2 2\n65000 1 1\n", layout)
    assert [frame.scan.stamp_ns // 10**6 for frame in frames] == [65000, 65500, 65636, 130536]
    assert sequence.notes() == {"scans with a repeated stamp dropped": 1}
    assert frames[2].scan.ranges[0] == 1.0  # the first of equal stamps


WHEELS = TickColumns(1, 2, ticks_per_turn=100.0, wheel_diameter_m=1.0 / np.pi, track_m=0.5, wraps_at=65536)


def test_both_wheels_drive_straight_on_over_a_wrap_of_their_counters():
    poses = integrate_ticks(WHEELS, np.array([[32700, -100], [-32736, 0], [32700, -100.0]]))
    np.testing.assert_allclose(poses, [[0, 0, 0], [1, 0, 0], [0, 0, 0]], atol=1e-12)


def test_opposite_wheels_turn_on_the_spot_by_the_turn_factor():
    counts = np.array([[0.0, 0.0], [-25.0, 25.0]])  # each wheel 0.25 m: 1 rad with a track of 0.5 m
    np.testing.assert_allclose(integrate_ticks(WHEELS, counts)[1], [0, 0, 1.0], atol=1e-12)
    slipping = TickColumns(1, 2, 100.0, 1.0 / np.pi, 0.5, turn_factor=0.5)
    np.testing.assert_allclose(integrate_ticks(slipping, counts)[1], [0, 0, 0.5], atol=1e-12)


def test_a_quarter_circle_is_an_arc():
    outer = 1.25 * np.pi / 2 * 100.0  # radius 1 m, track 0.5 m
    inner = 0.75 * np.pi / 2 * 100.0
    np.testing.assert_allclose(
        integrate_ticks(WHEELS, np.array([[0, 0], [inner, outer]]))[1], [1, 1, np.pi / 2], atol=1e-12
    )


def test_poses_in_columns_get_their_units(tmp_path):
    pose = {"x": 4, "y": 5, "heading": 6, "unit": "cm", "heading_unit": "deg"}
    layout = {"time": {"column": 1}, "scan": {**SCAN, "beams": 2}, "pose": pose, "header_lines": 1, "comment": "%"}
    text = "t r0 r1 x y heading\n1 1 1 100 200 90\n% pause\n2 1 1 100 200 270\n"
    _, frames = read(tmp_path, text, layout)
    np.testing.assert_allclose([frame.odom_from_base.row for frame in frames], [[1, 2, np.pi / 2], [1, 2, -np.pi / 2]])


def test_odometry_goes_on_where_it_was_after_it_began_again_at_the_origin(tmp_path):
    layout = {"time": {"column": 1}, "scan": {**SCAN, "beams": 2}, "pose": {"x": 4, "y": 5, "heading": 6}}
    sequence, frames = read(tmp_path, "1 1 1 2.0 0 0\n2 1 1 2.5 0 0\n2.1 1 1 0 0 0\n3 1 1 0.4 0 0\n", layout)
    np.testing.assert_allclose([frame.odom_from_base.x for frame in frames], [2.0, 2.5, 2.5, 2.9])
    assert list(sequence.notes().values()) == [1]


def test_scans_out_of_order_are_sorted_and_damaged_lines_counted(tmp_path):
    sequence, frames = read(tmp_path, "2 2 2\nx 1 1\n3 3\n1 1 1\n4 1 b\n", PLAIN)
    assert [frame.scan.ranges[0] for frame in frames] == [1.0, 2.0]
    assert sequence.notes() == {"damaged lines dropped": 3, "scans out of order": 1}


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("1,2,-,2", "line 2: '-' in column 3 is not a number"),
        ("1,2", "line 2: 2 columns, 4 expected"),
        (",2,2,2", "line 2: 'NaN' is not a time in seconds"),
        ("1,2,2,2", ""),
    ],
)
def test_the_first_line_that_is_dropped_is_named_with_column_and_value(tmp_path, line, why):
    sequence, frames = read(tmp_path, f"0,1,1,1\n{line}\n2,1,1,1\n3,x,1,1\n", PLAIN | {"scan": SCAN | {"beams": 3}})
    assert sequence.first_damage == (why or "line 4: 'x' in column 2 is not a number")
    assert sequence.notes() == {"damaged lines dropped": 2 if why else 1}
    assert len(frames) == (2 if why else 3)


def test_nan_and_an_empty_column_are_an_invalid_beam_and_shift_no_other(tmp_path):
    layout = PLAIN | {"scan": SCAN | {"beams": 4}}
    (frame,) = read(tmp_path, "0, 1, , 3, nan, 9\n", layout)[1]
    np.testing.assert_array_equal(frame.scan.ranges, [1.0, np.nan, 3.0, np.nan])
    (frame,) = read(tmp_path, "0;;;inf;4;9\n", layout)[1]
    np.testing.assert_array_equal(frame.scan.ranges, [np.nan, np.nan, np.inf, 4.0])
    sequence, (frame,) = read(tmp_path, "0,1,2,3,\n,,,,\n", layout)  # the last column, and a line without any
    np.testing.assert_array_equal(frame.scan.ranges, [1.0, 2.0, 3.0, np.nan])
    assert "damaged" not in str(sequence.notes())


def test_scans_with_another_number_of_ranges_are_counted_as_where_a_log_ends_in_a_line(tmp_path):
    text = "1 1 2 3 4\n2 1 2 3 4\n3 1 2 3 4\n4 1 2 3"
    sequence, frames = read(tmp_path, text, PLAIN)
    assert [len(frame.scan.ranges) for frame in frames] == [4, 4, 4, 3]
    assert sequence.notes() == {"scans with fewer or more ranges than most": 1}
    assert read(tmp_path, text + " 4", PLAIN)[0].notes() == {}


def test_the_layout_lies_beside_a_compressed_log_of_its_own_suffix(tmp_path):
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"1,1,1\n2,1,1\n3,1,1\n"))
    (tmp_path / "a.csv.gz.toml").write_text("[time]\ncolumn = 1\n[scan]\nfirst = 2\nstep_deg = 0.5\n")
    assert len(registry.dataset("columns").make(path=str(path), start=1)) == 2


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("1 2\n", "line 1: 2 columns, 3 expected; no valid line"),
        ("\n#\n", "no line with content"),
        ("nan 1 1\n", "line 1: .*not a time in s"),
        ("1 1 1\n", None),
    ],
)
def test_a_log_without_a_valid_line_is_reported(tmp_path, text, part):
    if part is None:
        with pytest.raises(BadData, match="start 1 lies beyond its 1 scans"):
            read(tmp_path, text, PLAIN, start=1)
        return
    with pytest.raises(BadData, match=rf"a\.txt: {part}"):
        read(tmp_path, text, PLAIN)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"time": {"column": 0}}, "time.column: expected 1 to 100000, got 0"),
        ({"time": {"column": 1, "unit": "min"}}, "time.unit: 'min' is not one of s, ms, us, ns"),
        ({"time": {"column": True}}, "time.column: True is not an integer"),
        ({"time": 3}, "time: 3 is not a table"),
        ({"scan": {**SCAN, "clockwise": 1}}, "scan.clockwise: 1 is not a bool"),
        ({"scan": {**SCAN, "no_return": 0}}, "scan.no_return: 0 is not a list"),
        ({"scan": {**SCAN, "beams": 1}}, "expected two beams or more"),
        ({"scan": {"first": 2}}, "'step_deg' missing"),
        ({"scan": {**SCAN, "step": 1}}, "unknown key 'step'; known: first, step_deg"),
        ({"pose": {"x": 1, "y": 2, "heading": 3}, "ticks": {"left": 1, "right": 2, "ticks_per_turn": 1.0,
          "wheel_diameter_m": 0.1, "track_m": 0.1}}, "pose, ticks: give one of them"),
        ({"base_from_sensor": [1, 2]}, r"expected \[x, y, heading\]"),
    ],
)  # fmt: skip
def test_a_wrong_layout_is_reported_with_its_key(changes, part):
    with pytest.raises(BadData, match=f"layout: .*{part}"):
        layout_from_table("layout", {**PLAIN, **changes})


def test_a_missing_layout_is_reported(tmp_path):
    (tmp_path / "a.txt").write_text("1 2 3\n")
    with pytest.raises(DataMissing, match=r"a\.txt\.toml.*give the path of a TOML file with the tables"):
        Columns(str(tmp_path / "a.txt"))


@pytest.mark.skipif(bool(registry.dataset("rplidar-slambot").missing()), reason="rplidar-slambot: files not at hand")
@pytest.mark.slow
def test_the_slambot_drives_a_closed_path_by_its_wheels():
    frames = list(registry.dataset("rplidar-slambot").make(drive="24JUL14").frames())
    assert len(frames) == 237
    # the drive ends where it began: 2 cm and 1 deg off after 4 m and a full turn
    np.testing.assert_allclose(frames[-1].odom_from_base.row, [0.005, 0.020, -0.014], atol=5e-4)
    assert np.mean([np.isposinf(frame.scan.ranges).mean() for frame in frames]) == pytest.approx(0.618, abs=1e-3)
