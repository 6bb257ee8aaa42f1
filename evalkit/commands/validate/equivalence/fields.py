"""The fields of two answers to one question: which of them differ, with both values, and in how many questions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping

from evalkit.commands.validate.equivalence.lockstep import AnswerPair
from evalkit.commands.validate.equivalence.margins import FLOAT32, Margin, MarginChoice, describe_gap
from evalkit.core.match import Match


def wrong_fields(a: Match, b: Match, margin: Margin) -> list[str]:
    """The fields of an answer that differ; without equal poses "pose" alone.

    A trace is optional: one that only one side reports is no difference.
    """
    if not margin.holds(a.target_from_source, b.target_from_source):
        return ["pose"]
    wrong = [name for name in ("converged", "iterations", "inliers") if getattr(a, name) != getattr(b, name)]
    if math.isnan(a.error) != math.isnan(b.error) or abs(a.error - b.error) > margin.metres:
        wrong.append("error")
    if a.history and b.history:
        if len(a.history) != len(b.history):
            wrong.append("trace length")
        entries = list(zip(a.history, b.history, strict=False))
        if any(one.inliers != other.inliers for one, other in entries):
            wrong.append("trace inliers")
        if any(not same_error(one.error, other.error, margin.metres) for one, other in entries):
            wrong.append("trace error")
        if any(not margin.holds(one.target_from_source, other.target_from_source) for one, other in entries):
            wrong.append("trace pose")
    return wrong


def describe_field(name: str, a: Match, b: Match, margin: Margin) -> str:
    """A field of ``wrong_fields`` in words: what ``b`` has where ``a``, the reference, has another value."""
    if name == "trace length":
        return f"{len(b.history)} entries, expected {len(a.history)}"
    if not name.startswith("trace "):
        return f"{_format_value(getattr(b, name))}, expected {_format_value(getattr(a, name))}"
    field = name.removeprefix("trace ")
    for number, (one, other) in enumerate(zip(a.history, b.history, strict=False), start=1):
        if field == "pose" and not margin.holds(one.target_from_source, other.target_from_source):
            return f"iteration {number}: {describe_gap(one.target_from_source, other.target_from_source)} apart"
        if field == "inliers" and one.inliers != other.inliers:
            return f"iteration {number}: {other.inliers}, expected {one.inliers}"
        if field == "error" and not same_error(one.error, other.error, margin.metres):
            return f"iteration {number}: {_format_value(other.error)}, expected {_format_value(one.error)}"
    return ""


def same_error(a: float, b: float, tolerance: float) -> bool:
    """Whether two errors are equal within a tolerance; one that is not reported is no difference."""
    if math.isnan(a) or math.isnan(b):
        return True
    return abs(a - b) <= tolerance


def count_fields(answered: Iterable[tuple[AnswerPair, Margin]], margin: MarginChoice) -> dict[str, int]:
    """The number of questions with an equal pose whose other field differs, by field.

    An error that the second side never reports is not compared. Under the float32 margin rounding may decide a count:
    there a field differs if it does in more than a tenth of the questions, and in more than two.
    """
    known = [(one.a, one.b, limits) for one, limits in answered if one.b is not None]
    capped = any(_is_capped(a, b, limits) for a, b, limits in known)
    counts = Counter(name for wrong in _find_wrong_fields(known) for name in wrong)
    least = max(0.1 * len(known), 2.0) if margin == FLOAT32 else 0.0
    return {name: count for name, count in counts.items() if count > least or (capped and name == "iterations")}


def count_equal_fields(answered: Iterable[tuple[AnswerPair, Margin]], counted: Mapping[str, int]) -> tuple[int, int]:
    """The number of questions with an equal pose whose other fields are equal, and of those that rounding excuses.

    ``counted``: the fields of ``count_fields``; any other that differs is excused.
    """
    known = [(one.a, one.b, limits) for one, limits in answered if one.b is not None]
    others = [wrong for wrong in _find_wrong_fields(known) if "pose" not in wrong]
    return sum(not wrong for wrong in others), sum(not counted.keys() >= set(wrong) for wrong in others)


def _find_wrong_fields(known: list[tuple[Match, Match, Margin]]) -> list[list[str]]:
    """The fields of each answer that differ and that the second side reports."""
    errors = any(not math.isnan(b.error) for _, b, _ in known)
    return [[name for name in wrong_fields(a, b, limits) if errors or name != "error"] for a, b, limits in known]


def _is_capped(a: Match, b: Match, limits: Margin) -> bool:
    """Whether the second side ends many iterations before the first one, at the same pose: more than rounding does."""
    same = limits.holds(a.target_from_source, b.target_from_source)
    return same and not a.converged and a.iterations - b.iterations > max(10, a.iterations // 2)


def _format_value(value: float) -> str:
    return f"{value:.6g} m" if isinstance(value, float) else str(value)
