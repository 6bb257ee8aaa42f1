"""Basin of convergence of the paper's ICP on its own scene; part of the chapter on validation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import fisher_exact, mannwhitneyu

from evalkit.core.arrays import Ints
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Table, Text
from evalkit.report.html.charts import Axis
from evalkit.stats.intervals import wilson_interval
from evalkit_paper import table_1, verdicts
from evalkit_paper.chapter import Finding, Results, Settings
from evalkit_paper.table_1 import MAX_ITERATIONS, ROOMS

DISTANCES_M = tuple(float(value) for value in range(9))
TURNS_DEG = (0.0, 10.0, 20.0, 30.0, 35.0, 40.0, 45.0, 50.0, 60.0, 90.0)
TABLE_TURNS_DEG = (0.0, 30.0, 40.0, 45.0, 50.0, 60.0, 90.0)
NEAR_M = 5.0
MANY_ITERATIONS = 200
"""Enough iterations for every start that converges at all."""

PARAMETERS = (
    Parameter("basin_seeds", 16, "", "starts per cell of the basin", low=2, high=1000),
    Parameter("within_m", 0.1, "m", "basin: largest position error of a success, at the room's centre", low=1e-3),
    Parameter("within_deg", 2.0, "deg", "basin: largest angle error of a success", low=0.01),
)


Bounds = tuple[float, float]

NEAR_STARTS: tuple[Bounds, Bounds] = ((0.0, 20.0), (0.0, 2.0))
FAR_STARTS: tuple[Bounds, Bounds] = ((40.0, 90.0), (4.0, 8.0))
"""Turns (deg) and distances (m) of good and of bad initial guesses."""

OVERLAP, OVERLAPS, LIMIT_M = "overlap", (1.0, 0.9, 0.8, 0.7, 0.6, 0.5), 0.5
MIN_OVERLAP = 0.7
"""Overlap from which on every start must succeed."""


class IcpVariant(NamedTuple):
    """An ICP variant whose basin is shown."""

    name: str
    title: str
    one_to_one: bool
    max_iterations: int


VARIANTS = (
    IcpVariant("filter", "with the one-to-one filter", True, MAX_ITERATIONS),
    IcpVariant("no filter", "without the filter", False, MAX_ITERATIONS),
    IcpVariant("filter, long", f"with the filter, up to {MANY_ITERATIONS} iterations", True, MANY_ITERATIONS),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """One task per variant and rotation, and one for partial overlap."""
    overlap = make_task(
        OVERLAP, table_1.measure_overlap, room="first", overlaps=list(OVERLAPS), limit_m=LIMIT_M,
        seeds=settings["basin_seeds"],
    )  # fmt: skip
    basins = (
        make_task(
            _name(variant, turn), table_1.measure_basin, room="first", distances_m=list(DISTANCES_M), turn_deg=turn,
            seeds=settings["basin_seeds"], within_m=settings["within_m"], within_deg=settings["within_deg"],
            one_to_one=variant.one_to_one, max_iterations=variant.max_iterations,
        )
        for variant in VARIANTS
        for turn in TURNS_DEG
    )  # fmt: skip
    return (*basins, overlap)


def blocks(settings: Settings, results: Results) -> list[Block]:
    """Heat maps of success over distance and rotation, a summary, and counts with intervals."""
    metres, degrees = table_1.initial_offset(ROOMS["first"])
    trials = settings["basin_seeds"]
    widest = wilson_interval(trials // 2, trials)
    text = (
        "The scan of Table 1 is shifted by a distance at the room's centre, in all directions, and rotated about it to "
        f"either side; {trials} starts per cell, each with its own noise. Success: within {settings['within_m']:g} m "
        f"at the centre and {settings['within_deg']:g} deg of the true pose when ICP ends. Table 1 itself starts "
        f"{metres:.1f} m and {degrees:.0f} deg off. The interval of a share of one half is {100 * widest.low:.0f} "
        f"to {100 * widest.high:.0f} % (Wilson)."
    )
    return [
        Text(text),
        Figures([_heat_figure(variant, load_successes(results, variant), trials) for variant in VARIANTS], small=True),
        _end_table(results, trials),
        Text(_summarize(results, trials)),
    ]


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the initial guess and on partial overlap."""
    del settings
    short, near_misled, near = _starts(results, *NEAR_STARTS)
    long, far_misled, far = _starts(results, *FAR_STARTS)
    faster = float(mannwhitneyu(short, long, alternative="less").pvalue)
    counts = np.array([[near_misled, near - near_misled], [far_misled, far - far_misled]])
    fewer = float(fisher_exact(counts, alternative="less").pvalue)
    found = results[OVERLAP]
    plain, limited = (dict(zip(OVERLAPS, found[name].tolist(), strict=True)) for name in ("plain", "limited"))
    text = ", ".join(f"{100 * overlap:.0f} %: {100 * plain[overlap]:.0f} and {100 * limited[overlap]:.0f} %"
                     for overlap in OVERLAPS)  # fmt: skip
    return (
        Finding(
            "The initial guess speeds up convergence and avoids wrong minima", "no figure is given",
            f"median {np.median(short):.0f} iterations and {near_misled} of {near} starts misled from up to 2 m and 20 "
            f"deg, {np.median(long):.0f} and {far_misled} of {far} from 4 m and 40 deg on",
            verdicts.judge_initial_guess(faster, fewer), "basin",
        ),
        Finding(
            "Partial overlap", "named, no figure is given",
            f"starts that succeed by overlap, with all pairs and with pairs within {LIMIT_M:g} m: {text}",
            verdicts.judge_overlap(plain, limited, MIN_OVERLAP, f"pairs beyond {LIMIT_M:g} m are dropped"), "basin",
        ),
    )  # fmt: skip


