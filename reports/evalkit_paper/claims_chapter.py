"""Chapter on claims that no other chapter measures: loops, moving people, artefacts of the map, short range, cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Cell, Column, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve
from evalkit.report.html.method_colours import BAR, Stroke
from evalkit_paper import long_drives, verdicts
from evalkit_paper.chapter import Case, Chapter, Finding, Judgement, Results, Settings

LOOPS, CHANGES = "loops-of-moderate-length", "maps-under-changes"
WORLDS = ("lab", "loop")
MARKS = 48
MAP_SCANS = 200
METRICS = ("ate_rmse_m", "map_f1", "map_precision", "map_entropy")
USES = ("evalkit_baselines.paper", "evalkit_baselines.embedded", "evalkit_datasets.worlds.synthetic")
FASTEST_HZ = 15.0
"""Highest rate of the paper's lidar."""


WHEELS = "wheel odometry alone"
PRINTED = "the paper's ICP, eq. 5 as printed"
READING = "the paper's ICP as in Table 1"
ENTRIES = (
    Case(WHEELS, "wheel-odometry"),
    Case(PRINTED, "paper-literal"),
    Case(READING, "embedded"),
    Case("the same with epsilon 1e-6", "embedded", {"epsilon": 1e-6}),
)
"""'embedded' is the compiled form of 'paper'; the chapter on the study measures their difference."""


PLAIN = Case("nothing changed", "embedded")
CROWD = Case("10 people", "embedded", sequence={"people": 10})
NO_FILTER = Case("outliers kept", "embedded", parameters={"max_correspondence_m": 0.0})
LOCAL = Case("local radius of 8 m", "embedded", parameters={"local_radius_m": 8.0})
ODOMETRY = Case(WHEELS, "wheel-odometry")
CHANGED = (
    PLAIN, *(Case(f"{people} people", "embedded", sequence={"people": people}) for people in (2, 5)), CROWD, NO_FILTER,
    LOCAL, ODOMETRY,
)  # fmt: skip

