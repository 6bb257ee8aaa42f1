"""``embedded-slam`` against ``paper-slam``: the same scans, the same loops, the same poses."""

import re
import runpy
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.loop_closures import judge_closures
from evalkit.metrics.metric import Evidence
from evalkit.metrics.recovery import add_recovery
from evalkit.metrics.track import find_lost_track
from evalkit.metrics.trajectory import match_trajectories
from evalkit.plugins import registry
from evalkit_baselines.slam import embedded_slam, paper_slam

pytest.importorskip("evalkit_baselines.embedded._core64")

shared = runpy.run_path(str(Path(__file__).with_name("test_paper_slam.py")))
RING, STEP_NS = shared["RING"], shared["STEP_NS"]
errors_m, make_frames, ring_drive = shared["errors_m"], shared["make_frames"], shared["ring_drive"]

LAPS, DRIFT = 1.25, 2e-4
BODY_RAD = np.radians(50.0)
FULL = 4
"""Flag of an update of the core: no memory for another keyframe."""
SMALL = {
    "beams": 400, "keyframes": 400, "keyframe_points": 100_000, "loops": 16, "records": 64, "voxels": 8192,
    "map_points": 8192, "loop_points": 16384, "score_cells": 1 << 17, "loop_path_m": 10.0,
}  # fmt: skip


def run(make, frames, **parameters):
    slam = make(**parameters)
    return slam, [slam.update(frame) for frame in frames]


def off_axis(frames):
    """Return the frames without a beam along an axis of the base: its points lie on a border of cells, where rounding
    decides, so that two correct programs thin a scan to other means.
    """
    return [replace(frame, base_from_sensor=Pose(0.0, 0.0, 0.003)) for frame in frames]


@cache
def drive():
    return list(make_frames(RING, ring_drive(LAPS), drift=DRIFT))


@cache
def reference():
    return run(paper_slam.make, drive(), loop_path_m=10.0)


def rows(estimates):
    return np.array([estimate.pose.row for estimate in estimates])


def decisions(slam):
    return [
        (loop.stamp_ns, loop.other_stamp_ns, loop.accepted, loop.found_again, loop.reason)
        for loop in slam.loop_closures()
    ]


def with_body(frames):
    """Return the frames of a turned lidar that sees the robot behind it; every 100th is without odometry."""
    turned = Pose(0.0, 0.0, 0.7)
    for at, frame in enumerate(frames):
        scan = frame.scan
        behind = np.cos(scan.angles + frame.base_from_sensor.theta) <= -np.cos(0.5 * BODY_RAD)
        ranges = np.where(behind, 0.25 + 0.001 * (np.arange(len(behind)) % 7), scan.ranges)
        own = replace(scan, ranges=ranges, angles=scan.angles - turned.theta)
        lost = {"odom_from_base": None, "start_from_end": None} if at % 100 == 99 else {}
        yield replace(frame, scan=own, base_from_sensor=frame.base_from_sensor @ turned, **lost)


def test_what_moves_along_is_left_out_alike_and_holds_neither_back():
    """Without that the robot stands in the corridor, and is 20 m off at the end."""
    data = registry.dataset("doors").make(seed=41, laps=0.5, rate_hz=10.0)
    frames = list(with_body(data.frames()))
    expected, estimates = run(paper_slam.make, frames)
    slam, found = run(embedded_slam.make, frames, work=0)
    assert decisions(slam) == decisions(expected)
    assert np.abs(se2.between(rows(estimates), rows(found))).max() < 1e-9
    true = data.truth().trajectory.at([frame.scan.stamp_ns for frame in frames])
    apart = se2.between(se2.between(true[:1], true), slam.trajectory().poses)
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 1.0


