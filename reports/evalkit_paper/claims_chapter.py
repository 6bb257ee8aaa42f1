"""Chapter on claims that no other chapter measures: drift on loops of moderate length, and stated limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html import charts
from evalkit.report.html.blocks import Cell, Column, Figure, Figures, Section, Table, Text
from evalkit.report.html.charts import Axis, Curve
from evalkit.report.html.palette import BAR, Stroke
from evalkit_paper import long_drives
from evalkit_paper.chapter import Chapter, Finding, Results, Settings, Verdict

ANCHOR, CROWD = "loops-of-moderate-length", "dynamic-objects"
WORLDS = ("lab", "loop")
MARKS = 48
LIMITED_PERCENT = 1.0
"""Drift that counts as limited: percent of the path after one lap, in every repetition."""

CROWDS = (0, 2, 5, 10)
MAP_SCANS = 200
CROWD_METRICS = ("ate_rmse_m", "map_f1", "map_entropy")
USES = ("evalkit_baselines.paper", "evalkit_baselines.embedded", "evalkit_datasets.synthetic")


@dataclass(frozen=True)
class LabelledMethod:
    """A method under a label."""

    label: str
    backend: str
    parameters: Mapping[str, Value]


WHEELS = "wheel odometry alone"
READING = "the paper's ICP as in Table 1"
ENTRIES = (
    LabelledMethod(WHEELS, "wheel-odometry", {}),
    LabelledMethod("the paper's ICP, eq. 5 as printed", "paper-literal", {}),
    LabelledMethod(READING, "embedded", {}),
    LabelledMethod("the same with epsilon 1e-6", "embedded", {"epsilon": 1e-6}),
)
"""'embedded' is the compiled form of 'paper'; the chapter on the study measures their difference."""

PARAMETERS = (
    Parameter("seeds", 3, "", "repetitions with other noise", low=1, high=50),
    Parameter("laps", 4.0, "", "laps of one drive", low=0.2, high=50.0),
    Parameter("crowd_laps", 1.0, "", "laps of a drive among people", low=0.1, high=10.0),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Tasks: a long drive for every method, world and seed, and drives among people."""
    long = [
        make_task(
            _drive_name(entry.label, world, seed), long_drives.error_over_path, backend=entry.backend,
            parameters=dict(entry.parameters), world=world, seed=seed, laps=settings["laps"], marks=MARKS,
        ).depending_on(*USES)
        for entry in ENTRIES for world in WORLDS for seed in _seeds(settings)
    ]  # fmt: skip
    among = [
        make_task(
            _crowd_name(people, seed), long_drives.metrics_among_people, backend="embedded", parameters={},
            world="lab", seed=seed, laps=settings["crowd_laps"], people=people, scans=MAP_SCANS,
            wanted=list(CROWD_METRICS),
        ).depending_on(*USES)
        for people in CROWDS for seed in _seeds(settings)
    ]  # fmt: skip
    return (*long, *among)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Sections: error over path length, and effect of people."""
    return (_loop_section(settings, results), _people_section(settings, results))


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the claim about loops and on the limits that the paper names."""
    first = {entry.label: _errors_after_one_lap(settings, results, entry.label) for entry in ENTRIES}
    told = "; ".join(f"{label}: {_format_range(values)} %" for label, values in first.items())
    alone, most = (_load_crowd_scores(settings, results, people) for people in (CROWDS[0], CROWDS[-1]))
    return (
        Finding(
            "Drift remains limited for loops of moderate length",
            "no figure is given",
            f"position error after one lap in % of the path, over worlds and seeds: {told}",
            _verdict(first),
            f"limited is read as at most {LIMITED_PERCENT:g} % of one lap in every repetition; without loop closure "
            "the drift keeps growing",
            ANCHOR,
        ),
        Finding(
            "Dynamic objects are a limit",
            "named, no figure is given",
            f"with {CROWDS[-1]} people in the lab ATE RMSE {_median(most, 'ate_rmse_m'):.3f} m against "
            f"{_median(alone, 'ate_rmse_m'):.3f} m without people, map F1 {_median(most, 'map_f1'):.3f} against "
            f"{_median(alone, 'map_f1'):.3f}",
            "not determined by the text",
            "number, distance and speed of people are not stated; here they are discs of 0.25 m radius that walk at 1 "
            "m/s",
            CROWD,
        ),
    )


def _loop_section(settings: Settings, results: Results) -> Section:
    figures = Figures([_growth_figure(settings, results, world) for world in WORLDS])
    rows: list[tuple[Cell | str, ...]] = [
        (entry.label, world, *_loop_row(settings, results, entry.label, world)) for world in WORLDS for entry in ENTRIES
    ]
    columns = (
        "Method", "World", Column("After one lap", "m", number=True), Column("of the path", "%", number=True),
        Column("At the end", "m", number=True), Column("of the path", "%", number=True),
        Column("Growth exponent", number=True, tip="slope of log error over log path length, from one lap on"),
    )  # fmt: skip
    return Section(
        "Loops of moderate length",
        (
            Text(
                f"One drive of {settings['laps']:g} laps, {settings['seeds']} seeds. Only the first pose is aligned: "
                "the "
                "position error is what the robot is off by when it returns to a place. Values are medians over the "
                "seeds."
            ),
            figures,
            Table(columns, rows),
        ),
        ANCHOR,
    )


