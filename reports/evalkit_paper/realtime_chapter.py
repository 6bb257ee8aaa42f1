"""The chapter on real time: what slower devices would drop, what that does to the drift, and when it breaks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.realtime import simulation
from evalkit.commands.realtime.virtual_clock import first_broken
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Curve
from evalkit.report.html.document import Block, Cell, Column, Figure, Figures, Fold, Section, Table, Text
from evalkit.report.html.palette import BAR, Stroke
from evalkit_paper.chapter import Chapter, Finding, Results, Settings
from evalkit_paper.device_ladders import RULE, Ladder

ANCHOR = "real-time"
WHEELS = "wheel-odometry"
MAIN = "embedded"
BOTH = ("embedded", "paper")
"""Who is also shown with waiting scans dropped."""


@dataclass(frozen=True)
class Entry:
    """A method under a label; ``bridged``: wheel odometry carries its answers on."""

    label: str
    backend: str
    parameters: Mapping[str, Value]
    uses: str
    bridged: bool = True


ENTRIES = (
    Entry("paper", "paper", {}, "evalkit_baselines.paper"),
    Entry("embedded", "embedded", {}, "evalkit_baselines.embedded"),
    Entry("embedded-f32", "embedded-f32", {}, "evalkit_baselines.embedded"),
    Entry("embedded-pipeline", "embedded-pipeline", {}, "evalkit_baselines.embedded"),
    Entry("embedded, no odometry", "embedded", {"prior": "constant-velocity"}, "evalkit_baselines.embedded", False),
    Entry("open3d-icp", "open3d-icp", {}, "evalkit_baselines.open3d_icp"),
    Entry("kiss-icp", "kiss-icp", {}, "evalkit_baselines.kiss_icp"),
    Entry("small-gicp", "small-gicp", {}, "evalkit_baselines.small_gicp"),
    Entry(WHEELS, WHEELS, {}, "evalkit_baselines.wheel_odometry"),
)
OWN = tuple(entry.label for entry in ENTRIES if entry.backend.startswith(("paper", "embedded", WHEELS)))
"""Those that need no library of others: what the quick page shows."""

PARAMETERS = (
    Parameter("world", "lab", "", "where the robot drives"),
    Parameter("seeds", 2, "", "repetitions with other noise", low=1, high=20),
    Parameter("laps", 0.6, "", "laps driven; the longer, the further the odometry drifts", low=0.05, high=3.0),
    Parameter("repetitions", 2, "", "measurements of a scan; the median counts", low=1, high=20),
    Parameter("rates_hz", "5,10,15", "Hz", "rates of the lidar", choices=("5,10,15", "10")),
    Parameter("methods", "all", "", "all, or only those that need no other library", choices=("all", "own")),
    Parameter("largest_factor", 5000, "", "the slowest device asked", low=10, high=1_000_000),
)


def jobs(settings: Settings) -> tuple[AnyTask, ...]:
    """One job for every method, rate and seed: its costs here, and its ladder of device factors."""
    return tuple(
        make_task(
            _name(entry.label, rate, seed), simulation.paced, backend=entry.backend,
            parameters=dict(entry.parameters), dataset=settings["world"],
            dataset_parameters={"seed": seed, "rate_hz": rate, "laps": settings["laps"]}, factors=_factors(settings),
            policies=["queue-of-one", "drop"] if entry.label in BOTH else ["queue-of-one"],
            repetitions=settings["repetitions"], bridged=entry.bridged,
        ).depending_on(entry.uses, "evalkit_datasets.synthetic")
        for entry in _entries(settings) for rate in _rates(settings) for seed in range(int(settings["seeds"]))
    )  # fmt: skip


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The rule of the game, costs and breaking points, drift against factor, and how far the assumption holds."""
    ladders = _ladders(settings, results)
    blocks: list[Block] = [
        Text(
            "No board is measured and none is claimed. What each scan costs is measured here, on one core, and kept; a "
            "virtual clock then lets a device that takes so many times as long work through the drive. It works on one "
            "scan at a time; a scan that comes meanwhile waits, and a newer one takes its place. Costs come from the "
            "record alone, so the same page drops the same scans."
        ),
        Text(
            "A robot needs a pose for every moment, not only for the scans that were answered: 'at hand' is the newest "
            "answer done by the time a scan begins, carried on to then by the wheel odometry (without odometry: by the "
            f"motion between the last two answers). Broken: {RULE}; the median over the seeds decides "
            f"({settings['seeds']}, {settings['laps']:g} laps of the {settings['world']} each)."
        ),
        Text(
            "Costs hold the Python around a back end, for all but embedded-pipeline, which is one call a scan: that "
            "one is what a board would run.",
            "note",
        ),
        *_out_of_reach(ladders),
        _breaking(ladders),
        *_drift(settings, ladders),
        *_flattered(ladders),
        _policies(settings, results),
        Fold("Is the cost of a scan known when others are dropped?", _assumption(ladders)),
    ]
    return (Section("Real time on slower devices", blocks, ANCHOR),)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """The paper's claim of real time."""
    own = [ladder for ladder in _ladders(settings, results) if ladder.label in ("embedded-pipeline", "paper")]
    told = "; ".join(
        f"{ladder.label} at {ladder.rate_hz:g} Hz: {np.median(ladder.costs_ms):.2f} ms a scan, in time up to factor "
        f"{ladder.headroom:.3g}, {_breaks(ladder)}"
        for ladder in own
    )
    return (
        Finding(
            "Real time on the Jetson TX2", "claimed, no times printed", told, "not reproducible in software",
            "a device cannot be run in software; what is measured is by what factor it may be slower than this machine",
            ANCHOR,
        ),
    )  # fmt: skip