def test_without_a_limit_of_work_it_is_paper_slam():
    expected, estimates = run(paper_slam.make, off_axis(drive()), loop_path_m=10.0)
    slam, found = run(embedded_slam.make, off_axis(drive()), work=0, **SMALL)
    assert decisions(slam) == decisions(expected)
    assert any(loop.accepted for loop in slam.loop_closures())
    assert np.abs(se2.between(rows(estimates), rows(found))).max() < 1e-9
    assert np.abs(se2.between(expected.trajectory().poses, slam.trajectory().poses)).max() < 1e-9
    assert [one.accepted for one in found] == [one.accepted for one in estimates]


def test_means_count_as_their_points_while_the_lidar_is_noisy_and_clean_as_in_paper_slam():
    """From the 31st scan on 60 % of the beams have no return and 5 % a random range: the lidar becomes dirty."""
    rng, frames = np.random.default_rng(6), list(islice(registry.dataset("room").make(seed=5).frames(), 60))
    for number in range(30, 60):
        ranges = frames[number].scan.ranges.copy()
        drawn = rng.random(len(ranges))
        ranges[drawn < 0.6] = np.nan
        ranges[drawn > 0.95] = rng.uniform(0.2, 11.0, (drawn > 0.95).sum())
        frames[number] = replace(frames[number], scan=replace(frames[number].scan, ranges=ranges))
    expected, told, estimates = paper_slam.make(), [], []
    for frame in frames:
        estimates.append(expected.update(frame))
        told.append(expected._map.noisy)
    assert (told[0], told[1:31], told[-1]) == (False, [True] * 30, False)  # by the scans before
    _, found = run(embedded_slam.make, frames, work=0, **SMALL | {"beams": 800})
    assert np.abs(se2.between(rows(estimates), rows(found))).max() < 1e-9


def test_scans_half_covered_without_odometry_are_placed_as_by_paper_slam():
    there, rng, frames = ring_drive(0.5)[:20], np.random.default_rng(4), []
    for row, frame in enumerate(make_frames(RING, there)):
        ranges = frame.scan.ranges.copy()
        if row in (14, 15):  # something 0.4 to 0.6 m away on one side
            side = np.abs(frame.scan.angles - np.pi / 2) < np.pi / 2
            ranges[side] = rng.uniform(0.4, 0.6, side.sum())
        frames.append(replace(frame, scan=replace(frame.scan, ranges=ranges), odom_from_base=None))
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL)
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-6
    errors = errors_m(rows(found), there)
    assert errors[:15].max() < 0.01  # the first of the two too: matched with near pairs from the prediction
    assert errors[16:].max() < 0.01


@pytest.mark.parametrize("slower", [1, 20])
def test_without_odometry_scans_bent_by_a_quick_turn_lie_on_the_map_also_2_s_apart(slower):
    data = registry.dataset("lab").make(seed=78, speed_mps=1.0)
    frames = [
        replace(
            frame,
            scan=replace(
                frame.scan,
                stamp_ns=slower * frame.scan.stamp_ns,
                time_increment_ns=slower * frame.scan.time_increment_ns,
            ),
            odom_from_base=None,
            start_from_end=None,
        )
        for frame in islice(data.frames(), 120)
    ]
    true = data.truth().trajectory.at([frame.scan.stamp_ns // slower for frame in frames])
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL | {"beams": 800})
    for answers in (expected, found):
        assert not any(answer.accepted is False for answer in answers)
        gap = se2.between(se2.between(true[:1], true[-1:]), rows(answers)[-1:])[0]
        assert np.hypot(gap[0], gap[1]) < 0.03  # without the search 0.17 m, where they are 2 s apart
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-9


def test_without_odometry_turns_of_50_deg_between_two_scans_keep_the_track_as_in_paper_slam():
    data = registry.dataset("office").make(seed=3, rate_hz=5.0, speed_mps=0.5, turn_dps=90.0)
    frames = [replace(one, odom_from_base=None, start_from_end=None) for one in islice(data.frames(), 0, 240, 3)]
    true = np.asarray(data.truth().trajectory.at([one.scan.stamp_ns for one in frames]))
    assert np.degrees(np.abs(se2.between(true[:-1], true[1:])[:, 2])).max() > 50.0
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL | {"beams": 1600})
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-6
    apart = se2.between(se2.between(true[:1], true), rows(found))
    assert np.hypot(apart[:, 0], apart[:, 1]).max() < 0.2  # without the search 1.6 m


