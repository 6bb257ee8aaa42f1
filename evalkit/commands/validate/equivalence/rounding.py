"""Whether rounding to single precision decides an answer: perturbed points change that of the reference as well."""

from __future__ import annotations

import numpy as np

from evalkit.commands.validate.equivalence.lockstep import Question
from evalkit.commands.validate.equivalence.margins import FLOAT32_ROUNDOFF, TIE_ROUNDINGS, Margin, Scale
from evalkit.core.match import Match
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

COPIES = 16
"""Copies of a question, perturbed by rounding."""


def is_decided_by_rounding(reference: Registration, question: Question, right: Match, margin: Margin) -> bool:
    """Whether points perturbed by rounding flip a pair or a stop of the reference, or move its answer beyond a margin.

    ``right``: the reference's answer to the unperturbed points. Where it is so, no implementation in single precision
    can be asked for the same answer.
    """
    rng = np.random.default_rng(0)
    reach = TIE_ROUNDINGS * FLOAT32_ROUNDOFF * Scale.of(question.target, question.source, question.guess).reach_m
    for _ in range(COPIES):
        target, source = (
            Cloud(one.points + rng.uniform(-reach, reach, one.points.shape))
            for one in (question.target, question.source)
        )
        match = reference.register(target, source, question.guess)
        counts = (match.inliers, match.iterations, match.converged)
        if counts != (right.inliers, right.iterations, right.converged) or not margin.holds(
            match.target_from_source, right.target_from_source
        ):
            return True
    return False
