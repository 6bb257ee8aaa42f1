"""Small scenes with a known answer: the points of a room for registrations, a drive through it for odometries.

They do not use the simulated data sets, so that the rules depend on evalkit alone.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline

CORNERS = np.array([[-4.0, -3.0], [4.0, -3.0], [4.0, 1.0], [0.5, 1.0], [0.5, 4.0], [-4.0, 4.0]])
"""An L-shaped room (m): no motion brings it onto itself."""

INNER_CORNER = CORNERS[3]
"""The corner that points into the room; what lies beyond it in both x and y is outside."""

ROOM = World(closed_outline(CORNERS))

REACH_M = 4.0
"""Half the size of the room: the lever at which a turn is measured."""


@dataclass(frozen=True)
class CloudPair:
    """Two clouds of the room, the true ``target_from_source``, and a guess with a small error."""

    target: Cloud
    source: Cloud
    truth: Pose
    guess: Pose


def clear_pair(truth: Pose = Pose(0.3, 0.0, 0.3)) -> CloudPair:  # noqa: B008 - a Pose is frozen
    """The same 150 points twice, without noise, so far apart that with this guess every nearest neighbour is right.

    Any method that minimises distances, to points or to walls, reaches the truth within a few steps.
    """
    points = _along_walls(spacing_m=0.2)
    guess = truth @ Pose(0.03, -0.02, np.radians(0.5))
    return CloudPair(Cloud(points), Cloud(truth.inverse().transform(points)), truth, guess)


def noisy_pair() -> CloudPair:
    """Two scans of the room with 3 cm of noise, no point twice; the guess is the identity: 5 cm and 2 degrees off."""
    rng = np.random.default_rng(7)
    truth = Pose(0.04, -0.03, 0.035)
    target, source = (_sample_walls(rng, count, 0.03) for count in (1200, 500))
    return CloudPair(Cloud(target), Cloud(truth.inverse().transform(source)), truth, Pose())


def drawn_pair(rng: np.random.Generator, targets: int, sources: int) -> CloudPair:
    """Two drawn scans of the room with 3 cm of noise, a drawn motion, and a guess up to 8 cm and 3 degrees off."""
    truth = Pose.of(rng.uniform(-1.0, 1.0, 3) * [2.0, 2.0, np.pi])
    guess = truth @ Pose.of(rng.uniform(-1.0, 1.0, 3) * [0.06, 0.06, 0.05])
    target, source = (_sample_walls(rng, count, 0.03) for count in (targets, sources))
    return CloudPair(Cloud(target), Cloud(truth.inverse().transform(source)), truth, guess)


def wall_pair() -> CloudPair:
    """Two scans of one straight wall, 5 cm apart across it; the motion along it is unobservable."""
    along = np.random.default_rng(3).uniform(-4.0, 4.0, 400)
    wall = np.stack([along, np.full_like(along, 2.0)], axis=1)
    truth = Pose(0.0, -0.05, 0.0)
    return CloudPair(Cloud(wall), Cloud(truth.inverse().transform(wall[::2])), truth, Pose())


def distance_m(answer: Pose, truth: Pose) -> float:
    """The distance (m) of an answer to the truth: its shift plus its turn at the lever ``REACH_M``."""
    error = truth.inverse() @ answer
    return float(np.hypot(error.x, error.y) + REACH_M * abs(error.theta))


def format_pose(pose: Pose) -> str:
    """A pose for a message."""
    return f"({pose.x:.3f} m, {pose.y:.3f} m, {pose.theta:.4f} rad)"


@dataclass(frozen=True)
class SimulatedDrive:
    """Frames along a known path: ``truth`` (N, 3) is ``start_from_base`` at each first beam."""

    frames: tuple[Frame, ...]
    truth: Floats


BEAMS = 360
PERIOD_NS = 100_000_000
WORLD_FROM_START = Pose(-2.0, -1.5, 0.4)
ODOM_FROM_START = Pose(10.0, -5.0, 1.0)


def drive(
    scans: int = 16,
    speed_mps: float = 0.4,
    turn_radps: float = 0.4,
    *,
    base_from_sensor: Pose = Pose(),  # noqa: B008 - a Pose is frozen
    standing: int = 0,
    odometry_gain: float | None = 1.0,
    sweeping: bool = True,
) -> SimulatedDrive:
    """A drive along a left-hand arc, ten scans a second, 1 cm of noise; the first ``standing`` scans do not move.

    ``odometry_gain``: factor of wheel odometry on every motion; None: no odometry. ``sweeping``: beams are fired one
    after the other, each from the pose of the sensor at that time; otherwise all at once.
    """
    rng = np.random.default_rng(11)
    frames, truth = [], []
    here, odom = Pose(), ODOM_FROM_START
    for index in range(scans):
        moving = index >= standing
        step = _arc(speed_mps, turn_radps) if moving else Pose()
        share: Floats = np.arange(BEAMS, dtype=np.float64) * (sweeping / BEAMS)
        truth.append(here.row)
        frame = _frame(index, WORLD_FROM_START @ here, step, share, base_from_sensor, rng)
        if odometry_gain is not None:
            measured = Pose.of(step.row * odometry_gain)
            within = Pose.of(se2.fraction(measured.row, share[-1:])[0])
            frame = replace(frame, odom_from_base=odom, start_from_end=within)
            odom = odom @ measured
        frames.append(frame)
        here = here @ step
    return SimulatedDrive(tuple(frames), np.array(truth))


def without_hits(frame: Frame) -> Frame:
    """The same frame with no returns."""
    scan = frame.scan
    return replace(frame, scan=replace(scan, ranges=np.full(len(scan.ranges), np.inf)))


def sector(frame: Frame, first: float, last: float) -> Frame:
    """A frame of simultaneous beams by those between two angles (rad) alone, in their order."""
    angles = se2.wrap(frame.scan.angles)
    rows = np.flatnonzero((angles >= first) & (angles <= last))
    rows = rows[np.argsort(angles[rows])]
    return replace(frame, scan=replace(frame.scan, ranges=frame.scan.ranges[rows], angles=angles[rows]))


def _arc(speed_mps: float, turn_radps: float) -> Pose:
    seconds = PERIOD_NS * 1e-9
    angle = turn_radps * seconds
    if angle == 0.0:
        return Pose(speed_mps * seconds, 0.0, 0.0)
    radius = speed_mps / turn_radps
    return Pose(radius * np.sin(angle), radius * (1.0 - np.cos(angle)), angle)


def _frame(
    index: int, world_from_base: Pose, step: Pose, share: Floats, base_from_sensor: Pose, rng: np.random.Generator
) -> Frame:
    angles: Floats = np.arange(BEAMS, dtype=np.float64) * (2.0 * np.pi / BEAMS)
    world_from_then = se2.compose(world_from_base.row, se2.fraction(step.row, share))
    world_from_sensor = se2.compose(world_from_then, base_from_sensor.row)
    ranges = ROOM.cast(world_from_sensor[:, :2], world_from_sensor[:, 2] + angles) + rng.normal(0.0, 0.01, BEAMS)
    increment = PERIOD_NS // BEAMS if share[-1] > 0.0 else 0
    scan = Scan(1_000_000_000 + index * PERIOD_NS, np.clip(ranges, 0.15, 12.0), angles, 0.15, 12.0, increment)
    return Frame(scan, base_from_sensor)


def _sides() -> tuple[Floats, Floats]:
    sides = np.roll(CORNERS, -1, axis=0) - CORNERS
    return sides, np.linalg.norm(sides, axis=1)


def _along_walls(spacing_m: float) -> Floats:
    """Points on the walls, about evenly spaced: a strictly even row would fit itself shifted by one."""
    sides, lengths = _sides()
    rng = np.random.default_rng(5)
    walls = []
    for corner, side, length in zip(CORNERS, sides, lengths, strict=True):
        count = round(length / spacing_m)
        at = (np.arange(count) + 0.5 + rng.uniform(-0.1, 0.1, count)) / count
        walls.append(corner + at[:, None] * side)
    return np.concatenate(walls)


def _sample_walls(rng: np.random.Generator, count: int, noise_m: float) -> Floats:
    sides, lengths = _sides()
    wall = rng.choice(len(sides), count, p=lengths / lengths.sum())
    return np.asarray(CORNERS[wall] + rng.uniform(size=(count, 1)) * sides[wall] + rng.normal(0.0, noise_m, (count, 2)))