@pytest.mark.parametrize("work", [200_000, 50_000])
def test_slices_close_the_same_loops_later_and_end_within_5_mm(work):
    expected, _ = reference()
    slam, _ = run(embedded_slam.make, drive(), work=work, **SMALL)
    accepted = [loop for loop in slam.loop_closures() if loop.accepted]
    assert len(accepted) == sum(loop.accepted for loop in expected.loop_closures())
    assert np.abs(se2.between(expected.trajectory().poses, slam.trajectory().poses))[:, :2].max() < 0.005
    assert errors_m(slam.trajectory().poses, ring_drive(LAPS)).max() < 0.05


def watch(slam):
    """Return a list that every update appends flags, last keyframe and operations of the core to."""
    inner, seen = slam._slam, []

    class Watched:
        """The core's SLAM."""

        def __getattr__(self, name):
            return getattr(inner, name)

        def update(self, **scan):
            answer = inner.update(**scan)
            seen.append(answer[4:])
            return answer

    slam._slam = Watched()
    return seen


def test_a_slice_of_work_ends_soon_after_its_operations_are_used_up():
    limit, slam = 50_000, embedded_slam.make(work=50_000, **SMALL)
    seen = watch(slam)
    for frame in drive():
        slam.update(frame)
    used = [operations for *_, operations in seen]
    # the largest part: the normals of a loop's target, 160 operations a point
    assert limit < max(used) < limit + 160 * 4000
    assert sorted(used)[len(used) // 2] <= limit


@pytest.mark.parametrize("scans", [1_000, pytest.param(100_000, marks=pytest.mark.thorough)])
def test_a_drive_that_wants_far_more_keyframes_than_there_is_room_for_goes_on_without_growing(scans):
    """Every scan is a keyframe, of one lap again and again, with every fourth beam."""
    room, lap, true = 200, list(make_frames(RING, ring_drive(1.0))), ring_drive(1.0)
    changed = {"keyframes": room, "keyframe_distance_m": 0.1, "keyframe_angle_deg": 1.0, "work": 200_000}
    slam = embedded_slam.make(**SMALL | changed)
    seen, memory = watch(slam), slam.memory_bytes
    for number in range(scans):
        frame = lap[number % len(lap)]
        scan = replace(
            frame.scan, stamp_ns=number * STEP_NS, ranges=frame.scan.ranges[::4], angles=frame.scan.angles[::4]
        )
        slam.update(replace(frame, scan=scan))
    flags, keyframe, operations = np.array(seen).T
    assert (flags & FULL).astype(bool).tolist() == [number >= room for number in range(scans)]
    assert keyframe.max() == room - 1
    assert slam.memory_bytes == memory
    assert operations[room:].max() < 30_000  # registrations alone; before, closing a loop took 400,000
    assert operations[:room].max() > 200_000
    assert errors_m(slam.trajectory().poses, true[np.arange(scans) % len(lap)]).max() < 0.05


def remark_on(scans, **memory):
    """Return the remarks on the first scans of the drive, every one of which is a keyframe."""
    slam, _ = run(embedded_slam.make, drive()[:scans], **SMALL | {"keyframe_distance_m": 0.05} | memory)
    return slam.remarks()


def test_used_up_memory_is_remarked_with_the_parameter_to_raise():
    assert remark_on(30) == ()
    at_20 = "no room for keyframes, and no loop closed, from scan 21 of 30 on"
    assert remark_on(30, keyframes=20) == (f"{at_20}: raise keyframes (20)",)
    (points,) = remark_on(30, keyframe_points=2000)
    assert points.endswith("of 30 on: raise keyframe_points (2000)")
    (voxels,) = remark_on(30, voxels=256)
    assert re.fullmatch(r"no room for [1-9][\d,]* groups of points in the map: raise voxels \(256\)", voxels)


def test_loops_and_candidates_without_room_are_remarked():
    slam, _ = run(embedded_slam.make, drive(), **SMALL | {"loops": 1})
    left = sum("no room" in loop.reason for loop in slam.loop_closures())
    assert left > 0
    assert slam.remarks() == (f"no room for {left} loops: raise loops (1)",)
    slam, _ = run(embedded_slam.make, drive(), **SMALL | {"records": 1})
    assert len(slam.loop_closures()) == 1
    (remark,) = slam.remarks()
    assert re.fullmatch(r"no room for [1-9]\d* candidates, which close no loop: raise records \(1\)", remark)


def test_single_precision_closes_the_loop():
    slam, _ = run(embedded_slam.make, drive(), precision="float", **SMALL)
    assert any(loop.accepted for loop in slam.loop_closures())
    assert errors_m(slam.trajectory().poses, ring_drive(LAPS)).max() < 0.05


def test_a_kidnapped_robot_is_reported_and_found_again():
    there = ring_drive(1.0)
    carried = there[16:62]
    frames = list(make_frames(RING, there))
    slam = embedded_slam.make(work=0, **SMALL | {"loop_path_m": 15.0})
    for frame in make_frames(RING, carried, seed=1):  # the wheels stand still
        later = replace(frame.scan, stamp_ns=frame.scan.stamp_ns + len(there) * STEP_NS)
        frames.append(replace(frame, scan=later, odom_from_base=frames[len(there) - 1].odom_from_base))
    frames = off_axis(frames)
    estimates = [slam.update(frame) for frame in frames]
    assert all(estimate.accepted is not False for estimate in estimates[: len(there)])
    assert estimates[len(there)].accepted is False
    assert any(loop.accepted and loop.found_again for loop in slam.loop_closures())
    assert all(loop.found_again is ("lost track" in loop.reason) for loop in slam.loop_closures())
    known = np.r_[: len(there), len(there) + 10 : len(there) + len(carried)]  # for 2 s the scans are set aside
    assert errors_m(slam.trajectory().poses, np.concatenate([there, carried]))[known].max() < 0.1
    expected, _ = run(paper_slam.make, frames)
    # of several rivals of an ambiguous place either may name another one
    one, other = ([(*row[:4], row[4].split(" has ")[0]) for row in decisions(each)] for each in (slam, expected))
    assert one == other


@pytest.mark.parametrize("measured", [False, True])
def test_found_again_counts_as_recovered_where_the_truth_agrees(measured):
    """20 scans are missing. The wheels know nothing of it, and the SLAM finds a place that looks the same instead."""
    poses, kept = ring_drive(2.5), np.r_[:170, 190 : len(ring_drive(2.5))]
    complete = list(make_frames(RING, poses))
    frames = [complete[index] for index in kept]
    stands = frames[169].odom_from_base @ frames[170].odom_from_base.inverse()
    for index, frame in enumerate(frames):
        odom = frame.odom_from_base if index < 170 else stands @ frame.odom_from_base
        frames[index] = replace(frame, odom_from_base=odom if measured else None)
    slam, estimates = run(embedded_slam.make, frames, work=0, **SMALL)
    (found,) = (loop for loop in slam.loop_closures() if loop.found_again)
    steps = np.zeros(len(frames), dtype=STEP)
    steps["stamp_ns"] = stamps = np.array([frame.scan.stamp_ns for frame in frames])
    steps["x"], steps["y"], steps["theta"] = rows(estimates).T
    truth, answers = Truth("exact", Trajectory(stamps, poses[kept])), RunResult(steps, len(steps))
    evidence = Evidence(answers, truth, match_trajectories(answers.estimate, truth.trajectory))
    lost = add_recovery(evidence, find_lost_track(evidence, lambda: frames))
    assert lost.at_s == pytest.approx(38.0)
    assert judge_closures([found], truth.trajectory).right.tolist() == [not measured]
    assert lost.recovered_at_s == (None if measured else pytest.approx(1e-9 * found.stamp_ns))


@pytest.mark.parametrize(("measured", "scans", "within"), [(True, 9, 1e-7), (True, 13, 1e-5), (False, 2, 1e-7)])
def test_covered_scans_are_set_aside_or_the_track_is_lost_as_in_paper_slam(measured, scans, within):
    """From the thirteenth covered scan on, without odometry the third, scans match random points: rounding grows."""
    covered = shared["cover"](make_frames(RING, ring_drive(0.5)[: 20 + scans]), range(15, 15 + scans), measured)
    frames = off_axis(covered)
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL)
    assert [one.accepted for one in found] == [one.accepted for one in expected]
    assert all(one.accepted is False for one in found[15 : 15 + (min(scans, 11) if measured else 1)])
    gap = np.abs(se2.between(rows(expected), rows(found)))
    assert gap[:27].max() < 1e-7
    assert gap.max() < within