PARAMETERS = (
    Parameter("seeds", 3, "", "repetitions with other noise", low=1, high=50),
    Parameter("laps", 4.0, "", "laps of one long drive", low=1.0, high=50.0),
    Parameter("map_seeds", 8, "", "repetitions of the drives of the maps", low=3, high=50),
    Parameter("map_laps", 1.0, "", "laps of the drives of the maps", low=0.1, high=10.0),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Tasks: a long drive for every method, world and seed, drives with changes, and the time of a map update."""
    long = [
        make_task(
            _drive_name(entry.name, world, seed), long_drives.error_over_path, backend=entry.backend,
            parameters=dict(entry.parameters), world=world, seed=seed, laps=settings["laps"], marks=MARKS,
        ).depending_on(*USES)
        for entry in ENTRIES for world in WORLDS for seed in _seeds(settings)
    ]  # fmt: skip
    changed = [
        make_task(
            _change_name(change, seed), long_drives.score_drive, backend=change.backend,
            parameters=dict(change.parameters), world="lab", scans=MAP_SCANS, wanted=list(METRICS),
            drive={"seed": seed, "laps": settings["map_laps"], **change.sequence},
        ).depending_on(*USES)
        for change in CHANGED for seed in range(settings["map_seeds"])
    ]  # fmt: skip
    updates = make_task("map updates", long_drives.time_map_updates, mappers=["log-odds", "embedded-log-odds"])
    return (*long, *changed, updates.depending_on(*USES))


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Sections: error over path length, and effect of the changes on the map."""
    return (_loop_section(settings, results), _change_section(settings, results))


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on drift over loops, contributions 1 and 2, artefacts, and moving people."""
    first = {entry.name: _errors_after_one_lap(settings, results, entry.name) for entry in ENTRIES}
    text = "; ".join(f"{label}: {_format_range(values)} %" for label, values in first.items())
    updates = results["map updates"]
    slowest = max(updates.values())
    return (
        Finding(
            "Drift remains limited for loops of moderate length", "no figure is given",
            f"position error after one lap in % of the path, over worlds and seeds: {text}",
            verdicts.judge_loops(float(first[PRINTED].max()), float(first[READING].max()),
                                 "the error of the stop rule is the mean distance, as in Table 1"),
            LOOPS,
        ),
        Finding(
            "Contribution 1: ICP tuned for short range", "no figure is given",
            f"{_describe(settings, results, PLAIN, 'ate_rmse_m')} in a room of 10 m, "
            f"{_describe(settings, results, ODOMETRY, 'ate_rmse_m')} along wheel odometry",
            _compare(settings, results, ODOMETRY, PLAIN, "ate_rmse_m", "a smaller ATE than wheel odometry"), CHANGES,
        ),
        Finding(
            "Contribution 2: light log-odds update", "no figure is given",
            "CPU time per scan: " + ", ".join(f"{name} {value:.2f} ms" for name, value in updates.items()),
            verdicts.judge_light(slowest, 1000.0 / FASTEST_HZ), CHANGES,
        ),
        *(
            Finding(
                item, "no figure is given",
                f"true share of the mapped walls: {_describe(settings, results, with_, 'map_precision')} with, "
                f"{_describe(settings, results, without, 'map_precision')} without",
                _compare(settings, results, with_, without, "map_precision", "a larger share of true walls"), CHANGES,
            )
            for item, with_, without in (
                ("Filtering outliers reduces artefacts of the map", PLAIN, NO_FILTER),
                ("A local radius reduces artefacts of the map", LOCAL, PLAIN),
            )
        ),
        Finding(
            "Dynamic objects are a limit", "named, no figure is given",
            f"ATE RMSE {_describe(settings, results, CROWD, 'ate_rmse_m')} with 10 people in the lab, "
            f"{_describe(settings, results, PLAIN, 'ate_rmse_m')} without; map F1 "
            f"{_describe(settings, results, CROWD, 'map_f1')} against {_describe(settings, results, PLAIN, 'map_f1')}",
            _compare(settings, results, PLAIN, CROWD, "map_f1", "a worse map among 10 people"), CHANGES,
        ),
    )  # fmt: skip


def _loop_section(settings: Settings, results: Results) -> Section:
    figures = Figures([_growth_figure(settings, results, world) for world in WORLDS])
    rows: list[tuple[Cell | str, ...]] = [
        (entry.name, world, *_loop_row(settings, results, entry.name, world)) for world in WORLDS for entry in ENTRIES
    ]
    columns = (
        "Method", "World", Column("After one lap", "m", number=True), Column("of the path", "%", number=True),
        Column("At the end", "m", number=True), Column("of the path", "%", number=True),
        Column("Growth exponent", number=True, tip="slope of log error over log path length, from one lap on"),
    )  # fmt: skip
    text = (
        f"One drive of {settings['laps']:g} laps, {settings['seeds']} seeds. Only the first pose is aligned: the "
        "position error is what the robot is off by when it returns to a place. Values are medians over the seeds."
    )
    return Section("Loops of moderate length", (Text(text), figures, Table(columns, rows)), LOOPS)


def _growth_figure(settings: Settings, results: Results, world: str) -> Figure:
    curves = []
    for number, entry in enumerate(ENTRIES):
        way, off = _load_errors(settings, results, entry.name, world)
        stroke = Stroke(BAR, (4.0, 2.0)) if entry.name == WHEELS else charts.stroke(number - 1)
        curves.append(Curve(entry.name, way, np.median(off, axis=0), off.min(axis=0), off.max(axis=0), stroke))
    lap_m = float(curves[0].x[-1] / settings["laps"])
    spans = [charts.ShadedSpan(lap_m, lap_m, "one lap", "#59636e")]
    drawn = charts.lines(curves, Axis("path length [m]", low=0.0), Axis("position error [m]", "log"), spans)
    return Figure(drawn, f"Error over path length, {world}", "Median over the seeds, bands: minimum to maximum.")


def _loop_row(settings: Settings, results: Results, label: str, world: str) -> tuple[Cell, ...]:
    way, off = _load_errors(settings, results, label, world)
    lap_m, middle = way[-1] / settings["laps"], np.median(off, axis=0)
    after = float(np.median(_after_one_lap(settings, way, off)))
    later = way >= lap_m
    logs = np.log(way[later]), np.log(np.maximum(middle[later], 1e-6))
    power = float(np.polyfit(*logs, 1)[0]) if later.sum() > 2 else None
    return (
        Cell(f"{after:.3f}", after),
        Cell(f"{100.0 * after / lap_m:.2f}", after / lap_m),
        Cell(f"{middle[-1]:.3f}", float(middle[-1])),
        Cell(f"{100.0 * middle[-1] / way[-1]:.2f}", float(middle[-1] / way[-1])),
        Cell("-" if power is None else f"{power:.1f}", power),
    )


def _change_section(settings: Settings, results: Results) -> Section:
    rows: list[tuple[Cell | str, ...]] = [
        (change.name, *(_range_cell(_values(settings, results, change, name)) for name in METRICS))
        for change in CHANGED
    ]  # fmt: skip
    columns = (
        "Changed", Column("ATE RMSE", "m", number=True), Column("map F1 at 10 cm", number=True),
        Column("wall precision at 10 cm", number=True), Column("map entropy", "nat", number=True),
    )  # fmt: skip
    text = (
        "The paper's ICP as in Table 1, in the lab; one thing is changed in each row. People are discs of 0.25 m "
        f"radius that walk at 1 m/s. Median over {settings['map_seeds']} seeds, minimum and maximum in brackets. The "
        "text gives neither the limit of its outlier filter nor its local radius; here outliers are pairs beyond 0.3 m."
    )
    return Section("Maps under changes", (Text(text), Table(columns, rows)), CHANGES)


def _errors_after_one_lap(settings: Settings, results: Results, label: str) -> Floats:
    """Error after one lap in percent of the path, for every world and seed."""
    found = []
    for world in WORLDS:
        way, off = _load_errors(settings, results, label, world)
        found.append(100.0 * _after_one_lap(settings, way, off) / (way[-1] / settings["laps"]))
    return np.concatenate(found)


def _after_one_lap(settings: Settings, way: Floats, off: Floats) -> Floats:
    """Error (S,) in metres after exactly one lap, between the marks on either side."""
    return np.array([np.interp(way[-1] / settings["laps"], way, own) for own in off])


def _load_errors(settings: Settings, results: Results, label: str, world: str) -> tuple[Floats, Floats]:
    """Path length (K,) and position error (seeds, K), both in metres."""
    own = [results[_drive_name(label, world, seed)] for seed in _seeds(settings)]
    return np.asarray(own[0]["path_m"]), np.stack([one["end_m"] for one in own])


def _values(settings: Settings, results: Results, change: Case, name: str) -> Floats:
    found = [results[_change_name(change, seed)]["scores"][name] for seed in range(settings["map_seeds"])]
    return np.array([np.nan if value is None else value for value in found])


def _compare(settings: Settings, results: Results, high: Case, low: Case, name: str, what: str) -> Judgement:
    """Whether a value is higher with one change than with the other."""
    one, other = (_values(settings, results, change, name) for change in (high, low))
    return verdicts.judge_difference((one - other).tolist(), what)


def _describe(settings: Settings, results: Results, change: Case, name: str) -> str:
    unit = " m" if name.endswith("_m") else ""
    return f"{np.median(_values(settings, results, change, name)):.3f}{unit}"


def _range_cell(values: Floats) -> Cell:
    middle = float(np.median(values))
    return Cell(f"{middle:.3f} ({values.min():.3f} to {values.max():.3f})", middle)


def _format_range(values: Floats) -> str:
    return f"{np.median(values):.2f} ({values.min():.2f} to {values.max():.2f})"


def _seeds(settings: Settings) -> Sequence[int]:
    return range(int(settings["seeds"]))


def _drive_name(label: str, world: str, seed: int) -> str:
    return f"{label} | {world} | {seed}"


def _change_name(change: Case, seed: int) -> str:
    return f"{change.name} | {seed}"


CHAPTER = Chapter("claims", PARAMETERS, tasks, sections, findings)
