"""Figures 9 and 10 over a recording with the paper's kind of lidar: no truth, so nothing is scored but by itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from evalkit.core.pose import Pose
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins import registry
from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Curve, Points, Span
from evalkit.report.html.document import Block, Cell, Column, Figure, Figures, Heading, Table, Text
from evalkit_paper import lab_maps, plan_fit, spikes, stage_errors
from evalkit_paper.chapter import Results
from evalkit_paper.lab_maps import Variant
from evalkit_paper.map_pictures import GHOST, PATH, cut, extent, image

RECORDING = "turtlebot4"
TURNING_DPS = 20.0
"""A turn of the recording is marked from here on."""

CALM_DPS = 5.0
DRIVING_MPS = 0.05
UNIQUE = 0.9
"""A second best place that fits this well makes the best one a guess."""

VARIANTS = (lab_maps.ODOMETRY, lab_maps.PAPER, lab_maps.TIGHT)
FLOOR = "floor"
USES = ("evalkit_datasets.recorded", "evalkit_baselines.paper")


def missing() -> str:
    """Why the recording cannot be shown here and how to get it, "" where it can."""
    return registry.dataset(RECORDING).missing()


def jobs() -> tuple[AnyTask, ...]:
    """A map a variant and the floor's; none where the recording is not here."""
    if missing():
        return ()
    maps = (
        make_task(
            name(each), lab_maps.recording, name=RECORDING, backend=each.backend, parameters=dict(each.parameters)
        ).depending_on(*USES)
        for each in VARIANTS
    )
    floor = make_task(FLOOR, lab_maps.floor, name=RECORDING, backend=lab_maps.TIGHT.backend)
    return (*maps, floor.depending_on(*USES))


def name(each: Variant) -> str:
    """What the result of a variant is asked for by."""
    return f"{RECORDING}, {each.name}"


def blocks(results: Results) -> Iterator[Block]:
    """What the recording shows, or how to get it."""
    if name(lab_maps.ODOMETRY) not in results:
        yield Text(f"The recording is not on this machine: {missing()}", "warn")
        return
    yield Text(
        "A TurtleBot 4 with an RPLIDAR, the paper's kind of sensor, drives 8 m of a university floor in 46 s. There is "
        "no true trajectory, so nothing is scored: what can be told without is how the two halves of the drive "
        "contradict each other (hits of one half where the other has cleared the cell and has no wall within 0.1 m)."
    )
    yield _over_time(results[name(lab_maps.PAPER)])
    yield Figures([_map(results[name(each)], each.name) for each in VARIANTS])
    yield _contradictions(results)
    yield from _floor(results[FLOOR])


def turns_told(result: Result) -> str:
    """How many spikes of each stage fall into turns, by the rules of Figure 9; calm is driving straight on."""
    times, yaw = result["times_s"], result["yaw_dps"]
    speeds = np.hypot(*np.diff(result["path"], axis=0, prepend=result["path"][:1]).T) * len(times) / times[-1]
    calm = (yaw < CALM_DPS) & (speeds > DRIVING_MPS)
    turns = spikes.events(times, yaw >= TURNING_DPS)
    told = []
    for stage in stage_errors.STAGES:
        residual = result[stage][:, 0]
        found = spikes.spikes(residual, spikes.band(residual, calm))
        inside = sum(any(spikes.within(spike, times, turn) for turn in turns) for spike in found)
        told.append(f"{inside} of {len(found)} {stage.upper()} spikes")
    return " and ".join(told)


def _over_time(result: Result) -> Figure:
    times, yaw = result["times_s"], result["yaw_dps"]
    spans = [Span(begin, end, "turn") for begin, end in spikes.events(times, yaw >= TURNING_DPS)]
    groups = [
        ([Curve(f"{stage.upper()} residual", times, result[stage][:, 0], stroke=charts.stroke(number))],
         Axis(f"{stage.upper()} [m]", low=0.0))
        for number, stage in enumerate(stage_errors.STAGES)
    ]  # fmt: skip
    groups.append(([Curve("yaw rate", times, yaw, stroke=charts.stroke(2))], Axis("[deg/s]", low=0.0)))
    told = [f"{stage.upper()} {_medians(result, stage)}" for stage in stage_errors.STAGES]
    return Figure(
        charts.panels(groups, Axis("time [s]"), spans, height=1.7),
        "TurtleBot 4: S2S, S2M and yaw rate over time with 'paper', deskewed by odometry",
        f"Medians apart from turns and in turns from {TURNING_DPS:g} deg/s on: {'; '.join(told)}. {turns_told(result)} "
        "fall into turns. Yaw rate by odometry.",
    )  # fmt: skip