@pytest.mark.parametrize("make", [paper_slam.make, embedded_slam.make])
@pytest.mark.parametrize("measured", [True, False])
def test_where_odometry_is_good_a_scan_is_matched_with_the_map_alone_and_a_slip_brings_both_stages_back(make, measured):
    true, slip, slipped = ring_drive(1.0)[:80], Pose(-0.15, 0.0, 0.0), 70
    frames = [
        replace(frame, odom_from_base=slip @ frame.odom_from_base if row >= slipped else frame.odom_from_base)
        if measured
        else replace(frame, odom_from_base=None)
        for row, frame in enumerate(make_frames(RING, true))
    ]
    _, estimates = run(make, frames)
    stages = [sorted(estimate.stages) for estimate in estimates]
    both = [row for row, names in enumerate(stages) if names == ["s2m", "s2s"]]
    assert stages[0] == []
    if measured:  # what is usual is known after 50 matches
        assert both == [*range(1, 51), slipped]
        assert all(names == ["s2m"] for row, names in enumerate(stages) if row > 50 and row != slipped)
    else:
        assert both == list(range(1, 80))
    assert errors_m(rows(estimates), true).max() < 0.04


def test_a_scan_within_which_the_robot_begins_or_ends_to_turn_has_the_pose_of_good_odometry_as_in_paper_slam():
    """The turns begin and end within scans 45, 48, 106 and 110; what is usual is known after 50 matches."""
    sequence = registry.dataset("symmetric-office").make(seed=3, laps=0.55)
    true, frames = sequence.truth().trajectory.poses, list(sequence.frames())
    turns = se2.wrap(np.diff(true[:, 2]))
    changed = np.flatnonzero(np.abs(np.diff(turns)) > np.radians(3.0)) + 1
    assert changed.tolist() == [45, 46, 48, 49, 106, 107, 110, 111]  # beside each of them the rate changes, too
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0)
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-9
    for estimates in (expected, found):
        assert [row for row, estimate in enumerate(estimates) if estimate.accepted is False] == [106, 110]
        assert [row for row, estimate in enumerate(estimates) if not estimate.stages] == [0, 106, 110]
    off_deg = np.degrees(np.abs(se2.between(rows(found), se2.between(true[0], true))[:, 2]))
    assert off_deg[[45, 48]].min() > 2.0  # bent
    assert off_deg[50:].max() < 0.3


