"""Drive corrected logs of other buildings, a scan a metre: ``python tests/baselines/slam/thinned_logs.py 5``.

The logs of Radish that GMapping corrected have poses to 5 to 10 cm and no odometry. Wheel odometry is made from the
poses: 2 % too long, turns 3 % too large, and with noise of 3 % of a step, 5 % of a turn and 0.6 deg a metre. No
setting was chosen on ``aces`` and ``freiburg-101``. A row for each log and method: drives; accepted closures, median;
ATE RMSE of the corrected poses against the log's, median and worst (cm); CPU time of a scan, median and largest (ms).

``--graph killian.g2o`` drives the Killian Court of the MIT instead: 1.9 km, a scan every 0.5 m, with the optimised
poses of a published graph. The file is in the package rtb-data of PyPI, ``rtbdata/data/killian.g2o.zip``.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from false_loops import ate

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.plugins import registry

LOGS = ("aces", "freiburg-101", "intel")


def main() -> int:
    """Drive and print."""
    parser = argparse.ArgumentParser(description="Drive thinned logs with simulated odometry.")
    parser.add_argument("drives", type=int, nargs="?", default=5, help="of each log, each with other noise")
    parser.add_argument("--methods", nargs="*", default=["embedded-slam", "paper-slam"])
    parser.add_argument("--work", type=int, help="operations a scan of embedded-slam")
    parser.add_argument("--graph", type=Path, help="a g2o file with a line ROBOTLASER1 for each vertex")
    arguments = parser.parse_args()
    heads = ("log", "method", "drives", "closures", "ATE cm", "worst", "ms a scan", "largest")
    sys.stdout.write(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}\n")
    if arguments.graph:
        paths = [write_log(arguments.graph, Path(tempfile.mkdtemp()) / f"{arguments.graph.stem}.log")]
    else:
        folder = Path(os.environ["EVALKIT_DATA"]) / "radish-corrected"
        paths = [folder / f"{log}-corrected.log.gz" for log in LOGS]
    for path in paths:
        log = path.name.removesuffix(".gz").removesuffix(".log").removesuffix("-corrected")
        for method in arguments.methods:
            work = {"work": arguments.work} if arguments.work is not None and method == "embedded-slam" else {}
            rows = [drive(path, method, work, seed) for seed in range(arguments.drives)]
            closures, errors, times, largest = (np.array(column) for column in zip(*rows, strict=True))
            cells = (log, method, str(len(rows)), f"{np.median(closures):.0f}", f"{100.0 * np.median(errors):.1f}",
                     f"{100.0 * errors.max():.1f}", f"{np.median(times):.2f}", f"{largest.max():.0f}")  # fmt: skip
            sys.stdout.write(f"| {' | '.join(cells)} |\n")
            sys.stdout.flush()
    return 0


def drive(path: Path, method: str, changed: dict[str, int], seed: int) -> tuple[int, float, float, float]:
    """Return accepted closures, ATE RMSE (m), and median and largest CPU time of a scan (ms)."""
    recording = registry.dataset("carmen").make(path=str(path))
    true = recording.truth().trajectory.poses
    spec = registry.backend(method)
    slam = spec.make(**{each.name: each.default for each in spec.parameters} | changed)
    times = []
    for frame, odom in zip(recording.frames(), simulate_odometry(true, np.random.default_rng(seed)), strict=True):
        frame = replace(frame, odom_from_base=Pose.of(odom))  # noqa: PLW2901 - the same frame, with odometry
        began = time.process_time()
        slam.update(frame)
        times.append(1e3 * (time.process_time() - began))
    accepted = sum(loop.accepted for loop in slam.loop_closures())
    return accepted, ate(slam.trajectory().poses, true), float(np.median(times)), max(times)


def write_log(graph: Path, log: Path) -> Path:
    """Write the scans of a graph with their vertices' poses as a corrected CARMEN log, and return its path."""
    rows, pose = [], ["0"] * 3
    for line in graph.read_text().splitlines():
        words = line.split()
        if words and words[0] == "VERTEX_SE2":
            pose = words[2:5]
        elif words and words[0] == "ROBOTLASER1":
            end = 9 + int(words[8])
            stamp = words[-3]  # then the host and the time since the start
            rows.append(" ".join(["FLASER", words[8], *words[9:end], *pose, *pose, stamp, "graph", stamp]))
    log.write_text("\n".join(["NEFF 0 0", *rows, ""]))  # as in GMapping's logs: the poses are corrected
    return log


def simulate_odometry(true: np.ndarray, rng: np.random.Generator) -> list[np.ndarray]:
    """Return the poses (N, 3) that wheels on the path would report."""
    poses = [np.zeros(3)]
    for x, y, turn in se2.between(true[:-1], true[1:]):
        way = math.hypot(x, y)
        slip = rng.normal(0.0, (0.03 * way + 0.002, 0.02 * way + 0.002, 0.05 * abs(turn) + 0.01 * way + 0.002))
        poses.append(se2.compose(poses[-1], np.array([1.02 * x, y, 1.03 * turn]) + slip))
    return poses


if __name__ == "__main__":
    sys.exit(main())
