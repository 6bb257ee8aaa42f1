"""The part of a study's page that tells effects: of each factor, of pairs, and what they foretell elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.commands.study import charts
from evalkit.commands.study.effects import Interaction, ModelFit
from evalkit.commands.study.formatting import amount, change, fitted, left, ranked
from evalkit.commands.study.plan import Design, Response
from evalkit.commands.study.result import StudyResult, on_scale
from evalkit.report.html.document import Block, Cell, Column, Figures, Fold, Heading, Table, Text

MAX_SHOWN = 4
"""So many interactions are drawn."""

MIN_LISTED = 5


def effect_blocks(outcome: StudyResult) -> tuple[Block, ...]:
    """Main effects and interactions of every design that tells them, and what they foretell elsewhere."""
    blocks: list[Block] = []
    for number, response in enumerate(outcome.study.responses):
        made = [
            block for design, fit in fitted(outcome, response) for block in _effects(outcome, response, design, fit)
        ]
        if not made:
            continue
        own = [Heading(response.metric.label), *made]
        blocks += own if number < 2 else [Fold(f"Effects on {response.metric.label}", made)]
    return tuple(blocks)


def _effects(outcome: StudyResult, response: Response, design: Design, fit: ModelFit) -> list[Block]:
    found = ranked(design, fit)
    pairs = fit.interactions()
    drawn = [pair for pair in pairs if pair.matters][:MAX_SHOWN]
    ordered = [
        charts.profile(response, factor, fit.factor(k).levels, fit.mean.value)
        for k, factor in enumerate(design.factors)
        if factor.numbers is not None and len(factor.levels) > 2
    ]
    quality_words = (
        f"{design.name}: the model of main effects{' and pairs' if fit.model.pairs else ''} explains "
        f"{100.0 * fit.explained:.0f} % of the variance over {len(fit.response)} points; what is left scatters by "
        f"{left(response, fit.residual)}."
    )
    blocks: list[Block] = [Text(quality_words), charts.main_effects(response, design, found)]
    blocks.append(
        Fold(f"{design.name}: levels of every factor", (Figures(ordered, small=True), _levels(response, design, fit)))
    )
    if pairs:
        blocks += _pairs(response, design, pairs)
    if drawn:
        blocks.append(Figures([charts.crossing(response, design, fit, pair) for pair in drawn], small=True))
    return [*blocks, *_checks(outcome, response, design, fit)]


def _levels(response: Response, design: Design, fit: ModelFit) -> Table:
    rows = []
    for number, factor in enumerate(design.factors):
        found = fit.factor(number)
        for level, interval in zip(factor.levels, found.levels, strict=True):
            cell = Cell(amount(response, interval), interval.value)
            rows.append((factor.name, Cell(level.label, level.number), cell, f"{100.0 * found.share:.1f}"))
    columns = ("Factor", "FactorLevel", Column("Against the mean of its levels", number=True),
               Column("Share of variance", "%", number=True))  # fmt: skip
    return Table(columns, rows)


def _pairs(response: Response, design: Design, pairs: Sequence[Interaction]) -> list[Block]:
    rows = [
        (
            f"{pair.a} x {pair.b}",
            f"{change(design, pair.a, pair.a_levels)}, at {change(design, pair.b, pair.b_levels)}",
            Cell(amount(response, pair.value), abs(pair.value.value)),
            Cell("yes" if pair.matters else "no", tone="warn" if pair.matters else ""),
            Cell(f"{100.0 * pair.share:.1f}", pair.share),
        )
        for pair in pairs
    ]
    columns = (
        "Pair", "Corner", Column("Changes the effect by", number=True, tip="difference of differences, 95 % interval"),
        Column("Told from chance", tip="the interval, widened for all pairs together (Bonferroni), tells the sign"),
        Column("Share of variance", "%", number=True),
    )  # fmt: skip
    shown = max(sum(pair.matters for pair in pairs), MIN_LISTED)
    caption = f"{design.name}: the interactions with the largest shares of the variance, of {len(pairs)}"
    blocks: list[Block] = [Table(columns, rows[:shown], caption)]
    return [*blocks, Fold("The other pairs", (Table(columns, rows[shown:]),))] if rows[shown:] else blocks


def _checks(outcome: StudyResult, response: Response, design: Design, fit: ModelFit) -> list[Block]:
    """What the effects foretell for space-filling points of the same factors, beside what was measured there."""
    blocks: list[Block] = []
    for other in outcome.study.designs:
        if other.kind not in ("sobol", "latin") or other.factors != design.factors:
            continue
        measured = on_scale(response, outcome.table(other, response)).mean(axis=1)
        told = np.isfinite(measured)
        expected = fit.predict(other.positions[told])
        apart = float(np.sqrt(np.mean((expected - measured[told]) ** 2)))
        around = float(np.std(measured[told]))
        verdict = "" if apart < around else ": the effects tell nothing of single points between the levels"
        words = (
            f"{other.name}: {int(told.sum())} points that no effect was computed from are foretold to within "
            f"{left(response, apart)} (root mean square); they scatter by {left(response, around)} around their mean"
            f"{verdict}."
        )
        ends = (charts.off_scale(response, values) for values in (expected, measured[told]))
        blocks += [Text(words), Fold("Foretold and measured", (charts.check(response, *ends),))]
    return blocks
