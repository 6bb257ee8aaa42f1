"""Chapter on the log-odds map: the effect of each setting on the walls, and recommended settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.execution.task import AnyTask, Parameters, R, Task, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Cell, Column, Figure, Figures, Section, Table, Text, Tone
from evalkit.report.html.charts import Axis, Curve
from evalkit_paper import map_figures, map_measurements
from evalkit_paper.chapter import Chapter, Finding, Results, Settings
from evalkit_paper.map_figures import CELL_SIZE, DRIFT_DEG, DRIFT_M, PICTURE_SIZES_M
from evalkit_paper.map_measurements import DEFAULT_THRESHOLD, THRESHOLDS
from evalkit_paper.map_study import POSES, MapStudy, describe_variant, factor_variants

USES = ("evalkit_baselines.embedded", "evalkit_baselines.paper", "evalkit_datasets.synthetic")
ANCHOR = "maps"
NO_RETURN_WORLD = "corridor"

PARAMETERS = (
    Parameter("worlds", "lab,office", "", "worlds of the maps", choices=("lab", "lab,office")),
    Parameter("seeds", 3, "", "repetitions with other noise; the last is held out where there are two", low=1, high=20),
    Parameter("laps", 1.0, "", "laps driven", low=0.1, high=3.0),
    Parameter("interactions", True, "", "measure pairs of factors too"),
)

NUMERIC: Mapping[str, tuple[str, str, Axis]] = {
    "resolution": ("resolution_m", "Cell size", CELL_SIZE),
    "evidence": ("l_occ", "Weight of one observation", Axis("l_occ = -l_free")),
    "free": ("l_free", "Weight of free space alone", Axis("l_free, with l_occ as printed")),
    "bounds": ("l_max", "Bounds of the log-odds", Axis("l_max = -l_min")),
    "scans": ("scans", "Scans in the map", Axis("scans, evenly spaced", "log", ticks=(62, 125, 250, 500, 1000))),
}


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """Tasks: every world, seed and kind of poses; drift, pictures, no-returns, comparison of the mappers."""
    variants = [dict(variant) for variant in map_measurements.variants(bool(settings["interactions"]))]
    laps = settings["laps"]
    seeds = range(int(settings["seeds"]))
    main = [
        _task(f"{world} seed {seed} {poses}", map_measurements.measure_maps,
             world=world, seed=seed, laps=laps, poses=poses, variants=variants)
        for world in _worlds(settings) for seed in seeds for poses in POSES
    ]  # fmt: skip
    drift = [
        _task(
            f"drift seed {seed}",
            map_measurements.measure_drift,
            world="lab",
            seed=seed,
            laps=laps,
            metres=DRIFT_M,
            degrees=DRIFT_DEG,
        )
        for seed in seeds
    ]
    clear = [
        _task(f"no returns seed {seed}", map_measurements.measure_maps, world=NO_RETURN_WORLD, seed=seed,
             laps=min(laps, 0.5), poses="true", variants=[{}, {"clear_no_returns": True}])
        for seed in seeds
    ]  # fmt: skip
    sizes = [{"resolution_m": size} for size in PICTURE_SIZES_M]
    silent = [
        _task(f"no noise seed {seed}", map_measurements.measure_maps, world="lab", seed=seed, laps=laps, poses="true",
              variants=sizes, sensor={"noise_m": 0.0})
        for seed in seeds
    ]  # fmt: skip
    drawn = _task(
        "pictures", map_measurements.render_maps, world="lab", seed=0, laps=laps, poses="estimated", variants=sizes
    )
    compare_mappers = _task("twins", map_measurements.compare_mappers, world="lab", seed=0, laps=min(laps, 0.3),
                 variants=[{}, {"resolution_m": 0.1}, {"l_free": -0.405}, {"l_min": -10.0, "l_max": 10.0}])  # fmt: skip
    return (*main, *drift, *clear, *silent, drawn, compare_mappers)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """Sections: method, F1 by factor, all numbers, interactions, recommendation, pictures, drift."""
    study = _study(settings, results)
    blocks = [
        *_lead_blocks(study, results),
        Figures([_factor_figure(study, name) for name in NUMERIC] + [_threshold_figure(study)], small=True),
        _effect_table(study, settings, results),
        *map_figures.interaction_blocks(study),
        *map_figures.recommendation_blocks(study, settings),
        *map_figures.picture_blocks(results["pictures"]),
        *map_figures.drift_blocks(settings, results),
    ]
    return (Section("The log-odds map and its settings", blocks, ANCHOR),)


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """Findings on the map's formulae and on what the paper leaves open."""
    study = _study(settings, results)
    own = study.f1(0, DEFAULT_THRESHOLD)
    spans = {name: _f1_range(study, name) for name in ("bounds", "rule", "traversal")}
    apart = "; ".join(f"{name}: F1 {low:.3f} to {high:.3f}" for name, (low, high) in spans.items())
    sizes = ", ".join(
        f"{100.0 * size:g} cm {study.f1(study.number({'resolution_m': size}), DEFAULT_THRESHOLD).mean():.3f}"
        for size in PICTURE_SIZES_M
    )
    return (
        Finding(
            "Equations 10, 11 and Figure 5: log-odds grid of 5 cm cells", "l_occ = +0.847, l_free = ln(0.3 / 0.7)",
            f"F1 at 10 cm {own.mean():.3f} ({own.min():.3f} to {own.max():.3f}) over {own.size} maps",
            "reproduced with a correction",
            "l_free is negative and is added; subtracting it would mark free space as occupied", ANCHOR,
        ),
        Finding(
            "Bounds of the log-odds, cells that a beam crosses, several beams in one cell", "l_min and l_max without "
            "values; nothing on the other two", apart, "not determined by the text",
            "each reading gives a map; the endpoint rule has the largest effect" if _rule_matters(spans) else
            "each reading gives a map",
            ANCHOR,
        ),
        Finding(
            "Study of the grid's resolution", "announced, no table printed", f"F1 at 10 cm by cell size: {sizes}",
            "not determined by the text",
            f"with ranges that have no noise (lab, true poses): {_describe_noise_free(settings, results)}", ANCHOR,
        ),
    )  # fmt: skip


