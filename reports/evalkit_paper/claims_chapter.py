"""The chapter on the paper's claims that no other chapter measures: loops of moderate length, and its stated limits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter, Value
from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Curve
from evalkit.report.html.document import Cell, Column, Figure, Figures, Section, Table, Text
from evalkit.report.html.palette import BAR, Stroke
from evalkit_paper import long_drives
from evalkit_paper.chapter import Chapter, Finding, Results, Settings, Verdict

ANCHOR, CROWD = "loops-of-moderate-length", "dynamic-objects"
WORLDS = ("lab", "loop")
MARKS = 48
LIMITED_PERCENT = 1.0
"""Drift that is called limited: so much of the way at the end of one lap, in every repetition."""

CROWDS = (0, 2, 5, 10)
MAP_SCANS = 200
CROWD_METRICS = ("ate_rmse_m", "map_f1", "map_entropy")
USES = ("evalkit_baselines.paper", "evalkit_baselines.embedded", "evalkit_datasets.synthetic")


@dataclass(frozen=True)
class Entry:
    """A method under a label."""

    label: str
    backend: str
    parameters: Mapping[str, Value]


WHEELS = "wheel odometry alone"
READING = "the paper's ICP, as Table 1 reads"
ENTRIES = (
    Entry(WHEELS, "wheel-odometry", {}),
    Entry("the paper's ICP, eq. 5 as printed", "paper-literal", {}),
    Entry(READING, "embedded", {}),
    Entry("the same, iterated to the end", "embedded", {"epsilon": 1e-6}),
)
"""'embedded' is the compiled twin of 'paper': see the chapter on the study for how equal they are."""

PARAMETERS = (
    Parameter("seeds", 3, "", "repetitions with other noise", low=1, high=50),
    Parameter("laps", 4.0, "", "laps driven without a stop", low=0.2, high=50.0),
    Parameter("crowd_laps", 1.0, "", "laps driven among people", low=0.1, high=10.0),
)


def jobs(settings: Settings) -> tuple[AnyTask, ...]:
    """A long drive for every method, world and seed, and drives among people."""
    long = [
        make_task(
            _long(entry.label, world, seed), long_drives.grown, backend=entry.backend,
            parameters=dict(entry.parameters), world=world, seed=seed, laps=settings["laps"], marks=MARKS,
        ).depending_on(*USES)
        for entry in ENTRIES for world in WORLDS for seed in _seeds(settings)
    ]  # fmt: skip
    among = [
        make_task(
            _among(people, seed), long_drives.crowded, backend="embedded", parameters={}, world="lab", seed=seed,
            laps=settings["crowd_laps"], people=people, scans=MAP_SCANS, wanted=list(CROWD_METRICS),
        ).depending_on(*USES)
        for people in CROWDS for seed in _seeds(settings)
    ]  # fmt: skip
    return (*long, *among)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """How the error grows with the way, and what people do to it."""
    return (_loops(settings, results), _people(settings, results))


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """The claim on loops, and the limits the paper names."""
    first = {entry.label: _after_one_lap(settings, results, entry.label) for entry in ENTRIES}
    told = "; ".join(f"{label}: {_range(values)} %" for label, values in first.items())
    alone, most = (_crowd(settings, results, people) for people in (CROWDS[0], CROWDS[-1]))
    return (
        Finding(
            "Drift remains limited for loops of moderate length",
            "no figure is given",
            f"distance to the truth after one lap, in % of the way, over worlds and seeds: {told}",
            _verdict(first),
            f"limited is read as at most {LIMITED_PERCENT:g} % of one lap in every repetition; without loop closure it "
            "goes on growing",
            ANCHOR,
        ),
        Finding(
            "Dynamic objects are a limit",
            "named, no figure is given",
            f"with {CROWDS[-1]} people in the lab ATE RMSE {_middle(most, 'ate_rmse_m'):.3f} m against "
            f"{_middle(alone, 'ate_rmse_m'):.3f} m with nobody, map F1 {_middle(most, 'map_f1'):.3f} against "
            f"{_middle(alone, 'map_f1'):.3f}",
            "not determined by the text",
            "how many people, how near and how fast is not said; here they are discs of 0.25 m that walk 1 m/s",
            CROWD,
        ),
    )


def _loops(settings: Settings, results: Results) -> Section:
    figures = Figures([_growth(settings, results, world) for world in WORLDS])
    rows: list[tuple[Cell | str, ...]] = [
        (entry.label, world, *_row(settings, results, entry.label, world)) for world in WORLDS for entry in ENTRIES
    ]
    columns = (
        "Method", "World", Column("After one lap", "m", number=True), Column("of the way", "%", number=True),
        Column("At the end", "m", number=True), Column("of the way", "%", number=True),
        Column("Grows as the way to the power", number=True, tip="slope of log error over log way, from one lap on"),
    )  # fmt: skip
    return Section(
        "Loops of moderate length",
        (
            Text(
                f"One drive of {settings['laps']:g} laps without a stop, {settings['seeds']} seeds. The first pose is "
                "aligned and nothing else: the distance to the truth is what the robot is off by when it comes round "
                "again. Values are medians over the seeds."
            ),
            figures,
            Table(columns, rows),
        ),
        ANCHOR,
    )


def _growth(settings: Settings, results: Results, world: str) -> Figure:
    curves = []
    for number, entry in enumerate(ENTRIES):
        way, off = _stacked(settings, results, entry.label, world)
        stroke = Stroke(BAR, (4.0, 2.0)) if entry.label == WHEELS else charts.stroke(number - 1)
        curves.append(Curve(entry.label, way, np.median(off, axis=0), off.min(axis=0), off.max(axis=0), stroke))
    lap = {"one lap": float(curves[0].x[-1] / settings["laps"])}
    spans = [charts.Span(value, value, name, "#59636e") for name, value in lap.items()]
    drawn = charts.lines(curves, Axis("way [m]", low=0.0), Axis("distance to the truth [m]", "log"), spans)
    return Figure(drawn, f"Error over the way, {world}", "Median over the seeds, bands from least to greatest.")


def _row(settings: Settings, results: Results, label: str, world: str) -> tuple[Cell, ...]:
    way, off = _stacked(settings, results, label, world)
    lap, middle = _lap(settings, way), np.median(off, axis=0)
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


def _people(settings: Settings, results: Results) -> Section:
    rows: list[tuple[Cell | str, ...]] = []
    for people in CROWDS:
        found = _crowd(settings, results, people)
        cells = [_spread(found, name) for name in CROWD_METRICS]
        rows.append((str(people), *cells))
    columns = (
        Column("People", number=True), Column("ATE RMSE", "m", number=True),
        Column("map F1 at 10 cm", number=True), Column("map entropy", "nat", number=True),
    )  # fmt: skip
    return Section(
        "Dynamic objects",
        (
            Text(
                f"The paper's ICP as Table 1 reads, in the lab among people: discs of 0.25 m radius that walk 1 m/s. "
                f"Median over {settings['seeds']} seeds, least and greatest in brackets."
            ),
            Table(columns, rows),
        ),
        CROWD,
    )


def _verdict(first: Mapping[str, Floats]) -> Verdict:
    """Whether the reading that fits Table 1, and whether the printed one, drifts as little as is claimed."""
    limited = {label: bool((values <= LIMITED_PERCENT).all()) for label, values in first.items()}
    if not limited[READING]:
        return "not determined by the text"
    return "reproduced" if all(limited[entry.label] for entry in ENTRIES[1:]) else "reproduced with a correction"


def _after_one_lap(settings: Settings, results: Results, label: str) -> Floats:
    """The error after one lap in percent of the way, for every world and seed."""
    found = []
    for world in WORLDS:
        way, off = _stacked(settings, results, label, world)
        lap = _lap(settings, way)
        found.append(100.0 * off[:, lap] / way[lap])
    return np.concatenate(found)


def _lap(settings: Settings, way: Floats) -> int:
    """The mark at which one lap is done, or the last of a shorter drive."""
    return int(np.argmin(np.abs(way - way[-1] / max(float(settings["laps"]), 1.0))))


def _stacked(settings: Settings, results: Results, label: str, world: str) -> tuple[Floats, Floats]:
    """The way (K,) and the distance to the truth (seeds, K)."""
    own = [results[_long(label, world, seed)] for seed in _seeds(settings)]
    return np.asarray(own[0]["path_m"]), np.stack([one["end_m"] for one in own])


def _crowd(settings: Settings, results: Results, people: int) -> list[Mapping[str, float | None]]:
    return [results[_among(people, seed)]["scores"] for seed in _seeds(settings)]


def _values(found: list[Mapping[str, float | None]], name: str) -> Floats:
    return np.array([np.nan if (value := scores[name]) is None else value for scores in found])


def _middle(found: list[Mapping[str, float | None]], name: str) -> float:
    return float(np.median(_values(found, name)))


def _spread(found: list[Mapping[str, float | None]], name: str) -> Cell:
    values = _values(found, name)
    middle = float(np.median(values))
    return Cell(f"{middle:.3f} ({values.min():.3f} to {values.max():.3f})", middle)


def _range(values: Floats) -> str:
    return f"{np.median(values):.2f} ({values.min():.2f} to {values.max():.2f})"


def _seeds(settings: Settings) -> range:
    return range(int(settings["seeds"]))


def _long(label: str, world: str, seed: int) -> str:
    return f"{label} | {world} | {seed}"


def _among(people: int, seed: int) -> str:
    return f"{people} people | {seed}"


CHAPTER = Chapter("claims", PARAMETERS, jobs, sections, findings)
