"""Run every benchmark, also after one that fails, and print each figure beside its aim: ``make bench``.

Each script runs in its own process and writes its samples, the machine and its load to reports/build/bench. Exit code 1
if a script wrote nothing; an aim that is missed is only reported. scale.py, which needs two free cores and prints only,
and soak.py and faults.py, which look for errors, are run by themselves.
"""

from __future__ import annotations

import argparse
import math
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from evalkit.commands.diff.benchmark import FOLDER, Benchmark, BenchmarkSeries, load_benchmarks

PEER = "absent peer "
"""Begins the entries of a benchmark's environment that say why a library was not measured."""

HERE = Path(__file__).resolve().parent
SCRIPTS = ("overhead", "backends", "registration", "pipeline", "normals", "mapper", "metrics", "growth")


@dataclass(frozen=True)
class Aim:
    """The largest median of a series; with ``beside`` the least ratio of the series to the series ``beside``, or with
    ``at_most`` the largest. ``percentile``: of the samples, instead of the median. ``limit`` nan: a row without an aim.
    """

    benchmark: str
    series: str
    limit: float
    beside: str = ""
    at_most: bool = False
    percentile: float = 50.0


def registration_aims(points: int, lasting_ms: float, built_ms: float, way: str) -> tuple[Aim, ...]:
    """Return the aims for a size of the target and a way to take turns, alone and as ratios to the other libraries."""
    core, kept, built = (f"embedded{kind}, {points} points, {way}" for kind in ("", " + table", " + index"))
    return (
        Aim("registration", kept, lasting_ms),
        Aim("registration", built, built_ms),
        *(
            Aim("registration", f"{name}, {points} points, {way}", ratio, beside)
            for name, ratio, beside in (
                ("small_gicp", 30.0, kept), ("Open3D, less its tree", 50.0, kept), ("KISS-ICP", 60.0, kept),
                ("small_gicp + index", 12.0, built), ("Open3D + index", 20.0, built),
                ("KISS-ICP + index", 25.0, built), ("cKDTree, queries", 1.0, core),
            )
        ),
    )  # fmt: skip


AIMS: tuple[Aim, ...] = (
    Aim("overhead", "a run's process beyond its libraries", 0.08),
    Aim("overhead", "around an idle method", 20.0),
    Aim("overhead", "around a scan of paper", math.nan),
    Aim("overhead", "evalkit --version", 0.3),
    Aim("overhead", "evalkit list", 0.3),
    *(Aim("backends", name, math.nan) for name in ("embedded", "paper", "paper-tight")),
    *registration_aims(5000, 0.12, 0.35, "in turn"),
    *registration_aims(5000, 0.12, 0.35, "in a row"),
    *registration_aims(50_000, 0.15, 0.6, "in turn"),
    *registration_aims(50_000, 0.15, 0.6, "in a row"),
    Aim("registration", "Karto, its own scans, 5000 points, in turn", math.nan),
    Aim("registration", "Karto, its own scans, 50000 points, in turn", math.nan),
    *(
        Aim("registration", f"{growth}, 50000 points, {way}", 1.25, f"{growth}, 5000 points, {way}", at_most=True)
        for growth in ("embedded", "embedded + table")
        for way in ("in turn", "in a row")
    ),
    Aim("pipeline", "embedded-pipeline, epsilon 1e-6", 0.1),
    Aim("pipeline", "embedded-pipeline, epsilon 1e-6", 0.3, percentile=99.0),
    Aim("pipeline", "paper-map-line", 3.7),
    Aim("pipeline", "paper-tight", math.nan),
    Aim("normals", "core, 5000 points", 2.0),
    Aim("normals", "NumPy, 5000 points", 3.0, "core, 5000 points"),
    Aim("mapper", "core, room 10 x 8 m, at once again", 300.0),
    Aim("mapper", "core, 12 m all round, at once again", 630.0),
    Aim("mapper", "core, polygon, 12 m all round, after the others", 100.0),
    Aim("mapper", "core, polygon, 12 m all round, at once again", 100.0),
    Aim("metrics", "together", 500.0),
    Aim("growth", "memory of a further scan", 400.0),
)