CHAPTER = Chapter("maps", PARAMETERS, tasks, sections, findings)


def _task(
    name: str, function: Callable[Parameters, R], /, *args: Parameters.args, **kwargs: Parameters.kwargs
) -> Task[R]:
    return make_task(name, function, *args, **kwargs).depending_on(*USES)


def _worlds(settings: Settings) -> list[str]:
    return str(settings["worlds"]).split(",")


def _study(settings: Settings, results: Results) -> MapStudy:
    units = [
        (world, seed, poses) for world in _worlds(settings) for seed in range(int(settings["seeds"])) for poses in POSES
    ]
    known = map_measurements.variants(bool(settings["interactions"]))
    return MapStudy(known, tuple(units), [results[f"{world} seed {seed} {poses}"] for world, seed, poses in units])


def _f1_range(study: MapStudy, factor: str) -> tuple[float, float]:
    means = [float(study.f1(number, DEFAULT_THRESHOLD).mean()) for number in factor_variants(study, factor)]
    return min(means), max(means)


def _describe_noise_free(settings: Settings, results: Results) -> str:
    values = np.mean(
        [results[f"no noise seed {s}"]["f1"][:, DEFAULT_THRESHOLD] for s in range(int(settings["seeds"]))], axis=0
    )
    return ", ".join(f"{100.0 * size:g} cm {value:.3f}" for size, value in zip(PICTURE_SIZES_M, values, strict=True))


def _rule_matters(spans: Mapping[str, tuple[float, float]]) -> bool:
    return max(spans, key=lambda name: spans[name][1] - spans[name][0]) == "rule"


def _lead_blocks(study: MapStudy, results: Results) -> list[Text]:
    compare_mappers = results["twins"]
    ate = {world: float(np.mean(values)) for world, values in study.ate_m().items()}
    slow = [number for number in range(len(study.variants)) if study.mappers[number] == "log-odds"]
    return [
        Text(
            "Every map is built from simulated scans of a known world and compared with the true boundaries: F1 of "
            "occupied cells at 10 cm, Chamfer distance, log-loss (mean surprise of the true state of a cell) and "
            "width of the walls. One factor is varied at a time around the paper's settings: 5 cm cells, "
            "±0.847, bounds ±5, a cell changed once per scan with occupied before free, exact traversal, occupied "
            "above P = 0.65, beams without return ignored, deskewed, 250 scans."
        ),
        Text(
            f"{len(study.variants)} kinds of map on {len(study.units)} drives each: with true poses, and with poses "
            "estimated by the paper's ICP with epsilon 1e-6 (paper-tight), aligned to the ground truth: "
            + ", ".join(f"{world}: ATE {1000.0 * value:.0f} mm" for world, value in ate.items()) + "."
        ),
        Text(
            f"The compiled mapper draws {len(study.variants) - len(slow)} of the kinds, the NumPy reference the other "
            f"{len(slow)} (every beam counts, Bresenham), which the compiled one does not support. Where both draw, "
            "over "
            f"{compare_mappers['cells']:,} cells, their log-odds differ by at most {compare_mappers['log_odds']:.1g}, "
            f"and {compare_mappers['observed by one only']} cells are observed by only one. The worlds are static: the "
            "effect of weak evidence of free space on traces of moving people is not measured.", "note",
        ),
    ]  # fmt: skip


