"""The chapter on the map, second half: factors together, the settings recommended, pictures, and what drift does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.report.html import charts
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.report.html.document import Bullets, Column, Figure, Figures, Table, Text
from evalkit_paper import map_measurements, map_recommendation
from evalkit_paper.chapter import Results, Settings
from evalkit_paper.map_measurements import THRESHOLDS, TOLD
from evalkit_paper.map_study import Study, named, of_factor, percent

PICTURED = (0.025, 0.05, 0.1, 0.2)
DRIFT_M = (0.0, 0.05, 0.1, 0.2, 0.4)
DRIFT_DEG = (0.0, 1.0, 2.0, 4.0)
CELL_SIZE = Axis("cell size [m]", "log", ticks=PICTURED)


def interactions(study: Study) -> list[Any]:
    """F1 where two settings vary together, and what follows in words."""
    free = of_factor(study, "free")
    sizes = of_factor(study, "resolution")
    drawn = [
        _heat(study, sizes, Axis("cell size [m]"), "resolution_m", "Cell size and threshold"),
        _heat(study, free, Axis("l_free"), "l_free", "Weight of free space and threshold"),
    ]
    blocks: list[Any] = [Figures(drawn, small=True)]
    rules = [(True, "exact"), (True, "bresenham"), (False, "exact"), (False, "bresenham")]
    try:
        curves = [_rule_curve(study, once, traversal) for once, traversal in rules]
    except KeyError:  # the quick page leaves them out
        return blocks
    shown = charts.lines(curves, CELL_SIZE, Axis("F1 at 10 cm"))
    caption = "Mean over all drives; bands from the least to the greatest of them are left out."
    return [*blocks, Figure(shown, "Endpoint rule and traversal, by cell size", caption), Bullets(_crossed(study))]


def _heat(study: Study, numbers: Sequence[int], x: Axis, key: str, title: str) -> Figure:
    numbers = sorted(numbers, key=lambda n: float(map_measurements.complete(study.variants[n])[key]))
    values = np.array([[study.f1(n, t).mean() for n in numbers] for t in range(len(THRESHOLDS))])
    columns = [float(map_measurements.complete(study.variants[n])[key]) for n in numbers]
    svg = charts.heat(
        values, x, Axis("occupied above P"), columns, THRESHOLDS, Axis("F1 at 10 cm", low=0.5, high=1.0),
        lambda value: f"{value:.3f}",
    )  # fmt: skip
    return Figure(svg, title, "Mean F1 over all drives.")


def _rule_curve(study: Study, once: bool, traversal: str) -> Curve:
    numbers = [study.number({"resolution_m": size, "once_per_scan": once, "traversal": traversal}) for size in PICTURED]
    label = f"{'once a scan' if once else 'every beam'}, {traversal}"
    return Curve(label, np.array(PICTURED), np.array([study.f1(n, TOLD).mean() for n in numbers]), marks=True)


def _crossed(study: Study) -> list[str]:
    def rule(size: float) -> float:
        every = study.number({"resolution_m": size, "once_per_scan": False})
        return float((study.f1(every, TOLD) - study.f1(study.number({"resolution_m": size}), TOLD)).mean())

    def walk(size: float) -> float:
        other = study.number({"resolution_m": size, "traversal": "bresenham"})
        return float((study.f1(other, TOLD) - study.f1(study.number({"resolution_m": size}), TOLD)).mean())

    many, weak = {"scans": 1000}, {"scans": 1000, "l_free": -0.405}
    gained = float((study.f1(study.number(weak), TOLD) - study.f1(study.number(many), TOLD)).mean())
    alone = float((study.f1(study.number({"l_free": -0.405}), TOLD) - study.f1(0, TOLD)).mean())
    by_size = [f"{100.0 * size:g} cm {rule(size):+.3f}" for size in PICTURED]
    return [
        f"Counting every beam instead of once a scan changes F1 by cell size: {', '.join(by_size)}. The larger the "
        "cell, the more beams cross it on their way to the wall, and the more often it is cleared by one scan.",
        f"Bresenham instead of the exact traversal: {', '.join(f'{100 * s:g} cm {walk(s):+.3f}' for s in PICTURED)}. "
        "It passes fewer cells, so it clears less beside a wall.",
        f"Halving the weight of free space changes F1 by {alone:+.3f} with 250 scans and by {gained:+.3f} with up to "
        "1,000.",
    ]


def recommendation(study: Study, settings: Settings) -> list[Any]:
    """The rule, and what it recommends beside the paper's settings."""
    held_out = int(settings["seeds"]) - 1
    own = study.mapper_settings()
    choice = study.choice(own, list(range(held_out)) or [0])
    variant, best = own[choice.variant], own[choice.best_variant]
    rows = []
    for label, number, threshold in (
        ("paper's settings", 0, TOLD),
        ("recommended", variant, choice.threshold),
        ("best F1 that counts", best, choice.best_threshold),
    ):
        seen, unseen = study.seed_means(number, threshold, held_out)
        rows.append(
            [
                label,
                named(study.variants[number]),
                f"{THRESHOLDS[threshold]:g}",
                f"{seen:.3f}",
                f"{unseen:.3f}" if held_out else "-",
                f"{100.0 * study.mean('chamfer_m', number, threshold):.1f}",
                f"{100.0 * study.mean('width_m', number, threshold):.1f}",
                f"{study.mean('log_loss', number):.3f}",
            ]
        )
    columns = (
        "", "Settings that differ", Column("occupied above P", number=True), Column("F1, chosen on", number=True),
        Column("F1, held out", number=True), Column("Chamfer", "cm", number=True),
        Column("wall width", "cm", number=True), Column("log-loss", "nat", number=True),
    )  # fmt: skip
    seen_on = "seed 0" if held_out == 1 else f"seeds 0 to {held_out - 1}"
    on = f"Chosen on {seen_on}, held out: seed {held_out}." if held_out else "One seed: none held out."
    return [Text(f"{map_recommendation.RULE} {on}"), Table(columns, rows, sortable=False)]