CHAPTER = Chapter("realtime", PARAMETERS, jobs, sections, findings)


def _entries(settings: Settings) -> list[Entry]:
    return [entry for entry in ENTRIES if settings["methods"] == "all" or entry.label in OWN]


def _rates(settings: Settings) -> list[float]:
    return [float(word) for word in str(settings["rates_hz"]).split(",")]


def _factors(settings: Settings) -> list[float]:
    """1, 2, 5, 10, ... up to the largest."""
    largest = float(settings["largest_factor"])
    steps = (step * 10.0**power for power in range(7) for step in (1.0, 2.0, 5.0))
    return [factor for factor in steps if factor <= largest]


def _name(label: str, rate: float, seed: int) -> str:
    return f"{label} {rate:g} Hz seed {seed}"


def _ladders(settings: Settings, results: Results, policy: str = "queue-of-one") -> list[Ladder]:
    return [
        Ladder(entry.label, rate, [results[_name(entry.label, rate, s)] for s in range(int(settings["seeds"]))], policy)
        for rate in _rates(settings)
        for entry in _entries(settings)
        if policy == "queue-of-one" or entry.label in BOTH
    ]


def _breaks(ladder: Ladder) -> str:
    at = ladder.breaks_at()
    return f"breaks at {at:g}" if at is not None else f"holds up to {ladder.factors[-1]:g}"


def _out_of_reach(ladders: Sequence[Ladder]) -> list[Block]:
    """A warning where a drive is too short for anybody who is carried on by the wheels to break."""
    alone = max(float(np.median(_ate(ladder)[:, 0])) for ladder in ladders if ladder.label == WHEELS)
    if alone > RULE.floor_m:
        return []
    told = f"The odometry alone is only {100.0 * alone:.1f} cm off on these drives: with it nobody can break."
    return [Text(told, "warn")]


def _ate(ladder: Ladder) -> Floats:
    return ladder.values("at_hand", "ate_rmse_m")


