"""Estimate the heading of a lidar on its base from straight drives: the direction of motion that the scans see."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.se2 import Floats
from evalkit_datasets.commands.inspect.streams import LaserStream, OdometryStream, interpolate_odometry
from evalkit_datasets.commands.inspect.timing import seconds_since_first

STEP_M = (0.05, 0.4)
MAX_TURN = math.radians(2.0)
MAX_PAIR_S = 3.0
MAX_PAIRS, MIN_PAIRS = 150, 12
MAX_EDGE_M = 0.3
"""Neighbouring ranges further apart belong to different surfaces."""

MIN_BEAMS = 40
HALF_WINDOW = math.radians(2.5)
"""Beams on each side of one that its line is fitted to."""

MAX_SPREAD = math.radians(12.0)
"""Directions of motion that differ more from each other (robust standard deviation) are not those of one mounting."""

SPEED_RATIOS = (0.6, 1.6)
"""Motion seen by the scans divided by that of the odometry; outside, a pair is not used."""


@dataclass(frozen=True, slots=True)
class MountingAngle:
    """The heading of the lidar on the base (deg), from ``pairs`` pairs of scans.

    ``spread_deg``: standard deviation of one pair (from the median absolute deviation); ``error_deg``: standard error
    of the median.
    """

    heading_deg: float
    spread_deg: float
    error_deg: float
    pairs: int


def estimate_mounting_angle(wheels: OdometryStream, laser: LaserStream) -> MountingAngle | None:
    """Return the heading of the lidar on the base; None with too few straight drives, or if they do not agree.

    While a differential drive moves straight, its base moves along x. The motion of the lidar between two scans is
    estimated from the scans alone; the angle between both directions is the heading of the lidar.
    """
    moved, seen, _ = pair_motions(wheels, laser)
    ratios = np.hypot(*seen[:, :2].T) / np.hypot(*moved[:, :2].T)
    fits = (ratios > SPEED_RATIOS[0]) & (ratios < SPEED_RATIOS[1])
    pairs = int(fits.sum())
    if pairs < MIN_PAIRS:
        return None
    heading, spread = measure_heading(moved[fits], seen[fits])
    if spread > MAX_SPREAD:
        return None
    spread_deg = math.degrees(spread)
    return MountingAngle(math.degrees(heading), spread_deg, 1.2533 * spread_deg / math.sqrt(pairs), pairs)


def measure_heading(moved: Floats, seen: Floats) -> tuple[float, float]:
    """Return the heading (rad) of a frame on the base, and how far the motions differ in it (rad).

    The base moves by ``moved`` (K, 3), each in its own frame, and the other frame by ``seen`` (K, 3) in its own: the
    heading is the median angle from ``seen`` to ``moved``, and the spread its median absolute deviation, scaled to a
    standard deviation.
    """
    headings = np.arctan2(moved[:, 1], moved[:, 0]) - np.arctan2(seen[:, 1], seen[:, 0])
    around = math.atan2(float(np.median(np.sin(headings))), float(np.median(np.cos(headings))))
    apart = se2.wrap(headings - around)
    middle = float(np.median(apart))
    return se2.wrap_angle(around + middle), 1.4826 * float(np.median(np.abs(apart - middle)))


def pair_motions(wheels: OdometryStream, laser: LaserStream) -> tuple[Floats, Floats, Ints]:
    """Return motions (K, 3) of the base by an odometry and of the lidar by its scans, on straight drives.

    With the indices (K, 2) of the two scans in the sample.
    """
    times, order, poses = interpolate_odometry(wheels, laser)
    rows: list[tuple[Floats, Floats, Ints]] = []
    for pair in _select_pairs(seconds_since_first(times), poses) if len(times) else ():
        one, other = order[list(pair)].tolist()
        seen = estimate_motion(laser.ranges[one], laser.ranges[other], laser.angles)
        if seen is not None:
            moved = se2.between(poses[pair[0] : pair[0] + 1], poses[pair[1] : pair[1] + 1])[0]
            rows.append((moved, seen, np.array([one, other])))
    if not rows:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2), dtype=np.int64)
    moved_all, seen_all, scans = (np.array(column) for column in zip(*rows, strict=True))
    return moved_all, seen_all, scans


def measure_visible_share(one: Floats, other: Floats, angles: Floats, way: float) -> float:
    """Return how much of a motion in a direction (rad, in the frame of the lidar) its ranges (B,) show, 0 to 1.

    Along a bare corridor that is nothing; across it, nearly all.
    """
    found = _find_flow(one, other, angles)
    if found is None:
        return 0.0
    rows = found[0][:, :2]
    return float(np.linalg.norm(rows @ [math.cos(way), math.sin(way)]) / np.linalg.norm(rows))


def estimate_motion(one: Floats, other: Floats, angles: Floats) -> Floats | None:
    """Return the motion (3,) of a lidar between two scans (B,) in its own frame (m, m, rad); None if they do not tell.

    Scans with other numbers of beams than ``angles`` (B,) do not tell.

    The range flow of Jaimez et al. (Planar odometry from a radial laser scanner, ICRA 2016, eq. 5): linear in the
    motion, solved by least squares with Cauchy weights.
    """
    found = _find_flow(one, other, angles)
    if found is None:
        return None
    rows, change = found
    weights = np.ones(len(change))
    solution: Floats = np.zeros(3)
    for _ in range(8):
        root = np.sqrt(weights)[:, None]
        solved, _, rank, values = np.linalg.lstsq(rows * root, change * root[:, 0], rcond=None)
        if rank < 3 or values[-1] < 0.05 * values[0]:  # walls of one direction only
            return None
        solution = np.asarray(solved, dtype=np.float64)
        residual = change - rows @ solution
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-4)
        weights = 1.0 / (1.0 + (residual / (2.0 * scale)) ** 2)
    return solution


def _find_flow(one: Floats, other: Floats, angles: Floats) -> tuple[Floats, Floats] | None:
    """Return how ranges follow from the motion (K, 3), and how they changed (K,); None for too few ranges."""
    if not len(one) == len(other) == len(angles) or len(one) < MIN_BEAMS:
        return None
    step = float(np.median(np.diff(angles)))
    (first, before), (second, after) = _fit_lines(one, step), _fit_lines(other, step)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(first + second) & (np.abs(second - first) < 2.0 * STEP_M[1])
    if known.sum() < MIN_BEAMS:
        return None
    middle, slope = 0.5 * (first + second)[known], 0.5 * (before + after)[known]
    cos, sin, steep = np.cos(angles[known]), np.sin(angles[known]), slope / middle
    rows = np.stack([-(cos + steep * sin), -(sin - steep * cos), slope], axis=1)
    return rows, (second - first)[known]


def _fit_lines(ranges: Floats, step: float) -> tuple[Floats, Floats]:
    """Return range (m) and its slope (m/rad), both (B,), of lines fitted around each beam; nan at edges.

    A slope between two neighbours would contain more noise than slope.
    """
    half = max(round(HALF_WINDOW / abs(step)), 1)
    if len(ranges) < 2 * half + 1:
        return np.full(len(ranges), np.nan), np.full(len(ranges), np.nan)
    plain = np.where(np.isfinite(ranges) & (ranges > 0.0), ranges, np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(plain, half, constant_values=np.nan), 2 * half + 1)
    offsets = np.arange(-half, half + 1)
    with np.errstate(invalid="ignore"):
        jumps = np.abs(np.diff(windows, axis=1)).max(axis=1) > MAX_EDGE_M
    mean = np.where(jumps, np.nan, windows.mean(axis=1))
    return mean, windows @ offsets / float((offsets**2).sum()) / step


def _select_pairs(seconds: Floats, poses: Floats) -> list[tuple[int, int]]:
    """Return pairs of scans between which the odometry moves straight, forwards or backwards."""
    pairs = []
    for one in range(len(seconds)):
        last = int(np.searchsorted(seconds, seconds[one] + MAX_PAIR_S, side="right"))
        for other in range(one + 1, last):
            moved = se2.between(poses[one : one + 1], poses[other : other + 1])[0]
            if abs(moved[2]) > MAX_TURN or np.hypot(*moved[:2]) > STEP_M[1]:
                break
            if np.hypot(*moved[:2]) >= 2.0 * STEP_M[0]:
                pairs.append((one, other))
                break
    return pairs[:: max(len(pairs) // MAX_PAIRS, 1)]