def _growth_figure(settings: Settings, results: Results, world: str) -> Figure:
    curves = []
    for number, entry in enumerate(ENTRIES):
        way, off = _load_errors(settings, results, entry.label, world)
        stroke = Stroke(BAR, (4.0, 2.0)) if entry.label == WHEELS else charts.stroke(number - 1)
        curves.append(Curve(entry.label, way, np.median(off, axis=0), off.min(axis=0), off.max(axis=0), stroke))
    lap = {"one lap": float(curves[0].x[-1] / settings["laps"])}
    spans = [charts.ShadedSpan(value, value, name, "#59636e") for name, value in lap.items()]
    drawn = charts.lines(curves, Axis("path length [m]", low=0.0), Axis("position error [m]", "log"), spans)
    return Figure(drawn, f"Error over path length, {world}", "Median over the seeds, bands: minimum to maximum.")


def _loop_row(settings: Settings, results: Results, label: str, world: str) -> tuple[Cell, ...]:
    way, off = _load_errors(settings, results, label, world)
    lap, middle = _lap_index(settings, way), np.median(off, axis=0)
    power = (
        float(np.polyfit(np.log(way[lap:]), np.log(np.maximum(middle[lap:], 1e-6)), 1)[0]) if lap < MARKS - 2 else None
    )
    return (
        Cell(f"{middle[lap]:.3f}", float(middle[lap])),
        Cell(f"{100.0 * middle[lap] / way[lap]:.2f}", float(middle[lap] / way[lap])),
        Cell(f"{middle[-1]:.3f}", float(middle[-1])),
        Cell(f"{100.0 * middle[-1] / way[-1]:.2f}", float(middle[-1] / way[-1])),
        Cell("-" if power is None else f"{power:.1f}", power),
    )


def _people_section(settings: Settings, results: Results) -> Section:
    rows: list[tuple[Cell | str, ...]] = []
    for people in CROWDS:
        found = _load_crowd_scores(settings, results, people)
        cells = [_range_cell(found, name) for name in CROWD_METRICS]
        rows.append((str(people), *cells))
    columns = (
        Column("People", number=True), Column("ATE RMSE", "m", number=True),
        Column("map F1 at 10 cm", number=True), Column("map entropy", "nat", number=True),
    )  # fmt: skip
    return Section(
        "Dynamic objects",
        (
            Text(
                f"The paper's ICP as in Table 1, in the lab among people: discs of 0.25 m radius that walk at 1 m/s. "
                f"Median over {settings['seeds']} seeds, minimum and maximum in brackets."
            ),
            Table(columns, rows),
        ),
        CROWD,
    )


def _verdict(first: Mapping[str, Floats]) -> Verdict:
    """Verdict: does the reading that fits Table 1, and does the printed one, drift as little as claimed?"""
    limited = {label: bool((values <= LIMITED_PERCENT).all()) for label, values in first.items()}
    if not limited[READING]:
        return "not determined by the text"
    return "reproduced" if all(limited[entry.label] for entry in ENTRIES[1:]) else "reproduced with a correction"


def _errors_after_one_lap(settings: Settings, results: Results, label: str) -> Floats:
    """Error after one lap in percent of the path, for every world and seed."""
    found = []
    for world in WORLDS:
        way, off = _load_errors(settings, results, label, world)
        lap = _lap_index(settings, way)
        found.append(100.0 * off[:, lap] / way[lap])
    return np.concatenate(found)


def _lap_index(settings: Settings, way: Floats) -> int:
    """Index of the mark after one lap, or of the last mark of a shorter drive."""
    return int(np.argmin(np.abs(way - way[-1] / max(float(settings["laps"]), 1.0))))


def _load_errors(settings: Settings, results: Results, label: str, world: str) -> tuple[Floats, Floats]:
    """Path length (K,) and position error (seeds, K), both in metres."""
    own = [results[_drive_name(label, world, seed)] for seed in _seeds(settings)]
    return np.asarray(own[0]["path_m"]), np.stack([one["end_m"] for one in own])


def _load_crowd_scores(settings: Settings, results: Results, people: int) -> list[Mapping[str, float | None]]:
    return [results[_crowd_name(people, seed)]["scores"] for seed in _seeds(settings)]


def _values(found: list[Mapping[str, float | None]], name: str) -> Floats:
    return np.array([np.nan if (value := scores[name]) is None else value for scores in found])


def _median(found: list[Mapping[str, float | None]], name: str) -> float:
    return float(np.median(_values(found, name)))


def _range_cell(found: list[Mapping[str, float | None]], name: str) -> Cell:
    values = _values(found, name)
    middle = float(np.median(values))
    return Cell(f"{middle:.3f} ({values.min():.3f} to {values.max():.3f})", middle)


def _format_range(values: Floats) -> str:
    return f"{np.median(values):.2f} ({values.min():.2f} to {values.max():.2f})"


def _seeds(settings: Settings) -> range:
    return range(int(settings["seeds"]))


def _drive_name(label: str, world: str, seed: int) -> str:
    return f"{label} | {world} | {seed}"


def _crowd_name(people: int, seed: int) -> str:
    return f"{people} people | {seed}"


CHAPTER = Chapter("claims", PARAMETERS, tasks, sections, findings)