def _breaking(ladders: Sequence[Ladder]) -> Table:
    rows = [_row(ladder) for ladder in ladders if ladder.label != WHEELS]
    columns = (
        "Method", Column("rate", "Hz", number=True), Column("cost, median", "ms", number=True),
        Column("cost, 99 %", "ms", number=True),
        Column("in time up to", "x", number=True, tip="the largest factor at which every scan is answered in time"),
        Column("half dropped at", "x", number=True, tip="the least factor asked that drops half of the scans or more"),
        Column("breaks at", "x", number=True), Column("dropped there", "%", number=True),
        Column("age there, 95 %", "s", number=True), Column("ATE without drops", "cm", number=True),
    )  # fmt: skip
    caption = (
        "Costs on one core of this machine, all seeds together. Factors are those asked, 1-2-5 steps; the true point "
        "lies between the one named and the one before."
    )
    return Table(columns, rows, caption)


def _row(ladder: Ladder) -> list[Cell | str]:
    dropped = np.median(ladder.values("dropped"), axis=0)
    half = first_broken(ladder.factors.tolist(), (dropped >= 0.5).tolist())
    at = ladder.breaks_at()
    there = None if at is None else ladder.rung(at)
    age = np.median([[rung["age_ms"][1] for rung in own] for own in ladder.rungs], axis=0) * 1e-3
    return [
        Cell(ladder.label),
        f"{ladder.rate_hz:g}",
        f"{np.median(ladder.costs_ms):.2f}",
        f"{np.percentile(ladder.costs_ms, 99):.2f}",
        Cell(f"{ladder.headroom:.3g}", ladder.headroom),
        Cell("-" if half is None else f"{half:g}", half if half is not None else 1e9),
        Cell(f"> {ladder.factors[-1]:g}" if at is None else f"{at:g}", at if at is not None else 1e9),
        "-" if there is None else f"{100.0 * dropped[there]:.0f}",
        "-" if there is None else f"{age[there]:.1f}",
        f"{100.0 * np.median(_ate(ladder)[:, 0]):.1f}",
    ]


def _drift(settings: Settings, ladders: Sequence[Ladder]) -> list[Block]:
    blocks: list[Block] = []
    for rate in _rates(settings):
        own = [ladder for ladder in ladders if ladder.rate_hz == rate]
        wheels = next(ladder for ladder in own if ladder.label == WHEELS)
        alone = float(np.median(_ate(wheels)[:, 0]))
        shown = [ladder for ladder in own if ladder.label != WHEELS]
        figures = [
            _figure(shown, ("at_hand", "ate_rmse_m"), "ATE at hand [m]", f"Drift at {rate:g} Hz", alone),
            _figure(shown, ("at_hand", "rpe_1m_m"), "RPE over 1 m, at hand [m]", f"RPE at {rate:g} Hz"),
            _figure(shown, ("dropped",), "share of scans dropped", f"Dropped scans at {rate:g} Hz", scale="linear"),
        ]  # fmt: skip
        blocks.append(Figures(figures, small=True))
    return blocks


def _figure(
    shown: Sequence[Ladder], path: tuple[str, ...], label: str, title: str, alone: float | None = None,
    scale: charts.Scale = "log",
) -> Figure:  # fmt: skip
    curves = []
    for ladder in shown:
        values, factors = ladder.values(*path)[:, 1:], ladder.factors[1:]
        low, middle, high = (pick(values, axis=0) for pick in (np.min, np.median, np.max))
        curves.append(Curve(ladder.label, factors, middle, low, high, marks=True))
    if alone is not None:
        ends = shown[0].factors[[1, -1]]
        curves.append(Curve("odometry alone", ends, np.full(2, alone), stroke=Stroke(BAR, (4.0, 2.0))))
    levels = {} if alone is None else {f"{100.0 * RULE.floor_m:g} cm": RULE.floor_m}
    svg = charts.lines(curves, Axis("device factor", "log"), Axis(label, scale), levels=levels)
    return Figure(svg, title, "Median over the seeds, least to greatest.")


