"""What a study's numbers are called in sentences and tables."""

from __future__ import annotations

import numpy as np

from evalkit.commands.study.charts import steps
from evalkit.commands.study.effects import FactorEffect, ModelFit
from evalkit.commands.study.plan import Design, EnvelopeChoice, Response, Study
from evalkit.commands.study.result import StudyResult
from evalkit.report.formatting import join_words
from evalkit.stats.intervals import Interval


def fitted(outcome: StudyResult, response: Response) -> list[tuple[Design, ModelFit]]:
    """The designs that effects on a response can be computed for."""
    found = [(d, outcome.fit(d, response)) for d in outcome.study.designs if d.kind in ("optimal", "fractional")]
    return [(design, fit) for design, fit in found if isinstance(fit, ModelFit)]


def ranked(design: Design, fit: ModelFit) -> list[FactorEffect]:
    """The factors' effects, the largest first."""
    found = [fit.factor(number) for number in range(len(design.factors))]
    return sorted(found, key=lambda effect: -effect.largest.value.value)


def main_words(response: Response, design: Design, fit: ModelFit, most: int = 3) -> str:
    """The largest effects whose intervals tell the sign, in a sentence."""
    found = ranked(design, fit)
    sure = [effect for effect in found if effect.largest.value.excludes(0.0)]
    if not sure:
        return f"no factor's effect on {response.metric.label} is told from chance."
    words = [f"{step_words(design, effect)} ({amount(response, effect.largest.value)})" for effect in sure[:most]]
    return f"{response.metric.label} depends most on {join_words(words)}."


def pair_words(response: Response, fit: ModelFit, most: int = 4) -> str:
    """The interactions that matter, in a sentence."""
    found = [pair for pair in fit.interactions() if pair.matters]
    if not fit.model.pairs:
        return "the design tells main effects only."
    if not found:
        return f"no two factors' interaction is told from chance on {response.metric.label}."
    words = [f"{pair.a} x {pair.b} ({amount(response, pair.value)})" for pair in found[:most]]
    more = f", and {len(found) - most} more" if len(found) > most else ""
    return f"{join_words(words)}{more} interact beyond what {len(fit.interactions())} pairs would show by chance."


def limit_words(choice: EnvelopeChoice) -> str:
    """The limit of an envelope as the beginning of a sentence."""
    metric = choice.response.metric
    side = "at least" if metric.better == "higher" else "at most"
    return f"{metric.label} stays {side} {choice.limit:g} {metric.unit}".rstrip()


def lost_words(study: Study) -> str:
    """When a run counts as lost, and what becomes of it."""
    bounds = [
        f"{r.metric.label} of {r.lost:g} {r.metric.unit} or {'less' if r.metric.better == 'higher' else 'more'}"
        for r in study.responses
        if r.lost is not None
    ]
    if not bounds:
        return "A run counts as lost when it fails."
    return (
        f"A run counts as lost when it fails or ends with {join_words(bounds)}. Lost runs are in every effect with "
        "that bound as their value: where there are some, an effect is a lower bound of the true one."
    )


def amount(response: Response, value: Interval) -> str:
    """An effect with its interval: a ratio on a log scale, else a difference."""
    if response.scale == "log":
        ends = [f"{np.exp(end):.2f}" for end in (value.value, value.low, value.high)]
        return f"x {ends[0]}, {ends[1]} to {ends[2]}"
    digits, unit = response.metric.digits, response.metric.unit
    ends = [f"{end:+.{digits}f}" for end in (value.value, value.low, value.high)]
    return f"{ends[0]} {unit}, {ends[1]} to {ends[2]}".replace(" ,", ",")


def left(response: Response, residual: float) -> str:
    """A scatter in words: a factor on a log scale, else an amount."""
    if response.scale == "log":
        return f"a factor of {np.exp(residual):.2f}"
    return f"{residual:.{response.metric.digits}f} {response.metric.unit}".rstrip()


def step_words(design: Design, effect: FactorEffect) -> str:
    """The levels between which a factor's effect is largest."""
    factor = next(factor for factor in design.factors if factor.name == effect.factor)
    return steps(factor, effect.largest.against, effect.largest.level)


def change(design: Design, name: str, levels: tuple[int, int]) -> str:
    """A factor's change of level."""
    factor = next(factor for factor in design.factors if factor.name == name)
    return steps(factor, *levels)
