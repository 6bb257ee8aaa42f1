"""Errors of estimated motions against measured motions between pairs of times (relations); no common frame needed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.ground_truth import Relations
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Evidence, make_metrics, make_score
from evalkit.metrics.trajectory import can_interpolate

RelationPart = Literal["short", "long", "all"]

MAX_GAP_S = 2.0
"""The estimate is interpolated at the stamps of a relation between poses at most this far apart."""

SHORT_S = 10.0
"""Relations over less time show local consistency, the others drift."""


def symmetric_errors(estimated: ArrayLike, measured: ArrayLike) -> Floats:
    """Return errors in metres and radians (M, 2) between motions ``first_from_second`` (M, 3), averaged over both
    orders.

    The translation error depends on the order of the two times of a relation; the mean of both orders does not.
    """
    forward = ordered_errors(estimated, measured)
    backward = ordered_errors(se2.inverse(estimated), se2.inverse(measured))
    metres = 0.5 * (np.linalg.norm(forward[:, :2], axis=1) + np.linalg.norm(backward[:, :2], axis=1))
    return np.stack([metres, np.abs(forward[:, 2])], axis=1)


def ordered_errors(estimated: ArrayLike, measured: ArrayLike) -> Floats:
    """Return the motions (M, 3) measured^-1 estimated: Kuemmerle et al., Autonomous Robots 27, 2009, as printed."""
    return se2.between(measured, estimated)


def componentwise_errors(estimated: ArrayLike, measured: ArrayLike) -> Floats:
    """Return the differences (M, 3) of x, y and heading, as computed by the evaluator of Kuemmerle et al.

    Their norms equal those of ``ordered_errors``.
    """
    difference = np.asarray(estimated, dtype=np.float64) - np.asarray(measured, dtype=np.float64)
    difference[:, 2] = se2.wrap(difference[:, 2])
    return difference


def cartographer_errors(estimated: ArrayLike, measured: ArrayLike) -> Floats:
    """Return the motions (M, 3) estimated measured^-1, as computed by Cartographer's evaluator: the opposite order."""
    return se2.compose(estimated, se2.inverse(measured))


def compute_estimated_motions(estimate: Trajectory, relations: Relations) -> tuple[Floats, Bools]:
    """Return the estimate's ``first_from_second`` (K, 3), and which relations (M,) the estimate covers."""
    covered = can_interpolate(estimate.stamps_ns, relations.first_ns, MAX_GAP_S) & can_interpolate(
        estimate.stamps_ns, relations.second_ns, MAX_GAP_S
    )
    world_from_first = estimate.at(relations.first_ns[covered])
    return se2.between(world_from_first, estimate.at(relations.second_ns[covered])), covered


def select_part(relations: Relations, part: RelationPart) -> Bools:
    """Return which relations (M,) span less than 10 s ("short"), 10 s or more ("long"), or any time ("all")."""
    short = np.abs(relations.second_ns - relations.first_ns) < SHORT_S * 1e9
    return np.asarray({"short": short, "long": ~short, "all": np.ones_like(short)}[part])


Errors = Callable[[Floats, Floats], Floats]
"""Metres and radians (M, 2) between estimated and measured motions (M, 3)."""


def _compute_norms(errors: Errors) -> Errors:
    def sizes(estimated: Floats, measured: Floats) -> Floats:
        motions = errors(estimated, measured)
        return np.stack([np.linalg.norm(motions[:, :2], axis=1), np.abs(motions[:, 2])], axis=1)

    return sizes


def _score_with(
    part: RelationPart,
    column: int,
    statistic: Callable[[Floats], np.floating],
    form: Errors = symmetric_errors,
    squared: bool = False,
) -> Callable[[Evidence], Score]:
    def compute(evidence: Evidence) -> Score:
        relations = evidence.truth.relations
        if relations is None or len(relations) == 0:
            return Score(None, reason=_NO_RELATIONS)
        wanted = select_part(relations, part)
        motions, covered = compute_estimated_motions(evidence.run.estimate, relations)
        measured = relations.first_from_second[covered]
        errors = form(motions, measured)[wanted[covered], column]
        if len(errors) == 0:
            kind = "" if part == "all" else f"{part} "
            return Score(None, reason=f"the estimate covers none of {wanted.sum()} {kind}relations")
        errors = np.degrees(errors) if column else errors
        return make_score(statistic(errors**2 if squared else errors), len(errors))

    return compute


def _score_covered(evidence: Evidence) -> Score:
    relations = evidence.truth.relations
    if relations is None or len(relations) == 0:
        return Score(None, reason=_NO_RELATIONS)
    return make_score(100.0 * compute_estimated_motions(evidence.run.estimate, relations)[1].mean(), len(relations))


_NO_RELATIONS = "no measured relations"

_PARTS: tuple[RelationPart, ...] = ("all", "short", "long")
_STATISTICS: dict[str, Callable[[Floats], np.floating]] = {"mean": np.mean, "sd": np.std}
_UNITS = ("m", "deg")
_FORMS: dict[str, Errors] = {"kuemmerle": componentwise_errors, "cartographer": cartographer_errors}

METRICS = make_metrics(
    "relations",
    {
        **{
            f"relations_{part}_{name}_{unit}": _score_with(part, column, statistic)
            for part in _PARTS
            for name, statistic in _STATISTICS.items()
            for column, unit in enumerate(_UNITS)
        },
        **{
            f"relations_{form}_{name}_m": _score_with("all", 0, statistic, _compute_norms(errors))
            for form, errors in _FORMS.items()
            for name, statistic in _STATISTICS.items()
        },
        **{
            f"relations_square_{name}_{unit}2": _score_with(
                "all", column, statistic, _compute_norms(componentwise_errors), squared=True
            )
            for name, statistic in _STATISTICS.items()
            for column, unit in enumerate(_UNITS)
        },
        "relations_answered_percent": _score_covered,
    },
)