def find_series(measured: Mapping[str, Benchmark], benchmark: str, name: str) -> BenchmarkSeries | None:
    """Return a series, or None if it was not measured."""
    found = measured.get(benchmark)
    return next((one for one in found.series if one.name == name), None) if found else None


def row(aim: Aim, measured: Mapping[str, Benchmark]) -> tuple[str, str, str, str, str]:
    """Return figure, found, quartiles, aim and verdict of one aim."""
    figure = aim.series if not aim.beside else f"{aim.series} / {aim.beside}"
    if aim.percentile != 50.0:
        figure = f"{figure}, {aim.percentile:g} %"
    series = find_series(measured, aim.benchmark, aim.series)
    other = find_series(measured, aim.benchmark, aim.beside) if aim.beside else None
    if series is None or (aim.beside and other is None):
        return f"{aim.benchmark}: {figure}", "", "", "" if math.isnan(aim.limit) else f"{aim.limit:g}", "not measured"
    low, high = series.quartiles
    if other is None:
        value = float(np.percentile(series.samples, aim.percentile))
        found, wanted, met = f"{value:.3g} {series.unit}", f"<= {aim.limit:g}", value <= aim.limit
    else:
        ratio = series.median / other.median
        low, high = low / other.median, high / other.median
        met = ratio <= aim.limit if aim.at_most else ratio >= aim.limit
        found, wanted = f"{ratio:.3g} x", f"{'<=' if aim.at_most else '>='} {aim.limit:g} x"
    quartiles = f"{low:.3g} - {high:.3g}" if aim.percentile == 50.0 else ""  # those of all samples are not around it
    if math.isnan(aim.limit):
        return f"{aim.benchmark}: {figure}", found, quartiles, "", "no aim"
    verdict = "met" if met else "missed"
    return f"{aim.benchmark}: {figure}", found, quartiles, wanted, verdict


def absent_peers(measured: Mapping[str, Benchmark]) -> list[str]:
    """Return a line for each library that was not measured, with the reason."""
    return [
        f"{name}: {entry.removeprefix(PEER)} was not measured: {why}"
        for name, one in measured.items()
        for entry, why in one.environment.items()
        if entry.startswith(PEER)
    ]


def run_scripts(names: Sequence[str]) -> list[str]:
    """Run the benchmarks one after the other; returns those that wrote no measurement."""
    failed = []
    for name in names:
        begun = time.time()
        print(f"== {name}", flush=True)
        subprocess.run([sys.executable, str(HERE / f"{name}.py")], check=False)
        written = FOLDER / f"{name}.json"
        if not written.exists() or written.stat().st_mtime < begun - 1.0:
            failed.append(name)
    return failed


def main() -> int:
    """Run the benchmarks and print the table; returns 1 if one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of: {', '.join(SCRIPTS)}")
    names = parser.parse_args().names or list(SCRIPTS)
    if unknown := sorted(set(names) - set(SCRIPTS)):
        parser.error(f"no benchmark {', '.join(unknown)}; there are {', '.join(SCRIPTS)}")
    failed = run_scripts(names)
    measured = {name: load_benchmarks(FOLDER / f"{name}.json")[name] for name in names if name not in failed}
    table = Table("figure", "median or %", "quartiles", "aim", "")
    rows = [row(aim, measured) for aim in AIMS if aim.benchmark in names]
    for one in rows:
        table.add_row(*one)
    console = Console(width=None if sys.stdout.isatty() else 160)
    console.print(table)
    loads = [one.environment.get(f"load {when}", "?") for one in measured.values() for when in ("before", "after")]
    met = sum(one[-1] == "met" for one in rows)
    console.print(
        f"{met} of {sum(one[-2] != '' for one in rows)} aims met; load before {loads[0] if loads else '?'}, "
        f"after {loads[-1] if loads else '?'}; all samples: {FOLDER}"
    )
    for line in absent_peers(measured):
        console.print(line)
    for name in failed:
        console.print(f"{name} failed: it wrote no measurement")
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main())
