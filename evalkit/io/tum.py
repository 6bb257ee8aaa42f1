"""Read and write trajectories in TUM format: one pose a line, ``t x y z qx qy qz qw`` in seconds and metres."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.io.text_lines import iter_rows, parse_numbers
from evalkit.io.timestamps import format_stamp, order_stamps, parse_stamp_ns

LAYOUT = "t x y z qx qy qz qw"


@dataclass(frozen=True, eq=False)
class TumFile:
    """A trajectory and the number of defects corrected while it was read, by name."""

    trajectory: Trajectory
    notes: Mapping[str, int] = field(default_factory=dict)


def read_tum(path: Path, parent: str = "world", child: str = "base") -> TumFile:
    """Return the planar part of a TUM file, sorted by time; of poses with equal stamps the first is kept.

    Comments (#), blank lines and commas are allowed. Raises DataMissing if there is no such file and BadData, with the
    line, if it is not a trajectory.
    """
    stamps, rows = [], []
    for line, words in iter_rows(path, LAYOUT, f"a trajectory in TUM format ({LAYOUT})"):
        try:
            stamps.append(parse_stamp_ns(words[0]))
        except ValueError as error:
            raise BadData(str(path), f"line {line}", str(error), f"expected '{LAYOUT}'") from None
        rows.append(_planar_pose(path, line, parse_numbers(path, line, words[1:], LAYOUT)))
    if not rows:
        raise BadData(str(path), "", "no pose in it", f"expected lines '{LAYOUT}'")
    order = order_stamps(np.array(stamps, dtype=np.int64))
    counts = {"poses out of order": order.backwards, "poses with a repeated stamp ignored": order.repeated}
    trajectory = Trajectory(np.array(stamps)[order.keep], np.array(rows)[order.keep], parent, child)
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


def _planar_pose(path: Path, line: int, values: list[float]) -> Floats:
    x, y, _, *quaternion = values
    if not np.isfinite(values).all():
        raise BadData(str(path), f"line {line}", "a value is not finite", "remove the pose from the file")
    if abs(np.linalg.norm(quaternion) - 1.0) > 0.01:
        found = f"a quaternion of length {np.linalg.norm(quaternion):g}"
        raise BadData(str(path), f"line {line}", found, f"expected '{LAYOUT}' with a unit quaternion")
    return np.array([x, y, yaw_from_quaternion(*quaternion)])
