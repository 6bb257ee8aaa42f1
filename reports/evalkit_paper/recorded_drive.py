"""Figures 9 and 10 for a recording with the paper's kind of lidar, without ground truth."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from evalkit.core.pose import Pose
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins import registry
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Heading, Table, Text
from evalkit.report.html.charts import Axis, Curve, Points, ShadedSpan
from evalkit_paper import lab_maps, plan_fit, spikes, stage_errors
from evalkit_paper.chapter import Case, Results
from evalkit_paper.map_pictures import GHOST, PATH, crop_image, render_image

RECORDING = "turtlebot4"
TURNING_DPS = 20.0
"""Yaw rate (deg/s) from which a turn of the recording is marked."""

CALM_DPS = 5.0
DRIVING_MPS = 0.05
UNIQUE = 0.9
"""Relative fit of the second best place from which the best one counts as ambiguous."""

VARIANTS = (lab_maps.ODOMETRY, lab_maps.PAPER, lab_maps.TIGHT)
FLOOR = "floor"
USES = ("evalkit_datasets.recordings.data_sets", "evalkit_baselines.paper")


def missing() -> str:
    """Why the recording is not available and how to get it; "" if it is available."""
    return registry.dataset(RECORDING).missing()


def tasks() -> tuple[AnyTask, ...]:
    """A map for each variant and the map of the floor; none if the recording is not available."""
    if missing():
        return ()
    maps = (
        make_task(
            result_name(each),
            lab_maps.map_recording,
            name=RECORDING,
            backend=each.backend,
            parameters=dict(each.parameters),
        ).depending_on(*USES)
        for each in VARIANTS
    )
    floor = make_task(FLOOR, lab_maps.fit_recording_on_floor, name=RECORDING, backend=lab_maps.TIGHT.backend)
    return (*maps, floor.depending_on(*USES))


def result_name(each: Case) -> str:
    """Name of the result of a variant."""
    return f"{RECORDING}, {each.name}"


def blocks(results: Results) -> Iterator[Block]:
    """Blocks on the recording, or how to get it."""
    if result_name(lab_maps.ODOMETRY) not in results:
        yield Text(f"The recording is not available on this machine: {missing()}", "warn")
        return
    yield Text(
        "A TurtleBot 4 with an RPLIDAR, the paper's kind of sensor, drives 8 m of a university floor in 46 s. There is "
        "no ground truth, so nothing is scored. What can be measured without it is how far the two halves of the drive "
        "contradict each other: hits of one half in cells that the other half has cleared, with no wall within 0.1 m."
    )
    yield _residual_figure(results[result_name(lab_maps.PAPER)])
    yield Figures([_map_figure(results[result_name(each)], each.name) for each in VARIANTS])
    yield _contradiction_table(results)
    yield from _floor_blocks(results[FLOOR])


def count_spikes_in_turns(result: Result) -> str:
    """Count the spikes of each stage that fall into turns, by the rules of Figure 9; calm means driving straight."""
    times, yaw = result["times_s"], result["yaw_dps"]
    speeds = np.hypot(*np.diff(result["path"], axis=0, prepend=result["path"][:1]).T) * len(times) / times[-1]
    calm = (yaw < CALM_DPS) & (speeds > DRIVING_MPS)
    turns = spikes.find_events(times, yaw >= TURNING_DPS)
    texts = []
    for stage in stage_errors.STAGES:
        residual = result[stage][:, 0]
        found = spikes.find_spikes(residual, spikes.compute_band(residual, calm))
        inside = sum(any(spikes.belongs_to(spike, times, turn) for turn in turns) for spike in found)
        texts.append(f"{inside} of {len(found)} {stage.upper()} spikes")
    return " and ".join(texts)


def _residual_figure(result: Result) -> Figure:
    times, yaw = result["times_s"], result["yaw_dps"]
    spans = [ShadedSpan(begin, end, "turn") for begin, end in spikes.find_events(times, yaw >= TURNING_DPS)]
    groups = [
        ([Curve(f"{stage.upper()} residual", times, result[stage][:, 0], stroke=charts.stroke(number))],
         Axis(f"{stage.upper()} [m]", low=0.0))
        for number, stage in enumerate(stage_errors.STAGES)
    ]  # fmt: skip
    groups.append(([Curve("yaw rate", times, yaw, stroke=charts.stroke(2))], Axis("[deg/s]", low=0.0)))
    texts = [f"{stage.upper()} {_describe_medians(result, stage)}" for stage in stage_errors.STAGES]
    return Figure(
        charts.panels(groups, Axis("time [s]"), spans, height=1.7),
        "TurtleBot 4: S2S, S2M and yaw rate over time with 'paper', deskewed by odometry",
        f"Medians outside turns and in turns from {TURNING_DPS:g} deg/s: {'; '.join(texts)}. "
        f"{count_spikes_in_turns(result)} fall into turns. Yaw rate by odometry.",
    )  # fmt: skip


def _describe_medians(result: Result, stage: str) -> str:
    turning, known = result["yaw_dps"] >= TURNING_DPS, np.isfinite(result[stage][:, 0])
    parts = [result[stage][known & mask, 0] for mask in (~turning, turning)]
    return " and ".join(f"{np.median(part):.3f} m" if len(part) else "none" for part in parts)


def _map_figure(result: Result, title: str) -> Figure:
    grid = lab_maps.grid_of(result)
    layers = [
        Points("contradicted by the other half", result["places"], GHOST, 1.0, alpha=0.6),
        Points("path", result["path"], PATH, 0.8, joined=True),
    ]
    return Figure(
        charts.picture(render_image(grid), grid.extent, layers), f"TurtleBot 4 along {title}",
        f"{_contradicted_percent(result):.1f} % of the hits contradicted (red)",
    )  # fmt: skip


def _contradicted_percent(result: Result) -> float:
    return float(100.0 * result["contradicted"] / max(result["hits"], 1))


def _contradiction_table(results: Results) -> Table:
    columns = (
        "Map along", Column("hits", number=True), Column("contradicted", number=True),
        Column("share", "%", number=True), Column("occupied cells", number=True),
    )  # fmt: skip
    rows: list[Sequence[Cell | str]] = []
    for each in VARIANTS:
        result = results[result_name(each)]
        numbers: tuple[tuple[Any, str], ...] = (
            (result["hits"], "{:,}"), (result["contradicted"], "{:,}"), (_contradicted_percent(result), "{:.1f}"),
            (lab_maps.grid_of(result).occupied().sum(), "{:,}"),
        )  # fmt: skip
        rows.append((each.name, *(Cell(form.format(value), float(value)) for value, form in numbers)))
    return Table(columns, rows, "The same scans and the same mapper for all.")


def _floor_blocks(result: Result) -> Iterator[Block]:
    yield Heading("The map of the floor")
    if "walls" not in result:
        yield Text("The map of the recording is not available (mac_1st_floor_final.pgm and .yaml).", "note")
        return
    yield Text(_describe_place(result))
    grid = lab_maps.grid_of(result)
    layers = [
        Points("walls of the recording's map", result["walls"], GHOST, 1.0, alpha=0.7),
        Points("path", result["path"], PATH, 1.0, joined=True),
    ]
    low, high = result["walls"].min(axis=0) - 1.5, result["walls"].max(axis=0) + 1.5
    left, right, bottom, top = grid.extent
    window = (max(left, low[0]), min(right, high[0]), max(bottom, low[1]), min(top, high[1]))
    yield Figures([
        Figure(charts.picture(crop_image(grid, window), window, layers), "The recording's walls on the floor map"),
        Figure(charts.picture(render_image(grid), grid.extent, layers[1:]), "The whole floor with the drive"),
    ])  # fmt: skip


def _describe_place(result: Result) -> str:
    found, odometry = Pose.of(result["pose"]), Pose.of(result["odometry"])
    apart = found.inverse() @ odometry
    place = "the place is unambiguous" if result["rival"] < UNIQUE else "the place is ambiguous and only shown"
    return (
        "The recording comes with a map of its floor; the transform between their frames is not documented. The map "
        f"along '{lab_maps.TIGHT.name}' was placed on it everywhere and at every {plan_fit.STEP_DEG:g} deg, then "
        f"fitted by ICP: its walls are {result['mean_m']:.2f} m from those of the floor on average, "
        f"{100.0 * result['within']:.0f} % of them within {plan_fit.WITHIN_M:g} m, with the start at "
        f"({found.x:.2f}, {found.y:.2f}) m and {np.degrees(found.theta):.0f} deg. The next best place reaches "
        f"{100.0 * result['rival']:.0f} % of its score: {place}. The recording's odometry starts "
        f"{np.hypot(apart.x, apart.y):.2f} m and {abs(np.degrees(apart.theta)):.0f} deg from there in its own frame. "
        "Nothing is scored: the floor map was made by others at another time."
    )
