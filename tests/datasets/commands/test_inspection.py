"""The inspection of recordings: recordings with one known defect each, and real ones with known properties."""

import gzip
import json
import math
import os
import re
import shlex
import tomllib
import tracemalloc
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evalkit import cli
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BadData
from evalkit.plugins import registry
from evalkit_datasets.commands.datasets.example_bag import write_example
from evalkit_datasets.commands.inspect import findings, lidar_findings, odometry_findings, turn_comparison
from evalkit_datasets.commands.inspect.command import inspect
from evalkit_datasets.commands.inspect.frame_tree import FrameTree, LidarMounting
from evalkit_datasets.commands.inspect.inspector import field_of_view_deg, inspect_recording
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.odometry_stats import TwistComparison, measure_odometry
from evalkit_datasets.commands.inspect.page import build_document
from evalkit_datasets.commands.inspect.range_stats import find_no_return_codes, measure_ranges
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, ScanSample
from evalkit_datasets.commands.inspect.suggested_config import best_lidar, suggest_config
from evalkit_datasets.commands.inspect.timing import ClockOffset, measure_clock_offset, measure_timing
from evalkit_datasets.commands.inspect.truth_choices import is_named_as_truth
from evalkit_datasets.commands.inspect.turn_comparison import compare_turns

DATA = Path(os.environ.get("EVALKIT_DATA") or "absent")
S = 10**9


def seconds(*values):
    return (np.array(values) * S).astype(np.int64)


def laser(ranges, stamps=None, high=np.nan, step=0.0174533):
    rows = [np.asarray(row, dtype=float) for row in ranges]
    times = np.arange(len(rows)) * S // 10 if stamps is None else stamps
    angles = -math.pi / 2 + step * np.arange(len(rows[0]))
    return LaserStream("/scan", "LaserScan", "laser", times, None, ScanSample(rows), angles, np.nan, high)


def walls(count=60, beams=180, seed=0):
    """Return plain ranges between 1 and 8 m in centimetres, different in every scan."""
    rng = np.random.default_rng(seed)
    return np.round(rng.uniform(1.0, 8.0, (count, beams)), 2)


# --- times


def test_rate_jitter_gaps_and_disorder_of_stamps():
    found = measure_timing(seconds(0.0, 0.1, 0.2, 0.2, 0.9, 1.0, 0.3, 1.1))
    assert (found.count, found.backwards, found.repeated) == (8, 1, 1)
    assert found.period_s == pytest.approx(0.1)
    assert found.rate_hz == pytest.approx(10.0)
    assert found.duration_s == pytest.approx(1.1)
    assert found.gap_count == 1
    assert (found.gaps[0].at_s, found.gaps[0].length_s) == (pytest.approx(0.3), pytest.approx(0.6))


def test_jitter_is_the_standard_deviation_of_normal_periods():
    periods = 0.1 + 0.003 * np.random.default_rng(1).standard_normal(4000)
    assert measure_timing(seconds(*np.cumsum(periods))).jitter_s == pytest.approx(0.003, rel=0.05)


def test_a_clock_with_offset_and_drift_is_reported():
    recorded = seconds(*np.arange(0.0, 100.0, 0.1))
    found = measure_clock_offset(recorded + np.int64(0.25 * S) + (recorded * 40e-6).astype(np.int64), recorded)
    assert found.median_s == pytest.approx(0.252, abs=1e-4)
    assert found.drift_ppm == pytest.approx(40.0, abs=0.1)


def test_a_clock_that_was_set_is_a_step_and_no_drift():
    recorded = np.arange(0.0, 20.0, 0.1)
    set_forward = measure_clock_offset(seconds(*(recorded + 5.0 * (recorded > 9.95))), seconds(*recorded))
    assert (set_forward.step_s, set_forward.step_at_s) == (pytest.approx(5.0), pytest.approx(10.0))
    assert measure_clock_offset(seconds(*(recorded + 0.01 * recorded)), seconds(*recorded)).step_s == 0.0


def test_stamps_that_step_back_leave_the_parts_before_and_behind_the_overlap():
    recorded = np.arange(0.0, 10.0, 0.1)
    found = measure_timing(seconds(*np.round(recorded - 2.05 * (recorded > 4.95), 3)))
    assert found.steps_back == 1
    assert (found.step_back.at_s, found.step_back.length_s) == (pytest.approx(4.9), pytest.approx(1.95))
    assert found.step_back.before == 30  # 0.0 to 2.9 s; the first behind the step is 2.95 s
    assert found.step_back.behind == 70  # all up to 4.9 s: 50 before the step, 20 behind it
    assert measure_timing(seconds(0.0, 0.2, 0.1, 0.3)).step_back is None  # two messages changed places


# --- ranges


@pytest.mark.parametrize("code", [81.83, 50.0, 8.19, 30.0])
def test_a_no_return_code_above_all_ranges_is_found(code):
    rows = walls()
    rows[np.random.default_rng(2).random(rows.shape) < 0.03] = code
    (found,) = find_no_return_codes(rows)
    assert found.low_m == found.high_m == code
    assert found.share == pytest.approx(0.03, abs=0.005)


def test_a_cluster_of_codes_is_one_code():
    rows = walls()
    rows[:, ::20] = np.random.default_rng(3).choice([51.06, 51.12, 51.25], rows[:, ::20].shape)
    (found,) = find_no_return_codes(rows)
    assert (found.low_m, found.high_m) == (51.06, 51.25)


def test_far_walls_are_not_no_return_codes():
    rows = walls()
    assert find_no_return_codes(rows) == ()
    rows[:, 90:94] = 20.0  # a door at the end of a corridor, seen in four directions
    assert find_no_return_codes(rows) == ()


def test_shares_of_invalid_ranges():
    row = [0.0, -1.0, np.nan, np.inf, 12.0, 13.0, 1.0, 2.0, 3.0, 4.0]
    found = measure_ranges(laser([row, row], high=12.0))
    assert (found.zero, found.negative, found.nan, found.infinite) == (0.1, 0.1, 0.1, 0.1)
    assert (found.at_maximum, found.beyond_maximum, found.hits) == (0.1, 0.1, pytest.approx(0.4))
    assert found.repeated == 1