def _starts(results: Results, turns: Bounds, distances: Bounds) -> tuple[Ints, int, int]:
    """Iterations of all starts with the filter within the bounds (deg, m), how many were misled, and their number."""
    chosen = [number for number, distance in enumerate(DISTANCES_M) if distances[0] <= distance <= distances[1]]
    own = [results[_name(VARIANTS[0], turn)] for turn in TURNS_DEG if turns[0] <= turn <= turns[1]]
    iterations = np.concatenate([result["iterations"][chosen].ravel() for result in own])
    return iterations, int(sum(result["misled"][chosen].sum() for result in own)), len(iterations)


def load_successes(results: Results, variant: IcpVariant) -> Ints:
    """Successes (T, D) by rotation and distance."""
    return np.stack([results[_name(variant, turn)]["successes"] for turn in TURNS_DEG])


def count_ends(results: Results, variant: IcpVariant, key: str, turn: float) -> int:
    """Number of starts up to ``NEAR_M`` and of one rotation that ended as "successes", "misled" or "ran_out"."""
    near = np.array(DISTANCES_M) <= NEAR_M
    return int(results[_name(variant, turn)][key][near].sum())


def _end_table(results: Results, trials: int) -> Table:
    """Table: how starts up to 5 m away ended, for some rotations."""
    every = trials * sum(distance <= NEAR_M for distance in DISTANCES_M)
    columns = (
        Column("Turn", "deg"),
        *(Column(variant.name, "%", number=True, tip=f"{variant.title}, with Wilson's 95 % interval")
          for variant in VARIANTS),
        *(Column(f"{variant.name}: misled, ran out", "%", number=True) for variant in VARIANTS),
    )  # fmt: skip
    rows = [
        [
            Cell(f"{turn:g}", sort=turn),
            *(_share_cell(count_ends(results, variant, "successes", turn), every) for variant in VARIANTS),
            *(_failed_cell(results, variant, turn, every) for variant in VARIANTS),
        ]
        for turn in TABLE_TURNS_DEG
    ]
    note = f"Starts up to {NEAR_M:g} m away. Misled: ICP converged elsewhere."
    return Table(columns, rows, note, sortable=False)


def _failed_cell(results: Results, variant: IcpVariant, turn: float, every: int) -> Cell:
    misled, ran_out = (100 * count_ends(results, variant, key, turn) / every for key in ("misled", "ran_out"))
    return Cell(f"{misled:.0f}, {ran_out:.0f}")


def _summarize(results: Results, trials: int) -> str:
    kept, long = VARIANTS[0], VARIANTS[-1]
    every = trials * sum(distance <= NEAR_M for distance in DISTANCES_M)
    short, more = (100 * count_ends(results, variant, "successes", 45.0) / every for variant in (kept, long))
    right = sum(int(load_successes(results, variant)[-1].sum()) for variant in VARIANTS)
    tried = len(VARIANTS) * len(DISTANCES_M) * trials
    return (
        f"At 45 deg {short:.0f} % of the starts up to {NEAR_M:g} m away succeed within {MAX_ITERATIONS} iterations and "
        f"{more:.0f} % within {MANY_ITERATIONS}: the iteration limit stops more of them than local minima do. At 90 "
        f"deg {right} "
        f"of all {tried} starts succeed: except for the circle, the square looks the same."
    )


def _share_cell(count: int, trials: int) -> Cell:
    share = wilson_interval(count, trials)
    return Cell(f"{100 * share.value:.0f} ({100 * share.low:.0f} to {100 * share.high:.0f})", sort=share.value)


def _heat_figure(variant: IcpVariant, counts: Ints, trials: int) -> Figure:
    body = charts.heat(
        100.0 * counts / trials, Axis("distance [m]"), Axis("turn [deg]"), DISTANCES_M, TURNS_DEG,
        Axis("success [%]", low=0.0, high=100.0), printed=lambda value: f"{value:.0f}",
    )  # fmt: skip
    return Figure(body, f"{variant.title[0].upper()}{variant.title[1:]}", f"Success in % of {trials} starts per cell.")


def _name(variant: IcpVariant, turn: float) -> str:
    return f"basin {variant.name} {turn:g}"