def _factor_figure(study: MapStudy, factor: str) -> Figure:
    key, title, axis = NUMERIC[factor]
    numbers = factor_variants(study, factor)
    x = np.array([float(map_measurements.complete(study.variants[number])[key]) for number in numbers])
    order = np.argsort(x)
    curves = [
        Curve(label, x[order], values.mean(axis=1)[order], values.min(axis=1)[order], values.max(axis=1)[order],
              marks=True)
        for label, values in _by_sequence(study, numbers).items()
    ]  # fmt: skip
    caption = "Mean over the seeds, band: minimum to maximum; occupied above P = 0.65."
    return Figure(charts.lines(curves, axis, Axis("F1 at 10 cm")), title, caption)


def _threshold_figure(study: MapStudy) -> Figure:
    curves = []
    for world, poses in study.sequences():
        values = study.f1(0)[:, study.drives_of(world, poses)]
        label = f"{world}, {poses} poses"
        low, high = values.min(axis=1), values.max(axis=1)
        curves.append(Curve(label, np.array(THRESHOLDS), values.mean(axis=1), low, high, marks=True))
    caption = "The same maps with other thresholds. Bands: minimum to maximum."
    return Figure(
        charts.lines(curves, Axis("occupied above P"), Axis("F1 at 10 cm")), "Threshold of occupied cells", caption
    )


def _by_sequence(study: MapStudy, numbers: Sequence[int]) -> dict[str, Any]:
    """F1 (K, S) of K variants over S seeds, for every world and kind of poses."""
    return {
        f"{world}, {poses} poses": np.array(
            [study.f1(n, DEFAULT_THRESHOLD)[study.drives_of(world, poses)] for n in numbers]
        )
        for world, poses in study.sequences()
    }


def _effect_table(study: MapStudy, settings: Settings, results: Results) -> Table:
    rows = [_effect_row(study, 0)]
    for factor in map_measurements.factors():
        rows += [_effect_row(study, number) for number in factor_variants(study, factor) if number]
    ignored, cleared = (
        np.array([results[f"no returns seed {s}"]["f1"][v, DEFAULT_THRESHOLD] for s in range(int(settings["seeds"]))])
        for v in (0, 1)
    )
    caption = (
        "Mean over all drives; the change is that of F1 against the paper's settings on the same drive, minimum and "
        "maximum in brackets; coloured if it exceeds 0.005 on all drives. Log-loss at another cell size refers to "
        f"other cells. In lab and office almost every beam has a return; in the {NO_RETURN_WORLD}, longer than the "
        "lidar "
        f"sees, F1 is {ignored.mean():.3f} where such beams are ignored and {cleared.mean():.3f} where they clear."
    )
    columns = (
        "Setting", Column("F1", number=True), Column("change of F1", number=True), Column("precision", number=True),
        Column("recall", number=True), Column("Chamfer", "cm", number=True), Column("wall width", "cm", number=True),
        Column("log-loss", "nat", number=True), Column("entropy", "nat", number=True),
    )  # fmt: skip
    return Table(columns, rows, caption)


def _effect_row(study: MapStudy, number: int) -> list[Cell]:
    change = study.f1(number, DEFAULT_THRESHOLD) - study.f1(0, DEFAULT_THRESHOLD)
    tone: Tone = "good" if change.min() > 0.005 else "bad" if change.max() < -0.005 else ""
    told = f"{change.mean():+.3f} [{change.min():+.3f}, {change.max():+.3f}]"
    mean = study.mean
    return [
        Cell(describe_variant(study.variants[number])),
        Cell(f"{study.f1(number, DEFAULT_THRESHOLD).mean():.3f}"),
        Cell(told if number else "-", float(change.mean()), tone),
        Cell(f"{mean('precision', number, DEFAULT_THRESHOLD):.3f}"),
        Cell(f"{mean('recall', number, DEFAULT_THRESHOLD):.3f}"),
        Cell(f"{100.0 * mean('chamfer_m', number, DEFAULT_THRESHOLD):.1f}"),
        Cell(f"{100.0 * mean('width_m', number, DEFAULT_THRESHOLD):.1f}"),
        Cell(f"{mean('log_loss', number):.3f}"),
        Cell(f"{mean('entropy', number):.3f}"),
    ]
