"""Read and write trajectories in TUM format: one pose a line, ``t x y z qx qy qz qw`` in seconds and metres."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.pose import MAX_COORDINATE_M
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.io.text_lines import iter_rows, parse_numbers
from evalkit.io.timestamps import format_stamp, order_stamps, parse_stamp_ns

LAYOUT = "t x y z qx qy qz qw"

MAX_TILT_RAD = math.radians(30.0)
"""A frame tilted by more does not lie in the plane of a floor: a ramp is less steep."""

CLEARLY_RAD = math.radians(5.0), math.radians(0.5)
"""Quaternions are in another order where the poses are then less tilted by this, or by the second if they are upside
down as given, which few are."""


@dataclass(frozen=True, eq=False)
class TumFile:
    """A trajectory and the number of defects corrected while it was read, by name."""

    trajectory: Trajectory
    notes: Mapping[str, int] = field(default_factory=dict)


def read_tum(path: Path) -> TumFile:
    """Return the planar part of a TUM file, sorted by time; of poses with equal stamps the first is kept.

    Comments (#), blank lines and commas are allowed. Raises DataMissing if there is no such file and BadData, with the
    line, if it is not a trajectory in a plane: of poses tilted by more than 30 deg, the heading has no meaning.
    """
    stamps, rows, lines = [], [], []
    for line, words in iter_rows(path, LAYOUT, f"a trajectory in TUM format ({LAYOUT})"):
        try:
            stamps.append(parse_stamp_ns(words[0]))
        except ValueError as error:
            raise BadData(str(path), f"line {line}", str(error), f"expected '{LAYOUT}'") from None
        rows.append(_check_pose(path, line, parse_numbers(path, line, words[1:], LAYOUT)))
        lines.append(line)
    if not rows:
        raise BadData(str(path), "", "no pose in it", f"expected lines '{LAYOUT}'")
    _check_tilt(path, lines, np.array(rows)[:, 3:])
    poses = np.array([(x, y, yaw_from_quaternion(*rotation)) for x, y, _, *rotation in rows])
    order = order_stamps(np.array(stamps, dtype=np.int64))
    counts = {"poses out of order": order.backwards, "poses with a repeated stamp ignored": order.repeated}
    trajectory = Trajectory(np.array(stamps)[order.keep], poses[order.keep])
    return TumFile(trajectory, {name: count for name, count in counts.items() if count})


def format_tum(trajectory: Trajectory, *comments: str) -> str:
    """Return a trajectory as TUM text: exact seconds, 12 decimals of metres and of the quaternion (x y z w)."""
    frames = f"{trajectory.parent}_from_{trajectory.child}: timestamp tx ty tz qx qy qz qw"
    lines = [f"# {comment}" for comment in (*comments, frames)]
    half = 0.5 * trajectory.poses[:, 2]
    for stamp, pose, sin, cos in zip(trajectory.stamps_ns, trajectory.poses, np.sin(half), np.cos(half), strict=True):
        lines.append(f"{format_stamp(int(stamp))} {pose[0]:.12f} {pose[1]:.12f} 0 0 0 {sin:.12f} {cos:.12f}")
    return "\n".join(lines) + "\n"


def yaw_from_quaternion(qx: float, qy: float, qz: float, qw: float) -> float:
    """Return the heading (rad) of a rotation: the direction of its x axis seen from above (ZYX convention)."""
    return float(np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))


def _check_pose(path: Path, line: int, values: list[float]) -> list[float]:
    if not np.isfinite(values).all():
        raise BadData(str(path), f"line {line}", "a value is not finite", "remove the pose from the file")
    if max(map(abs, values[:3])) > MAX_COORDINATE_M:
        found = f"a length above {MAX_COORDINATE_M:,.0f} m"
        raise BadData(str(path), f"line {line}", found, "remove the pose from the file")
    length = float(np.linalg.norm(values[3:]))
    if abs(length - 1.0) > 0.01:
        found = f"a quaternion of length {length:g}"
        raise BadData(str(path), f"line {line}", found, f"expected '{LAYOUT}' with a unit quaternion")
    return values


def _check_tilt(path: Path, lines: list[int], quaternions: Floats) -> None:
    """Raise BadData for quaternions (N, 4) in another order, or of a frame that does not lie in the plane.

    All poses may be upside down, as those of a lidar mounted so are. Of both orders that is the right one by which the
    poses are less tilted; a robot that never turned tells neither.
    """
    upright = _cos_of_tilt(quaternions)
    upside_down = bool((upright < 0.0).all())
    tilts, clearly_rad = _tilts_of(-upright if upside_down else upright), CLEARLY_RAD[upside_down]
    others = _tilts_of(_cos_of_tilt(np.roll(quaternions, -1, axis=1)))
    swapped = bool(others.max() <= MAX_TILT_RAD and others.max() + clearly_rad < tilts.max())
    tilted = np.flatnonzero(tilts > (clearly_rad if swapped else MAX_TILT_RAD))
    if not len(tilted):
        return
    remedy = f"expected '{LAYOUT}' of a frame with x forward and z up"
    if swapped:
        remedy += "; its quaternions are in the order 'qw qx qy qz': move qw to the end"
    else:
        remedy += "; turn the poses of a camera or an IMU with other axes (z forward) into those of the robot's base"
    tilt_deg = math.degrees(math.acos(np.clip(upright[tilted[0]], -1.0, 1.0)))
    most = "" if swapped else f" (at most {math.degrees(MAX_TILT_RAD):.0f} deg)"
    what = f"a pose tilted by {tilt_deg:.0f} deg to the plane{most}"
    raise BadData(str(path), f"line {lines[tilted[0]]}", what, remedy)


def _tilts_of(cosines: Floats) -> Floats:
    return np.asarray(np.arccos(np.clip(cosines, -1.0, 1.0)))


def _cos_of_tilt(quaternions: Floats) -> Floats:
    """Return the cosines (N,) of the angles between the z axes of rotations (N, 4) and that of the world."""
    return np.asarray(1.0 - 2.0 * (quaternions[:, 0] ** 2 + quaternions[:, 1] ** 2))
