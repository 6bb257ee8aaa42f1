"""Checks of single registrations against a known motion, and beside other methods: is one as good as the reference?"""

from __future__ import annotations

import math

import numpy as np

from evalkit.commands.validate.acceptance import Check, CheckOutcome
from evalkit.commands.validate.comparison_terms import ComparisonTerms, ResultsByPlace
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.equivalence.margins import EquivalenceInterval, interval
from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result


def known_motion_checks(results: ResultsByPlace, terms: ComparisonTerms) -> list[Check]:
    """Whether the back end finds known motions as well as the reference does."""
    known = {place: result for place, result in results.items() if np.isfinite(result["truth"]).any()}
    if not known:
        return []
    own, others = (answer_errors(known, side) for side in ("b", "a"))
    margins = noise_level(known, terms.noise_share)
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in known))
    checks = []
    for column, unit, quantity in ((0, "m", "position"), (1, "rad", "heading")):
        answered = np.isfinite(own[:, column]) & np.isfinite(others[:, column])
        gap = _interval(quantity, unit, (own - others)[answered, column], margins[column])
        observed = (
            f"mean error {np.nanmean(own[:, column]):.3g} {unit}, {terms.reference} "
            f"{np.nanmean(others[:, column]):.3g} {unit}; difference {_format_interval(gap)}"
        )
        outcome, hint = judge_gap(gap.mean, gap.low, gap.high, gap.margin, gap.n)
        if not answered.all():
            outcome, hint = "failed", f"{int((~answered).sum())} pairs have no answer"
        name = f"finds a known motion as well as {terms.reference}: {quantity}"
        margin = _format_noise(gap, terms.noise_share)
        checks.append(Check(name, on, outcome, "as-good", observed, margin, hint))
    return checks


def peer_check(name: str, results: ResultsByPlace, answers: ResultsByPlace, terms: ComparisonTerms) -> Check:
    """The distance of the answers to those of another method."""
    label = f"compared with {name}"
    shared = {place: result for place, result in results.items() if ENDED not in answers.get(place, {ENDED: ""})}
    if not shared:
        why = "; ".join(dict.fromkeys(str(result[ENDED]) for result in answers.values()))
        return Check(label, "", "not applicable", "never", f"{name} did not finish: {why}")
    apart = np.concatenate([se2.between(answers[place]["rows"], result["b"]) for place, result in shared.items()])
    near = np.concatenate([near_guesses(result) for result in shared.values()])
    rows = apart[near & np.isfinite(apart).all(axis=1)]
    if not len(rows):
        return Check(label, "", "not applicable", "never", "no pair was answered by both")
    margins = noise_level(shared, terms.noise_share)
    distance = np.hypot(rows[:, 0], rows[:, 1])
    tests = [_interval(axis, unit, rows[:, column], margins[column // 2])
             for column, (axis, unit) in enumerate((("x", "m"), ("y", "m"), ("theta", "rad")))]  # fmt: skip
    biased = " and ".join(one.quantity for one in tests if one.low > one.margin or one.high < -one.margin)
    unbiased = "without a bias" if all(one.inside for one in tests) else "too few pairs to exclude a bias"
    observed = (
        f"answers lie {np.median(distance):.2g} m apart (median; 95 % within {np.quantile(distance, 0.95):.2g} m), "
        f"{f'with a bias beyond the margin in {biased}' if biased else unbiased}"
    )
    x, y, theta = (_format_interval(one) for one in tests)
    on = ", ".join(dict.fromkeys(place.partition(",")[0] for place in shared))
    return Check(
        label, f"{on}, near guesses", "informative", "never", observed, _format_noise(tests[0], terms.noise_share),
        f"means over {len(rows)} pairs: x {x}, y {y}, theta {theta}",
    )  # fmt: skip


def judge_gap(value: float, low: float, high: float, margin: float, count: int) -> tuple[CheckOutcome, str]:
    """Whether a loss is shown to be below a margin, or above it, and else what would show it.

    ``low``, ``high``: the 90 % interval of the loss over ``count`` values; it shrinks with the root of their number.
    """
    if high < margin:
        return "passed", ""
    if low > margin:
        return "failed", "its loss is shown to exceed the margin"
    if value >= margin or not math.isfinite(high):
        return "not shown", "more data would show which: the loss is near the margin, or the values are too few"
    wanted = count * ((high - value) / (margin - value)) ** 2
    return (
        "not shown",
        f"about {math.ceil(wanted):,} values instead of {count:,} would show it: more --seeds, longer --on",
    )


def near_guesses(result: Result) -> Bools:
    """Which questions (N,) started from a guess near the answer, not from a disturbed one."""
    return np.array([not stage.endswith(DISTURBED) for stage in result["stage"]], dtype=np.bool_)


def answer_errors(results: ResultsByPlace, side: str) -> Floats:
    """Errors (N, 2) of all answers to known motions: metres and radians, nan if there is no answer or no truth."""
    apart = np.concatenate([se2.between(result["truth"], result[side]) for result in results.values()])
    return np.stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])], axis=1)


def noise_level(results: ResultsByPlace, share: float) -> tuple[float, float]:
    """A share of the uncertainty of an answer due to the sensor's noise alone: metres, radians.

    N points with mean distance e to their partners determine a position to about e / sqrt(N), and a heading to that
    divided by their root mean square radius.
    """
    metres = np.concatenate([result["residual_m"] / np.sqrt(result["points"]) for result in results.values()])
    radii = np.concatenate([result["radius_m"] for result in results.values()])
    return share * float(np.median(metres)), share * float(np.median(metres / radii))


def _interval(quantity: str, unit: str, values: Floats, margin: float) -> EquivalenceInterval:
    return interval(quantity, unit, values, np.arange(1, len(values) + 1), margin)


def _format_interval(one: EquivalenceInterval) -> str:
    return f"{one.mean:.2g} {one.unit} (90 % [{one.low:.2g}, {one.high:.2g}])"


def _format_noise(one: EquivalenceInterval, share: float) -> str:
    return f"{one.margin:.2g} {one.unit}: {share:g} of the noise level, mean residual / sqrt(points)"
