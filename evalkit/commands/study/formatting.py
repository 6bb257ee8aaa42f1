"""Sentences and numbers for the page of a study."""

from __future__ import annotations

import numpy as np

from evalkit.commands.study.effects import FactorEffect, ModelFit
from evalkit.commands.study.plan import Design, EnvelopeChoice, Study
from evalkit.design.factors import Factor
from evalkit.design.responses import Response
from evalkit.report.formatting import join_words
from evalkit.stats.intervals import Interval

MAX_EFFECTS = 3
"""Most main effects that a sentence names."""


def describe_main_effects(response: Response, design: Design, fit: ModelFit) -> str:
    """A sentence with the largest significant effects."""
    ranked = sorted(fit.effects, key=lambda effect: -effect.largest.value.value)
    significant = [effect for effect in ranked if effect.largest.value.excludes(0.0)]
    if not significant:
        return f"No factor has a significant effect on {response.metric.label}."
    words = [
        f"{describe_largest(design, effect)} ({format_effect(response, effect.largest.value)})"
        for effect in significant[:MAX_EFFECTS]
    ]
    return (
        f"{response.metric.label} depends most on {join_words(words)}, adjusted for {fit.differences} differences of "
        "levels."
    )


def describe_interactions(response: Response, fit: ModelFit, most: int = 4) -> str:
    """A sentence with the significant interactions."""
    significant = [pair for pair in fit.interactions() if pair.significant]
    if not fit.model.pairs:
        return "The design estimates main effects only."
    if not significant:
        return f"No interaction has a significant effect on {response.metric.label}."
    words = [f"{pair.a} x {pair.b} ({format_effect(response, pair.value)})" for pair in significant[:most]]
    more = f", and {len(significant) - most} more" if len(significant) > most else ""
    return f"Significant interactions, adjusted for {fit.corners} comparisons: {join_words(words)}{more}."


def describe_missing_effects(response: Response, design: Design, reason: str) -> str:
    """A sentence on why a design has no effects on a response."""
    return f"{design.name}: the effects on {response.metric.label} cannot be computed: {reason}."


def describe_limit(choice: EnvelopeChoice) -> str:
    """The limit of an envelope as the beginning of a sentence."""
    metric = choice.response.metric
    side = "at least" if metric.better == "higher" else "at most"
    return f"{metric.label} stays {side} {choice.limit:g} {metric.unit}".rstrip()


def describe_lost_runs(study: Study) -> str:
    """Sentences on when a run is lost, and how lost runs enter the effects."""
    bounds = [
        f"{r.metric.label} of {r.lost:g} {r.metric.unit}".rstrip()
        + (" or less" if r.metric.better == "higher" else " or more")
        for r in study.responses
        if r.lost is not None
    ]
    unbounded = [r.metric.label for r in study.responses if r.lost is None]
    lines = [f"A run is lost if it fails{''.join(f' or ends with {bound}' for bound in bounds)}."]
    if bounds:
        lines.append(
            "A run that failed or is beyond a bound enters the effects on that metric with the bound as its value. So "
            "effects with lost runs can be too small, and an interaction can come from the bound alone."
        )
    if unbounded:
        lines.append(f"Effects on {join_words(unbounded)}, without a bound, leave out the runs that have no value.")
    return " ".join(lines)


def format_effect(response: Response, value: Interval) -> str:
    """An effect with its interval: a ratio on a log scale, otherwise a difference."""
    if response.scale == "log":
        ends = [f"{np.exp(end):.2f}" for end in (value.value, value.low, value.high)]
        return f"x {ends[0]}, {ends[1]} to {ends[2]}"
    digits, unit = response.metric.digits, response.metric.unit
    ends = [f"{end:+.{digits}f}" for end in (value.value, value.low, value.high)]
    return f"{ends[0]} {unit}, {ends[1]} to {ends[2]}".replace(" ,", ",")


def format_scatter(response: Response, residual: float) -> str:
    """A standard deviation as text: a factor on a log scale, otherwise with its unit."""
    if response.scale == "log":
        return f"a factor of {np.exp(residual):.2f}"
    return f"{residual:.{response.metric.digits}f} {response.metric.unit}".rstrip()


def describe_largest(design: Design, effect: FactorEffect) -> str:
    """The change of level with a factor's largest effect."""
    return describe_step(design.factor(effect.factor), effect.largest.against, effect.largest.level)


def describe_step(factor: Factor, one: int, other: int) -> str:
    """A change of level as text."""
    return f"{factor.name}: {factor.levels[one].label} → {factor.levels[other].label}"