def pictures(result: Mapping[str, Any]) -> list[Any]:
    """One row of maps at the four cell sizes."""
    figures = []
    walls = Points("true walls", result["walls"], "#d55e00", 1.6)
    for number, size in enumerate(PICTURED):
        image = 1.0 - result[str(number)][::-1] / 255.0
        left, right, bottom, top = result["extents"][number].tolist()
        figures.append(
            Figure(charts.picture(image, (left, right, bottom, top), [walls]), f"{100.0 * size:g} cm cells", "")
        )
    told = (
        f"The lab, seed 0, at four cell sizes, poses estimated (ATE {1000.0 * result['ate_m']:.0f} mm); dark: occupied."
    )
    return [Text(told), Figures(figures, small=True)]


def drift(settings: Settings, results: Results) -> list[Any]:
    """How the measures answer to poses that leave the truth."""
    seeds = range(int(settings["seeds"]))
    figures, told = [], []
    for key, amounts, unit in (("metres", DRIFT_M, "m"), ("degrees", DRIFT_DEG, "deg")):
        values = np.array([results[f"drift seed {seed}"][key] for seed in seeds])
        relative = values / values[:, :1]
        curves = [
            Curve(name, np.array(amounts), relative[:, :, m].mean(axis=0), relative[:, :, m].min(axis=0),
                  relative[:, :, m].max(axis=0), marks=True)
            for m, name in enumerate(map_measurements.DRIFT_MEASURES)
        ]  # fmt: skip
        svg = charts.lines(curves, Axis(f"drift at the end [{unit}]"), Axis("times the value without drift"))
        figures.append(Figure(svg, f"Drift of up to {amounts[-1]:g} {unit}", "Mean over the seeds, least to greatest."))
        at_end = relative.mean(axis=0)[-1]
        changes = zip(map_measurements.DRIFT_MEASURES, at_end, strict=True)
        told.append(
            f"{amounts[-1]:g} {unit}: " + ", ".join(f"{name} {percent(value)}" for name, value in changes) + "."
        )
    lead = (
        "How drift moves the measures: maps of the lab with the true poses, led away from them evenly until the end, "
        "along x or by a turn about the middle of the path; not aligned again. Changes at the largest drift:"
    )
    return [Text(lead), Bullets(told), Figures(figures)]
