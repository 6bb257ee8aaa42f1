"""Whether rounding decides an answer: points perturbed by rounding change that of the reference as well."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.commands.validate.equivalence.margins import FLOAT32_ROUNDOFF, TIE_ROUNDINGS, GeometryScale, Margin
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

COPIES = 16
"""Copies of a question, perturbed by rounding to single or to double precision."""

FLOAT64_ROUNDOFF = float(np.finfo(np.float64).eps)


def is_decided_by_rounding(reference: Registration, question: Question, right: Match, margin: Margin) -> bool:
    """Whether points perturbed by rounding flip a pair or a stop of the reference, or move its answer beyond a margin.

    ``right``: the reference's answer to the unperturbed points. Where it is so, no implementation in single precision
    can be asked for the same answer.
    """
    for match in _answer_perturbed(reference, question, FLOAT32_ROUNDOFF):
        counts = (match.inliers, match.iterations, match.converged)
        if counts != (right.inliers, right.iterations, right.converged) or not margin.holds(
            match.target_from_source, right.target_from_source
        ):
            return True
    return False


def is_ill_conditioned(reference: Registration, question: Question, right: Match, margin: Margin) -> bool:
    """Whether points perturbed by rounding to double precision move a pose of the reference by a tenth of a margin.

    A pose after an iteration, or the last one, with as many pairs: a pair that flips is a tie, and no reason.
    """
    tenth = replace(margin, metres=0.1 * margin.metres, radians=0.1 * margin.radians)
    expected = _list_poses(right)
    for match in _answer_perturbed(reference, question, FLOAT64_ROUNDOFF):
        if _count_pairs(match) == _count_pairs(right) and not all(map(tenth.holds, _list_poses(match), expected)):
            return True
    return False


def is_reached_by_rounding(reference: Registration, question: Question, answer: Pose) -> bool:
    """Whether the reference gives an answer where its points are perturbed by rounding to double precision."""
    return any(
        Margin().holds(match.target_from_source, answer)
        for match in _answer_perturbed(reference, question, FLOAT64_ROUNDOFF)
    )


def _answer_perturbed(reference: Registration, question: Question, roundoff: float) -> Iterator[Match]:
    """The answers of the reference to copies of a question with perturbed points."""
    rng = np.random.default_rng(0)
    reach = TIE_ROUNDINGS * roundoff * GeometryScale.of(question.target, question.source, question.guess).reach_m
    for _ in range(COPIES):
        target, source = (
            Cloud(one.points + rng.uniform(-reach, reach, one.points.shape))
            for one in (question.target, question.source)
        )
        yield reference.register(target, source, question.guess)


def _list_poses(match: Match) -> list[Pose]:
    return [*(one.target_from_source for one in match.history), match.target_from_source]


def _count_pairs(match: Match) -> tuple[object, ...]:
    return (match.converged, match.iterations, match.inliers, *(one.inliers for one in match.history))
