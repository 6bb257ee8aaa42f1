"""Doubts about a true trajectory: its unit, its clock, its frame and the part of the recording that it covers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.plugins.result_files import read_trajectory
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.finding import MAX_OFFSET_S
from evalkit_datasets.commands.inspect.frame_tree import mirror_if_upside_down
from evalkit_datasets.commands.inspect.inspector import Inspection
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.mounting_angle import MAX_SPREAD, measure_heading
from evalkit_datasets.commands.inspect.odometry_findings import is_apart
from evalkit_datasets.commands.inspect.odometry_stats import measure_odometry
from evalkit_datasets.commands.inspect.odometry_unit import find_length_unit
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream
from evalkit_datasets.commands.inspect.turn_comparison import TurnComparison, compare_turns
from evalkit_datasets.parsing.columns_layout import LENGTH_UNITS

MIN_COVERED = 0.5
"""A truth that covers a smaller share of the scans may be of another clock."""

WINDOW_NS = 10**9
"""Motions are compared between true poses that are at least this far apart."""

STRAIGHT, TURNING, MIN_DRIVEN_M = math.radians(2.0), math.radians(5.0), 0.1
MIN_WINDOWS = 8
MIN_HEADING = math.radians(5.0)
MIN_TURNED, MIN_TURNED_SHARE = math.radians(90.0), 0.05
"""A truth that turns by a smaller share than an odometry that turns by more has no headings."""

MIN_LEVER_M = 0.05
MAX_OUTLIER = 4.0
"""A motion is left out that is this many times as far off as two thirds of them are."""

MIN_LEVER_ERRORS = 5.0


def find_truth_doubts(recording: Inspection, lidar: LidarStats, address: str) -> Iterator[Choice]:
    """Say why errors against a true trajectory (a file, or what is meant in it) are not those of the methods."""
    poses = read_trajectory(address).trajectory
    laser = next((one for one in recording.streams.lasers if one.topic == lidar.topic), None)
    if laser is None or len(poses) < 2:
        return
    laser = mirror_if_upside_down(laser, recording.frames)
    truth = OdometryStream("ground truth", "world", "base", poses.stamps_ns, poses.poses)
    found = _find_first(recording, lidar, laser, truth)
    if found is not None:
        level, what = found
        yield Choice("ground_truth", None, f"{level}: ground truth {Path(address).name}: {what}", warns=True)


def _find_first(
    recording: Inspection, lidar: LidarStats, laser: LaserStream, truth: OdometryStream
) -> tuple[str, str] | None:
    """Return level and text of the first doubt: a later one may follow from it."""
    if what := _describe_unit(laser, truth):
        return "problem", what
    if what := _describe_covered(laser, truth):
        return "warning", what
    turns = compare_turns(truth, laser)
    if turns is not None and (what := _describe_turns(turns, lidar)):
        return "problem" if turns.differs else "warning", what
    for wheels, stats in zip(recording.streams.wheels, recording.odometries, strict=True):
        if stats.like_wheels and stats.unit is None and not stats.clock_shift_s and not is_apart(lidar, stats):
            what = _describe_frame(truth, wheels)
            return ("warning", what) if what else None
    return None


def _describe_unit(laser: LaserStream, truth: OdometryStream) -> str:
    found = find_length_unit(truth, laser, measure_odometry(truth).driving_m_s)
    if found is None:
        return ""
    speed = f"it drives at {found.driving_m_s:.0f} m/s (median)"
    if not found.unit:
        return f"{speed}, faster than any vehicle with a 2D lidar: mm or cm taken for m? Divide its x and y"
    share = round(1.0 / LENGTH_UNITS[found.unit])
    what = f"its lengths are in {found.unit}, not in m: {speed}, the scans {share} times less"
    return f"{what}; divide x and y by {share}"


def _describe_covered(laser: LaserStream, truth: OdometryStream) -> str:
    first, last = int(truth.stamps_ns[0]), int(truth.stamps_ns[-1])
    covered = float(np.mean((laser.stamps_ns >= first) & (laser.stamps_ns <= last)))
    if covered >= MIN_COVERED:
        return ""
    begin_s = (first - int(laser.stamps_ns.min())) * 1e-9
    side = "after" if begin_s > 0.0 else "before"
    return (
        f"it covers {100 * covered:.0f} % of the scans, and begins {abs(begin_s):.1f} s {side} them: if that is "
        "another clock, all errors are wrong; else they are those of this part"
    )


def _describe_turns(turns: TurnComparison, lidar: LidarStats) -> str:
    """Return how a truth turns otherwise than the scans, or at other times, "" if it does not."""
    if turns.differs:
        what = f"the scans rotate {turns.scale:.2f} times as much as it does ({turns.pairs} turns)"
        return f"{what}: its y axis points to the right, or its heading is in another unit" if turns.scale < 0 else what
    is_half_a_sweep = lidar.sweep_s == 0.0 and 0.0 < turns.shift_s < 0.5 * lidar.revolution_s + MAX_OFFSET_S
    if not turns.is_shifted or is_half_a_sweep:
        return ""
    low, high = sorted(abs(value) for value in turns.shift_interval)
    side = "ahead of" if turns.shift_s > 0.0 else "behind"
    return (
        f"by its turns, its clock is {abs(turns.shift_s):.2f} s {side} that of the scans ({low:.2f} to {high:.2f} s, "
        f"{turns.pairs} turns): add {-turns.shift_s:.2f} s to its times, or to those of the scans "
        f"{turns.shift_s:.2f} s if they are wrong"
    )


def _describe_frame(truth: OdometryStream, wheels: OdometryStream) -> str:
    """Return how the frame of a truth is mounted on the base of an odometry, "" if it is the base or unknown."""
    own, base = _pair_motions(truth, wheels)
    turned, base_turned = (float(np.abs(motions[:, 2]).sum()) for motions in (own, base))
    if base_turned > MIN_TURNED and turned < MIN_TURNED_SHARE * base_turned:
        what = f"its headings turn by {math.degrees(turned):.0f} deg, those of {wheels.topic} by"
        return f"{what} {math.degrees(base_turned):.0f} deg: it has no headings; only errors of positions can be true"
    heading = _measure_heading(own, base)
    if heading is None:
        return ""
    if abs(heading) > MIN_HEADING:
        return (
            f"by straight drives of {wheels.topic}, its heading differs by {math.degrees(heading):.0f} deg from that "
            "of the base: it is of another frame; give the trajectory of the base, with x forward"
        )
    lever = _measure_lever(own, base)
    if lever is None:
        return ""
    x, y = lever
    apart = f"{math.hypot(x, y):.2f} m from that of {wheels.topic} (x {x:.2f} m, y {y:.2f} m)"
    what = f"by the turns, it is the path of a point {apart}: one of both is not the base, and errors contain this"
    return f"{what}; give the trajectory of the base"


def _pair_motions(truth: OdometryStream, wheels: OdometryStream) -> tuple[Floats, Floats]:
    """Return the motions (K, 3) of truth and wheels between true poses a window or more apart."""
    stamps, first = np.unique(wheels.stamps_ns, return_index=True)
    inside = np.flatnonzero((truth.stamps_ns >= stamps[0]) & (truth.stamps_ns <= stamps[-1]))
    ends: list[int] = []
    for at in inside.tolist():
        if not ends or truth.stamps_ns[at] - truth.stamps_ns[ends[-1]] >= WINDOW_NS:
            ends.append(at)
    if len(ends) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3))
    base = se2.interpolate(stamps, wheels.poses[first], truth.stamps_ns[ends])
    own = truth.poses[ends]
    return se2.between(own[:-1], own[1:]), se2.between(base[:-1], base[1:])


def _measure_heading(own: Floats, base: Floats) -> float | None:
    """Return the heading (rad) of a truth on the base by straight drives; None if they are few or disagree."""
    straight = (np.abs(base[:, 2]) < STRAIGHT) & (np.hypot(base[:, 0], base[:, 1]) > MIN_DRIVEN_M)
    straight &= np.hypot(own[:, 0], own[:, 1]) > MIN_DRIVEN_M
    if straight.sum() < MIN_WINDOWS:
        return None
    heading, spread = measure_heading(base[straight], own[straight])
    return heading if spread < MAX_SPREAD else None


def _measure_lever(own: Floats, base: Floats) -> Floats | None:
    """Return where on the base (x, y in m) a truth is measured; None if that is the base, or if no turn shows it.

    A point at ``lever`` moves by ``moved + (R(turn) - 1) lever`` while the base moves and turns.
    """
    turning = np.abs(base[:, 2]) > TURNING
    if turning.sum() < MIN_WINDOWS:
        return None
    cos, sin = np.cos(base[turning, 2]) - 1.0, np.sin(base[turning, 2])
    rows = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)  # (K, 2, 2)
    apart = own[turning, :2] - base[turning, :2]
    kept: Bools = np.ones(len(apart), dtype=np.bool_)
    lever, errors = np.zeros(2), np.full(2, np.inf)
    for _ in range(2):
        lever, errors = _fit_lever(rows[kept], apart[kept])
        left = np.linalg.norm(apart - rows @ lever, axis=1)
        kept = left <= MAX_OUTLIER * np.percentile(left, 68) + 1e-9
    length, error = math.hypot(*lever), math.hypot(*errors)
    return lever if length > MIN_LEVER_M and length > MIN_LEVER_ERRORS * error else None


def _fit_lever(rows: Floats, apart: Floats) -> tuple[Floats, Floats]:
    """Return the lever (2,) by least squares, and its standard errors (2,)."""
    flat, values = rows.reshape(-1, 2), apart.reshape(-1)
    lever = np.asarray(np.linalg.lstsq(flat, values, rcond=None)[0], dtype=np.float64)
    variance = float(((values - flat @ lever) ** 2).sum()) / max(len(values) - 2, 1)
    return lever, np.sqrt(variance * np.diag(np.linalg.inv(flat.T @ flat)))
