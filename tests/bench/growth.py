"""Memory of a run over the length of its recording: bags of 1x, 10x and 100x, each in a separate run.

Wheel odometry stores nothing, so growth is due to evalkit: the reader, the run, its trajectory. ``--day`` adds a bag of
24 hours.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import threading
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import long_bags
import numpy as np

from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import FOLDER, BenchmarkSeries
from evalkit.config.limits import Limits
from evalkit.execution import run_process
from evalkit.execution.one_run import Request

FACTORS = (1, 10, 100)
DAY_S = 24 * 3600
LIMIT_BYTES = 400
"""Of memory for every further scan: its stamp and counts (28), two poses (48), the odometry (32), copies on the way."""

PATIENT = Limits(run_s=7200.0, scan_s=3600.0, run_cpu_s=7200.0, scan_cpu_s=3600.0)
"""A long bag is read once before its first scan is shown."""


@dataclass(frozen=True)
class Run:
    """One run: number of answered scans, peak resident memory of its process, size of its bag."""

    scans: int
    peak_bytes: int
    bag_bytes: int


def run(bag: Path) -> Run:
    """Run wheel odometry over a bag in a separate process."""
    request = Request("wheel-odometry", {}, "rosbag", {"path": str(bag)})
    with tempfile.TemporaryDirectory() as folder:
        made = run_process.run(request, Path(folder), PATIENT, lambda _: None, threading.Event())
    if made.status != "complete":
        sys.exit(f"{bag.name}: {made.status}: {made.reason}")
    size = sum(file.stat().st_size for file in ([bag] if bag.is_file() else bag.iterdir()))
    return Run(len(made.steps), made.peak_memory_bytes, size)


def per_scan(runs: list[Run]) -> list[float]:
    """Return the bytes of memory per additional scan, from each length to the next."""
    return [(b.peak_bytes - a.peak_bytes) / (b.scans - a.scans) for a, b in pairwise(runs)]


def draw_chart(found: dict[str, list[Run]], path: Path) -> None:
    """Draw memory over the number of scans, with the size of the recording."""
    from evalkit.report.html import charts

    curves = [
        charts.Curve(
            f"run on {kind}",
            np.array([one.scans for one in runs], dtype=np.float64),
            np.array([one.peak_bytes / 2**20 for one in runs]),
            marks=True,
        )
        for kind, runs in found.items()
    ]
    first = next(iter(found.values()))
    scans = np.array([one.scans for one in first], dtype=np.float64)
    curves.append(
        charts.Curve("the bag on disk", scans, np.array([one.bag_bytes / 2**20 for one in first]), marks=True)
    )
    x, y = charts.Axis("scans", "log"), charts.Axis("peak of the run, size of the bag [MiB]", "log")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(charts.lines(curves, x, y))


def main() -> int:
    """Print the table, store the figures and the chart; returns 1 if memory grows faster than the limit."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--scans", type=int, default=600, help="in the shortest bag (10 a second)")
    parser.add_argument("--kinds", nargs="+", default=["sqlite3"], choices=long_bags.KINDS)
    parser.add_argument("--day", action="store_true", help="a bag of 24 hours, too")
    arguments = parser.parse_args()
    ran_on = benchmark.describe_environment()
    lengths = [arguments.scans * factor for factor in FACTORS]
    lengths += [round(DAY_S * long_bags.RATE_HZ)] if arguments.day else []
    found: dict[str, list[Run]] = {}
    print(f"{'bag':10} {'scans':>8} {'hours':>7} {'bag MiB':>9} {'peak MiB':>9} {'bytes a further scan':>21}")
    for kind in arguments.kinds:
        runs = found[kind] = []
        for scans in lengths:
            with tempfile.TemporaryDirectory(prefix="evalkit-growth-") as folder:
                runs.append(run(long_bags.write(Path(folder), kind, scans)))
            more = f"{per_scan(runs)[-1]:21.0f}" if len(runs) > 1 else ""
            hours = runs[-1].scans / long_bags.RATE_HZ / 3600
            sizes = f"{runs[-1].bag_bytes / 2**20:9.1f} {runs[-1].peak_bytes / 2**20:9.1f}"
            print(f"{kind:10} {runs[-1].scans:8} {hours:7.2f} {sizes} {more}", flush=True)
    series = [
        BenchmarkSeries(f"{kind}, {one.scans} scans", "MiB", (one.peak_bytes / 2**20,))
        for kind in found
        for one in found[kind]
    ]
    worst = max(per_scan(runs)[-1] for runs in found.values())
    series.append(BenchmarkSeries("memory of a further scan", "B", (worst,)))
    print(benchmark.write_benchmark("growth", series, ran_on))
    draw_chart(found, FOLDER / "growth.svg")
    print(FOLDER / "growth.svg")
    print(f"limit: {LIMIT_BYTES} bytes for every further scan; found {worst:.0f} from the last but one to the last")
    return int(worst > LIMIT_BYTES)


if __name__ == "__main__":
    sys.exit(main())