@pytest.mark.parametrize("covered", [61, 62])
def test_a_covered_scan_after_one_that_was_set_aside_is_set_aside_too(covered):
    """The sweeps of scans 20, 30 and 60 turn 3 deg farther than the robot by the wheels: the last one is set aside."""
    true, frames = ring_drive(1.0)[:85], []
    for row, frame in enumerate(shared["cover"](make_frames(RING, true), range(covered, 66))):
        if row in (20, 30, 60):
            within = se2.between(true[row - 1], true[row])[2] + np.radians(3.0)
            scan = replace(frame.scan, time_increment_ns=STEP_NS // 360)
            frames.append(replace(frame, scan=scan, start_from_end=Pose(0.0, 0.0, within)))
        else:
            frames.append(frame)
    _, expected = run(paper_slam.make, off_axis(frames), loop_path_m=10.0)
    _, found = run(embedded_slam.make, off_axis(frames), work=0, **SMALL)
    for estimates in (expected, found):
        aside = [row for row, estimate in enumerate(estimates) if estimate.accepted is False]
        assert aside == [60, *range(covered, 66)]
        assert errors_m(rows(estimates), true).max() < 0.05
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-9


@pytest.mark.parametrize("make", [paper_slam.make, embedded_slam.make])
@pytest.mark.parametrize("odometry", ["none", "standing"])
def test_a_first_scan_without_returns_leaves_no_direction_open_for_the_scans_after_it(make, odometry):
    true = ring_drive(1.0)[:60]
    frames = list(make_frames(RING, true))
    odom = {"none": None, "standing": Pose()}[odometry]
    empty = replace(frames[0].scan, ranges=np.full_like(frames[0].scan.ranges, np.inf))
    frames = [replace(frame, odom_from_base=odom) for frame in [replace(frames[0], scan=empty), *frames[1:]]]
    _, estimates = run(make, frames)
    assert errors_m(rows(estimates)[1:], true[1:]).max() < 0.1


@pytest.mark.parametrize("make", [paper_slam.make, embedded_slam.make])
@pytest.mark.parametrize("beams", [399, 400, 800])
def test_of_a_large_scan_points_half_a_metre_from_the_map_have_no_pair(make, beams):
    angles = np.arange(beams) * 2.0 * np.pi / beams
    room = 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    ahead = np.abs(angles - np.pi) < 0.1 * np.pi  # a tenth of the beams now ends at something 0.6 m before the wall
    slam = make()
    for index, ranges in enumerate((room, np.where(ahead, room - 0.6, room))):
        answer = slam.update(Frame(Scan(index * STEP_NS, ranges, angles, 0.0, 12.0), Pose(), Pose(), Pose()))
    large = beams >= 400
    assert answer.stages["s2s"].inliers == beams  # of a part of a large scan, counted as of all points
    assert answer.stages["s2m"].inliers == beams - large * int(ahead.sum())
    assert (np.abs(answer.pose.row).max() < 1e-3) == large  # pairs with the wall behind pull by 4 mm


def test_noisy_fine_beams_and_a_wrong_odometry_scale_are_corrected_as_in_paper_slam():
    rng = np.random.default_rng(4)
    frames = []
    for frame in make_frames(RING, ring_drive(0.75)):
        ranges = np.maximum(np.repeat(frame.scan.ranges, 4) + rng.normal(0.0, 0.04, 4 * len(frame.scan.ranges)), 0.05)
        angles = np.radians(np.arange(0.0, 360.0, 0.25))
        wheels = replace(frame.odom_from_base, x=0.96 * frame.odom_from_base.x, y=0.96 * frame.odom_from_base.y)
        frames.append(replace(frame, scan=replace(frame.scan, ranges=ranges, angles=angles), odom_from_base=wheels))
    expected, estimates = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL | {"beams": 1440, "loop_path_m": 15.0})
    assert expected._scale.scale > 1.01
    gap = np.abs(se2.between(rows(estimates), rows(found)))
    assert gap.max() < 1e-9