def test_ranges_reveal_their_quantisation_and_whether_the_robot_is_at_rest():
    still = np.repeat(walls(1), 60, axis=0)
    assert measure_ranges(laser(walls())).step_m == 0.01
    assert measure_ranges(laser(still)).still == 1.0
    assert measure_ranges(laser(walls())).still == 0.0


# --- the robot's own body


def with_body(first=100, last=110, range_m=0.25, noise_m=0.005, hit=1.0, rows=None):
    """Return scans of a robot of which the lidar sees a part, with beams at -90, -89, ... deg."""
    rng = np.random.default_rng(7)
    rows = walls() if rows is None else rows
    body = range_m + noise_m * rng.uniform(-1.0, 1.0, (len(rows), last - first))
    rows[:, first:last] = np.where(rng.random(body.shape) < hit, body, np.inf)
    return rows


def test_beams_that_always_have_the_same_range_are_the_robots_own_body():
    rows = with_body()
    body = measure_ranges(laser([*rows, [0.25] * 90])).body  # the last scan has another number of beams
    assert body.share == pytest.approx(10 / 180)
    assert body.sectors_deg == (pytest.approx((10.0, 19.0), abs=0.01),)
    assert (body.nearest_m, body.farthest_m) == pytest.approx((0.25, 0.25), abs=0.005)
    assert body.range_min_m == 0.3
    above = np.where(rows < body.range_min_m, np.nan, rows)
    assert measure_ranges(laser(above)).body is None


@pytest.mark.parametrize(
    "rows",
    [
        walls(),
        with_body(last=102),
        with_body(range_m=1.6),
        with_body(noise_m=0.06),
        with_body(hit=0.8),
        with_body(rows=np.repeat(walls(1), 60, axis=0)),
        with_body(rows=walls(19)),
    ],
    ids=["none", "two beams", "far", "range changes", "rarely hit", "robot stands", "few scans"],
)
def test_other_beams_are_not_the_robots_own_body(rows):
    assert measure_ranges(laser(rows)).body is None


def test_sectors_of_the_body_go_on_through_the_border_of_a_full_turn():
    rows = with_body(0, 10, rows=with_body(175, 180, range_m=0.4))  # steps of 2 deg
    body = measure_ranges(laser(rows, step=np.radians(2.0))).body
    assert body.sectors_deg == (pytest.approx((260.0, 288.0), abs=0.01),)
    assert (body.nearest_m, body.farthest_m, body.range_min_m) == pytest.approx((0.25, 0.4, 0.5), abs=0.005)


def test_the_walls_of_a_corridor_are_not_the_robots_own_body():
    scans = [frame.scan for frame in registry.dataset("corridor").make().frames()]
    stream = replace(laser([scan.ranges for scan in scans]), angles=scans[0].angles)
    assert measure_ranges(stream).body is None
    body = np.arange(len(scans[0].angles)) < 80
    seen = replace(stream, scans=ScanSample(np.where(body, 0.25, scan.ranges) for scan in scans))
    assert measure_ranges(seen).body.share == 0.1


def test_the_robots_own_body_is_a_warning_that_a_comparison_repeats(tmp_path):
    rows, poses = with_body(), arc(count=60).poses
    path = log(tmp_path, *(flaser(f"{1000 + 0.1 * at:.6f}", rows[at], poses[at]) for at in range(60)))
    what = "6 % of the beams (10 to 19 deg) always have the same range, 0.25 m: the robot's own body?"
    advice = (
        "set range_min_m = 0.3 (m; of a text log in [scan] of its layout): all methods then leave them out, "
        "with all else that is nearer"
    )
    (found,) = [one for one in inspect_recording(path).findings if "body" in one.what]
    assert (found.level, found.what, found.advice) == ("warning", what, advice)
    choose = registry.dataset("carmen").choose
    said = [(one.reason, one.warns) for one in choose({"path": str(path), "range_min_m": 0.2}) if "body" in one.reason]
    assert said == [(f"warning: FLASER / ROBOTLASER1: {what}; {advice}", True)]
    assert not any("body" in one.reason for one in choose({"path": str(path), "range_min_m": 0.3}))
    printed = CliRunner().invoke(cli.app, ["inspect", str(path), "--out", str(tmp_path / "page")]).output
    assert " ".join(printed.split()).count(f"{what}; {advice}") == 1
    assert "10 to 19 deg" in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")


# --- long recordings


def test_a_long_recording_is_sampled_in_windows_over_its_whole_length():
    rows = [np.full(10, 1.0), np.full(12, 2.0), np.full(10, 3.0)]
    sample = ScanSample((rows[number % 3] for number in range(99_999)), max_ranges=40_000)
    sample.append(rows[2])
    assert (len(sample), sample.beams, sample.repeated) == (100_000, {10, 12}, 1)  # of all scans
    assert 20_000 <= sum(map(len, sample.rows)) <= 40_000
    assert sorted(set(np.diff(sample.numbers))) == [1, 31 * 256 + 1]  # every 32nd window of 256 scans
    assert [row[0] for row in sample.rows[:-1]] == [1.0 + number % 3 for number in sample.numbers[:-1]]


def test_a_sample_of_a_long_recording_gives_the_findings_of_the_whole():
    """A lidar sways by 60 deg in a room, with a no-return code; mirrored beams are found in a quarter of it."""
    turns = np.radians(60.0) * np.sin(0.05 * np.arange(3000))
    rows = round_view(-turns)
    rows[np.random.default_rng(5).random(rows.shape) < 0.03] = 30.0
    whole = laser(rows)
    part = replace(whole, scans=ScanSample(rows, max_ranges=200_000))
    assert len(part.ranges) == 768
    one, other = measure_ranges(whole), measure_ranges(part)
    assert (other.codes[0].high_m, other.repeated, other.still < 0.05) == (30.0, 0, True)
    assert (other.hits, other.median_m) == (pytest.approx(one.hits, abs=0.005), pytest.approx(one.median_m, abs=0.01))
    assert compare_turns(turning(turns), part).scale == pytest.approx(-1.0, rel=0.03)


def test_a_recording_that_stands_is_said_to_stand_where_scans_are_left_out():
    """A scan is compared with one of a second before, not with one from before a gap of the sample."""
    rows = np.repeat(walls(8), 256, axis=0)  # another place in every window
    sample = ScanSample(rows, max_ranges=3 * 256 * 180)
    assert measure_ranges(replace(laser(rows), scans=sample)).still == 1.0


