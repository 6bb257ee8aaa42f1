"""Blocks of the map chapter: interactions, recommendation, pictures, and the effect of drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from evalkit.report.html import charts
from evalkit.report.html.blocks import Bullets, Column, Figure, Figures, Table, Text
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit_paper import map_measurements, map_recommendation
from evalkit_paper.chapter import Results, Settings
from evalkit_paper.map_measurements import DEFAULT_THRESHOLD, THRESHOLDS
from evalkit_paper.map_study import MapStudy, describe_variant, factor_variants, format_change

PICTURE_SIZES_M = (0.025, 0.05, 0.1, 0.2)
DRIFT_M = (0.0, 0.05, 0.1, 0.2, 0.4)
DRIFT_DEG = (0.0, 1.0, 2.0, 4.0)
CELL_SIZE = Axis("cell size [m]", "log", ticks=PICTURE_SIZES_M)


def interaction_blocks(study: MapStudy) -> list[Any]:
    """F1 when two settings vary together, with a summary."""
    free = factor_variants(study, "free")
    sizes = factor_variants(study, "resolution")
    drawn = [
        _heat_figure(study, sizes, Axis("cell size [m]"), "resolution_m", "Cell size and threshold"),
        _heat_figure(study, free, Axis("l_free"), "l_free", "Weight of free space and threshold"),
    ]
    blocks: list[Any] = [Figures(drawn, small=True)]
    rules = [(True, "exact"), (True, "bresenham"), (False, "exact"), (False, "bresenham")]
    try:
        curves = [_rule_curve(study, once, traversal) for once, traversal in rules]
    except KeyError:  # not measured for the quick page
        return blocks
    shown = charts.lines(curves, CELL_SIZE, Axis("F1 at 10 cm"))
    caption = "Mean over all drives."
    return [
        *blocks,
        Figure(shown, "Endpoint rule and traversal, by cell size", caption),
        Bullets(_describe_interactions(study)),
    ]


def _heat_figure(study: MapStudy, numbers: Sequence[int], x: Axis, key: str, title: str) -> Figure:
    numbers = sorted(numbers, key=lambda n: float(map_measurements.complete(study.variants[n])[key]))
    values = np.array([[study.f1(n, t).mean() for n in numbers] for t in range(len(THRESHOLDS))])
    columns = [float(map_measurements.complete(study.variants[n])[key]) for n in numbers]
    svg = charts.heat(
        values, x, Axis("occupied above P"), columns, THRESHOLDS, Axis("F1 at 10 cm", low=0.5, high=1.0),
        lambda value: f"{value:.3f}",
    )  # fmt: skip
    return Figure(svg, title, "Mean F1 over all drives.")


def _rule_curve(study: MapStudy, once: bool, traversal: str) -> Curve:
    numbers = [
        study.number({"resolution_m": size, "once_per_scan": once, "traversal": traversal}) for size in PICTURE_SIZES_M
    ]
    label = f"{'once per scan' if once else 'every beam'}, {traversal}"
    return Curve(
        label, np.array(PICTURE_SIZES_M), np.array([study.f1(n, DEFAULT_THRESHOLD).mean() for n in numbers]), marks=True
    )


def _describe_interactions(study: MapStudy) -> list[str]:
    def rule(size: float) -> float:
        every = study.number({"resolution_m": size, "once_per_scan": False})
        return float(
            (
                study.f1(every, DEFAULT_THRESHOLD) - study.f1(study.number({"resolution_m": size}), DEFAULT_THRESHOLD)
            ).mean()
        )

    def walk(size: float) -> float:
        other = study.number({"resolution_m": size, "traversal": "bresenham"})
        return float(
            (
                study.f1(other, DEFAULT_THRESHOLD) - study.f1(study.number({"resolution_m": size}), DEFAULT_THRESHOLD)
            ).mean()
        )

    many, weak = {"scans": 1000}, {"scans": 1000, "l_free": -0.405}
    gained = float(
        (study.f1(study.number(weak), DEFAULT_THRESHOLD) - study.f1(study.number(many), DEFAULT_THRESHOLD)).mean()
    )
    alone = float(
        (study.f1(study.number({"l_free": -0.405}), DEFAULT_THRESHOLD) - study.f1(0, DEFAULT_THRESHOLD)).mean()
    )
    by_size = [f"{100.0 * size:g} cm {rule(size):+.3f}" for size in PICTURE_SIZES_M]
    return [
        f"Counting every beam instead of once per scan changes F1 by cell size: {', '.join(by_size)}. The larger the "
        "cell, the more beams cross it before the wall, and the more often one scan clears it.",
        f"Bresenham instead of the exact traversal: "
        f"{', '.join(f'{100 * s:g} cm {walk(s):+.3f}' for s in PICTURE_SIZES_M)}. "
        "It crosses fewer cells and therefore clears less beside a wall.",
        f"Halving the weight of free space changes F1 by {alone:+.3f} with 250 scans and by {gained:+.3f} with up to "
        "1,000.",
    ]


def recommendation_blocks(study: MapStudy, settings: Settings) -> list[Any]:
    """The recommendation rule and its result beside the paper's settings."""
    held_out = int(settings["seeds"]) - 1
    own = study.mapper_settings()
    choice = study.choice(own, list(range(held_out)) or [0])
    variant, best = own[choice.variant], own[choice.best_variant]
    rows = []
    for label, number, threshold in (
        ("paper's settings", 0, DEFAULT_THRESHOLD),
        ("recommended", variant, choice.threshold),
        ("best F1 of all candidates", best, choice.best_threshold),
    ):
        seen, unseen = study.seed_means(number, threshold, held_out)
        rows.append(
            [
                label,
                describe_variant(study.variants[number]),
                f"{THRESHOLDS[threshold]:g}",
                f"{seen:.3f}",
                f"{unseen:.3f}" if held_out else "-",
                f"{100.0 * study.mean('chamfer_m', number, threshold):.1f}",
                f"{100.0 * study.mean('width_m', number, threshold):.1f}",
                f"{study.mean('log_loss', number):.3f}",
            ]
        )
    columns = (
        "", "Settings that differ", Column("occupied above P", number=True),
        Column("F1, used for the choice", number=True), Column("F1, held out", number=True),
        Column("Chamfer", "cm", number=True),
        Column("wall width", "cm", number=True), Column("log-loss", "nat", number=True),
    )  # fmt: skip
    seen_on = "seed 0" if held_out == 1 else f"seeds 0 to {held_out - 1}"
    on = f"Chosen on {seen_on}, held out: seed {held_out}." if held_out else "One seed: none held out."
    return [Text(f"{map_recommendation.RULE} {on}"), Table(columns, rows, sortable=False)]