def test_the_gate_by_odometry_accepts_the_same_matches_as_that_of_paper_slam():
    rng = np.random.default_rng(5)
    frames = []
    for row, frame in enumerate(make_frames(RING, ring_drive(1.0)[:80])):
        ranges = np.maximum(frame.scan.ranges + rng.normal(0.0, 0.15, len(frame.scan.ranges)), 0.05)
        if row == 70:
            ranges[30:] = np.inf  # 30 points
        slip = Pose(0.0, 0.42 * ((row >= 10) + (row >= 60)), 0.0)  # the wheels jump sideways by 0.42 m, twice
        frames.append(
            replace(frame, scan=replace(frame.scan, ranges=ranges), odom_from_base=frame.odom_from_base @ slip)
        )
    _, expected = run(paper_slam.make, frames)
    _, found = run(embedded_slam.make, frames, work=0, **SMALL)
    for estimates in (expected, found):
        assert estimates[10].stages["s2s"].accepted  # the wheels are not known yet
        assert not estimates[60].stages["s2s"].accepted  # they were good
        assert estimates[60].stages["s2m"].accepted  # it fits well, with all points
        assert not estimates[70].stages["s2m"].accepted
    assert np.abs(se2.between(rows(expected), rows(found))).max() < 1e-9
    assert [one.accepted for one in found] == [one.accepted for one in expected]


