"""Build a reference trajectory in TUM format from the graph-optimised poses of flirtlib."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from evalkit.io.timestamps import format_stamp
from evalkit_datasets.recordings.building.log_lines import iter_log


def build_trajectory(graph: Path) -> Iterator[str]:
    """Yield the lines of the trajectory: the optimised robot pose of every scan of a graph, in order of time.

    Nine decimals of the quaternion: further ones differ between mathematical libraries.
    """
    yield "# timestamp tx ty tz qx qy qz qw\n"
    for reading in sorted(iter_log(graph), key=lambda one: one.stamp_ns):
        x, y, theta = reading.robot
        half = 0.5 * theta
        stamp = format_stamp(reading.stamp_ns)[:-3]
        yield f"{stamp} {x:.6f} {y:.6f} 0 0 0 {math.sin(half):.9f} {math.cos(half):.9f}\n"
