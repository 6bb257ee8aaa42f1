"""Simulated drives in a known map, with the faults that lead a tracker astray, and the fit of their scans."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypedDict

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.errors import BadData, NotLocalised
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.metrics.localisation import measure_fit
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.odometry.map_localisation import localise
from evalkit.odometry.run_odometry import run_odometry
from evalkit.plugins import registry
from evalkit.plugins.parameters import MAP, MAP_START, TRUE_MAP, Value
from evalkit.plugins.protocols import Sequence

MEASURED = 40
"""At most this many scans of a drive are measured, evenly spaced."""

DriveChange = Callable[["KnownDrive", np.random.Generator], "KnownDrive"]


@dataclass(frozen=True)
class KnownDrive:
    """A drive with its true poses (N, 3) and grid in one frame, and the start that the tracker is given.

    It is a Sequence.
    """

    all_frames: tuple[Frame, ...]
    poses: Floats
    grid: OccupancyGrid
    start: Pose

    def __len__(self) -> int:
        return len(self.all_frames)

    def frames(self) -> Iterator[Frame]:
        """Return an iterator over the frames."""
        return iter(self.all_frames)

    def truth(self) -> Truth:
        """Return the known map as the true one."""
        return Truth("simulated", grid=self.grid)

    def notes(self) -> Mapping[str, int]:
        """Return no defects."""
        return {}


class MeasuredScans(TypedDict):
    """The measured scans of a drive: predicted error (m, nan without one), number of points, true error of the position
    (m), each (N,); side of the map's cells (m).
    """

    fit_m: Floats
    points: Ints
    error_m: Floats
    cell_m: float


def measure_drive(
    dataset: str, parameters: dict[str, Value], backend: str, values: dict[str, Value], fault: str, seed: int
) -> MeasuredScans:
    """Track the robot through one simulated drive with one of the ``FAULTS``, and measure the fit of its scans.

    ``values``: complete parameters of the back end. A drive whose start the harness refuses has no scans. Raises
    BadData for a data set without true poses or map.
    """
    drive = FAULTS[fault](read_drive(registry.dataset(dataset).open(parameters), dataset), np.random.default_rng(seed))
    spec = registry.backend(backend)
    start = drive.start
    reserved: dict[str, Value] = {MAP: TRUE_MAP, MAP_START: f"{start.x},{start.y},{math.degrees(start.theta)}"}
    rows: list[tuple[float, int, float]] = []
    with TemporaryDirectory() as folder:
        try:
            localised = localise(spec, values, reserved, drive, Path(folder))
        except NotLocalised:
            localised = None
        walls = build_kd_tree(drive.grid.centres(drive.grid.occupied()))
        measured = set(spread_indices(len(drive), MEASURED).tolist())
        steps = run_odometry(localised.make(), drive.frames(), dataset) if localised else ()
        for index, step in enumerate(steps):
            if localised is None or step.estimate is None or index not in measured:
                continue
            map_from_base = localised.start.map_from_start @ step.estimate.pose
            points = map_from_base.transform(step.frame.points_in_base(step.frame.start_from_end))
            fit_m, _ = measure_fit(points, walls, drive.grid.resolution_m)
            x, y, _ = drive.poses[index]
            rows.append((fit_m, len(points), math.hypot(map_from_base.x - x, map_from_base.y - y)))
    fits, counts, errors = np.array(rows, dtype=np.float64).reshape(-1, 3).T
    return {"fit_m": fits, "points": counts.astype(np.int64), "error_m": errors, "cell_m": drive.grid.resolution_m}


def read_drive(sequence: Sequence, name: str) -> KnownDrive:
    """Return a simulated sequence as a drive that starts where it truly does."""
    truth, frames = sequence.truth(), tuple(sequence.frames())
    if truth.trajectory is None or truth.grid is None:
        raise BadData(name, "", "the data set has no true poses or no true map", "name a simulated world")
    poses = truth.trajectory.at([frame.scan.stamp_ns for frame in frames])
    return KnownDrive(frames, poses, truth.grid, Pose.of(poses[0]))


def start_wrong(drive: KnownDrive, rng: np.random.Generator) -> KnownDrive:
    """Give a start that is 0.4 to 1.5 m and up to 30 deg off."""
    away, towards, turned = rng.uniform(0.4, 1.5), rng.uniform(-math.pi, math.pi), rng.uniform(-1.0, 1.0)
    off = Pose(away * math.cos(towards), away * math.sin(towards), math.radians(30.0) * turned)
    return replace(drive, start=drive.start @ off)


def kidnap(drive: KnownDrive, rng: np.random.Generator) -> KnownDrive:
    """Leave out a third of the scans; the wheels do not notice it."""
    first = int(len(drive) * rng.uniform(0.2, 0.5))
    last = first + len(drive) // 3
    before, after = drive.all_frames[first - 1].odom_from_base, drive.all_frames[last].odom_from_base
    moved = None if before is None or after is None else before @ after.inverse()

    def carry(frame: Frame) -> Frame:
        odom = frame.odom_from_base
        return frame if moved is None or odom is None else replace(frame, odom_from_base=moved @ odom)

    kept = (*drive.all_frames[:first], *map(carry, drive.all_frames[last:]))
    return replace(drive, all_frames=kept, poses=np.delete(drive.poses, slice(first, last), axis=0))


def move_furniture(drive: KnownDrive, rng: np.random.Generator) -> KnownDrive:
    """Move round pieces of the known map, in all 10 to 40 % of its walls, by 0.2 to 1 m."""
    grid = drive.grid
    log_odds, observed = grid.log_odds.copy(), grid.observed.copy()
    cells = np.argwhere(grid.occupied())
    free = log_odds[grid.free()].min()
    for piece in _choose_pieces(grid.centres(grid.occupied()), rng.uniform(0.1, 0.4), rng):
        step = rng.uniform(0.2, 1.0) / grid.resolution_m
        towards = rng.uniform(-math.pi, math.pi)
        to = cells[piece] + np.rint([step * math.sin(towards), step * math.cos(towards)]).astype(int)
        to = to[((to >= 0) & (to < grid.shape)).all(axis=1)]
        log_odds[tuple(cells[piece].T)] = free
        log_odds[tuple(to.T)] = grid.log_odds[tuple(cells[piece[0]])]
        observed[tuple(to.T)] = True
    return replace(drive, grid=replace(grid, log_odds=log_odds, observed=observed))


def turn_to_glass(drive: KnownDrive, rng: np.random.Generator) -> KnownDrive:
    """Let 10 to 40 % of the walls return nothing."""
    walls = drive.grid.centres(drive.grid.occupied())
    glass = np.zeros(len(walls), dtype=np.bool_)
    for piece in _choose_pieces(walls, rng.uniform(0.1, 0.4), rng):
        glass[piece] = True
    tree = build_kd_tree(walls)

    def look(frame: Frame, pose: Floats) -> Frame:
        hits = np.flatnonzero(frame.scan.hits)
        points = se2.transform(se2.compose(pose, frame.base_from_sensor.row), frame.scan.points())
        seen = glass[np.asarray(tree.query(points)[1])]
        ranges = frame.scan.ranges.copy()
        ranges[hits[seen]] = np.inf
        return replace(frame, scan=replace(frame.scan, ranges=ranges))

    return replace(drive, all_frames=tuple(map(look, drive.all_frames, drive.poses)))


def soil_lidar(drive: KnownDrive, rng: np.random.Generator) -> KnownDrive:
    """Let a sector of 30 to 150 deg return 0.2 to 0.6 m, as from dirt on the lidar's window."""
    middle, half = rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(15.0, 75.0))

    def look(frame: Frame) -> Frame:
        dirty = frame.scan.hits & (np.abs(se2.wrap(frame.scan.angles - middle)) < half)
        ranges = np.where(dirty, rng.uniform(0.2, 0.6, len(dirty)), frame.scan.ranges)
        return replace(frame, scan=replace(frame.scan, ranges=ranges))

    return replace(drive, all_frames=tuple(map(look, drive.all_frames)))


def _choose_pieces(points: Floats, share: float, rng: np.random.Generator) -> Iterator[Ints]:
    """Yield the rows of round pieces of 0.4 to 1 m radius, until a share of the points (N, 2) (m) belongs to one."""
    left = np.ones(len(points), dtype=np.bool_)
    while (~left).mean() < share:
        centre = points[rng.choice(np.flatnonzero(left))]
        piece = left & (np.hypot(*(points - centre).T) <= rng.uniform(0.4, 1.0))
        left &= ~piece
        yield np.flatnonzero(piece)


FAULTS: Mapping[str, DriveChange] = {
    "none": lambda drive, _: drive,
    "wrong start": start_wrong,
    "kidnapped": kidnap,
    "moved furniture": move_furniture,
    "glass": turn_to_glass,
    "dirty lidar": soil_lidar,
}
