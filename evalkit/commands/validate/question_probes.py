"""Drawn questions to both back ends, run in a separate process: plain values in, JSON values out."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from itertools import islice
from typing import Any, Literal

import numpy as np

from evalkit.commands.validate.drive_probes import compare_drives
from evalkit.commands.validate.equivalence import lockstep
from evalkit.commands.validate.equivalence.comparison import (
    FLOAT32,
    ROUNDING,
    MarginChoice,
    count_equal_fields,
    count_fields,
)
from evalkit.commands.validate.equivalence.diagnosis import mistakes_in_start
from evalkit.commands.validate.equivalence.divergence import (
    Divergence,
    describe_field,
    first_divergence,
    wrong_fields,
)
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, ComparedBackend, Question
from evalkit.commands.validate.equivalence.margins import GeometryScale, Margin, float32_margin, float64_margin
from evalkit.commands.validate.equivalence.questions import MAX_FLOAT32_REACH_M, DrawnQuestion, draw_questions
from evalkit.commands.validate.equivalence.rounding import is_decided_by_rounding, is_ill_conditioned
from evalkit.commands.validate.probes import Plugin, load_backend, parse_margin
from evalkit.commands.validate.rules.state_rules import match_bits
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.io.json_values import replace_non_finite
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import RegistrationSpec

TIE_M = 1e-5
"""How far (m, rad) the answers to the two sides of a tie may be from the answer to the tie itself."""

MAX_MOVED = 5
"""Questions of a family that are asked again with the source moved by the guess."""

MAX_RESTARTED = 2
"""Questions of a family that are asked again with a mistake in the guess."""

ProbedEffect = Literal["none", "some", "not asked"]
"""The effect of a changed parameter on an answer, where it has one on the reference."""

ParameterKey = tuple[tuple[str, Any], ...]


@dataclass(frozen=True, eq=False)
class Asked:
    """A drawn question with both answers; ``repeats``: the second answer came again to the bit at the end.

    ``ask``: asks both sides another question, with the same parameters.
    """

    drawn: DrawnQuestion
    answers: AnswerPair
    others: tuple[Match, ...]
    effect: ProbedEffect
    repeats: bool
    reference: Registration
    ask: Callable[[Question], AnswerPair]

    def is_decided_by_rounding(self, margin: Margin, choice: MarginChoice) -> bool:
        """Whether no implementation in single precision, or none at all, can be asked for this answer."""
        decides = is_decided_by_rounding if choice == FLOAT32 else is_ill_conditioned
        return decides(self.reference, self.drawn.question, self.answers.a, margin)


def compare_questions(a: Plugin, b: Plugin, seed: int, margins: list[str], quick: bool) -> Result:
    """The comparison of the answers to all drawn questions under every margin, by family.

    Back ends that are no registrations are asked drawn drives.
    """
    sides = load_backend(a), load_backend(b)
    if not all(isinstance(side.spec, RegistrationSpec) for side in sides):
        return compare_drives(sides, seed, {name: parse_margin(name) for name in margins})
    asked = _ask_all(sides, list(draw_questions(seed, *sides, quick)))
    unrepeated = sum(not one.repeats for one in asked)
    return {name: _summary(asked, parse_margin(name)) for name in margins} | {"seed": seed, "unrepeated": unrepeated}


def _ask_all(sides: tuple[ComparedBackend, ComparedBackend], drawn: list[DrawnQuestion]) -> list[Asked]:
    @cache
    def make_registration(side: int, key: ParameterKey) -> Registration:
        one = sides[side]
        return replace(one, parameters={**one.parameters, **dict(key)}).registrations()["s2m"]

    asked, bits = [], []
    for one in drawn:
        note_place(f"drawn questions, {one.family}: {one.what}")
        key = tuple(sorted(one.changes.items()))
        try:
            first = make_registration(0, key)
            match = first.register(one.question.target, one.question.source, one.question.guess)
            others = tuple(first.register(tie.target, tie.source, tie.guess) for tie in one.ties)
        except Exception:  # noqa: BLE001 - what the reference refuses is no question
            continue

        def ask(question: Question, first: Registration = first, key: ParameterKey = key) -> AnswerPair:
            match = first.register(question.target, question.source, question.guess)
            return _answer(lambda: make_registration(1, key), question, match, first)

        answers = _answer(lambda key=key: make_registration(1, key), one.question, match, first)
        asked.append(Asked(one, answers, others, _effect(make_registration, one, answers), True, first, ask))
        bits.append(None if answers.b is None else match_bits(answers.b))
    return _ask_again(asked, bits, make_registration)


def _ask_again(asked: list[Asked], bits: list[Any], make_registration: Any) -> list[Asked]:
    """The same, with whether each small question has the same answer again, in the opposite order."""
    again = list(asked)
    for number in reversed(range(len(asked))):
        one = asked[number].drawn
        if bits[number] is None or len(one.question.target) + len(one.question.source) > 5000:
            continue
        note_place(f"drawn questions again, {one.family}: {one.what}")
        registration = make_registration(1, tuple(sorted(one.changes.items())))
        answers = lockstep.answer(registration, one.question, asked[number].answers.a)
        repeats = answers.b is not None and match_bits(answers.b) == bits[number]
        again[number] = replace(asked[number], repeats=repeats)
    return again


def _answer(make: Any, question: Question, match: Match, reference: Registration) -> AnswerPair:
    try:
        registration: Registration = make()
    except Exception as error:  # noqa: BLE001 - a third party's exception is a difference to report
        return AnswerPair(question, match, None, f"cannot be created: {error}")
    return lockstep.answer(registration, question, match, reference)


def _effect(make_registration: Any, one: DrawnQuestion, answers: AnswerPair) -> ProbedEffect:
    """Whether a single parameter that changes the answer of the reference changes the other one too."""
    if len(one.changes) != 1 or answers.b is None or math.isnan(answers.b.error):
        return "not asked"
    question = one.question
    base_a = make_registration(0, ()).register(question.target, question.source, question.guess)
    base_b = lockstep.answer(make_registration(1, ()), question, base_a).b
    if base_b is None or match_bits(base_a) == match_bits(answers.a):
        return "not asked"
    return "none" if match_bits(base_b) == match_bits(answers.b) else "some"


def _margin_of(question: Question, margin: MarginChoice) -> Margin | None:
    """The margin of one question at its scale; None if single precision cannot hold its coordinates."""
    scale = GeometryScale.of(question.target, question.source, question.guess)
    if margin == FLOAT32:
        return float32_margin(scale) if scale.reach_m < MAX_FLOAT32_REACH_M else None
    return float64_margin(scale, margin)


@dataclass(frozen=True, eq=False)
class _FamilySummary:
    """The questions of a family with their margins, those that differ, and the result as JSON values.

    ``plausible``: whether rounding explains the answers to clear points of the families so far.
    """

    members: Sequence[tuple[Asked, Margin]]
    wrong: Mapping[Asked, Divergence]
    plausible: bool
    equal_fields: int
    excused_fields: int
    values: Mapping[str, Any]


def _summary(asked: Sequence[Asked], margin: MarginChoice) -> dict[str, Any]:
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
    family: str, members: Sequence[tuple[Asked, Margin]], margin: MarginChoice, plausible: bool
) -> _FamilySummary:
    """The comparison of the questions of one family; ``plausible``: as in ``_FamilySummary``, before this one."""

    @cache
    def is_undecided(one: Asked, known: Margin) -> bool:
        """Whether rounding decides the answer; asked for as long as rounding explains the answers to clear points."""
        return plausible and (margin == FLOAT32 or not one.others) and one.is_decided_by_rounding(known, margin)

    wrong: dict[Asked, Divergence] = {}
    effects = {one.effect for one, _ in members}
    ignored = family.removeprefix("parameter ") if "none" in effects and "some" not in effects else ""
    for one, known in members:
        divergence = _judge(one, known, margin, ignored, not wrong and (plausible or margin != FLOAT32))
        if divergence and not is_undecided(one, known):
            wrong[one] = divergence
    plausible = plausible and not (family == "clear" and wrong)
    plain = [
        (one, known) for one, known in members
        if not one.others and not (plausible and _has_wrong_field(one, known) and is_undecided(one, known))
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
        "apart": len(members) - missing - sum(_holds(*each) for each in members),
        "compared": len(plain), "examples": {name: examples[name] for name in fields if name != "pose"},
        **_describe_differences([each for each in members if each[0] not in wrong]),
        "recounted": sum(_is_recounted(*each) for each in wrong.items()),
        "counted": all(_is_counted(one.answers) for one in wrong),
        "mispaired": any(_is_mispaired(*each, margin_of[each[0]]) for each in islice(wrong.items(), MAX_MOVED)),
        "what": first[0].drawn.what if first else "",
        "first": replace_non_finite(asdict(first[1])) if first else None,
    }  # fmt: skip
    return _FamilySummary(members, wrong, plausible, *alike, values)


FEATURES: Mapping[str, Callable[[Asked], float]] = {
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


def _describe_where(verdicts: list[tuple[Asked, bool]]) -> str:
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


def _describe_differences(accepted: list[tuple[Asked, Margin]]) -> dict[str, Any]:
    """The largest difference of accepted answers, by its margin, and the number of those beyond their margin."""
    apart = [(_distance_m(one.answers), margin.metres) for one, margin in accepted if _holds(one, margin)]
    largest_m, allowed_m = max(apart, key=lambda each: each[0] / each[1], default=(0.0, 0.0))
    return {"largest_m": largest_m, "allowed_m": allowed_m, "excepted": len(accepted) - len(apart)}


def _holds(one: Asked, margin: Margin) -> bool:
    """Whether there is an answer, and its pose is equal within the margin."""
    a, b = one.answers.a, one.answers.b
    return b is not None and margin.holds(a.target_from_source, b.target_from_source)


def _distance_m(answers: AnswerPair) -> float:
    if answers.b is None:
        return math.inf
    a, b = answers.a.target_from_source, answers.b.target_from_source
    return math.hypot(b.x - a.x, b.y - a.y)


def _is_counted(answers: AnswerPair) -> bool:
    """Whether the answers show if only their stops differ: as many iterations, or the poses of the first answer."""
    a, b = answers.a, answers.b
    return b is not None and b.iterations > 0 and (a.iterations == b.iterations or bool(a.history))


def _is_recounted(one: Asked, divergence: Divergence) -> bool:
    """Whether the numbers of pairs differ: those of the first iteration that differs, or of the answers."""
    a, b = one.answers.a, one.answers.b
    return divergence.quantity == "pairs" or (
        divergence.quantity == "answer" and b is not None and a.inliers != b.inliers
    )


def _is_mispaired(one: Asked, divergence: Divergence, margin: Margin) -> bool:
    """Whether the first iteration has another number of pairs, from the identity too, with the source moved instead.

    No unit, sign or order of the guess, no motion of the points and no step has had an effect there.
    """
    if divergence.quantity != "pairs" or divergence.iteration != 1 or divergence.kind in ROUNDING:
        return False
    question = one.drawn.question
    moved = replace(question, source=Cloud(question.guess.transform(question.source.points)), guess=Pose())
    again = first_divergence(one.ask(moved), margin, explain=False)
    return again is not None and again.quantity == "pairs" and again.iteration == 1


def _describe_start(wrong: list[tuple[Asked, Margin]]) -> str:
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


def _has_wrong_field(one: Asked, margin: Margin) -> bool:
    b = one.answers.b
    return b is not None and bool(wrong_fields(one.answers.a, b, margin))


def _judge(one: Asked, margin: Margin, choice: MarginChoice, ignored: str, explain: bool) -> Divergence | None:
    """Why the second answer differs; None if it does not, or is only rounded under the float32 margin.

    ``ignored``: the parameter of the family that has no effect, or "".
    """
    answers = one.answers
    if answers.b is not None:
        near = replace(margin, metres=max(margin.metres, TIE_M), radians=max(margin.radians, TIE_M))
        accepted = [(answers.a, margin), *((other, near) for other in one.others)]
        if any(known.holds(a.target_from_source, answers.b.target_from_source) for a, known in accepted):
            return None
    divergence = first_divergence(answers, margin, explain)
    if divergence is None or (choice == FLOAT32 and divergence.kind in ROUNDING):
        return None
    if ignored and one.drawn.family.startswith("parameter "):
        what = f"parameter {ignored} has no effect"
        return replace(divergence, quantity="answer", kind="parameter", what=what)
    return divergence
