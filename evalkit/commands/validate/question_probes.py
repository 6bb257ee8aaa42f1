"""Drawn questions to both back ends, run in a separate process: plain values in, JSON values out."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

from evalkit.commands.validate.asked_question import AskedQuestion, ProbedEffect
from evalkit.commands.validate.drive_probes import compare_drives
from evalkit.commands.validate.equivalence import lockstep
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, ComparedBackend, Question
from evalkit.commands.validate.equivalence.questions import DrawnQuestion, draw_questions
from evalkit.commands.validate.probes import Plugin, load_backend, parse_margin
from evalkit.commands.validate.question_summary import summarise_questions
from evalkit.commands.validate.rules.state_rules import match_bits
from evalkit.core.match import Match
from evalkit.execution.sandbox import note_place
from evalkit.execution.task import Result
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import RegistrationSpec

ParameterKey = tuple[tuple[str, Any], ...]


def compare_questions(a: Plugin, b: Plugin, seed: int, margins: list[str], quick: bool) -> Result:
    """The comparison of the answers to all drawn questions under every margin, by family.

    Back ends that are no registrations are asked drawn drives.
    """
    sides = load_backend(a), load_backend(b)
    if not all(isinstance(side.spec, RegistrationSpec) for side in sides):
        return compare_drives(sides, seed, {name: parse_margin(name) for name in margins})
    asked = _ask_all(sides, list(draw_questions(seed, *sides, quick)))
    found: Result = {name: summarise_questions(asked, parse_margin(name)) for name in margins}
    return {**found, "seed": seed, "unrepeated": sum(not one.repeats for one in asked)}


def _ask_all(sides: tuple[ComparedBackend, ComparedBackend], drawn: list[DrawnQuestion]) -> list[AskedQuestion]:
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
        asked.append(AskedQuestion(one, answers, others, _effect(make_registration, one, answers), True, first, ask))
        bits.append(None if answers.b is None else match_bits(answers.b))
    return _ask_again(asked, bits, make_registration)


def _ask_again(asked: list[AskedQuestion], bits: list[Any], make_registration: Any) -> list[AskedQuestion]:
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