def _medians(result: Result, stage: str) -> str:
    turning, known = result["yaw_dps"] >= TURNING_DPS, np.isfinite(result[stage][:, 0])
    parts = [result[stage][known & mask, 0] for mask in (~turning, turning)]
    return " and ".join(f"{np.median(part):.3f} m" if len(part) else "none" for part in parts)


def _map(result: Result, title: str) -> Figure:
    grid = lab_maps.grid_of(result)
    layers = [
        Points("contradicted by the other half", result["places"], GHOST, 1.0, alpha=0.6),
        Points("path", result["path"], PATH, 0.8, joined=True),
    ]
    return Figure(
        charts.picture(image(grid), extent(grid), layers), f"TurtleBot 4 along {title}",
        f"{_share(result):.1f} % of the hits contradicted (red)",
    )  # fmt: skip


def _share(result: Result) -> float:
    return float(100.0 * result["contradicted"] / max(result["hits"], 1))


def _contradictions(results: Results) -> Table:
    columns = (
        "Map drawn along", Column("hits", number=True), Column("contradicted", number=True),
        Column("share", "%", number=True), Column("occupied cells", number=True),
    )  # fmt: skip
    rows: list[Sequence[Cell | str]] = []
    for each in VARIANTS:
        result = results[name(each)]
        numbers: tuple[tuple[Any, str], ...] = (
            (result["hits"], "{:,}"), (result["contradicted"], "{:,}"), (_share(result), "{:.1f}"),
            (lab_maps.grid_of(result).occupied().sum(), "{:,}"),
        )  # fmt: skip
        rows.append((each.name, *(Cell(form.format(value), float(value)) for value, form in numbers)))
    return Table(columns, rows, "The same scans and the same mapper for all.")


def _floor(result: Result) -> Iterator[Block]:
    yield Heading("The map of the floor")
    if "walls" not in result:
        yield Text("The map shipped with the recording is not here (mac_1st_floor_final.pgm and .yaml).", "note")
        return
    yield Text(_placed_told(result))
    grid = lab_maps.grid_of(result)
    layers = [
        Points("walls of the recording's map", result["walls"], GHOST, 1.0, alpha=0.7),
        Points("path", result["path"], PATH, 1.0, joined=True),
    ]
    low, high = result["walls"].min(axis=0) - 1.5, result["walls"].max(axis=0) + 1.5
    left, right, bottom, top = extent(grid)
    window = (max(left, low[0]), min(right, high[0]), max(bottom, low[1]), min(top, high[1]))
    yield Figures([
        Figure(charts.picture(cut(grid, window), window, layers), "The recording's walls laid on the floor map"),
        Figure(charts.picture(image(grid), extent(grid), layers[1:]), "The whole floor, and where the drive was"),
    ])  # fmt: skip


def _placed_told(result: Result) -> str:
    found, odometry = Pose.of(result["pose"]), Pose.of(result["odometry"])
    apart = found.inverse() @ odometry
    place = (
        "the place is told apart from all others"
        if result["rival"] < UNIQUE
        else "the place is a guess, and only shown"
    )
    return (
        "The recording comes with a map of its floor; how their frames relate is not documented. The map along "
        f"'{lab_maps.TIGHT.name}' was tried on it everywhere and at every {plan_fit.STEP_DEG:g} deg, then fitted by "
        "ICP: "
        f"its walls lie {result['mean_m']:.2f} m from the floor's on average, {100.0 * result['within']:.0f} % of them "
        f"within {plan_fit.WITHIN_M:g} m, with the start at ({found.x:.2f}, {found.y:.2f}) m and "
        f"{np.degrees(found.theta):.0f} deg. The best place elsewhere fits {100.0 * result['rival']:.0f} % as well: "
        f"{place}. The recording's odometry starts {np.hypot(apart.x, apart.y):.2f} m and "
        f"{abs(np.degrees(apart.theta)):.0f} deg from there in its own frame. Nothing is scored: the floor was "
        "mapped by others at another time."
    )
