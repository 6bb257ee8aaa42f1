"""The comparison of the answers to all drawn questions: by family, with what the questions that differ share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import islice
from typing import Any

import numpy as np

from evalkit.commands.validate.asked_question import AskedQuestion
from evalkit.commands.validate.equivalence import lockstep
from evalkit.commands.validate.equivalence.diagnosis import mistakes_in_start
from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.fields import count_equal_fields, count_fields, describe_field, wrong_fields
from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.commands.validate.equivalence.margins import (
    FLOAT32,
    GeometryScale,
    Margin,
    MarginChoice,
    float32_margin,
    float64_margin,
)
from evalkit.commands.validate.equivalence.questions import MAX_FLOAT32_REACH_M
from evalkit.core.pose import Pose
from evalkit.io.json_values import replace_non_finite

MAX_MOVED = 5
"""Questions of a family that are asked again with the source moved by the guess."""

MAX_RESTARTED = 2
"""Questions of a family that are asked again with a mistake in the guess."""

FEATURES: Mapping[str, Callable[[AskedQuestion], float]] = {
    "the heading of the guess (rad)": lambda one: one.drawn.question.guess.theta,
    "the size of the guess's heading (rad)": lambda one: abs(one.drawn.question.guess.theta),
    "the number of target points": lambda one: len(one.drawn.question.target),
    "the number of source points": lambda one: len(one.drawn.question.source),
    "the largest coordinate (m)": lambda one: float(np.abs(one.drawn.question.target.points).max(initial=0.0)),
    "the smallest coordinate (m)": lambda one: float(one.drawn.question.target.points.min(initial=0.0)),
    "the shift of the guess (m)": lambda one: math.hypot(one.drawn.question.guess.x, one.drawn.question.guess.y),
    "the number of pairs": lambda one: one.answers.a.inliers,
    "the number of iterations": lambda one: one.answers.a.iterations,
}
"""Quantities of a question that may decide whether an answer differs."""

MIN_WRONG, MIN_RIGHT = 3, 10


@dataclass(frozen=True, eq=False)
class _FamilySummary:
    """The questions of a family with their margins, those that differ, and the result as JSON values.

    ``plausible``: whether rounding explains the answers to clear points of the families so far.
    """

    members: Sequence[tuple[AskedQuestion, Margin]]
    wrong: Mapping[AskedQuestion, Divergence]
    plausible: bool
    equal_fields: int
    excused_fields: int
    values: Mapping[str, Any]


def summarise_questions(asked: Sequence[AskedQuestion], margin: MarginChoice) -> dict[str, Any]:
    """The comparison of all questions, in the form of an ``Equivalence`` and by family."""
    families: dict[str, _FamilySummary] = {}
    plausible = True
    for family in dict.fromkeys(one.drawn.family for one in asked):
        members = [(one, known) for one in asked
                   if one.drawn.family == family and (known := _margin_of(one.drawn.question, margin))]  # fmt: skip
        families[family] = _summarise_family(family, members, margin, plausible)
        plausible = families[family].plausible
    parts = families.values()
    count, beyond = sum(len(one.members) for one in parts), sum(len(one.wrong) for one in parts)
    margins = [known for one in parts for _, known in one.members]
    return {
        "equivalent": not beyond, "level": "answers", "n": count, "questions": count,
        "unanswered": sum(one.values["unanswered"] for one in parts), "beyond_rounding": beyond,
        "apart": sum(one.values["apart"] for one in parts),
        "first": next((first for one in parts if (first := one.values["first"])), None),
        "classes": {}, "intervals": [], "fields": {}, "equal_fields": sum(one.equal_fields for one in parts),
        "excused_fields": sum(one.excused_fields for one in parts),
        "margin": asdict(max([Margin(1e-300, 1e-300), *margins], key=lambda known: known.metres)),
        "families": {name: one.values for name, one in families.items()},
        "where": _describe_where([(each, each in one.wrong) for one in parts for each, _ in one.members]),
        "start": _describe_start([
            (each, dict(one.members)[each]) for one in parts for each in islice(one.wrong, MAX_RESTARTED)
        ]),
    }  # fmt: skip


def _summarise_family(
    family: str, members: Sequence[tuple[AskedQuestion, Margin]], margin: MarginChoice, plausible: bool
) -> _FamilySummary:
    """The comparison of the questions of one family; ``plausible``: as in ``_FamilySummary``, before this one."""

    @cache
    def is_undecided(one: AskedQuestion, known: Margin) -> bool:
        """Whether rounding decides the answer; asked for as long as rounding explains the answers to clear points."""
        return plausible and (margin == FLOAT32 or not one.others) and one.is_decided_by_rounding(known, margin)

    wrong: dict[AskedQuestion, Divergence] = {}
    effects = {one.effect for one, _ in members}
    ignored = family.removeprefix("parameter ") if "none" in effects and "some" not in effects else ""
    for one, known in members:
        divergence = one.judge(known, margin, ignored, not wrong and (plausible or margin != FLOAT32))
        if divergence and not is_undecided(one, known):
            wrong[one] = divergence
    plausible = plausible and not (family == "clear" and wrong)
    plain = [
        (one, known) for one, known in members
        if not one.others and not (plausible and one.has_wrong_field(known) and is_undecided(one, known))
    ]  # fmt: skip
    fields = count_fields([(one.answers, known) for one, known in plain], margin)
    alike = count_equal_fields([(one.answers, known) for one, known in members if not one.others], fields)
    examples = {
        name: f"{one.drawn.what}: {describe_field(name, one.answers.a, one.answers.b, known)}"
        for one, known in reversed(plain) if one.answers.b is not None
        for name in wrong_fields(one.answers.a, one.answers.b, known) if name != "pose"
    }  # fmt: skip
    missing, margin_of = sum(one.answers.b is None for one, _ in members), dict(members)
    first = next(iter(wrong.items()), None)
    values = {
        "asked": len(members), "wrong": len(wrong), "unanswered": missing, "fields": fields,
        "apart": len(members) - missing - sum(one.holds(known) for one, known in members),
        "compared": len(plain), "examples": {name: examples[name] for name in fields if name != "pose"},
        **_describe_differences([each for each in members if each[0] not in wrong]),
        "recounted": sum(one.is_recounted(divergence) for one, divergence in wrong.items()),
        "counted": all(one.is_counted() for one in wrong),
        "mispaired": any(
            one.is_mispaired(divergence, margin_of[one]) for one, divergence in islice(wrong.items(), MAX_MOVED)
        ),
        "what": first[0].drawn.what if first else "",
        "first": replace_non_finite(asdict(first[1])) if first else None,
    }  # fmt: skip
    return _FamilySummary(members, wrong, plausible, *alike, values)


def _margin_of(question: Question, margin: MarginChoice) -> Margin | None:
    """The margin of one question at its scale; None if single precision cannot hold its coordinates."""
    scale = GeometryScale.of(question.target, question.source, question.guess)
    if margin == FLOAT32:
        return float32_margin(scale) if scale.reach_m < MAX_FLOAT32_REACH_M else None
    return float64_margin(scale, margin)


def _describe_where(verdicts: list[tuple[AskedQuestion, bool]]) -> str:
    """The one quantity that separates the questions that differ from the others, in words; "" if there is none."""
    plain = [(one, wrong) for one, wrong in verdicts
             if not one.drawn.changes and not one.others and not math.isnan(one.answers.a.error)]  # fmt: skip
    if 2 * sum(differs for _, differs in plain) > len(plain):
        return ""
    for name, quantity in FEATURES.items():
        wrong = [quantity(one) for one, differs in plain if differs]
        right = [quantity(one) for one, differs in plain if not differs]
        if len(wrong) < MIN_WRONG or len(right) < MIN_RIGHT:
            return ""
        if min(wrong) > max(right):
            return f"only where {name} is above {max(right):.4g}, from {min(wrong):.4g} on"
        if max(wrong) < min(right):
            return f"only where {name} is below {min(right):.4g}, up to {max(wrong):.4g}"
        if not any(min(wrong) <= each <= max(wrong) for each in right):
            return f"only where {name} is between {min(wrong):.4g} and {max(wrong):.4g}"
    return ""


def _describe_differences(accepted: list[tuple[AskedQuestion, Margin]]) -> dict[str, Any]:
    """The largest difference of accepted answers, by its margin, and the number of those beyond their margin."""
    apart = []
    for one, margin in accepted:
        a, b = one.answers.a, one.answers.b
        if b is not None and one.holds(margin):
            here, there = a.target_from_source, b.target_from_source
            apart.append((math.hypot(there.x - here.x, there.y - here.y), margin.metres))
    largest_m, allowed_m = max(apart, key=lambda each: each[0] / each[1], default=(0.0, 0.0))
    return {"largest_m": largest_m, "allowed_m": allowed_m, "excepted": len(accepted) - len(apart)}


def _describe_start(wrong: list[tuple[AskedQuestion, Margin]]) -> str:
    """The mistakes in the guess with which the reference itself gives the other answers, in every field; "" if none.

    ``wrong``: some questions that differ, with their margins; one mistake has to explain all of them.
    """
    if len(wrong) < MIN_WRONG:
        return ""
    found: list[str] | None = None
    for one, margin in wrong:
        question, b = one.drawn.question, one.answers.b
        if b is None:
            return ""
        unreported = {"error"} if math.isnan(b.error) else set()
        explained = []
        for start in mistakes_in_start(question.guess.row):
            if found is None or start.what in found:
                again = lockstep.answer(one.reference, replace(question, guess=Pose.of(start.row)), one.answers.a).b
                if again is not None and unreported.issuperset(wrong_fields(again, b, margin)):
                    explained.append(start.what)
        found = explained
    return " or ".join(found or ())
