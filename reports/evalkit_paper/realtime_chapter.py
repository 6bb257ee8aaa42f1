"""Chapter on real time: scans that slower devices drop, the effect on drift, and the breaking point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.commands.realtime import simulation
from evalkit.commands.realtime.virtual_clock import BreakingRule, find_breaking_factor
from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve
from evalkit.report.html.method_colours import BAR, Stroke
from evalkit_paper import verdicts
from evalkit_paper.chapter import Case, Chapter, Finding, Results, Settings

ANCHOR = "real-time"
WHEELS = "wheel-odometry"
MAIN = "embedded"
RULE = BreakingRule()


@dataclass(frozen=True, eq=False)
class Ladder:
    """Rungs of one method at one rate, for all seeds and factors."""

    label: str
    rate_hz: float
    results: Sequence[Result]

    @property
    def rungs(self) -> list[list[Mapping[str, Any]]]:
        """Rungs (S, K); the first of each seed is for a device that takes no time."""
        return [result["devices"] for result in self.results]

    @property
    def factors(self) -> Floats:
        """Device factors (K,), 0 first."""
        return np.array([rung["factor"] for rung in self.rungs[0]])

    def values(self, *path: str) -> Floats:
        """One value of every rung (S, K); nan if missing."""
        return np.array([[_at(rung, path) for rung in own] for own in self.rungs], dtype=np.float64)

    def broken(self) -> list[bool]:
        """Whether each rung is broken: the median over the seeds is, or most seeds are lost."""
        ate = self.values("at_hand", "ate_rmse_m")
        lost = np.array([[bool(rung["lost"]) for rung in own] for own in self.rungs])
        middle = np.median(np.where(np.isfinite(ate) & ~lost, ate, np.inf), axis=0)
        return [RULE.is_broken(value if np.isfinite(value) else None, float(middle[0])) for value in middle.tolist()]

    def breaks_at(self) -> float | None:
        """Smallest factor that is broken."""
        return find_breaking_factor(self.factors.tolist(), self.broken())

    def rung(self, factor: float) -> int:
        """Index of a factor."""
        return int(np.flatnonzero(self.factors == factor)[0])

    @property
    def headroom(self) -> float:
        """Largest factor at which no scan of any seed is late."""
        return min(float(result["headroom"]) for result in self.results)

    @property
    def costs_ms(self) -> Floats:
        """Measured cost (ms) of all scans of all seeds."""
        return np.asarray(np.concatenate([result["costs_ns"] for result in self.results]) * 1e-6)


def _at(rung: Mapping[str, Any], path: Sequence[str]) -> float:
    value: Any = rung
    for name in path:
        value = value[name]
    return float("nan") if value is None else float(value)


UNBRIDGED = "unbridged"
"""Mark of the cases whose dropped scans wheel odometry does not bridge."""

ENTRIES = (
    *(Case(name, name) for name in ("paper", "embedded", "embedded-f32", "embedded-pipeline")),
    Case("embedded, no odometry", "embedded", {"prior": "constant-velocity"}, mark=UNBRIDGED),
    *(Case(name, name) for name in ("open3d-icp", "kiss-icp", "small-gicp", WHEELS)),
)
OWN = tuple(entry.name for entry in ENTRIES if entry.backend.startswith(("paper", "embedded", WHEELS)))
"""Methods without third-party libraries, for the quick page."""

PARAMETERS = (
    Parameter("world", "lab", "", "world of the drives"),
    Parameter("seeds", 2, "", "repetitions with other noise", low=1, high=20),
    Parameter("laps", 0.6, "", "laps; on a longer drive the odometry drifts further", low=0.05, high=3.0),
    Parameter("repetitions", 2, "", "measurements per scan; the median is used", low=1, high=20),
    Parameter("rates_hz", "5,10,15", "Hz", "rates of the lidar", choices=("5,10,15", "10")),
    Parameter("methods", "all", "", "all, or only those without third-party libraries", choices=("all", "own")),
    Parameter("largest_factor", 5000, "", "slowest device simulated", low=10, high=1_000_000),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """One job for every method, rate and seed: its costs here, and its ladder of device factors."""
    return tuple(
        make_task(
            _name(entry.name, rate, seed), simulation.simulate_realtime, backend=entry.backend,
            parameters=dict(entry.parameters), dataset=settings["world"],
            dataset_parameters={"seed": seed, "rate_hz": rate, "laps": settings["laps"]}, factors=_factors(settings),
            repetitions=settings["repetitions"], bridged=entry.mark != UNBRIDGED,
        ).depending_on(registry.plug_in_of("backends", entry.backend).module, "evalkit_datasets.worlds.synthetic")
        for entry in _entries(settings) for rate in _rates(settings) for seed in range(int(settings["seeds"]))
    )  # fmt: skip


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Section: method, costs and breaking points, drift by device factor, and check of the cost model."""
    ladders = _ladders(settings, results)
    blocks: list[Block] = [
        Text(
            "No board is measured. The cost of each scan is measured on one core of this machine and stored; a "
            "virtual clock "
            "then simulates a device that is slower by a factor. It processes one scan at a time; a scan that arrives "
            "meanwhile waits and is replaced by a newer one. Only stored costs are used, so the same page drops the "
            "same scans."
        ),
        Text(
            "A robot needs a pose at every time, not only for answered scans: the pose 'at hand' is the newest result "
            "available when a scan begins, extrapolated to that time by wheel odometry (without odometry: by the "
            f"motion between the last two results). Broken: {RULE}; the median over the seeds decides "
            f"({settings['seeds']}, {settings['laps']:g} laps of the {settings['world']} each)."
        ),
        Text(
            "Costs include the Python code around a back end, except for embedded-pipeline, which is one call per scan "
            "and what a board would run.",
            "note",
        ),
        *_short_drive_warning(ladders),
        _breaking_table(ladders),
        *_drift_figures(settings, ladders),
        *_answered_only_blocks(ladders),
    ]
    return (Section("Real time on slower devices", blocks, ANCHOR),)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Finding on the paper's claim of real time."""
    own = [ladder for ladder in _ladders(settings, results) if ladder.label in ("embedded-pipeline", "paper")]
    text = "; ".join(
        f"{ladder.label} at {ladder.rate_hz:g} Hz: {np.median(ladder.costs_ms):.2f} ms per scan, in time up to factor "
        f"{ladder.headroom:.3g}, {_describe_breaking_point(ladder)}"
        for ladder in own
    )
    return (
        Finding(
            "Real time on the Jetson TX2", "claimed, no times printed", text,
            verdicts.judge_real_time(min(ladder.headroom for ladder in own)), ANCHOR,
        ),
    )  # fmt: skip