# --- odometry


def arc(count=200, speed=0.3, rate=0.4, noise=0.0, stop=20):
    """Return poses of a base that drives along an arc and rests for the last ``stop`` poses, ten poses a second."""
    moving = np.arange(count) < count - stop
    distance, heading = np.cumsum(speed * 0.1 * moving), np.cumsum(rate * 0.1 * moving)
    radius = speed / rate
    poses = np.stack([radius * np.sin(heading), radius * (1 - np.cos(heading)), heading], axis=-1)
    poses += noise * np.random.default_rng(4).standard_normal(poses.shape)
    assert distance[-1] > 0
    return OdometryStream("/odom", "odom", "base_link", np.arange(count) * S // 10, poses,
                  np.stack([speed * moving, rate * moving], axis=-1))  # fmt: skip


def test_an_arc_driven_by_wheels_is_classified_as_wheel_odometry():
    found = measure_odometry(arc())
    assert found.path_m == pytest.approx(179 * 0.03, rel=1e-3)
    assert found.turned_deg == pytest.approx(math.degrees(179 * 0.04), rel=1e-6)
    assert found.sideways < 1e-9
    assert found.standing == pytest.approx(0.1, abs=0.04)
    assert found.like_wheels
    assert found.twist is not None
    assert found.twist.scale == pytest.approx(1.0, abs=0.02)
    assert found.twist.turn_scale == pytest.approx(1.0, abs=0.02)


def test_noisy_poses_are_not_classified_as_wheel_odometry():
    assert not measure_odometry(arc(noise=0.002)).like_wheels


def test_a_jump_is_reported_with_its_time_and_size():
    wheels = arc()
    wheels.poses[100:, 0] += 2.0
    found = measure_odometry(wheels)
    assert found.jump_count == 1
    assert found.jumps[0].at_s == pytest.approx(10.0)
    assert found.jumps[0].step_m == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("sign", [1.0, 0.5, -1.0])
def test_turns_of_the_odometry_are_compared_with_the_scans(sign):
    """A lidar turns on the spot in an L-shaped room; the odometry reports ``sign`` times its turn."""
    turns = np.radians(4.0) * np.arange(40)
    found = compare_turns(turning(sign * turns), laser(round_view(turns)))
    assert found is not None
    assert found.scale == pytest.approx(1.0 / sign, rel=0.02)


def test_one_turn_that_the_odometry_reports_late_is_no_wrong_scale():
    """The lidar turns by 24 deg in 1.2 s; the odometry has seen half of it by then and the rest one second later."""
    turns = np.radians(2.0) * np.clip(np.arange(40), 0, 12)
    late = np.radians(1.0) * np.clip(np.arange(40), 0, 24)
    assert compare_turns(turning(late), laser(round_view(turns))) is None


@pytest.mark.parametrize(("less", "differs"), [(6, False), (9, True)])
def test_turns_that_contradict_each_other_are_no_wrong_scale(less, differs):
    """Of ten turns of 6 deg the odometry reports ``less`` as 4 deg, ratio 1.5, and the others as 8 deg, ratio 0.75."""
    seen = np.array([4.0] * less + [8.0] * (10 - less))
    found = compare_turns(
        turning(np.radians([0.0, *np.cumsum(seen)])), laser(round_view(np.radians(6.0) * np.arange(11)))
    )
    assert (found.pairs, found.scale) == (10, pytest.approx(1.5, rel=0.02))
    assert found.interval == (pytest.approx(1.5 if differs else 0.75, rel=0.02), pytest.approx(1.5, rel=0.02))
    assert found.differs is differs


def round_view(turns):
    """Return the ranges of a lidar with 180 beams that turns on the spot in a room without symmetry."""
    ways = np.radians(np.arange(-90.0, 90.0)) + turns[:, None]
    return 3.0 + np.cos(2 * ways) + 0.5 * np.sin(5 * ways) + 0.3 * np.cos(11 * ways + 1.0)