def picture_blocks(result: Mapping[str, Any]) -> list[Any]:
    """Maps at the four cell sizes."""
    figures = []
    walls = Points("true walls", result["walls"], "#d55e00", 1.6)
    for number, size in enumerate(PICTURE_SIZES_M):
        image = 1.0 - result[str(number)][::-1] / 255.0
        left, right, bottom, top = result["extents"][number].tolist()
        figures.append(
            Figure(charts.picture(image, (left, right, bottom, top), [walls]), f"{100.0 * size:g} cm cells", "")
        )
    told = (
        f"The lab, seed 0, at four cell sizes, with estimated poses (ATE {1000.0 * result['ate_m']:.0f} mm); dark: "
        "occupied."
    )
    return [Text(told), Figures(figures, small=True)]


def drift_blocks(settings: Settings, results: Results) -> list[Any]:
    """Effect of drifting poses on the measures."""
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
        svg = charts.lines(curves, Axis(f"drift at the end [{unit}]"), Axis("relative to no drift"))
        figures.append(
            Figure(svg, f"Drift of up to {amounts[-1]:g} {unit}", "Mean over the seeds, band: minimum to maximum.")
        )
        at_end = relative.mean(axis=0)[-1]
        changes = zip(map_measurements.DRIFT_MEASURES, at_end, strict=True)
        told.append(
            f"{amounts[-1]:g} {unit}: " + ", ".join(f"{name} {format_change(value)}" for name, value in changes) + "."
        )
    lead = (
        "Effect of drift on the measures: maps of the lab with true poses plus a drift that grows evenly until the "
        "end, along x or as a rotation about the middle of the path, without realignment. Changes at the largest drift:"
    )
    return [Text(lead), Bullets(told), Figures(figures)]