def _flattered(ladders: Sequence[Ladder]) -> list[Block]:
    """That the answers alone hide what the dropped scans cost."""
    chosen = [ladder for ladder in ladders if ladder.rate_hz == 10.0 and ladder.label in (MAIN, "paper", "kiss-icp")]
    curves = []
    for ladder in chosen:
        for words, where in (("at hand", "at_hand"), ("answers alone", "of_answers")):
            middle = np.median(ladder.values(where, "ate_rmse_m")[:, 1:], axis=0)
            curves.append(Curve(f"{ladder.label}, {words}", ladder.factors[1:], middle, marks=True))
    if not curves:
        return []
    svg = charts.lines(curves, Axis("device factor", "log"), Axis("ATE [m]", "log"))
    told = (
        "Scored by their answers alone, slow devices look fine however many scans they drop: the few answers given are "
        "good. What the robot goes by in between is not."
    )
    return [Text(told), Figure(svg, "Answers alone flatter", "Median over the seeds, 10 Hz.")]


def _policies(settings: Settings, results: Results) -> Table:
    rows = []
    for one, other in zip(
        (ladder for ladder in _ladders(settings, results) if ladder.label in BOTH),
        _ladders(settings, results, "drop"),
        strict=True,
    ):
        for number, factor in enumerate(one.factors.tolist()):
            dropped = [float(np.median(ladder.values("dropped")[:, number])) for ladder in (one, other)]
            if 0.02 < max(dropped) < 0.98:
                ates = [float(np.median(_ate(ladder)[:, number])) for ladder in (one, other)]
                rows.append([one.label, f"{one.rate_hz:g}", f"{factor:g}", *(f"{100.0 * d:.0f}" for d in dropped),
                             *(f"{100.0 * ate:.1f}" for ate in ates)])  # fmt: skip
    columns = (
        "Method", Column("rate", "Hz", number=True), Column("factor", number=True),
        Column("dropped, one waits", "%", number=True), Column("dropped, none waits", "%", number=True),
        Column("ATE, one waits", "cm", number=True), Column("ATE, none waits", "cm", number=True),
    )  # fmt: skip
    return Table(columns, rows, "A scan that finds the robot busy waits for it (the newest one), or is lost.")


def _assumption(ladders: Sequence[Ladder]) -> list[Block]:
    rows = []
    for ladder in ladders:
        linear = [result["linear"] for result in ladder.results if result["linear"] is not None]
        growth = np.mean([result["growth"][-1] for result in ladder.results])
        gap = int(ladder.results[0]["gaps"][-1])
        ratios = ladder.values("predicted")
        factors = ladder.values("dropped")
        apart = ratios[np.isfinite(ratios) & (factors > 0.1)]
        rows.append(
            [
                ladder.label,
                f"{ladder.rate_hz:g}",
                f"{growth:.2f} at {gap}",
                f"{np.mean([fit['base_ns'] for fit in linear]) * 1e-6:.3f}" if linear else "-",
                f"{np.mean([fit['step_ns'] for fit in linear]):.1f}" if linear else "-",
                f"{100.0 * np.mean([fit['residual'] for fit in linear]):.0f}" if linear else "-",
                f"{100.0 * np.mean([fit['held_out'] for fit in linear]):.0f}" if linear else "-",
                f"{np.median(apart):.2f} [{apart.min():.2f}, {apart.max():.2f}]" if len(apart) else "-",
            ]
        )
    columns = (
        "Method", Column("rate", "Hz", number=True), Column("growth at gap", number=True),
        Column("a", "ms", number=True), Column("b", "ns", number=True), Column("off, fitted", "%", number=True),
        Column("off, with gaps", "%", number=True), Column("model / clock", number=True),
    )  # fmt: skip
    return [
        Text(
            "Where scans are dropped the next one has moved further and costs more. So runs that answer only every "
            "2nd, 4th, 8th and 16th scan are measured too, and the clock takes a scan's own cost times the growth for "
            "its gap; beyond 16 it stays. As a check, cost = a + b x iterations x points is fitted to the full run "
            "where a back end tells its iterations: 'off' is the median relative difference, and 'model / clock' the "
            "cost it predicts from the iterations really done with scans dropped, by what the clock assumed: median "
            "and extremes over the rungs with more than 10 % dropped."
        ),
        Table(columns, rows),
    ]