def turning(turns):
    """Return an odometry on the spot with these headings, ten a second."""
    poses = np.column_stack([0.0 * turns, 0.0 * turns, turns])
    return OdometryStream("/odom", "odom", "base_link", np.arange(len(turns)) * S // 10, poses)


@pytest.mark.parametrize("late_s", [0.0, 0.3, -0.2])
def test_stamps_that_are_not_the_times_of_the_scans_are_found_by_the_turns(late_s):
    times, fine = np.arange(0.0, 60.0, 0.1), np.arange(0.0, 60.0, 0.02)
    scans = laser(round_view(np.sin(0.7 * times)), seconds(*(times - late_s + 10.0)))  # turns to and fro on the spot
    heading = np.sin(0.7 * fine)
    poses = np.column_stack([0.0 * heading, 0.0 * heading, heading])
    found = compare_turns(OdometryStream("/odom", "odom", "base", seconds(*(fine + 10.0)), poses), scans)
    assert found.shift_s == pytest.approx(late_s, abs=0.03)
    assert found.shift_interval == pytest.approx((late_s, late_s), abs=0.04)
    assert found.is_shifted is (late_s != 0.0)


@pytest.mark.parametrize("late_s", [0.0, 0.15, -0.15, 0.9])
def test_turns_at_a_constant_rate_tell_wrong_stamps_where_they_begin_and_end(late_s):
    """Turns of 1.0 to 2.2 s, and half a second of rest: most pairs of scans lie within a turn or within a rest."""
    lengths = np.column_stack([np.full(30, 0.5), 1.0 + 0.3 * (np.arange(30) * 7 % 5)])
    ends = np.cumsum(lengths.ravel())
    knots = np.column_stack([np.zeros(30), lengths[:, 1] * np.where(np.arange(30) % 3, 0.6, -0.6)]).cumsum(axis=None)

    def heading(at):
        return np.interp(at, [0.0, *ends], [0.0, *knots])

    times, fine = np.arange(1.0, ends[-1] - 1.0, 0.1), np.arange(0.0, ends[-1], 0.05)
    rng = np.random.default_rng(6)
    scans = laser(round_view(heading(times)), seconds(*(times - late_s + 10.0)))
    poses = np.column_stack([0.0 * fine, 0.0 * fine, heading(fine) + 0.002 * rng.standard_normal(len(fine))])
    found = compare_turns(OdometryStream("/odom", "odom", "base", seconds(*(fine + 10.0)), poses), scans)
    assert found.shift_s == pytest.approx(late_s, abs=0.03)
    assert found.shift_interval == pytest.approx((late_s, late_s), abs=0.06)
    assert found.is_shifted is (late_s != 0.0)


def test_turns_are_not_compared_with_too_few_pairs():
    assert compare_turns(arc(count=5, stop=0), laser(walls(5))) is None
    assert turn_comparison.MIN_PAIRS > 5


# --- whole recordings


def log(folder, *lines, name="made.log"):
    path = folder / name
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def flaser(stamp, ranges, pose=(0.0, 0.0, 0.0), host="h", logger=None):
    words = " ".join(f"{value:.2f}" for value in ranges)
    place = " ".join(f"{value:.9f}" for value in pose)
    return f"FLASER {len(ranges)} {words} {place} {place} {stamp} {host} {stamp if logger is None else logger}"


def drive(count=60, code=None):
    """Write a log of scans at 10 Hz with wheel odometry along an arc."""
    rows, poses = walls(count), arc(count=count).poses
    if code is not None:
        rows[np.random.default_rng(5).random(rows.shape) < 0.03] = code
    return [flaser(f"{1000 + 0.1 * at:.6f}", rows[at], poses[at]) for at in range(count)]


def test_a_log_of_a_lidar_that_sees_all_around_is_found_by_the_turns(tmp_path):
    headings = 0.5 * np.sin(0.07 * np.arange(300))
    ways = np.radians(np.arange(-180.0, 180.0)) + headings[:, None]
    rows = 3.0 + np.cos(2 * ways) + 0.5 * np.sin(5 * ways) + 0.3 * np.cos(11 * ways + 1.0)
    lines = [flaser(f"{1000 + 0.1 * at:.6f}", rows[at], (0.0, 0.0, headings[at])) for at in range(300)]
    path = log(tmp_path, *lines)
    carmen = registry.dataset("carmen")
    (said,) = [one.reason for one in carmen.choose({"path": str(path)}) if "see all around" in one.reason]
    assert said.startswith("problem: angles of FLASER lines")
    given = {"start_deg": -180.0, "step_deg": 1.0}
    assert "--set start_deg=-180 --set step_deg=1," in said
    assert not [one for one in carmen.choose({"path": str(path), **given}) if "all around" in one.reason]
    half = [flaser(f"{1000 + 0.1 * at:.6f}", rows[at][90:270], (0.0, 0.0, headings[at])) for at in range(300)]
    other = log(tmp_path, *half, name="half.log")
    assert not [one for one in carmen.choose({"path": str(other)}) if "all around" in one.reason]


def run_inspection(found):
    return " | ".join(f"{one.about}: {one.what}; {one.advice}" for one in found.findings)


@pytest.mark.parametrize(("moves", "turns", "warned"), [(0.0, True, True), (0.0, False, False), (0.02, True, False)])
def test_an_odometry_that_stands_still_while_the_scans_change_is_a_warning(tmp_path, moves, turns, warned):
    rows = walls(60) if turns else np.repeat(walls(1), 60, axis=0)
    lines = [flaser(0.1 * at, row, (moves * at, 0.0, 0.0)) for at, row in enumerate(rows)]
    lines += [f"ODOM {moves * at:.2f} 0 0 0 0 0 {0.1 * at:.1f} h {0.1 * at:.1f}" for at in range(60)]
    found = inspect_recording(log(tmp_path, *lines))
    said = [one for one in found.findings if "stands still, but 100 % of the scans change" in one.what]
    assert [one.level for one in said] == ["warning"] * warned


def test_a_suggested_config_is_a_valid_experiment_and_an_unknown_code_sets_range_max(tmp_path):
    path = log(tmp_path, *drive(code=30.0))
    found = inspect_recording(path)
    advice = suggest_config(found)
    assert "30 m means no return" in run_inspection(found)
    assert (advice.parameters["range_max_m"], advice.scans, advice.problem) == (30.0, 60, "")
    plan = experiment_from_tables(
        tomllib.loads(advice.table + '[[method]]\nuse = "wheel-odometry"\n'), "made", "made", "x"
    )
    assert plan.sequences[0].parameters["range_max_m"] == 30.0
    assert advice.command == f"evalkit compare {path} --set range_max_m=30.0"


def test_a_corrected_log_has_a_reference_but_no_odometry(tmp_path):
    rows = walls(30)
    lines = [flaser(f"{1000 + at}", rows[at], (0.9 * at, 0.01 * at, 0.0), "pippo") for at in range(30)]
    found = inspect_recording(log(tmp_path, *lines, "NEFF 0.5"))
    assert found.truth_inside == "GMapping's poses"
    assert "not odometry but GMapping's poses" in run_inspection(found)
    assert "4 significant digits" in run_inspection(found)
    assert "0.90 m apart" in run_inspection(found)
    assert "GMapping" in suggest_config(found).truth


def test_relations_beside_a_log_are_used_if_they_share_its_time(tmp_path):
    path = log(tmp_path, *drive())
    (tmp_path / "other.relations").write_text("5.0 6.0 1 0 0 0 0 0\n", encoding="utf-8")
    (tmp_path / "truth.relations").write_text("1000.5 1002.0 1 0 0 0 0 0\n", encoding="utf-8")
    assert suggest_config(inspect_recording(path)).parameters["relations"] == str(tmp_path / "truth.relations")


def test_a_comparison_takes_what_the_inspection_finds_except_what_is_given(tmp_path):
    path = log(tmp_path, *drive(code=30.0))
    (tmp_path / "truth.relations").write_text("1000.5 1002.0 1 0 0 0 0 0\n", encoding="utf-8")
    chosen = {one.name: one.value for one in registry.dataset("carmen").choose({"path": str(path)})}
    assert chosen == {"range_max_m": 30.0, "relations": str(tmp_path / "truth.relations")}
    given = {"path": str(path), "range_max_m": 25.0, "relations": ""}
    assert list(registry.dataset("carmen").choose(given)) == []


def tum(path, begin_s=1000):
    """Write true poses at 60 tenths of a second: those of the scans of ``drive``."""
    path.write_text("".join(f"{begin_s + 0.1 * at:.1f} 0 0 0 0 0 0 1\n" for at in range(60)), encoding="utf-8")
    return path


def truth_choices(path):
    return [one for one in registry.dataset("carmen").choose({"path": str(path)}) if one.name == "ground_truth"]


@pytest.mark.parametrize(
    ("recording", "file", "named"),
    [
        ("drive", "drive.tum", True),
        ("drive.bag", "Drive-GroundTruth.tum", True),
        ("fr079-fullrate.clf.gz", "fr079-reference-flirtlib.tum", True),
        ("fr079-fullrate.clf.gz", "fr079.relations", True),
        ("drive", "truth.tum", True),
        ("drive", "ground_truth_2d.tum", True),
        ("drive", "gt.tum", True),
        ("drive", "final.tum", False),
        ("drive", "drive-slam.tum", False),
        ("drive", "drive2.tum", False),
        ("drive", "other-truth.tum", False),
        ("drive", "truthless.tum", False),
        ("run1.2.bag", "run1.2.tum", True),
        ("intel.gfs.log", "intel.gfs.tum", True),
        ("drive.bag", "vicon_icp.tum", False),
        ("2024-01-05-run.bag", "2024.tum", False),
        ("2024-01-05-run.bag", "2024-01-05-run-gt.tum", True),
        ("fr079-fullrate.clf.gz", "fr079-gmapping.tum", False),
    ],
)
def test_a_truth_has_the_name_of_its_recording_or_of_a_truth(recording, file, named):
    assert is_named_as_truth(Path(file), Path(recording)) is named


def test_the_output_of_a_slam_beside_a_recording_is_not_taken_for_its_truth(tmp_path):
    path = log(tmp_path, *drive())
    tum(tmp_path / "final.tum"), tum(tmp_path / "online.tum"), tum(tmp_path / "early.tum", 500)
    (said,) = truth_choices(path)
    assert (said.value, "--ground-truth FILE" in said.reason) == (None, True)
    assert "no ground truth taken of final.tum, online.tum, in the same folder: no name says" in said.reason
    truth = tum(tmp_path / "truth.tum")
    (chosen,) = truth_choices(path)
    assert chosen.value == str(truth)
    tum(tmp_path / "gt.tum")
    (said,) = truth_choices(path)
    assert said.value is None
    assert "of gt.tum, truth.tum, in the same folder: several have the name of a truth" in said.reason


def test_a_truth_by_its_name_that_cannot_be_used_is_told(tmp_path):
    path = log(tmp_path, *drive())
    tum(tmp_path / "truth.tum", 500)
    (said,) = truth_choices(path)
    assert said.value is None
    assert "ground truth truth.tum not taken: " in said.reason
    assert "do not overlap the recording" in said.reason


def test_a_given_truth_is_checked_and_stands_in_the_command(tmp_path):
    path = log(tmp_path, *drive())
    given = tum(tmp_path / "final.tum")
    good = CliRunner().invoke(cli.app, ["inspect", str(path), "--ground-truth", str(given)])
    assert good.exit_code == 0
    assert "opened: 60 scans, with ground truth" in good.stdout
    assert shlex.join(["evalkit", "compare", str(path), "--ground-truth", str(given)]) in good.stdout
    assert "truth: none inside the file" in good.stdout
    bad = CliRunner().invoke(cli.app, ["inspect", str(path), "--ground-truth", str(tum(given, 500))])
    assert bad.exit_code == 1
    assert "do not overlap the recording" in " ".join(bad.stdout.split())


@pytest.mark.parametrize(
    ("beams", "step_deg", "field_deg"),
    [
        (181, 1.0, 180.0),
        (361, 0.5, 180.0),
        (360, 1.0, 360.0),
        (361, 1.0, 360.0),
        (720, 0.4993, 360.0),
        (270, 1.0, 269.0),
        (1, 1.0, 0.0),
    ],
)
def test_the_field_of_view_is_from_the_first_beam_to_the_last_or_a_full_circle(beams, step_deg, field_deg):
    angles = np.radians(-90.0 + step_deg * np.arange(beams)).tolist()
    assert field_of_view_deg(angles) == pytest.approx(field_deg)


@pytest.mark.parametrize(
    ("low", "high", "said"),
    [
        (0.1, 8.0, "0.1 to 8 m"),
        (None, 8.0, "up to 8 m"),
        (0.1, None, "from 0.1 m"),
        (None, None, "no range limits stated"),
    ],
)
def test_range_limits_that_are_not_stated_are_not_made_up(low, high, said):
    given = dict.fromkeys((one.name for one in fields(LidarStats)), 0)
    assert LidarStats(**{**given, "range_min_m": low, "range_max_m": high}).limits == said


def test_map_cells_grow_with_the_distance_of_the_beams(tmp_path):
    """One degree at 4 m is 0.07 m, at 8 m 0.14 m: more than two cells of 0.05 m."""
    for scale, cell in ((1.0, None), (3.0, 0.1)):
        ranges = [[scale * 3.0] * 180 for _ in range(30)]
        path = log(tmp_path, *(flaser(f"{1000 + at}", row, (0.1 * at, 0.0, 0.0)) for at, row in enumerate(ranges)))
        chosen = {one.name: one.value for one in registry.dataset("carmen").choose({"path": str(path)})}
        assert chosen.get("mapper.resolution_m") == cell


def test_a_log_without_a_scan_is_a_problem_and_gets_no_suggested_config(tmp_path):
    found = inspect_recording(log(tmp_path, "ODOM 0 0 0 0 0 0 1.0 h 1.0", "ODOM 1 0 0 0 0 0 2.0 h 2.0"))
    assert found.findings[0].level == "problem"
    assert suggest_config(found) is None


def test_a_log_whose_scans_are_all_damaged_tells_why_instead_of_asking_for_a_lidar(tmp_path):
    line = "FLASER 2 1 1 0 0 0 0 0 0 nan host nan\n"
    (tmp_path / "a.log").write_text(3 * line)
    first, *others = inspect_recording(tmp_path / "a.log").findings
    told = "no scan in it can be read: 3 damaged lines, dropped; the first is line 1: "
    assert (first.level, first.what.startswith(told)) == ("problem", True)
    assert not [one for one in others if "damaged" in one.what or "no laser scans" in one.what]


def test_a_pose_graph_is_told_its_size_and_chi_square(tmp_path):
    """A square of steps of 1 m whose last edge is 0.2 m too short: 0.04 times an information of 100."""
    path = tmp_path / "a.g2o"
    steps = "".join(f"EDGE_SE2 {k} {k + 1} 1 0 {math.pi / 2} 100 0 0 100 0 100\n" for k in range(3))
    path.write_text(steps + f"EDGE_SE2 3 0 0.8 0 {math.pi / 2} 100 0 0 100 0 100\n")
    with pytest.raises(
        BadData, match=r"a pose graph \(g2o\) without scans: 4 poses, 4 edges, 1 of them loops, "
    ) as told:
        inspect_recording(path)
    assert float(str(told.value).split("chi-square ")[1].split(";")[0]) == pytest.approx(4.0)
    assert f"python -m evalkit_baselines.slam {path} OPTIMISED.g2o" in str(told.value)


def test_errors_of_invalid_files_are_those_of_the_readers(tmp_path):
    (tmp_path / "torn.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(40))
    with pytest.raises(BadData, match="not a readable bag"):
        inspect_recording(tmp_path / "torn.bag")
    (tmp_path / "torn.log.gz").write_bytes(b"\x1f\x8b" + bytes(40))
    with pytest.raises(BadData, match="gzip"):
        inspect_recording(tmp_path / "torn.log.gz")
    (tmp_path / "picture.png").write_bytes(bytes(range(256)) * 20)
    with pytest.raises(BadData, match="give a bag"):
        inspect_recording(tmp_path / "picture.png")
    (tmp_path / "true.tum").write_text("1.0 0 0 0 0 0 0 1\n")
    with pytest.raises(BadData, match=r"with its recording: evalkit compare RECORDING --ground-truth .*true\.tum"):
        inspect_recording(tmp_path / "true.tum")
    (tmp_path / "notes.txt").write_text("some words\n")
    with pytest.raises(BadData, match=r"notes\.txt\.toml \(tables \[time\] and \[scan\], see docs/pages/") as told:
        inspect_recording(tmp_path / "notes.txt")
    page = Path(__file__).parents[3] / re.search(r"see (\S+)\)", str(told.value))[1]
    assert "[scan]" in page.read_text(encoding="utf-8")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadData, match=r"without metadata\.yaml"):
        inspect_recording(tmp_path / "empty")


@pytest.mark.parametrize(
    ("begin", "end", "said"),
    [
        ("2023-11-14T22:13:{at:02d}+00:00,", "", r"texts such as '2023-11-14T22:13:00\+00:00'; write numbers alone"),
        ('{at},"[', ']"', r"texts such as '\"\[2\.0'; write numbers alone"),
        ("", "one beam", r"text of 3 columns of numbers: too few for a scan a line; write one line per scan"),
    ],
)
def test_a_text_log_with_times_or_ranges_that_are_no_numbers_names_them(tmp_path, begin, end, said):
    ranges = ",".join(["2.0"] * 60)
    lines = [f"{begin.format(at=at)}{ranges}{end}" for at in range(60)]
    if end == "one beam":
        lines = [f"{at // 20},{at % 20},2.0" for at in range(600)]
    (tmp_path / "run.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(BadData, match=said):
        inspect_recording(tmp_path / "run.csv")


def test_the_command_prints_json_and_writes_a_page(tmp_path):
    app = typer.Typer()
    app.command()(inspect)
    path = log(tmp_path, *drive())
    result = CliRunner().invoke(app, [str(path), "--json", "-o", str(tmp_path / "page")])
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["lidars"][0]["timing"]["count"] == 60
    assert told["run"]["command"].startswith("evalkit compare")
    assert "<svg" not in (tmp_path / "page" / "index.html").read_text(encoding="utf-8")  # figures are data URIs
    assert json.loads((tmp_path / "page" / "inspection.json").read_text(encoding="utf-8"))["kind"] == "CARMEN log"
    told = CliRunner().invoke(app, [str(path)]).stdout
    assert "[[sequence]]" in told


@pytest.mark.parametrize("last", [4.29e9, pytest.param(1e6, marks=pytest.mark.thorough)])
def test_stamps_over_a_century_do_not_fill_the_memory(tmp_path, last):
    """A grid of half seconds over these times would have 8.6e9 cells."""
    stamps = [-208.0, *(1000.0 + 0.1 * at for at in range(60)), last]
    poses = arc(count=62).poses
    lines = [flaser(f"{stamp:.6f}", walls(1)[0], pose) for stamp, pose in zip(stamps, poses, strict=True)]
    path = log(tmp_path, *lines)
    tracemalloc.start()
    found = inspect_recording(path)
    build_document(found, suggest_config(found))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2**28
    assert found.lidars[0].timing.duration_s == pytest.approx(last + 208.0)
    assert found.odometries[0].fastest_m_s == pytest.approx(0.3, abs=0.02)  # as between the usual stamps


def test_poses_with_equal_stamps_are_all_on_the_path():
    poses = np.stack([0.1 * np.arange(100.0), np.zeros(100), np.zeros(100)], axis=-1)
    for stamps in (np.arange(100) // 2 * S, np.zeros(100, dtype=np.int64)):  # pairs, and all of them
        found = measure_odometry(OdometryStream("x", "odom", "base", stamps, poses))
        assert found.path_m == pytest.approx(9.9)
        assert found.median_step_m == pytest.approx(0.1)
        assert found.jump_count == 0
        assert found.net[0] == pytest.approx(9.9)


def test_raw_odometry_of_a_gmapping_log_is_not_taken_for_poses_of_a_filter(tmp_path):
    """Half a metre and more apart, wheels do not stay on one arc; the ODOM line carries the previous reading's pose."""
    rng = np.random.default_rng(0)
    heading = np.cumsum(0.1 * rng.standard_normal(4000))
    fine = np.stack([np.cumsum(0.02 * np.cos(heading)), np.cumsum(0.02 * np.sin(heading)), heading], axis=-1)
    poses, lines = fine[::30], []
    for at, row in enumerate(walls(len(poses))):
        x, y, theta = poses[at]
        x0, y0, theta0 = poses[max(at - 1, 0)]
        ranges = " ".join(f"{value:.2f}" for value in row)
        lines += [f"ODOM {x0} {y0} {theta0} {at}.5", f"LASER_READING 180 {ranges} {x} {y} {theta} {at}.5"]
    found = inspect_recording(log(tmp_path, *lines, name="made.gfs"))
    (odometry,) = found.odometries
    assert odometry.median_step_m > 0.3
    assert odometry.like_wheels
    assert "filter" not in run_inspection(found)
    assert "odometry" not in suggest_config(found).parameters
    assert odometry.net[0] == pytest.approx(poses[-1, 0] - poses[0, 0], abs=2.0)


def write_columns(folder):
    path = folder / "drive.csv"
    path.write_text("t,x,y,h,ranges\n" + "".join(
        f"{0.1 * at},{pose[0]},{pose[1]},{pose[2]},{','.join(f'{r:.2f}' for r in row)}\n"
        for at, (pose, row) in enumerate(zip(arc(count=60).poses, walls(60), strict=True))
    ))  # fmt: skip
    path.with_name("drive.csv.toml").write_text(
        "header_lines = 1\n[time]\ncolumn = 1\n[scan]\nfirst = 5\nstep_deg = 1\n[pose]\nx = 2\ny = 3\nheading = 4\n"
    )
    return path


def test_a_sweep_of_a_text_log_that_is_longer_than_the_time_between_scans_names_its_key(tmp_path):
    path = write_columns(tmp_path)
    layout = path.with_name("drive.csv.toml")
    for turned_s in (0.1, 0.3):
        text = layout.read_text(encoding="utf-8").replace("[pose]", f"turned_s = {turned_s}\n[pose]")
        path.with_name("drive.csv.toml").write_text(text, encoding="utf-8")
        said = [one.advice for one in inspect_recording(path).findings if one.level == "problem"]
        layout.write_text(text.replace(f"turned_s = {turned_s}\n", ""), encoding="utf-8")
        mend = "if the lidar turns once a scan, write turned_s = 0.05 in [scan] of the layout"  # half a turn
        assert said == [mend] * (turned_s > 0.15)


def test_times_of_a_text_log_that_have_lost_their_digits_are_a_problem_that_a_comparison_repeats(tmp_path):
    path = write_columns(tmp_path)
    lines = path.read_text().splitlines()
    times = [0.1 * at for at in range(60)]
    cut = [f"{1.7e9 + time:.5E},{line.partition(',')[2]}" for time, line in zip(times, lines[1:], strict=True)]
    path.write_text("\n".join([lines[0], *cut]))
    said = [one for one in inspect_recording(path).findings if one.level == "problem"]
    assert [one.what for one in said] == ["59 of 60 scans have the time of another scan, and are dropped"]
    assert any("59 of 60 scans" in one.reason for one in registry.dataset("columns").choose({"path": str(path)}))
    path.write_text("\n".join([*lines, lines[-1]]))  # the last line twice
    notes = [one.what for one in inspect_recording(path).findings if one.level == "note"]
    assert "scans with a repeated stamp dropped: 1" in notes


def test_a_defect_that_a_reader_names_with_the_same_word_is_no_lost_digit():
    streams = SimpleNamespace(defects={"scans repeated by the logger": 90}, topics=[SimpleNamespace(count=60)])
    (found,) = findings._check_defects(streams)
    assert (found.level, found.what) == ("note", "scans repeated by the logger: 90")


RECORDINGS = {
    "odometry": lambda folder: log(folder, *drive()),
    "a code": lambda folder: log(folder, *drive(code=30.0)),
    "another suffix": lambda folder: log(folder, *drive(), name="drive.txt"),
    "blanks in its name": lambda folder: log(folder, *drive(), name="my drive's log"),
    "no suffix, gzip": lambda folder: packed(log(folder, *drive())),
    "filter poses": lambda folder: log(folder, *(flaser(f"{1000 + at}", row, pose) for at, (row, pose) in enumerate(
        zip(walls(60), arc(count=60, noise=0.01).poses, strict=True)))),
    "no stamps": lambda folder: log(folder, *(flaser("0", row, pose) for row, pose in zip(
        walls(60), arc(count=60).poses, strict=True))),
    "corrected": lambda folder: log(folder, *(flaser(f"{at}", row, (0.9 * at, 0, 0), "pippo")
        for at, row in enumerate(walls(30))), "NEFF 1"),
    "columns": write_columns,
    "bag": lambda folder: write_example(folder / "drive", "lab", {"laps": 0.05}).bag,
}  # fmt: skip


def packed(path):
    target = path.with_name("drive")
    target.write_bytes(gzip.compress(path.read_bytes()))
    return target


def run_suggested(found):
    """Run the suggested command, without its runs, and return its result."""
    advice = suggest_config(found)
    words = shlex.split(advice.command)
    assert words[:2] == ["evalkit", "compare"]
    return CliRunner().invoke(cli.app, [*words[1:], "--backends", "wheel-odometry", "--collect", "--no-page"])


@pytest.mark.parametrize("kind", RECORDINGS)
def test_the_suggested_command_is_accepted(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = inspect_recording(RECORDINGS[kind](tmp_path))
    assert suggest_config(found).problem == ""
    result = run_suggested(found)
    assert "1 not run yet" in result.output or "no wheel odometry" in result.output, result.output


def shorten(path, target, messages=30):
    """Copy the first messages of each topic of a bag."""
    rosbag1 = pytest.importorskip("rosbags.rosbag1")
    with rosbag1.Reader(path) as bag, rosbag1.Writer(target) as out:
        copies = {
            one.id: out.add_connection(one.topic, one.msgtype, msgdef=one.msgdef.data, md5sum=one.digest)
            for one in bag.connections
        }
        left = dict.fromkeys(copies, messages)
        for one, stamp, content in bag.messages():
            if left[one.id]:
                left[one.id] -= 1
                out.write(copies[one.id], stamp, content)
            elif not any(left[lidar.id] for lidar in bag.connections if "Scan" in lidar.msgtype):
                break
    return target


@pytest.mark.parametrize(
    "name",
    [
        "static-2xhokuyo.bag",
        "wheelchair-3xhokuyo.bag",
        pytest.param("cartographer-backpack-short.bag", marks=pytest.mark.thorough),
    ],
)
def test_the_suggested_command_of_a_real_bag_is_accepted(name, tmp_path, monkeypatch):
    path = shorten(recorded("bags", name), tmp_path / name)
    monkeypatch.chdir(tmp_path)
    result = run_suggested(inspect_recording(path))
    assert "1 not run yet" in result.output or "no wheel odometry" in result.output, result.output


# --- known properties of real recordings


def recorded(*names):
    path = DATA.joinpath(*names)
    if not path.exists():
        pytest.skip(f"{path} is not here: set EVALKIT_DATA")
    return path


@cache
def inspect_real(*names):
    """Inspect a recording once for all tests."""
    return inspect_recording(recorded(*names))


def test_clock_zeros_and_missing_frames_of_the_wheelchair_are_found():
    found = inspect_real("bags", "wheelchair-3xhokuyo.bag")
    assert [lidar.topic for lidar in found.lidars] == ["/left_scan", "/rear_scan", "/right_scan"]
    assert all(lidar.beams == 768 and lidar.field_of_view_deg == pytest.approx(270, abs=1) for lidar in found.lidars)
    assert all(lidar.clock.median_s == pytest.approx(0.24, abs=0.01) for lidar in found.lidars)
    assert all(0.13 < lidar.returns.zero < 0.21 for lidar in found.lidars)
    assert "no transforms" in run_inspection(found)
    bodies = [lidar.returns.body for lidar in found.lidars]  # at both ends of a view of 270 deg
    assert [[round(edge) for sector in body.sectors_deg for edge in sector] for body in bodies] == [
        [-135, -130, 134, 135], [-135, -126, 128, 135], [-135, -132, 133, 135]
    ]  # fmt: skip
    assert best_lidar(found)[0].topic == "/right_scan"
    told = 'it is a catalogued recording: use = "wheelchair" runs it with its parameters and ground truth'
    chosen = registry.dataset("rosbag").choose({"path": str(found.path)})  # as before a comparison
    assert [one.reason for one in chosen if one.value is None and "catalogued" in one.reason] == [told]


def test_the_stationary_robot_is_found_to_be_at_rest():
    found = inspect_real("bags", "static-2xhokuyo.bag")
    assert all(lidar.returns.still > 0.99 and lidar.returns.body is None for lidar in found.lidars)
    assert "the robot stands still" in run_inspection(found)


def test_the_turtlebots_lidar_is_rotated_and_its_two_bases_are_reported():
    found = inspect_recording(recorded("turtlebot4-rplidar", "macfirst_floor_take_2"))
    (seat,) = found.frames.mountings
    assert (seat.x_m, seat.y_m, seat.theta_deg) == pytest.approx((0.004, 0.0, 90.0), abs=1e-3)
    assert found.lidars[0].returns.infinite == pytest.approx(0.23, abs=0.005)
    assert found.lidars[0].returns.body is None
    odometry = next(one for one in found.odometries if one.topic == "/odom")
    assert odometry.path_m == pytest.approx(8.35, abs=0.01)
    assert odometry.like_wheels
    assert "base_footprint and base_link" in run_inspection(found)
    assert "(6.54, -8.86)" in run_inspection(found)


@pytest.mark.thorough
@pytest.mark.slow
def test_pseudo_odometry_is_rejected():
    found = inspect_recording(recorded("fr079", "fr079-fullrate.clf.gz"))
    advice = suggest_config(found)
    assert "sideways slip" in run_inspection(found)
    assert "1211.00 to 1211.51 s" in run_inspection(found)
    assert advice.parameters["odometry"] == "none"
    assert advice.parameters["relations"].endswith("fr079.relations")
    assert (advice.scans, advice.catalogued) == (4791, "")  # a file made otherwise than the catalogued one
    assert any("x -0.040 m" in reason for reason in advice.reasons)
    assert "360 beams are assumed to begin at -90 deg" in run_inspection(found)
    assert build_document(found, advice).title == "fr079-fullrate.clf.gz"


def test_raw_wheel_odometry_is_distinguished_from_pseudo_odometry():
    found = inspect_recording(recorded("intel", "intel-merged.clf.gz"))
    assert all(one.like_wheels for one in found.odometries)
    assert found.lidars[0].returns.codes[0].low_m == 81.83
    assert found.lidars[0].returns.body is None
    assert found.lidars[0].timing.gaps[0].length_s == pytest.approx(28.3, abs=0.1)


@pytest.mark.parametrize(("name", "code"), [("aces", 50.0), ("freiburg-101", 81.91), ("intel", 81.83)])
def test_corrected_logs_are_recognised_by_their_markers(name, code):
    found = inspect_recording(recorded("radish-corrected", f"{name}-corrected.log.gz"))
    assert found.truth_inside == "GMapping's poses"
    assert found.lidars[0].returns.codes[0].high_m == code
    for trap in ("6 significant digits", "m apart (median)", "stamps decrease"):
        assert trap in run_inspection(found)


def told(found):
    return [(one.level, one.what) for one in found]


def test_clocks_that_drift_and_speeds_that_disagree_are_said():
    drifting = ClockOffset(0.0, 0.0, 0.0, 0.0, 0.0, 800.0)
    assert told(lidar_findings._check_clock(drifting, "/scan", False)) == [
        ("warning", "its clock drifts from the recorder's by 800 ppm")
    ]
    wheels = SimpleNamespace(twist=TwistComparison(False, 2.0, float("nan")))
    assert told(odometry_findings._check_twist(wheels, "/odom")) == [
        ("warning", "its poses have 2.00 times the speed of its messages")
    ]
    assert list(odometry_findings._check_twist(SimpleNamespace(twist=TwistComparison(False, 1.0, 1.2)), "/odom")) == []


def test_frames_with_several_parents_and_lidars_that_are_not_level_are_said():
    mountings = (
        LidarMounting("base", "a", problem="it is tilted by 12 deg"), LidarMounting("base", "b", mirrored=True),
        LidarMounting("base", "c", theta_deg=90.0), LidarMounting("base", "d"),
    )  # fmt: skip
    tree = FrameTree(("base", "a"), contested={"a": ("base", "odom")}, mountings=mountings)
    streams = SimpleNamespace(kind="ROS 2 bag", lasers=(), tree=SimpleNamespace(moving=[]))
    assert told(findings._check_frames(tree, streams)) == [
        ("warning", "frame 'a' has several parents: base, odom"),
        ("warning", "it is tilted by 12 deg"),
        ("note", "mounted upside down; the reader mirrors its angles"),
        ("note", "rotated by 90 deg on 'base'"),
    ]
