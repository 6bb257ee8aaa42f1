"""The blocks of a study's page on effects, interactions and predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.commands.study import charts
from evalkit.commands.study.effects import Interaction, ModelFit
from evalkit.commands.study.formatting import (
    describe_missing_effects,
    describe_step,
    format_effect,
    format_scatter,
)
from evalkit.commands.study.plan import Design
from evalkit.commands.study.result import StudyResult
from evalkit.design.responses import Response, to_scale
from evalkit.report.html.blocks import Block, Cell, Column, Figures, Fold, Heading, Table, Text

MAX_SHOWN = 4
"""Most interactions to draw."""

MIN_LISTED = 5
"""Fewest interactions in the table that is not folded."""


def build_effect_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """Main effects and interactions of every design that has them, and their predictions at other points."""
    blocks: list[Block] = []
    for number, response in enumerate(outcome.study.responses):
        content: list[Block] = [
            Text(describe_missing_effects(response, design, reason), "warn")
            for design, reason in outcome.missing_fits(response)
        ]
        for design, fit in outcome.fits(response):
            content += _build_effects(outcome, response, design, fit)
        if not content:
            continue
        section = [Heading(response.metric.label), *content]
        blocks += section if number < 2 else [Fold(f"Effects on {response.metric.label}", content)]
    return tuple(blocks)


def _build_effects(outcome: StudyResult, response: Response, design: Design, fit: ModelFit) -> list[Block]:
    pairs = fit.interactions()
    shown = [pair for pair in pairs if pair.significant][:MAX_SHOWN]
    ordered = [
        charts.draw_profile(response, factor, effect.levels, fit.mean.value)
        for factor, effect in zip(design.factors, fit.effects, strict=True)
        if factor.numbers is not None and len(factor.levels) > 2
    ]
    quality_words = (
        f"{design.name}: the model of main effects{' and pairs' if fit.model.pairs else ''} explains "
        f"{100.0 * fit.explained:.0f} % of the variance over {len(fit.response)} points; the residuals have a standard "
        f"deviation of {format_scatter(response, fit.residual)}."
    )
    blocks: list[Block] = [Text(quality_words), charts.draw_main_effects(response, design, fit.effects)]
    blocks.append(
        Fold(
            f"{design.name}: levels of every factor",
            (Figures(ordered, small=True), _build_levels(response, design, fit)),
        )
    )
    if pairs:
        blocks += _build_pairs(response, design, pairs)
    if shown:
        blocks.append(Figures([charts.draw_interaction(response, design, fit, pair) for pair in shown], small=True))
    return [*blocks, *_build_checks(outcome, response, design, fit)]


def _build_levels(response: Response, design: Design, fit: ModelFit) -> Table:
    rows = []
    for factor, effect in zip(design.factors, fit.effects, strict=True):
        for level, interval in zip(factor.levels, effect.levels, strict=True):
            cell = Cell(format_effect(response, interval), interval.value)
            rows.append((factor.name, Cell(level.label, level.number), cell, f"{100.0 * effect.share:.1f}"))
    columns = ("Factor", "Level", Column("Against the mean of its levels", number=True),
               Column("Share of variance", "%", number=True))  # fmt: skip
    return Table(columns, rows)


def _build_pairs(response: Response, design: Design, pairs: Sequence[Interaction]) -> list[Block]:
    rows = [
        (
            f"{pair.a} x {pair.b}",
            f"{describe_step(design.factor(pair.a), *pair.a_levels)}, at "
            f"{describe_step(design.factor(pair.b), *pair.b_levels)}",
            Cell(format_effect(response, pair.value), abs(pair.value.value)),
            Cell("yes" if pair.significant else "no", tone="warn" if pair.significant else ""),
            Cell(f"{100.0 * pair.share:.1f}", pair.share),
        )
        for pair in pairs
    ]
    columns = (
        "Pair", "Corner",
        Column("Changes the effect by", number=True,
               tip="difference of differences, 95 % interval adjusted for all comparisons (Bonferroni)"),
        Column("Significant", tip="the interval excludes no change"),
        Column("Share of variance", "%", number=True),
    )  # fmt: skip
    shown = max(sum(pair.significant for pair in pairs), MIN_LISTED)
    caption = f"{design.name}: the interactions with the largest shares of the variance, of {len(pairs)}"
    blocks: list[Block] = [Table(columns, rows[:shown], caption)]
    return [*blocks, Fold("The other pairs", (Table(columns, rows[shown:]),))] if rows[shown:] else blocks


def _build_checks(outcome: StudyResult, response: Response, design: Design, fit: ModelFit) -> list[Block]:
    """Predictions at space-filling points of the same factors against the measured values."""
    blocks: list[Block] = []
    for other in outcome.study.designs:
        if other.kind not in ("sobol", "latin") or other.factors != design.factors:
            continue
        measured = to_scale(response, outcome.table(other, response)).mean(axis=1)
        known = np.isfinite(measured)
        if not known.any():
            continue
        expected = fit.predict(other.positions[known])
        apart = float(np.sqrt(np.mean((expected - measured[known]) ** 2)))
        around = float(np.std(measured[known]))
        verdict = "" if apart < around else ": the effects do not predict single points between the levels"
        words = (
            f"{other.name}: the effects predict {int(known.sum())} points that were not used to compute them with an "
            f"error of {format_scatter(response, apart)} (root mean square); the standard deviation of these points is "
            f"{format_scatter(response, around)}{verdict}."
        )
        ends = (charts.from_scale(response, values) for values in (expected, measured[known]))
        blocks += [Text(words), Fold("Predicted and measured", (charts.draw_prediction(response, *ends),))]
    return blocks
