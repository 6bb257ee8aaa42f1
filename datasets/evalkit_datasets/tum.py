"""TUM trajectories (``t x y z qx qy qz qw``, one pose a line) read from and written to text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit_datasets.rows import columns, lines_of, numbers
from evalkit_datasets.timestamps import ordered, stamp_ns, stamp_text

LAYOUT = "t x y z qx qy qz qw"


@dataclass(frozen=True, eq=False)
class TumFile:
    """A trajectory and the defects met while reading it, counted by name."""

    trajectory: Trajectory
    notes: Mapping[str, int] = field(default_factory=dict)


def read(path: Path, parent: str = "world", child: str = "base") -> TumFile:
    """The planar part of a TUM file, x, y in metres and the heading, sorted by time, the first of equal times kept.

    Comments (#), blank lines and commas are allowed. BadData names file, line and what is wrong with it.
    """
    stamps, rows = [], []
    for line, text in lines_of(path, f"a trajectory in TUM format ({LAYOUT})"):
        words = columns(path, line, text, LAYOUT)
        try:
            stamps.append(stamp_ns(words[0]))
        except ValueError as error:
            raise BadData(str(path), f"line {line}", str(error), f"expected '{LAYOUT}'") from None
        rows.append(_pose(path, line, numbers(path, line, words[1:], LAYOUT)))
    if not rows:
        raise BadData(str(path), "", "no pose in it", f"expected lines '{LAYOUT}'")
    keep, backwards, repeated = ordered(np.array(stamps, dtype=np.int64))
    counts = {"poses out of order": backwards, "poses with a repeated stamp left out": repeated}
    trajectory = Trajectory(np.array(stamps)[keep], np.array(rows)[keep], parent, child)
    return TumFile(trajectory, {name: count for name, count in counts.items() if count})


def text(trajectory: Trajectory, comments: tuple[str, ...] = ()) -> str:
    """The trajectory as TUM text, nine decimals of seconds (exact), twelve of metres and of the quaternion."""
    half = 0.5 * trajectory.poses[:, 2]
    lines = [f"# {comment}" for comment in (*comments, "timestamp tx ty tz qx qy qz qw")]
    for stamp, pose, sin, cos in zip(trajectory.stamps_ns, trajectory.poses, np.sin(half), np.cos(half), strict=True):
        lines.append(f"{stamp_text(int(stamp))} {pose[0]:.12f} {pose[1]:.12f} 0 0 0 {sin:.12f} {cos:.12f}")
    return "\n".join(lines) + "\n"


def yaw(qx: float, qy: float, qz: float, qw: float) -> float:
    """The heading (rad) of a rotation: the angle of its x axis, seen from above (ZYX convention)."""
    return float(np.arctan2(2.0 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz))


def _pose(path: Path, line: int, values: list[float]) -> Floats:
    x, y, _, *quaternion = values
    if not np.isfinite(values).all():
        raise BadData(str(path), f"line {line}", "a value is not finite", "take the pose out of the file")
    if abs(np.linalg.norm(quaternion) - 1.0) > 0.01:
        raise BadData(
            str(path),
            f"line {line}",
            f"the quaternion has length {np.linalg.norm(quaternion):g}",
            f"expected '{LAYOUT}'",
        )
    return np.array([x, y, yaw(*quaternion)])
