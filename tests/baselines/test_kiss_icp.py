"""KISS-ICP on planar scans: poses at the first beam, the given guess, and sparse scans."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.errors import NotInstalled
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import kiss_icp

needs_kiss_icp = pytest.mark.skipif(bool(why := kiss_icp.kiss_icp_missing()), reason=why or "kiss-icp is here")

BEAMS, PERIOD_NS = 720, 200_000_000
MOUNT = Pose(0.2, 0.05, 0.3)
WALLS = np.array(
    [
        [[-5, -4], [5, -4]], [[5, -4], [5, 4]], [[5, 4], [-5, 4]], [[-5, 4], [-5, -4]],
        [[1, 1], [3, 2]], [[-3, -2], [-2, -2.5]],
    ],
    dtype=float,
)  # fmt: skip


def measure_ranges(origins, headings, walls):
    """Return the distances (B,) to the nearest wall along rays, inf where there is none."""
    ray = np.stack([np.cos(headings), np.sin(headings)], axis=-1)[:, None]
    to_wall, side = walls[None, :, 0] - origins[:, None], (walls[:, 1] - walls[:, 0])[None]
    cross = ray[..., 0] * side[..., 1] - ray[..., 1] * side[..., 0]
    with np.errstate(all="ignore"):
        along_ray = (to_wall[..., 0] * side[..., 1] - to_wall[..., 1] * side[..., 0]) / cross
        along_wall = (to_wall[..., 0] * ray[..., 1] - to_wall[..., 1] * ray[..., 0]) / cross
    met = (along_wall >= 0.0) & (along_wall <= 1.0) & (along_ray > 0.15)
    return np.where(met, along_ray, np.inf).min(axis=1)


def drive(steps, odometry_scale=1.0, walls=WALLS):
    """Return frames of a lidar that moves by ``steps`` (N, 3) per revolution, and the true poses (N, 3)."""
    increment = PERIOD_NS // BEAMS
    share, angles = np.arange(BEAMS) * increment / PERIOD_NS, -np.arange(BEAMS) * 2.0 * np.pi / BEAMS
    start = np.array([-2.0, -1.0, 0.2])
    world, wheels, frames, truth = start, np.zeros(3), [], []
    for k, step in enumerate(np.asarray(steps, dtype=float)):
        sensors = se2.compose(se2.compose(world, se2.fraction(step, share)), MOUNT.row)
        scan = Scan(
            k * PERIOD_NS, measure_ranges(sensors[:, :2], sensors[:, 2] + angles, walls), angles, 0.15, 12.0, increment
        )
        told = odometry_scale * step
        within = Pose.of(se2.fraction(told, share[-1:])[0])
        frames.append(Frame(scan, MOUNT, Pose.of(wheels), within))
        truth.append(se2.between(start, world))
        world, wheels = se2.compose(world, step), se2.compose(wheels, told)
    return frames, np.array(truth)


def run_poses(frames, **parameters):
    follower = kiss_icp.SPEC.make(**resolve_parameters("kiss-icp", kiss_icp.SPEC.parameters, parameters))
    return np.array([follower.update(frame).pose.row for frame in frames])


def compute_errors(truth, poses):
    """Return the errors in metres (N,) and radians (N,) between poses and ground truth."""
    difference = se2.between(truth, poses)
    return np.hypot(difference[:, 0], difference[:, 1]), np.abs(difference[:, 2])


# one second at rest, then 0.5 m/s and 50 deg/s: each scan spans 10 cm and 10 degrees
START_UP = np.array([[0.0, 0.0, 0.0]] * 5 + [[0.1, 0.0, np.radians(10.0)]] * 15)


@needs_kiss_icp
def test_poses_refer_to_the_first_beam_of_a_scan_taken_in_motion():
    frames, truth = drive(START_UP)
    metres, radians = compute_errors(truth, run_poses(frames))
    assert metres.max() < 0.01  # the end of the scan is 0.10 m away, its middle 0.05 m
    assert radians.max() < np.radians(0.5)
    blurred, turned = compute_errors(truth, run_poses(frames, deskew=False))
    assert blurred.max() > 0.03
    assert turned.max() > np.radians(3.0)


@needs_kiss_icp
def test_wrong_wheel_odometry_is_corrected():
    frames, truth = drive(START_UP, odometry_scale=1.1)
    wheels = np.array([frame.odom_from_base.row for frame in frames])
    metres, radians = compute_errors(truth, run_poses(frames))
    assert compute_errors(truth, wheels)[1][-1] > np.radians(14.0)
    assert metres.max() < 0.03
    assert radians.max() < np.radians(2.0)


@needs_kiss_icp
def test_missing_returns_at_the_ends_of_a_scan_do_not_stretch_its_duration():
    frames, truth = drive(START_UP)
    seeing = (np.arange(BEAMS) >= 200) & (np.arange(BEAMS) < BEAMS - 150)
    half_blind = [
        Frame(
            replace(f.scan, ranges=np.where(seeing, f.scan.ranges, np.inf)), MOUNT, f.odom_from_base, f.start_from_end
        )
        for f in frames
    ]
    metres, radians = compute_errors(truth, run_poses(half_blind))
    assert metres.max() < 0.02  # 0.07 m and 4.7 degrees if the visible half were taken as the whole revolution
    assert radians.max() < np.radians(1.0)


@needs_kiss_icp
def test_constant_velocity_does_not_use_odometry():
    frames, truth = drive([[0.02, 0.0, np.radians(2.0)]] * 20, odometry_scale=5.0)
    blind = [Frame(frame.scan, frame.base_from_sensor) for frame in frames]
    told = run_poses(frames, prior="constant-velocity")
    assert told.tobytes() == run_poses(blind, prior="constant-velocity").tobytes() == run_poses(blind).tobytes()
    metres, radians = compute_errors(truth, told)
    assert metres.max() < 0.03
    assert radians.max() < np.radians(2.0)


@needs_kiss_icp
def test_a_dropped_scan_extrapolates_the_steady_motion():
    frames, truth = drive([[0.05, 0.0, np.radians(2.0)]] * 20)
    kept = [k for k in range(20) if k not in (10, 15)]
    metres, _ = compute_errors(truth[kept], run_poses([frames[k] for k in kept], prior="constant-velocity"))
    assert metres.max() < 0.05


@needs_kiss_icp
def test_scans_with_simultaneous_beams_are_followed():
    frames, truth = drive(np.zeros((5, 3)))
    instant = [Frame(replace(f.scan, time_increment_ns=0), MOUNT) for f in frames]
    moved = [Frame(f.scan, MOUNT, Pose(0.05 * k, 0.0, 0.0), Pose(0.05, 0.0, 0.0)) for k, f in enumerate(instant)]
    assert compute_errors(truth, run_poses(instant))[0].max() < 1e-3
    assert compute_errors(truth, run_poses(moved))[0].max() < 0.02


@needs_kiss_icp
@pytest.mark.parametrize("first", [0, 8])
def test_a_nearly_empty_scan_keeps_the_prediction(first):
    frames, truth = drive(START_UP, odometry_scale=1.01)
    for k in (first, first + 1):
        scan = replace(frames[k].scan, ranges=np.where(np.arange(BEAMS) < 6, frames[k].scan.ranges, np.inf))
        frames[k] = Frame(scan, MOUNT, frames[k].odom_from_base, frames[k].start_from_end)
    poses = run_poses(frames)
    assert compute_errors(truth, poses)[0].max() < 0.03
    after, before = frames[first + 1].odom_from_base, frames[first].odom_from_base
    assert np.allclose(se2.between(poses[first], poses[first + 1]), (before.inverse() @ after).row, atol=1e-12)


@needs_kiss_icp
def test_a_scan_with_too_few_points_or_without_pairs_is_not_accepted():
    frames, _ = drive(START_UP, odometry_scale=1.01)
    frames[8] = Frame(replace(frames[8].scan, ranges=np.full(BEAMS, np.inf)), MOUNT, frames[8].odom_from_base)
    lost = replace(frames[-1].scan, stamp_ns=frames[-1].scan.stamp_ns + PERIOD_NS)
    frames.append(Frame(lost, MOUNT, Pose(500.0, 500.0, 1.0)))
    follower = kiss_icp.SPEC.make(**resolve_parameters("kiss-icp", kiss_icp.SPEC.parameters, {}))
    accepted = [follower.update(frame).accepted for frame in frames]
    assert accepted[0] is None
    assert accepted[8] is accepted[-1] is False
    assert set(accepted[6:8] + accepted[9:-1]) == {True}


@needs_kiss_icp
def test_the_first_pose_is_the_identity_even_in_motion():
    frames, _ = drive(START_UP[5:7])
    assert run_poses(frames)[0].tolist() == [0.0, 0.0, 0.0]


@needs_kiss_icp
def test_repeated_runs_are_identical_and_independent_of_the_environment(monkeypatch):
    frames, _ = drive(START_UP[:8])
    once = run_poses(frames)
    monkeypatch.setenv("kiss_icp_data", '{"max_range": 1.0, "deskew": false}')
    monkeypatch.setenv("kiss_icp_mapping", '{"voxel_size": 1.0}')
    assert run_poses(frames).tobytes() == once.tobytes()


@needs_kiss_icp
def test_ranges_outside_the_limits_are_not_used():
    frames, _ = drive(np.zeros((3, 3)))
    near = run_poses(frames, max_range_m=4.0, min_range_m=1.0)
    cut = [np.where((f.scan.ranges < 1.0) | (f.scan.ranges > 4.0), np.inf, f.scan.ranges) for f in frames]
    scans = [
        replace(f.scan, ranges=ranges, range_min_m=1.0, range_max_m=4.0) for f, ranges in zip(frames, cut, strict=True)
    ]
    assert near.tobytes() == run_poses([Frame(s, MOUNT, Pose(), Pose()) for s in scans]).tobytes()


def test_a_missing_package_is_reported_with_its_install_command(monkeypatch):
    monkeypatch.setattr(kiss_icp.importlib.util, "find_spec", lambda _name: None)
    assert kiss_icp.kiss_icp_missing() == "not installed: pip install 'evalkit[kiss-icp]'"


def test_a_failing_import_raises_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "kiss_icp", None)
    with pytest.raises(NotInstalled, match="does not load"):
        run_poses([])
