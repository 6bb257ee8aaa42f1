"""A drawn question with both answers, and what they show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from evalkit.commands.validate.equivalence.diagnosis import ROUNDING
from evalkit.commands.validate.equivalence.divergence import Divergence, first_divergence
from evalkit.commands.validate.equivalence.fields import wrong_fields
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, Question
from evalkit.commands.validate.equivalence.margins import FLOAT32, Margin, MarginChoice
from evalkit.commands.validate.equivalence.questions import DrawnQuestion
from evalkit.commands.validate.equivalence.rounding import is_decided_by_rounding, is_ill_conditioned
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

TIE_M = 1e-5
"""How far (m, rad) the answers to the two sides of a tie may be from the answer to the tie itself."""

ProbedEffect = Literal["none", "some", "not asked"]
"""The effect of a changed parameter on an answer, where it has one on the reference."""


@dataclass(frozen=True, eq=False)
class AskedQuestion:
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

    def holds(self, margin: Margin) -> bool:
        """Whether there is an answer, and its pose is equal within the margin."""
        a, b = self.answers.a, self.answers.b
        return b is not None and margin.holds(a.target_from_source, b.target_from_source)

    def has_wrong_field(self, margin: Margin) -> bool:
        """Whether there is an answer, and any of its fields differs."""
        b = self.answers.b
        return b is not None and bool(wrong_fields(self.answers.a, b, margin))

    def judge(self, margin: Margin, choice: MarginChoice, ignored: str, explain: bool) -> Divergence | None:
        """Why the second answer differs; None if it does not, or is only rounded under the float32 margin.

        ``ignored``: the parameter of the family that has no effect, or "".
        """
        answers = self.answers
        if answers.b is not None:
            near = replace(margin, metres=max(margin.metres, TIE_M), radians=max(margin.radians, TIE_M))
            accepted = [(answers.a, margin), *((other, near) for other in self.others)]
            if any(known.holds(a.target_from_source, answers.b.target_from_source) for a, known in accepted):
                return None
        divergence = first_divergence(answers, margin, explain)
        if divergence is None or (choice == FLOAT32 and divergence.kind in ROUNDING):
            return None
        if ignored and self.drawn.family.startswith("parameter "):
            what = f"parameter {ignored} has no effect"
            return replace(divergence, quantity="answer", kind="parameter", what=what)
        return divergence

    def is_counted(self) -> bool:
        """Whether the answers show if only their stops differ: as many iterations, or the poses of the first answer."""
        a, b = self.answers.a, self.answers.b
        return b is not None and b.iterations > 0 and (a.iterations == b.iterations or bool(a.history))

    def is_recounted(self, divergence: Divergence) -> bool:
        """Whether the numbers of pairs differ: those of the first iteration that differs, or of the answers."""
        a, b = self.answers.a, self.answers.b
        return divergence.quantity == "pairs" or (
            divergence.quantity == "answer" and b is not None and a.inliers != b.inliers
        )

    def is_mispaired(self, divergence: Divergence, margin: Margin) -> bool:
        """Whether the first iteration has another number of pairs, also from the identity with the source moved.

        No unit, sign or order of the guess, no motion of the points and no step has had an effect there.
        """
        if divergence.quantity != "pairs" or divergence.iteration != 1 or divergence.kind in ROUNDING:
            return False
        question = self.drawn.question
        moved = replace(question, source=Cloud(question.guess.transform(question.source.points)), guess=Pose())
        again = first_divergence(self.ask(moved), margin, explain=False)
        return again is not None and again.quantity == "pairs" and again.iteration == 1
