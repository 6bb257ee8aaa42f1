"""Where two answers to one question first part, and why: pairs, cost, step and pose of each iteration, then the end."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from evalkit.commands.validate.equivalence import correspondences
from evalkit.commands.validate.equivalence.diagnosis import (
    Kind,
    Mistake,
    apart,
    best_step,
    cost_told,
    explanation,
    in_answer,
    in_step,
)
from evalkit.commands.validate.equivalence.lockstep import Exchange, Question
from evalkit.commands.validate.equivalence.margins import FLOAT32_ROUNDOFF, TIE_ROUNDINGS, Margin, Scale, float32
from evalkit.core.arrays import Ints
from evalkit.core.match import Iteration, Match
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats


@dataclass(frozen=True)
class Divergence:
    """The first difference in one question: scan (from 1), stage, iteration (from 1; None: not told), class and what.

    ``quantity``: "pairs", "cost", "pose", "iterations", "answer" or "cells".
    """

    scan: int
    stage: str
    iteration: int | None
    quantity: str
    kind: Kind
    what: str

    def __str__(self) -> str:
        at = "" if self.iteration is None else f", iteration {self.iteration}"
        return f"scan {self.scan}, {self.stage}{at}, {self.quantity}: {self.kind}: {self.what}"


def first_divergence(exchange: Exchange, margin: Margin) -> Divergence | None:
    """The first difference between two answers beyond the margin; None where they are the same."""
    question, a, b = exchange.question, exchange.a, exchange.b
    if b is None:
        return Divergence(question.scan, question.stage, None, "answer", "different", f"B {exchange.failure}")
    comparison = _Comparison(question, a, b, margin)
    return comparison.along_the_path() or comparison.at_the_end()


class _Comparison:
    """Two answers to one question, held against each other."""

    def __init__(self, question: Question, a: Match, b: Match, margin: Margin) -> None:
        self._question, self._a, self._b, self._margin = question, a, b, margin
        self._scale = Scale.of(question.target, question.source, question.guess)
        self._rounding = float32(self._scale)
        self._lever_m = max(self._scale.radius_m, 0.1)

    def along_the_path(self) -> Divergence | None:
        """The first difference within the iterations both have told."""
        before_a = before_b = self._question.guess
        for number, (a, b) in enumerate(zip(self._a.history, self._b.history, strict=False), start=1):
            found = (
                self._of_pairs(number, before_a, before_b, a, b)
                or self._of_pose(number, before_a, a, b)
                or self._of_cost(number, before_a, a, b)
            )
            if found:
                return found
            before_a, before_b = a.target_from_source, b.target_from_source
        return None

    def at_the_end(self) -> Divergence | None:
        """How many iterations, and the answer itself."""
        told = bool(self._a.history and self._b.history) or bool(self._a.iterations and self._b.iterations)
        same = self._margin.holds(self._a.target_from_source, self._b.target_from_source)
        stopped = self._of_stop() if told else None
        if not (self._a.history and self._b.history):  # without a path, a wrong answer explains more than its length
            found = None if same else self._mistaken_answer() or stopped or self._unexplained_answer()
            return found or stopped or self._of_final_cost()
        if stopped or same:
            return stopped
        return self._mistaken_answer() or self._found(
            None, "answer", "different", f"the same path, another answer ({self._gap()})"
        )

    def _of_pairs(self, number: int, before_a: Pose, before_b: Pose, a: Iteration, b: Iteration) -> Divergence | None:
        if a.pairs is None or b.pairs is None:
            if a.inliers == b.inliers:
                return None
            kind: Kind = "outlier rule"
            return self._found(number, "pairs", kind, f"{a.inliers} pairs against {b.inliers}; not both tell which")
        if correspondences.same(a.pairs, b.pairs):
            return None
        parted = apart(before_a.row, before_b.row, self._scale.reach_m)
        tolerance_m = 2.0 * parted + TIE_ROUNDINGS * FLOAT32_ROUNDOFF * self._scale.reach_m
        kind, what = correspondences.told(self._question, before_a, a.pairs, b.pairs, tolerance_m, number == 1)
        return self._found(number, "pairs", kind, what)

    def _of_pose(self, number: int, before: Pose, a: Iteration, b: Iteration) -> Divergence | None:
        right, found = a.target_from_source, b.target_from_source
        if self._margin.holds(right, found):
            return None
        mistake = explanation(
            [*self._wrong_steps(before, a), *in_answer(right.row, self._question.guess.row)],
            right.row,
            found.row,
            self._lever_m,
        )
        if mistake:
            return self._found(number, "pose", mistake.kind, mistake.what)
        if self._rounding.holds(right, found):
            return self._found(number, "pose", "precision", f"within rounding to float32 ({self._growth(number)})")
        return self._found(number, "pose", "different", self._who_is_right(before, a, b))

    def _of_cost(self, number: int, before: Pose, a: Iteration, b: Iteration) -> Divergence | None:
        if _close(a.error, b.error, self._margin.metres):
            return None
        values = f"{a.error:.6g} m against {b.error:.6g} m for the same pairs and the same step"
        told_a, told_b = self._cost_told(before, a, a.error), self._cost_told(before, a, b.error)
        if told_a and told_b and told_a != told_b:
            return self._found(number, "cost", "cost", f"A tells {told_a}, B {told_b} ({values})")
        if abs(a.error - b.error) <= self._rounding.metres:
            return self._found(number, "cost", "precision", values)
        return self._found(number, "cost", "cost", values)

    def _of_stop(self) -> Divergence | None:
        a, b = self._a, self._b
        if a.iterations == b.iterations:
            if a.converged == b.converged:
                return None
            yes, no = ("A", "B") if a.converged else ("B", "A")
            what = f"after {a.iterations} iterations on the same path {yes} says converged, {no} does not"
            return self._found(a.iterations, "iterations", "stop rule", what)
        shorter, name, other = (a, "A", "B") if a.iterations < b.iterations else (b, "B", "A")
        at, on = sorted((a.iterations, b.iterations))
        if math.isnan(shorter.error):
            what = f"{name} gives up after {at} iterations, {other} goes on to {on}"
            return self._found(at, "iterations", "different", what)
        if not shorter.converged:
            what = f"{name} ends unconverged after {at} iterations, {other} goes on to {on}"
            return self._found(at, "iterations", "iteration cap", what)
        what = f"{name} stops after {at} iterations{_last_change(shorter)}, {other} goes on to {on}"
        return self._found(at, "iterations", "stop rule", what)

    def _mistaken_answer(self) -> Divergence | None:
        right, found = self._a.target_from_source.row, self._b.target_from_source.row
        mistake = explanation(in_answer(right, self._question.guess.row), right, found, self._lever_m)
        return self._found(None, "answer", mistake.kind, mistake.what) if mistake else None

    def _unexplained_answer(self) -> Divergence:
        a, b = self._a, self._b
        if self._rounding.holds(a.target_from_source, b.target_from_source):
            return self._found(None, "answer", "precision", f"within rounding to float32 ({self._gap()})")
        if a.inliers != b.inliers:
            what = f"{a.inliers} pairs against {b.inliers}; not both tell their path ({self._gap()})"
            return self._found(None, "answer", "outlier rule", what)
        return self._found(None, "answer", "different", f"not both tell their path ({self._gap()})")

    def _of_final_cost(self) -> Divergence | None:
        if _close(self._a.error, self._b.error, self._margin.metres):
            return None
        kind: Kind = "precision" if abs(self._a.error - self._b.error) <= self._rounding.metres else "cost"
        what = f"{self._a.error:.6g} m against {self._b.error:.6g} m for the same answer"
        return self._found(None, "cost", kind, what)

    def _wrong_steps(self, before: Pose, a: Iteration) -> list[Mistake]:
        if a.pairs is None or not len(a.pairs):
            return []
        source, target = self._paired(before, a.pairs)
        return in_step(before.row, source, target, before.transform(self._question.source.points))

    def _who_is_right(self, before: Pose, a: Iteration, b: Iteration) -> str:
        if a.pairs is None or not len(a.pairs):
            return f"another pose ({self._gap_of(a, b)})"
        best = Pose.of(best_step(*self._paired(before, a.pairs))) @ before
        right = [name for name, one in (("A", a), ("B", b)) if self._rounding.holds(best, one.target_from_source)]
        who = f"{right[0]}'s is best in least squares" if len(right) == 1 else "neither is best in least squares"
        return f"another step from the same pairs; {who} ({self._gap_of(a, b)})"

    def _cost_told(self, before: Pose, a: Iteration, error: float) -> str:
        if a.pairs is None or not len(a.pairs):
            return ""
        return cost_told(error, self._distances(before, a.pairs), self._distances(a.target_from_source, a.pairs))

    def _distances(self, pose: Pose, pairs: Ints) -> Floats:
        source, target = self._paired(pose, pairs)
        return np.asarray(np.linalg.norm(source - target, axis=1))

    def _paired(self, pose: Pose, pairs: Ints) -> tuple[Floats, Floats]:
        """The pairs' source points where a pose puts them, and their targets (both (K, 2))."""
        source, target = self._question.source.points, self._question.target.points
        return pose.transform(source[pairs[:, 0]]), target[pairs[:, 1]]

    def _growth(self, number: int) -> str:
        first = self._a.history[number - 1], self._b.history[number - 1]
        return f"{self._gap_of(*first)} here, {self._gap()} at the end"

    def _gap(self) -> str:
        return self._gap_of(self._a, self._b)

    @staticmethod
    def _gap_of(a: Iteration | Match, b: Iteration | Match) -> str:
        away = a.target_from_source.inverse() @ b.target_from_source
        return f"{math.hypot(away.x, away.y):.2g} m and {abs(away.theta):.2g} rad"

    def _found(self, number: int | None, quantity: str, kind: Kind, what: str) -> Divergence:
        return Divergence(self._question.scan, self._question.stage, number, quantity, kind, what)


def _close(a: float, b: float, tolerance: float) -> bool:
    if math.isnan(a) or math.isnan(b):  # no error told is no other error
        return True
    return abs(a - b) <= tolerance


def _last_change(match: Match) -> str:
    if len(match.history) < 2:
        return ""
    return f" (its error had changed by {abs(match.history[-1].error - match.history[-2].error):.2g} m)"
