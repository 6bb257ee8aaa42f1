"""Figure 10: maps beside the true floor plan with their faults marked, in simulation and for a recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from evalkit.core.grid import OccupancyGrid
from evalkit.execution.task import AnyTask, Result, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Heading, Section, Table, Text
from evalkit.report.html.charts import Points
from evalkit_paper import lab_maps, map_faults, recorded_drive, verdicts
from evalkit_paper.chapter import Chapter, Finding, Results, Settings
from evalkit_paper.map_pictures import GHOST, MISSING, PATH, SMEAR, TRUE, render_image

ANCHOR = "figure-10"
VARIANTS = (lab_maps.ODOMETRY, lab_maps.LITERAL, lab_maps.PAPER, lab_maps.TIGHT)

PARAMETERS = (
    Parameter("laps", 2.0, "", "of the laboratory", low=0.05, high=10.0),
    Parameter("speed_mps", 0.2, "m/s", "the paper's cruise", low=0.05, high=3.0),
    Parameter("turn_dps", 90.0, "deg/s", "yaw rate of quick turns", low=5.0, high=180.0),
    Parameter("rate_hz", 5.0, "Hz", "revolutions a second", low=5.0, high=15.0),
    Parameter("seed", 1, "", "of noise and odometry", low=0),
    Parameter("scans", 300, "", "scans in a map, at most", low=10),
    Parameter("recording", True, "", "show the recording, too"),
)


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """The true map, a map for each variant, and the maps of the recording if its files are available."""
    sequence = {name: settings[name] for name in ("laps", "speed_mps", "turn_dps", "rate_hz", "seed")}
    uses = ("evalkit_datasets.worlds.synthetic", "evalkit_baselines.paper")
    maps = [
        make_task(
            each.name, lab_maps.map_laboratory, backend=each.backend, parameters=dict(each.parameters),
            sequence=sequence, scans=settings["scans"],
        ).depending_on(*uses)
        for each in VARIANTS
    ]  # fmt: skip
    plan = make_task("plan", lab_maps.true_lab_map, sequence=sequence).depending_on(*uses)
    return (plan, *maps, *(recorded_drive.tasks() if settings["recording"] else ()))


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The sections on the laboratory and on the recording."""
    lab = Section("Figure 10: the map beside the plan", [*_lab_blocks(settings, results)], ANCHOR)
    if not settings["recording"]:
        return (lab,)
    return lab, Section(
        "Figure 10: a recording with the paper's kind of lidar", [*recorded_drive.blocks(results)], "figure-10-b"
    )


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """The finding on Figure 10."""
    del settings
    true = lab_maps.grid_of(results["plan"])
    ghosts = {each.name: _count_ghosts(results[each.name], true) for each in VARIANTS}
    text = ", ".join(f"{name} {count[0]} of {count[1]}" for name, count in ghosts.items())
    share = {name: count[0] / max(count[1], 1) for name, count in ghosts.items()}
    shares = {"paper": share["paper"], "odometry": share[lab_maps.ODOMETRY.name]}
    return (
        Finding(
            "Figure 10", "a map that agrees with the place (a photo; here the simulated plan)",
            f"cells more than {map_faults.GHOST_M:g} m off every true wall: {text}",
            verdicts.judge_map(shares, float(results["paper"]["f1"])), ANCHOR,
        ),
    )  # fmt: skip


def _count_ghosts(result: Result, true: OccupancyGrid) -> tuple[int, int]:
    found = map_faults.find_faults(lab_maps.grid_of(result), true)
    return int(found.ghosts.sum()), int(found.occupied.sum())


# --- the laboratory