def test_full_memory_ends_the_search_for_loops_and_the_poses_go_on():
    slam, _ = run(embedded_slam.make, drive(), **SMALL | {"keyframes": 40})
    assert not any(loop.accepted for loop in slam.loop_closures())
    assert len(slam.trajectory()) == len(drive())
    assert errors_m(slam.trajectory().poses, ring_drive(LAPS)).max() < 0.5


def test_room_for_one_loop_and_few_records_is_kept_and_said():
    slam, _ = run(embedded_slam.make, drive(), work=0, **SMALL | {"loops": 1, "records": 4})
    loops = slam.loop_closures()
    assert [loop.accepted for loop in loops] == [True, False, False, False]
    assert loops[3].reason.startswith("no room for more loops: chi2")


def test_memory_is_fixed_and_grows_with_the_square_of_the_loops():
    def size(**changed):
        return embedded_slam.make(**SMALL | changed).memory_bytes

    small = size()
    slam, _ = run(embedded_slam.make, drive()[:50], **SMALL)
    assert slam.memory_bytes == small
    # blocks of 3 x 3 numbers of 8 bytes for each pair of loops
    assert size(loops=1000) - size(loops=500) == pytest.approx(9 * 8 * (1001 * 1002 - 501 * 502) / 2, rel=0.02)
    assert size(precision="float") < 0.75 * small


@pytest.mark.parametrize("wrong", [{"keyframes": 1 << 21}, {"loop_radius_m": 20.0}, {"score_cells": 100}])
def test_parameters_out_of_range_are_an_error(wrong):
    with pytest.raises(ValueError, match="range"):
        embedded_slam.make(**SMALL | wrong)


def test_time_that_goes_back_is_an_error_that_names_both_stamps():
    slam = embedded_slam.make(**SMALL)
    slam.update(drive()[1])
    with pytest.raises(ValueError, match=r"stamp 0 ns is not later than the one before, 200000000 ns"):
        slam.update(drive()[0])


def test_scans_without_returns_do_no_harm():
    frames = list(drive())
    for index in (0, 10, 11, 12, 40):
        blind = replace(frames[index].scan, ranges=np.full(len(frames[index].scan.ranges), np.inf))
        frames[index] = replace(frames[index], scan=blind)
    expected, _ = run(paper_slam.make, frames[:80])
    slam, _ = run(embedded_slam.make, frames[:80], work=0, **SMALL | {"loop_path_m": 15.0})
    np.testing.assert_allclose(slam.trajectory().poses, expected.trajectory().poses, atol=1e-9)
