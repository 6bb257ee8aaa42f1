"""The first divergence of two answers to one question, and its cause: by iteration, then at the end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from evalkit.commands.validate.equivalence import correspondences
from evalkit.commands.validate.equivalence.diagnosis import (
    DivergenceKind,
    Mistake,
    best_step,
    find_mistake,
    mistakes_in_answer,
    motion_distance_m,
    name_cost,
)
from evalkit.commands.validate.equivalence.fields import describe_field, same_error, wrong_fields
from evalkit.commands.validate.equivalence.hypotheses import ObservedStep
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, Question
from evalkit.commands.validate.equivalence.margins import (
    FLOAT32_ROUNDOFF,
    TIE_ROUNDINGS,
    GeometryScale,
    Margin,
    describe_gap,
    float32_margin,
)
from evalkit.commands.validate.equivalence.other_points import written_decimals
from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Registration

MAX_RESTARTS = 50
"""Times that a reference is asked again from its last pose, for its poses after more iterations."""

EXACT = 1e-13
"""The distance of exactly placed points, as a share of the largest coordinate."""


@dataclass(frozen=True)
class Divergence:
    """The first difference in one question: scan (from 1), stage, iteration (from 1; None: unknown), class and text.

    ``quantity``: "pairs", "cost", "pose", "iterations", "answer" or "cells".
    """

    scan: int
    stage: str
    iteration: int | None
    quantity: str
    kind: DivergenceKind
    what: str

    def __str__(self) -> str:
        at = "" if self.iteration is None else f", iteration {self.iteration}"
        return f"scan {self.scan}, {self.stage}{at}, {self.quantity}: {self.kind}: {self.what}"


def first_divergence(answered: AnswerPair, margin: Margin, explain: bool = True) -> Divergence | None:
    """The first difference between two answers beyond the margin; None if there is none.

    ``explain``: search for the rule that causes it where pairs are not known, which takes some milliseconds.
    """
    question, a, b = answered.question, answered.a, answered.b
    if b is None:
        return Divergence(question.scan, question.stage, None, "answer", "different", f"B {answered.failure}")
    wrong = wrong_fields(a, b, margin)
    stops = {"iterations", "trace length"} if bool(a.history) == bool(b.history) else {"iterations"}
    explained = ({"pose"}, stops, {"error", "trace error"})  # by the first iteration that differs
    if wrong and not any(each <= set(wrong) for each in explained):
        what = f"the pose is equal, but not {', '.join(wrong)}: {describe_field(wrong[0], a, b, margin)}"
        return Divergence(question.scan, question.stage, None, "answer", "field", what)
    comparison = _AnswerComparison(answered, b, margin, explain)
    return comparison.in_iterations() or comparison.at_the_end()


class _AnswerComparison:
    """Two answers to one question."""

    def __init__(self, answered: AnswerPair, b: Match, margin: Margin, explain: bool) -> None:
        self._question, self._a, self._reference = answered.question, answered.a, answered.reference
        self._b, self._margin, self._explain = b, margin, explain
        self._scale = GeometryScale.of(self._question.target, self._question.source, self._question.guess)
        self._rounding = float32_margin(self._scale)
        self._lever_m = max(self._scale.radius_m, 0.1)

    def in_iterations(self) -> Divergence | None:
        """The first difference within the iterations that both report."""
        before_a = before_b = self._question.guess
        for number, (a, b) in enumerate(zip(self._a.history, self._b.history, strict=False), start=1):
            divergence = (
                self._compare_pairs(number, before_a, before_b, a, b)
                or self._compare_poses(number, before_a, a, b)
                or self._compare_costs(number, before_a, a, b)
            )
            if divergence:
                return divergence
            before_a, before_b = a.target_from_source, b.target_from_source
        return None

    def at_the_end(self) -> Divergence | None:
        """The difference in the number of iterations, or in the answer itself."""
        same = self._margin.holds(self._a.target_from_source, self._b.target_from_source)
        if not (self._a.history and self._b.history):
            return self._compare_ends(same)
        stopped = self._compare_stops()
        if stopped or same:
            return stopped
        return self._mistaken_answer() or self._divergence(
            None, "answer", "different", f"the same iterations, another answer ({self._gap()})"
        )

    def _compare_ends(self, same: bool) -> Divergence | None:
        """The difference where not both report their iterations; ``same``: the pose is equal."""
        ended = self._compare_stops() if self._a.iterations and self._b.iterations else None
        if ended and ended.kind != "different" and self._stops_on_path():
            return ended
        failed = ended if ended and ended.kind == "different" else None
        if same:
            return failed or self._compare_counts() or self._compare_final_costs()
        return self._mistaken_answer() or failed or self._unexplained_answer()

    def _compare_pairs(
        self, number: int, before_a: Pose, before_b: Pose, a: Iteration, b: Iteration
    ) -> Divergence | None:
        if a.pairs is None or b.pairs is None:
            same = self._margin.holds(a.target_from_source, b.target_from_source)
            if a.inliers == b.inliers or same:
                return None
            if mistake := self._hypothesis(number, before_a, a, b):
                return self._divergence(number, "pairs", mistake.kind, mistake.what)
            if self._rounding.holds(a.target_from_source, b.target_from_source):
                return self._divergence(number, "pairs", "precision", "another number of pairs, within rounding")
            return self._divergence(
                number, "pairs", "different", f"{a.inliers} pairs against {b.inliers}; not both report their pairs"
            )
        if correspondences.same_pairs(a.pairs, b.pairs):
            return None
        distance_m = motion_distance_m(before_a.row, before_b.row, self._scale.reach_m)
        tolerance_m = 2.0 * distance_m + TIE_ROUNDINGS * FLOAT32_ROUNDOFF * self._scale.reach_m
        kind, what = correspondences.explain_difference(
            self._question, before_a, a.pairs, b.pairs, tolerance_m, number == 1
        )
        return self._divergence(number, "pairs", kind, what)

    def _compare_poses(self, number: int, before: Pose, a: Iteration, b: Iteration) -> Divergence | None:
        right, other = a.target_from_source, b.target_from_source
        if self._margin.holds(right, other):
            return None
        if written := self._describe_decimals(right, other):
            return self._divergence(number, "pose", "rounding", written)
        if self._rounding.holds(right, other):
            return self._divergence(number, "pose", "precision", f"within rounding to float32 ({self._growth(number)})")
        answers = mistakes_in_answer(right.row, self._question.guess.row)
        mistake = find_mistake(answers, right.row, other.row, self._lever_m) or self._hypothesis(number, before, a, b)
        if mistake:
            return self._divergence(number, "pose", mistake.kind, mistake.what)
        return self._divergence(number, "pose", "different", self._least_squares_side(before, a, b))

    def _compare_costs(self, number: int, before: Pose, a: Iteration, b: Iteration) -> Divergence | None:
        if same_error(a.error, b.error, self._margin.metres):
            return None
        values = f"an error of {a.error:.6g} m against {b.error:.6g} m for the same pairs and the same step"
        cost_a, cost_b = self._name_cost(before, a, a.error), self._name_cost(before, a, b.error)
        if cost_a and cost_b and cost_a != cost_b:
            return self._divergence(number, "cost", "cost", f"A reports {cost_a}, B {cost_b} ({values})")
        if abs(a.error - b.error) <= self._rounding.metres:
            return self._divergence(number, "cost", "precision", values)
        return self._divergence(number, "cost", "cost", values)

    def _compare_stops(self) -> Divergence | None:
        a, b = self._a, self._b
        if a.iterations == b.iterations:
            if a.converged == b.converged:
                return None
            yes, no = ("A", "B") if a.converged else ("B", "A")
            what = f"after {a.iterations} identical iterations {yes} reports converged, {no} does not"
            return self._divergence(a.iterations, "iterations", "stop rule", what)
        shorter, name, other = (a, "A", "B") if a.iterations < b.iterations else (b, "B", "A")
        at, on = sorted((a.iterations, b.iterations))
        if math.isnan(shorter.error):
            what = f"{name} fails after {at} iterations, {other} continues to {on}"
            return self._divergence(at, "iterations", "different", what)
        if not shorter.converged:
            what = f"{name} ends unconverged after {at} iterations, {other} continues to {on}"
            return self._divergence(at, "iterations", "iteration cap", what)
        what = f"{name} stops after {at} iterations{_last_change(shorter)}, {other} continues to {on}"
        return self._divergence(at, "iterations", "stop rule", what)

    def _stops_on_path(self) -> bool:
        """Whether B's answer is the pose of the reference after as many iterations: only the stop differs then."""
        pose = _pose_after(self._b.iterations, self._a, self._question, self._reference)
        other = self._b.target_from_source
        return pose is not None and (self._margin.holds(pose, other) or self._rounding.holds(pose, other))

    def _compare_counts(self) -> Divergence | None:
        """The difference of numbers of iterations, or of their end, that no stop explains."""
        a, b = self._a, self._b
        names = [name for name in ("converged", "iterations") if getattr(a, name) != getattr(b, name)]
        if not (a.iterations and b.iterations and names):
            return None
        what = f"the pose is equal, but not {', '.join(names)}: {describe_field(names[-1], a, b, self._margin)}"
        return self._divergence(None, "answer", "field", what)

    def _mistaken_answer(self) -> Divergence | None:
        right, other = self._a.target_from_source.row, self._b.target_from_source.row
        guess = self._question.guess
        if math.isnan(self._a.error) and not self._a.converged and self._a.target_from_source == guess:
            what = f"with too few pairs A returns the guess, B another pose ({self._gap()})"
            return self._divergence(None, "answer", "different", what)
        if len(self._a.history) > 1 and self._margin.holds(
            self._a.history[-2].target_from_source, self._b.target_from_source
        ):
            return self._divergence(None, "answer", "different", "the pose before the last step is returned")
        mistake = find_mistake(mistakes_in_answer(right, self._question.guess.row), right, other, self._lever_m)
        return self._divergence(None, "answer", mistake.kind, mistake.what) if mistake else None

    def _unexplained_answer(self) -> Divergence:
        a, b = self._a, self._b
        if written := self._describe_decimals(a.target_from_source, b.target_from_source):
            return self._divergence(None, "answer", "rounding", written)
        if self._rounding.holds(a.target_from_source, b.target_from_source):
            return self._divergence(None, "answer", "precision", f"within rounding to float32 ({self._gap()})")
        if len(a.history) == b.iterations == 1:
            only = Iteration(b.error, b.inliers, b.target_from_source)
            if mistake := self._hypothesis(1, self._question.guess, a.history[0], only):
                return self._divergence(None, "answer", mistake.kind, mistake.what)
        if a.inliers != b.inliers:
            what = f"{a.inliers} pairs against {b.inliers}; not both report their iterations ({self._gap()})"
            return self._divergence(None, "answer", "different", what)
        counts = f"{a.iterations} iterations against {b.iterations}; " if a.iterations and b.iterations else ""
        what = f"{counts if a.iterations != b.iterations else ''}not both report their iterations ({self._gap()})"
        return self._divergence(None, "answer", "different", what)

    def _compare_final_costs(self) -> Divergence | None:
        if same_error(self._a.error, self._b.error, self._margin.metres):
            return None
        kind: DivergenceKind = "precision" if abs(self._a.error - self._b.error) <= self._rounding.metres else "cost"
        what = f"{self._a.error:.6g} m against {self._b.error:.6g} m for the same answer"
        return self._divergence(None, "cost", kind, what)

    def _hypothesis(self, number: int, before: Pose, a: Iteration, b: Iteration) -> Mistake | None:
        """The rule whose change leads from the reference's pairs to the other pose; None without pairs or cause."""
        history = self._a.history[: number - 1]
        if not self._explain or a.pairs is None or not len(a.pairs):
            return None
        observed = ObservedStep(
            self._question.target.points, self._question.source.points, before.row, self._question.guess.row, a.pairs,
            a.target_from_source.row, b.target_from_source.row, b.inliers, history[0].pairs if history else None,
            history[-1].pairs if history else None, self._lever_m,
        )  # fmt: skip
        return observed.explain()

    def _describe_decimals(self, right: Pose, other: Pose) -> str:
        """That a pose was written with few decimals, in words; "" if it was not.

        Its numbers differ by at most one in the last place, and it does not place the points exactly: a true motion
        may have few decimals.
        """
        decimals = written_decimals(other.row)
        if decimals is None or other == self._question.guess or written_decimals(right.row) == decimals:
            return ""
        apart = max(abs(other.x - right.x), abs(other.y - right.y), abs(float(se2.wrap(other.theta - right.theta))))
        if apart > (1.0 + 1e-9) * 10.0**-decimals or self._is_exact(other):
            return ""
        return f"the numbers of the pose are written with {decimals} decimals: rounded"

    def _is_exact(self, pose: Pose) -> bool:
        """Whether a pose places most of the source points on target points, but for rounding."""
        tree = cKDTree(self._question.target.points)
        distance = tree.query(pose.transform(self._question.source.points))[0]
        return float(np.median(distance)) <= EXACT * self._scale.reach_m

    def _least_squares_side(self, before: Pose, a: Iteration, b: Iteration) -> str:
        gap = describe_gap(a.target_from_source, b.target_from_source)
        if a.pairs is None or not len(a.pairs):
            return f"different poses ({gap})"
        best = Pose.of(best_step(*self._select_points(before, a.pairs))) @ before
        right = [name for name, one in (("A", a), ("B", b)) if self._rounding.holds(best, one.target_from_source)]
        best_side = f"that of {right[0]}" if len(right) == 1 else "neither"
        pairs = "the same" if b.pairs is not None else "as many"
        return f"different steps from {pairs} pairs; {best_side} is the least-squares step ({gap})"

    def _name_cost(self, before: Pose, a: Iteration, error: float) -> str:
        if a.pairs is None or not len(a.pairs):
            return ""
        return name_cost(error, self._distances(before, a.pairs), self._distances(a.target_from_source, a.pairs))

    def _distances(self, pose: Pose, pairs: Ints) -> Floats:
        source, target = self._select_points(pose, pairs)
        return np.asarray(np.linalg.norm(source - target, axis=1))

    def _select_points(self, pose: Pose, pairs: Ints) -> tuple[Floats, Floats]:
        """The source points of the pairs, moved by a pose, and their targets (both (K, 2))."""
        source, target = self._question.source.points, self._question.target.points
        return pose.transform(source[pairs[:, 0]]), target[pairs[:, 1]]

    def _growth(self, number: int) -> str:
        a, b = (match.history[number - 1].target_from_source for match in (self._a, self._b))
        return f"{describe_gap(a, b)} here, {self._gap()} at the end"

    def _gap(self) -> str:
        return describe_gap(self._a.target_from_source, self._b.target_from_source)

    def _divergence(self, number: int | None, quantity: str, kind: DivergenceKind, what: str) -> Divergence:
        return Divergence(self._question.scan, self._question.stage, number, quantity, kind, what)


def _pose_after(count: int, match: Match, question: Question, reference: Registration | None) -> Pose | None:
    """The pose of the reference after a number of iterations: of its trace, or asked again from where it stopped.

    None if it has no trace, or does not go on.
    """
    for _ in range(MAX_RESTARTS):
        if count <= len(match.history):
            return match.history[count - 1].target_from_source if count > 0 else None
        if not match.history or reference is None:
            return None
        count -= len(match.history)
        match = reference.register(question.target, question.source, match.target_from_source)
    return None


def _last_change(match: Match) -> str:
    if len(match.history) < 2:
        return ""
    return f" (its error changed by {abs(match.history[-1].error - match.history[-2].error):.2g} m)"