CHAPTER = Chapter("realtime", PARAMETERS, tasks, sections, findings)


def _entries(settings: Settings) -> list[Case]:
    return [entry for entry in ENTRIES if settings["methods"] == "all" or entry.name in OWN]


def _rates(settings: Settings) -> list[float]:
    return [float(word) for word in str(settings["rates_hz"]).split(",")]


def _factors(settings: Settings) -> list[float]:
    """Device factors 1, 2, 5, 10, ... up to the largest."""
    largest = float(settings["largest_factor"])
    steps = (step * 10.0**power for power in range(7) for step in (1.0, 2.0, 5.0))
    return [factor for factor in steps if factor <= largest]


def _name(label: str, rate: float, seed: int) -> str:
    return f"{label} {rate:g} Hz seed {seed}"


def _ladders(settings: Settings, results: Results) -> list[Ladder]:
    return [
        Ladder(entry.name, rate, [results[_name(entry.name, rate, s)] for s in range(int(settings["seeds"]))])
        for rate in _rates(settings)
        for entry in _entries(settings)
    ]


def _describe_breaking_point(ladder: Ladder) -> str:
    at = ladder.breaks_at()
    return f"breaks at {at:g}" if at is not None else f"holds up to {ladder.factors[-1]:g}"


def _short_drive_warning(ladders: Sequence[Ladder]) -> list[Block]:
    """Warning if a drive is too short for any bridged method to break."""
    alone = max(float(np.median(_ate(ladder)[:, 0])) for ladder in ladders if ladder.label == WHEELS)
    if alone > RULE.floor_m:
        return []
    text = f"The error of wheel odometry alone is only {100.0 * alone:.1f} cm on these drives: no bridged method can "
    "break."
    return [Text(text, "warn")]


def _ate(ladder: Ladder) -> Floats:
    return ladder.values("at_hand", "ate_rmse_m")


def _breaking_table(ladders: Sequence[Ladder]) -> Table:
    rows = [_breaking_row(ladder) for ladder in ladders if ladder.label != WHEELS]
    columns = (
        "Method", Column("rate", "Hz", number=True), Column("cost, median", "ms", number=True),
        Column("cost, 99 %", "ms", number=True),
        Column("in time up to", "x", number=True, tip="largest factor at which every scan is processed in time"),
        Column("half dropped at", "x", number=True, tip="smallest simulated factor that drops half of the scans or "
        "more"),
        Column("breaks at", "x", number=True), Column("dropped there", "%", number=True),
        Column("age there, 95 %", "s", number=True), Column("ATE without drops", "cm", number=True),
    )  # fmt: skip
    caption = (
        "Costs on one core of this machine, all seeds together. Factors are simulated in 1-2-5 steps; the true value "
        "is between the one shown and the one before."
    )
    return Table(columns, rows, caption)


def _breaking_row(ladder: Ladder) -> list[Cell | str]:
    dropped = np.median(ladder.values("dropped"), axis=0)
    half = find_breaking_factor(ladder.factors.tolist(), (dropped >= 0.5).tolist())
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


def _drift_figures(settings: Settings, ladders: Sequence[Ladder]) -> list[Block]:
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
    scale: charts.AxisKind = "log",
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
    return Figure(svg, title, "Median over the seeds, band: minimum to maximum.")


def _answered_only_blocks(ladders: Sequence[Ladder]) -> list[Block]:
    """Show that scoring only the answered scans hides the effect of dropped scans."""
    chosen = [ladder for ladder in ladders if ladder.rate_hz == 10.0 and ladder.label in (MAIN, "paper", "kiss-icp")]
    curves = []
    for ladder in chosen:
        for words, where in (("at hand", "at_hand"), ("answered scans only", "of_answers")):
            middle = np.median(ladder.values(where, "ate_rmse_m")[:, 1:], axis=0)
            curves.append(Curve(f"{ladder.label}, {words}", ladder.factors[1:], middle, marks=True))
    if not curves:
        return []
    svg = charts.lines(curves, Axis("device factor", "log"), Axis("ATE [m]", "log"))
    text = (
        "Scored by answered scans only, slow devices look good however many scans they drop: the few results are "
        "accurate. The poses in between are not."
    )
    return [Text(text), Figure(svg, "Scoring only answered scans is misleading", "Median over the seeds, 10 Hz.")]
