"""The map update for 1,600 beams: cells per second of each mapper, compared with only writing as many cells.

Each mapper is called twice per round: after the others, with cold caches, and immediately again.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from evalkit import Pose, Scan
from evalkit.commands.diff import benchmark
from evalkit.commands.diff.benchmark import BenchmarkSeries
from evalkit.execution.environment import SINGLE_THREAD
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.specs import MapperSpec
from evalkit_baselines import embedded, paper
from evalkit_baselines.embedded.compiled import compiled_missing, load_core

BEAMS = 1600
RANGE_MAX_M = 12.0
AWAY = Pose(0.0213, 0.0117, 0.3)
EXTENT = (-512, -512, 1024, 1024)
MAP = {"resolution": 0.05, "l_occ": 0.847, "l_free": -0.847, "l_min": -5.0, "l_max": 5.0, "range_max": RANGE_MAX_M}


def scenes() -> dict[str, Scan]:
    """Return a room of 10 m x 8 m seen from its centre, and walls 12 m away in all directions."""
    angles = np.arange(BEAMS) * 2.0 * np.pi / BEAMS
    room = np.minimum(5.0 / np.maximum(np.abs(np.cos(angles)), 1e-9), 4.0 / np.maximum(np.abs(np.sin(angles)), 1e-9))
    return {
        "room 10 x 8 m": Scan(0, room, angles, 0.15, RANGE_MAX_M),
        "12 m all round": Scan(0, np.full(BEAMS, RANGE_MAX_M), angles, 0.15, RANGE_MAX_M),
    }


def make_mapper(spec: MapperSpec) -> Any:
    """Return a mapper with its default parameters."""
    return spec.make(**resolve_parameters("bench", spec.parameters, {}))


def calls_for(scan: Scan) -> tuple[dict[str, Callable[[], Any]], int]:
    """Return the timed calls and the number of cells that the scan crosses."""
    grid = load_core("double").Grid(extent=EXTENT, **MAP)
    hits, misses, row = scan.points(), np.zeros((0, 2)), (AWAY.x, AWAY.y, AWAY.theta)
    grid.add(row, hits, misses)
    cells = np.zeros(grid.touched, dtype=np.int16)
    compiled, polygon = make_mapper(embedded.MAPPER), make_mapper(embedded.POLYGON_MAPPER)
    filled, twin = (
        load_core("double").Grid(extent=EXTENT, polygon=True, widest_gap=0.05, **MAP),
        make_mapper(paper.MAPPER),
    )
    return {
        "memset of these cells": lambda: cells.fill(1),
        "core": lambda: grid.add(row, hits, misses),
        "core, polygon": lambda: filled.add(row, hits, misses),
        "embedded-log-odds": lambda: compiled.update(scan, AWAY),
        "embedded-polygon": lambda: polygon.update(scan, AWAY),
        "log-odds (NumPy)": lambda: twin.update(scan, AWAY),
    }, int(grid.touched)


def main() -> None:
    """Print the median CPU time of each update and the updated cells per second."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("--rounds", type=int, default=60)
    arguments = parser.parse_args()
    if why := compiled_missing():
        parser.error(why)
    ran_on = benchmark.describe_environment()
    series = []
    os.environ.update(SINGLE_THREAD)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    for name, scan in scenes().items():
        calls, touched = calls_for(scan)
        first: dict[str, list[int]] = {what: [] for what in calls}
        again: dict[str, list[int]] = {what: [] for what in calls}
        for round_ in range(arguments.rounds + 3):
            for what in list(calls) if round_ % 2 else reversed(calls):
                first[what].append(cpu_ns(calls[what]))
                again[what].append(cpu_ns(calls[what]))
        print(f"{BEAMS} beams, {name}: {touched} cells of 5 cm, {arguments.rounds} rounds")
        print(f"{'':24} {'CPU us':>8} {'at once again':>14} {'million cells/s then':>21}")
        for what in calls:
            cold, warm = (float(np.median(taken[what][3:])) / 1e3 for taken in (first, again))
            print(f"{what:24} {cold:8.1f} {warm:14.1f} {touched / warm:21.0f}")
            series += [
                BenchmarkSeries(f"{what}, {name}, {when}", "us", tuple(ns / 1e3 for ns in taken[what][3:]))
                for when, taken in (("after the others", first), ("at once again", again))
            ]
    print(benchmark.write_benchmark("mapper", series, ran_on))


def cpu_ns(call: Callable[[], Any]) -> int:
    """Return the CPU time of one call in ns."""
    start = time.process_time_ns()
    call()
    return time.process_time_ns() - start


if __name__ == "__main__":
    main()
