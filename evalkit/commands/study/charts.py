"""Charts of a study: effects, levels, interactions, curves, envelopes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from evalkit.commands.study.effects import FactorEffect, Interaction, ModelFit
from evalkit.commands.study.envelope import Panel, find_envelope_axes
from evalkit.commands.study.formatting import describe_largest
from evalkit.commands.study.plan import Design, EnvelopeChoice
from evalkit.commands.study.result import StudyResult
from evalkit.core.se2 import Floats
from evalkit.design.factors import Factor
from evalkit.design.responses import Response, to_scale
from evalkit.report.formatting import label_with_unit
from evalkit.report.html.blocks import Figure
from evalkit.report.html.charts import Axis, Curve, Points, bars, compute_log_ticks, heat, lines, scatter
from evalkit.report.html.method_colours import HUES
from evalkit.stats.intervals import Interval

GREY = "#aab2bd"


def make_response_axis(response: Response, *values: Floats) -> Axis:
    """A vertical axis for a response, with ticks around the values to show."""
    return Axis(format_response(response), response.scale, ticks=compute_response_ticks(response, *values))


def compute_response_ticks(response: Response, *values: Floats) -> tuple[float, ...]:
    """Ticks at 1, 2 and 5 times the powers of ten around values on a log scale; none on a linear one."""
    known = np.concatenate([np.ravel(part) for part in values])
    known = known[np.isfinite(known) & (known > 0.0)]
    if response.scale == "linear" or not len(known):
        return ()
    low, high = float(known.min()), float(known.max())
    return compute_log_ticks(low / 2.0, high * 2.0, (1.0, 2.0, 5.0) if high < 1e4 * low else (1.0,))


def format_response(response: Response) -> str:
    """A response with its unit."""
    return label_with_unit(response.metric.label, response.metric.unit)


def make_factor_axis(factor: Factor) -> Axis:
    """A horizontal axis with a tick at every level."""
    return Axis(label_with_unit(factor.name, factor.unit), factor.scale, ticks=factor.numbers or ())


def draw_main_effects(response: Response, design: Design, effects: Sequence[FactorEffect]) -> Figure:
    """A bar for every factor: the worst level against the best, with its interval, the largest on top."""
    ordered = sorted(effects, key=lambda effect: -effect.largest.value.value)
    labels = [describe_largest(design, effect) for effect in ordered]
    values, low, high = (
        from_scale(response, np.array([getattr(effect.largest.value, end) for effect in ordered]))
        for end in ("value", "low", "high")
    )
    neutral = 1.0 if response.scale == "log" else 0.0
    colours = [HUES[0] if effect.largest.value.excludes(0.0) else GREY for effect in ordered]
    unit = "times" if response.scale == "log" else response.metric.unit
    label = label_with_unit(f"{response.metric.label}: largest against smallest", unit)
    axis = Axis(label, response.scale, ticks=compute_response_ticks(response, low, high))
    title = f"{design.name}: effects on {response.metric.label}"
    caption = (
        "From the level with the smallest value to the level with the largest, averaged over all other factors. Line: "
        "95 % interval, adjusted for all differences of levels (Bonferroni); grey: not significant."
    )
    return Figure(bars(labels, values, axis, low, high, neutral, colours), title, caption)


def draw_profile(response: Response, factor: Factor, levels: Sequence[Interval], mean: float) -> Figure:
    """The response over the levels of an ordered factor, averaged over all others."""
    x = np.array(factor.numbers)
    y, low, high = (
        from_scale(response, mean + np.array([getattr(level, end) for level in levels]))
        for end in ("value", "low", "high")
    )
    curve = Curve(response.metric.label, x, y, low, high, marks=True)
    return Figure(
        lines([curve], make_factor_axis(factor), make_response_axis(response, low, high)),
        f"{response.metric.label} over {factor.name}",
    )


def draw_interaction(response: Response, design: Design, fit: ModelFit, interaction: Interaction) -> Figure:
    """The response over one factor at two levels of another, averaged over the rest."""
    numbers = {factor.name: number for number, factor in enumerate(design.factors)}
    a, b = numbers[interaction.a], numbers[interaction.b]
    b_levels = interaction.b_levels
    if design.factors[a].numbers is None and design.factors[b].numbers is not None:
        a, b, b_levels = b, a, interaction.a_levels
    along, other = design.factors[a], design.factors[b]
    curves = []
    for level in b_levels:
        intervals = [fit.expected({a: number, b: level}) for number in range(len(along.levels))]
        y, low, high = (
            from_scale(response, np.array([getattr(one, end) for one in intervals])) for end in ("value", "low", "high")
        )
        x = np.array(along.numbers or range(len(along.levels)))
        curves.append(Curve(f"{other.name} {other.levels[level].label}", x, y, low, high, marks=True))
    title = f"{along.name} with {other.name}"
    vertical = make_response_axis(response, *(curve.y for curve in curves))
    return Figure(lines(curves, make_factor_axis(along), vertical), title, "" if along.numbers else _list_levels(along))


def draw_curve(outcome: StudyResult, response: Response, factor: Factor, designs: Sequence[Design]) -> Figure:
    """The response over a factor in every design that varies it alone: mean of the seeds and their span."""
    curves = []
    for design in designs:
        points = [point for point in design.points if factor.name in point.levels]
        rows = to_scale(response, np.array([outcome.row(design, response, point) for point in points]))
        y, low, high = (from_scale(response, ends) for ends in (rows.mean(axis=1), rows.min(axis=1), rows.max(axis=1)))
        curves.append(Curve(design.name, np.array(factor.numbers), y, low, high, marks=True))
    levels = {} if response.lost is None or response.scale == "linear" else {"lost": response.lost}
    vertical = make_response_axis(response, *(curve.y for curve in curves), np.array([*levels.values()]))
    chart = lines(curves, make_factor_axis(factor), vertical, levels=levels)
    return Figure(chart, f"{response.metric.label} over {factor.name}", "Lines: means of the seeds; bands: their span.")


def draw_prediction(response: Response, expected: Floats, measured: Floats) -> Figure:
    """Predicted against measured values at points that were not used to compute the effects."""
    ends = [float(min(expected.min(), measured.min())), float(max(expected.max(), measured.max()))]
    layers = [
        Points("the same", np.array([[ends[0]] * 2, [ends[1]] * 2]), GREY, 1.0, joined=True),
        Points("a point", np.stack([expected, measured], axis=1), HUES[0], 5.0),
    ]
    x = Axis(f"predicted: {format_response(response)}", response.scale)
    chart = scatter(layers, x, Axis(f"measured: {format_response(response)}", response.scale), equal=False)
    return Figure(chart, f"{response.metric.label} between the levels")


def draw_envelope(choice: EnvelopeChoice, design: Design, panel: Panel, limits: tuple[float, float]) -> Figure:
    """One map of an envelope: the value of the worst seed in every cell, the limit as a line, lost cells empty."""
    x, y = find_envelope_axes(design, choice)
    response = choice.response
    chart = heat(
        panel.worst,
        make_factor_axis(x),
        make_factor_axis(y),
        x.numbers or (),
        y.numbers or (),
        Axis(format_response(response), response.scale, *limits),
        lambda value: f"{value:.3f}" if value < 1.0 else f"{value:.2g}",
        (choice.limit,) if _is_crossed(panel.worst, choice.limit) else (),
    )
    lost = int((panel.lost > 0).sum())
    return Figure(chart, panel.label, f"{lost} of {panel.worst.size} cells lost" if lost else "")


def from_scale(response: Response, values: Floats) -> Floats:
    """Values from a response's scale to its unit: exponentials on a log scale."""
    return np.exp(values) if response.scale == "log" else values


def _is_crossed(values: Floats, limit: float) -> bool:
    known = values[np.isfinite(values)]
    return bool(len(known) and known.min() < limit < known.max())


def _list_levels(factor: Factor) -> str:
    return "; ".join(f"{number}: {level.label}" for number, level in enumerate(factor.levels))
