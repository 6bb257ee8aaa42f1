"""CPU time of every metric of a map or its scans: a floor of 50 m x 50 m in 1,000 x 1,000 cells.

The aim is half a second for all of them together.
"""

from __future__ import annotations

import time
from statistics import median

import numpy as np

from evalkit import metrics
from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.core.arrays import keep_freed_memory
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Scan
from evalkit.metrics.metric import NO_POSES, Evidence, PlacedScan, Unmatched

CELLS, SIZE_M, ROOM_M = 1000, 0.05, 5.0
BEAMS, SCANS = 720, 300
REPEATS = 9
GROUPS = ("map against truth", "map consistency")


def floor(noise_cells: float, seed: int) -> OccupancyGrid:
    """Return rooms of 5 m x 5 m, with walls two cells thick and displaced by the given distance."""
    rng = np.random.default_rng(seed)
    places = np.arange(CELLS)
    walls = np.zeros((CELLS, CELLS), np.bool_)
    for line in np.arange(0, CELLS, round(ROOM_M / SIZE_M)):
        for thick in (0, 1):
            off = np.clip(line + thick + np.round(rng.normal(0.0, noise_cells, CELLS)).astype(int), 0, CELLS - 1)
            walls[off, places] = walls[places, off] = True
    log_odds = np.where(walls, 3.0, -3.0) + rng.normal(0.0, 0.5, walls.shape)
    return OccupancyGrid(log_odds.astype(np.float32), np.ones_like(walls), SIZE_M, 0.0, 0.0)


def scans(sigma_m: float) -> tuple[PlacedScan, ...]:
    """Return a scan of its own room from each of the given number of places."""
    rng = np.random.default_rng(1)
    angles = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    placed = []
    for index in range(SCANS):
        room, away = divmod(index % 100, 10), rng.uniform(1.0, 4.0, 2)
        x = np.where(np.cos(angles) > 0.0, ROOM_M - away[0], away[0]) / np.maximum(np.abs(np.cos(angles)), 1e-9)
        y = np.where(np.sin(angles) > 0.0, ROOM_M - away[1], away[1]) / np.maximum(np.abs(np.sin(angles)), 1e-9)
        ranges = np.minimum(x, y) + rng.normal(0.0, sigma_m, BEAMS)
        placed.append((Scan(index, ranges, angles, 0.05, 12.0), np.array([*(ROOM_M * np.array(room) + away), 0.0])))
    return tuple(placed)


def time_metrics() -> dict[str, dict[str, float]]:
    """Return the CPU milliseconds of each metric by group; shared results are charged to the first metric."""
    mapped, steps = scans(0.02), np.zeros(0, STEP)
    true = Truth("exact", grid=floor(0.0, 0))
    halves = floor(1.0, 3), floor(1.0, 4)
    evidence = Evidence(RunResult(steps, 0), true, Unmatched(NO_POSES), floor(1.0, 2), mapped, *halves)
    found: dict[str, dict[str, float]] = {group: {} for group in GROUPS}
    for metric in metrics.METRICS:
        if metric.group in GROUPS:
            begin = time.process_time()
            metric.compute(evidence)
            found[metric.group][metric.name] = 1e3 * (time.process_time() - begin)
    return found


def main() -> None:
    """Print the slowest twelve metrics and the sums, medians of the repeats, and store every sample."""
    ran_on = benchmark.describe_environment()
    keep_freed_memory()  # as in the processes that score runs
    repeats = [time_metrics() for _ in range(REPEATS)]
    series = [
        BenchmarkSeries(name, "ms", tuple(found[group][name] for found in repeats))
        for group in GROUPS
        for name in repeats[0][group]
    ]
    for group in GROUPS:
        print(f"{group}: {median(sum(found[group].values()) for found in repeats):.0f} ms")
    for one in sorted(series, key=lambda one: -one.median)[:12]:
        print(f"  {one.name:24} {one.median:6.0f} ms")
    together = BenchmarkSeries(
        "together", "ms", tuple(sum(sum(own.values()) for own in found.values()) for found in repeats)
    )
    print(f"together: {together.median:.0f} ms, aim 500")
    print(benchmark.write_benchmark("metrics", [*series, together], ran_on))


if __name__ == "__main__":
    main()
