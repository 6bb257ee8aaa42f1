"""The terms of a comparison with a reference, and the margin within which all its results are equal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from evalkit.commands.validate.equivalence.diagnosis import ROUNDING
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.execution.sandbox import ENDED
from evalkit.execution.task import Result

ResultsByPlace = Mapping[str, Result]
"""Results by place: "room, seed 0"."""


@dataclass(frozen=True)
class ComparisonTerms:
    """The labels of the validated back end and its reference, the margin, and the peers.

    ``noise_share``: the share of the noise level by which an answer may be worse and still count as good. ``waivers``:
    reasons by the name of a check that is excepted.
    """

    backend: str
    reference: str
    margin: str
    noise_share: float
    peers: tuple[str, ...] = ()
    waivers: Mapping[str, str] = field(default_factory=dict)


def choose_margin(results: ResultsByPlace, margins: Sequence[str]) -> str:
    """The first margin under which all results are equal.

    Single precision is chosen only if every result shows its rounding, in most of its poses, and the back end repeats
    all its answers to the bit: a difference in some, or one that comes and goes, is no rounding. If there is no such
    margin, so that the claim fails: the last one if rounding explains the simplest answers, to show the other
    differences, else the first.
    """
    completed = [result for result in results.values() if ENDED not in result]
    if not completed or any(result.get("unrepeated") for result in completed):
        return margins[0]
    first = [result[margins[0]]["first"] for result in completed]
    if any(one and one["kind"] == "rounding" for one in first):  # to decimals or cells: no single precision
        return margins[0]
    if any(_is_mostly_equal(result[margins[0]]) for result in completed):
        return margins[0]
    for margin in margins:
        contradicted = margin != margins[0] and any(is_equal(result[margins[0]], margins[0]) for result in completed)
        if not contradicted and all(is_equal(result[margin], margin) for result in completed):
            return margin
    if any(is_equal(result[margins[0]], margins[0]) for result in completed):
        return margins[0]
    families = [result[margins[0]].get("families", {}) for result in completed]
    clear = [one["clear"]["first"] for one in families if "clear" in one]  # of well separated points
    kinds = [one["kind"] for one in clear or first if one]
    return margins[-1] if kinds and all(kind in ROUNDING for kind in kinds) else margins[0]


def is_equal(comparison: Mapping[str, Any], margin: str) -> bool:
    """Whether a comparison shows no difference.

    Under the float32 margin, every answer beyond the margin must have diverged by rounding: at a tie that single
    precision breaks differently. The mean of such answers is not compared; level 3 measures what they lead to.
    """
    if margin != FLOAT32 or comparison["level"] == "trajectories":
        return bool(comparison["equivalent"])
    return not comparison["beyond_rounding"] and not comparison["unanswered"]


def _is_mostly_equal(comparison: Mapping[str, Any]) -> bool:
    """Whether at least half of the poses lie within the margin: single precision would round nearly all of them."""
    if "apart" not in comparison:  # trajectories
        return False
    answered = comparison["questions"] - comparison["unanswered"]
    return bool(answered) and 2 * comparison["apart"] <= answered


def format_margin(results: ResultsByPlace, margin: str) -> str:
    """The margin in words, at the largest value over all results.

    The poses of odometries are equal if their mean difference lies within it, answers of registrations also where
    rounding decides them: where all results are equal and a single difference is larger, the largest is stated, too.
    """
    completed = [result for result in results.values() if ENDED not in result and "families" not in result[margin]]
    if not completed:
        return "within no margin: no question was answered"
    largest = max((result[margin]["margin"] for result in completed), key=lambda one: float(one["metres"]))
    size = f"{largest['metres']:.2g} m and {largest['radians']:.2g} rad"
    within = f"within the single-precision rounding margin ({size})" if margin == FLOAT32 else f"within {size}"
    compared = [result[margin] for result in completed]
    if not all(is_equal(comparison, margin) for comparison in compared):
        return within
    beyond = " and ".join(text for unit in ("m", "rad") if (text := _format_beyond(compared, unit)))
    if excepted := sum(comparison.get("excepted", 0) for comparison in compared):
        asked = sum(comparison["questions"] for comparison in compared)
        return f"{within.removesuffix(')')}; rounding decides {excepted} of {asked} answers, at most {beyond} apart)"
    return f"{within} in the mean (single poses at most {beyond} apart)" if beyond else within


def _format_beyond(compared: Sequence[Mapping[str, Any]], unit: str) -> str:
    """The largest difference in a unit that is beyond the margin of its result, "" if none is."""
    intervals = [one for comparison in compared for one in comparison["intervals"] if one["unit"] == unit]
    beyond = [abs(one["worst"]) for one in intervals if one["worst"] is not None and abs(one["worst"]) > one["margin"]]
    return f"{max(beyond):.2g} {unit}" if beyond else ""