def _lab_blocks(settings: Settings, results: Results) -> Iterator[Block]:
    true = lab_maps.grid_of(results["plan"])
    yield Text(
        f"{settings['laps']:g} laps of the laboratory at {settings['speed_mps']:g} m/s and {settings['rate_hz']:g} Hz "
        f"with turns of {settings['turn_dps']:g} deg/s; each map is drawn from the same {settings['scans']} scans "
        "along the poses of its back end, and aligned to the plan by least squares over the trajectory. The paper "
        "shows a photo of the place; here the plan itself is known."
    )
    yield Figures([
        Figure(_render_plan(true), "The plan: the map of a perfect lidar on this drive"),
        *(_map_figure(results[each.name], true, each.name) for each in VARIANTS),
    ])  # fmt: skip
    yield Text(
        f"Red: ghosts, occupied cells farther than {map_faults.GHOST_M:g} m (four sigma of the range noise) from every "
        f"true wall. Orange: smeared cells, {map_faults.SMEAR_M:g} to {map_faults.GHOST_M:g} m from it. Blue dots: "
        "true walls that are free on the map, with no occupied cell near. Light blue: the true walls.", "note",
    )  # fmt: skip
    yield _summary_table(results, true)
    yield Heading("Where the ghosts are")
    yield _ghost_table(results, true)


def _summary_table(results: Results, true: OccupancyGrid) -> Table:
    columns = (
        "Map drawn along", Column("ATE", "m", number=True), Column("F1 at 10 cm", number=True),
        Column("occupied cells", number=True), Column("ghosts", "cells", number=True),
        Column("ghosts", "%", number=True), Column("smear", "%", number=True),
        Column("missing walls", "cells", number=True),
    )  # fmt: skip
    rows: list[Sequence[Cell | str]] = []
    for each in VARIANTS:
        result = results[each.name]
        found = map_faults.find_faults(lab_maps.grid_of(result), true)
        occupied, ghosts, smeared = (int(mask.sum()) for mask in (found.occupied, found.ghosts, found.smeared))
        numbers = (
            (result["ate_m"], "{:.3f}"), (result["f1"], "{:.3f}"), (occupied, "{:,}"), (ghosts, "{:,}"),
            (100.0 * ghosts / max(occupied, 1), "{:.1f}"), (100.0 * smeared / max(occupied, 1), "{:.1f}"),
            (len(found.missing), "{:,}"),
        )  # fmt: skip
        rows.append((each.name, *(Cell(form.format(value), float(value)) for value, form in numbers)))
    return Table(columns, rows)


def _ghost_table(results: Results, true: OccupancyGrid) -> Table:
    """Table of the largest ghosts of every map."""
    walls = true.centres(true.occupied())
    columns = (
        "Map drawn along", Column("cells", number=True), Column("x", "m", number=True), Column("y", "m", number=True),
        Column("extent", "m", number=True), Column("distance to a wall", "m", number=True, tip="largest"),
    )  # fmt: skip
    rows: list[Sequence[Cell | str]] = []
    for each in VARIANTS:
        grid = lab_maps.grid_of(results[each.name])
        found = map_faults.find_clusters(grid.centres(map_faults.find_faults(grid, true).ghosts), walls)
        for cluster in found[:5]:
            numbers = (cluster.x, cluster.y, cluster.extent_m, cluster.wall_distance_m)
            rows.append((
                each.name, Cell(str(cluster.cells), cluster.cells), *(Cell(f"{value:.2f}", value) for value in numbers)
            ))  # fmt: skip
        if not found:
            rows.append((each.name, Cell("0", 0), "", "", "", ""))
    return Table(columns, rows, "The five largest groups of ghosts of every map, in the plan's frame.")


def _render_plan(true: OccupancyGrid) -> bytes:
    return charts.picture(render_image(true), true.extent)


def _map_figure(result: Result, true: OccupancyGrid, name: str) -> Figure:
    grid = lab_maps.grid_of(result)
    found = map_faults.find_faults(grid, true)
    layers = [
        Points("true walls", true.centres(true.occupied()), TRUE, 1.3, alpha=0.7),
        Points("path", result["path"], PATH, 0.8, joined=True),
        Points("missing wall", found.missing, MISSING, 2.0),
    ]
    marked = render_image(grid, {SMEAR: found.smeared, GHOST: found.ghosts})
    return Figure(
        charts.picture(marked, grid.extent, layers), f"Along {name}",
        f"ATE {result['ate_m']:.3f} m; {found.ghosts.sum():,} ghost and {found.smeared.sum():,} smeared cells",
    )  # fmt: skip


CHAPTER = Chapter("figure-10", PARAMETERS, tasks, sections, findings)
