"""Diagnosis of a difference: the results that common mistakes would give, compared with the observed one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats

DivergenceKind = Literal[
    "nearest-neighbour tie", "precision", "stop rule", "iteration cap", "outlier rule", "neighbours", "stale pairs",
    "step", "rounding", "start", "cost", "field", "parameter", "units", "sign", "different", "traversal",
    "endpoint rule", "clamp", "counting rule", "increment",
]  # fmt: skip

ROUNDING: tuple[DivergenceKind, ...] = ("precision", "nearest-neighbour tie")
"""Classes of divergence that rounding alone explains."""

EXPLAINED = 0.01
"""A mistake explains a difference if less than this share of it remains."""


@dataclass(frozen=True, eq=False)
class Mistake:
    """A common mistake: its class, a description, and the motion (3,) that it leads to."""

    kind: DivergenceKind
    what: str
    row: Floats


def find_mistake(mistakes: Sequence[Mistake], right: Floats, observed: Floats, lever_m: float) -> Mistake | None:
    """The mistake that leads from the right motion (3,) to the observed one, or None; turns weigh ``lever_m``."""
    if not mistakes:
        return None
    left = [motion_distance_m(mistake.row, observed, lever_m) for mistake in mistakes]
    best = int(np.argmin(left))
    return mistakes[best] if left[best] < EXPLAINED * motion_distance_m(right, observed, lever_m) else None


def motion_distance_m(a: Floats, b: Floats, lever_m: float) -> float:
    """The distance (m) of two motions, their turn measured at the end of a lever."""
    x, y, theta = se2.between(a, b)
    return float(math.hypot(x, y) + lever_m * abs(theta))


def mistakes_in_answer(answer: Floats, guess: Floats) -> list[Mistake]:
    """Mistakes in returning a right answer (3,)."""
    x, y, theta = answer
    swapped = np.array([y, x, theta])
    return [
        *_units("the answer", answer),
        *_signs("the answer", answer),
        Mistake("different", "the answer is the inverse: source_from_target", se2.inverse(answer)),
        Mistake("different", "the answer has x and y exchanged", swapped),
        *_orders("the answer", answer),
        *_folds("the answer", answer),
        Mistake("different", "the answer leaves out the guess", se2.compose(answer, se2.inverse(guess))),
        Mistake("different", "the answer is relative to the guess", se2.compose(se2.inverse(guess), answer)),
        Mistake("different", "the guess is returned as the answer", guess),
    ]


def mistakes_in_start(guess: Floats) -> list[Mistake]:
    """Mistakes in the start from a guess (3,)."""
    return [
        *_units("the guess", guess),
        *_signs("the guess", guess),
        Mistake("different", "the guess is inverted: source_from_target", se2.inverse(guess)),
        Mistake("different", "the guess is not used", np.zeros(3)),
        Mistake("different", "the heading of the guess is not used", np.array([*guess[:2], 0.0])),
        *_orders("the guess", guess),
        *_folds("the guess", guess),
    ]


def mistakes_in_step(before: Floats, source: Floats, target: Floats, everything: Floats) -> list[Mistake]:
    """Mistakes in a step from the pose before (3,): pairs (K, 2) and all source points (N, 2), moved by that pose."""
    p_bar, q_bar = source.mean(axis=0), target.mean(axis=0)
    step = best_step(source, target)
    theta = step[2]
    steps = [
        Mistake("different", "the rotation is transposed", _about(p_bar, q_bar, -theta)),
        Mistake("different", "the translation leaves out the rotation", np.array([*(q_bar - p_bar), theta])),
        Mistake("different", "the rotation is left out", np.array([*(q_bar - p_bar), 0.0])),
        Mistake(
            "different",
            "the centroid is that of all points, not of the pairs",
            _about(everything.mean(0), q_bar, theta),
        ),
        Mistake("different", "the step is inverted", se2.inverse(step)),
        Mistake("units", "the step's angle is in degrees", _about(p_bar, q_bar, math.degrees(theta))),
        Mistake("units", "the step's angle is converted to radians twice", _about(p_bar, q_bar, math.radians(theta))),
        *_units("the step", step),
        *_signs("the step", step),
    ]
    composed = [Mistake(one.kind, one.what, se2.compose(one.row, before)) for one in steps]
    wrong_side = Mistake("different", "the step is composed on the wrong side", se2.compose(before, step))
    return [*composed, wrong_side, *_turned_steps(before, p_bar, q_bar, theta)]


def _turned_steps(before: Floats, p_bar: Floats, q_bar: Floats, theta: float) -> Iterator[Mistake]:
    """The step about centroids (2,) with a sine of its degrees: for the pose before, for the centroid, or for both."""
    cosine, sine = math.cos(theta), math.sin(theta)

    def rotate(point: Floats, first: float, second: float) -> Floats:
        return np.array([cosine * point[0] - first * point[1], second * point[0] + cosine * point[1]])

    for where, first, second in wrong_sines(theta):
        what = f"the step is turned with {where} of its angle in degrees"
        for of_pose in ((sine, sine), (first, second)):
            for of_centroid in ((sine, sine), (first, second)):
                shift = q_bar + rotate(before[:2], *of_pose) - rotate(p_bar, *of_centroid)
                if (of_pose, of_centroid) != ((sine, sine), (sine, sine)):
                    yield Mistake("units", what, np.array([*shift, float(se2.wrap(before[2] + theta))]))


def wrong_sines(angle: float) -> Iterator[tuple[str, float, float]]:
    """Rotations by an angle (rad) with a sine of its degrees: which one, and the sines of their rows for x and y."""
    right, wrong = math.sin(angle), math.sin(math.degrees(angle))
    yield "the sine", wrong, wrong
    yield "the sine for x", wrong, right
    yield "the sine for y", right, wrong


def best_step(source: Floats, target: Floats) -> Floats:
    """The least-squares motion (3,) of pairs (K, 2) (Umeyama, PAMI 1991, in the plane)."""
    p_bar, q_bar = source.mean(axis=0), target.mean(axis=0)
    cross = (source - p_bar).T @ (target - q_bar)
    return _about(p_bar, q_bar, math.atan2(cross[0, 1] - cross[1, 0], cross[0, 0] + cross[1, 1]))


COSTS: dict[str, Callable[[Floats], float]] = {
    "mean distance": lambda d: float(d.mean()),
    "root mean square distance": lambda d: float(np.sqrt(np.mean(d * d))),
    "mean squared distance": lambda d: float(np.mean(d * d)),
    "median distance": lambda d: float(np.median(d)),
    "sum of distances": lambda d: float(d.sum()),
    "sum of squared distances": lambda d: float(np.sum(d * d)),
}


def name_cost(error: float, before: Floats, after: Floats) -> str:
    """The name of the cost of the distances (K,) before or after the step that equals an error; "" if none does."""
    for when, distances in (("after", after), ("before", before)):
        for name, cost in COSTS.items():
            if math.isclose(cost(distances), error, rel_tol=1e-5):
                return f"the {name} {when} the step"
    return ""


def _units(what: str, row: Floats) -> list[Mistake]:
    x, y, theta = row
    return [
        Mistake("units", f"{what}'s angle is in degrees", np.array([x, y, float(se2.wrap(math.degrees(theta)))])),
        Mistake("units", f"{what}'s angle is interpreted as degrees", np.array([x, y, math.radians(theta)])),
        *(
            Mistake("units", f"{what}'s translation is {name} of what it should be", np.array([x * by, y * by, theta]))
            for by, name in ((1e3, "1000 times"), (1e2, "100 times"), (1e-2, "a 100th"), (1e-3, "a 1000th"))
        ),
    ]


def _signs(what: str, row: Floats) -> list[Mistake]:
    x, y, theta = row
    return [
        Mistake("sign", f"{what}'s angle has the wrong sign", np.array([x, y, -theta])),
        Mistake("sign", f"{what}'s x has the wrong sign", np.array([-x, y, theta])),
        Mistake("sign", f"{what}'s y has the wrong sign", np.array([x, -y, theta])),
        Mistake("sign", f"{what}'s translation has the wrong sign", np.array([-x, -y, theta])),
    ]


def _orders(what: str, row: Floats) -> list[Mistake]:
    x, y, theta = row
    return [
        Mistake("different", f"{what}'s numbers are in the order theta, x, y", np.array([theta, x, y])),
        Mistake("different", f"{what}'s numbers are in the order y, theta, x", np.array([y, theta, x])),
    ]


def _folds(what: str, row: Floats) -> list[Mistake]:
    x, y, theta = row
    folds = (
        ("within a quarter turn, as by asin", math.asin(math.sin(theta))),
        ("positive, as by acos", abs(theta)),
        ("half a turn off, as by atan of a quotient", float(se2.wrap(theta + math.pi))),
    )
    return [Mistake("different", f"{what}'s heading is {how}", np.array([x, y, folded])) for how, folded in folds]


def _about(centre: Floats, moved_centre: Floats, theta: float) -> Floats:
    turn = np.array([0.0, 0.0, theta])
    x, y = moved_centre - se2.transform(turn, centre[None])[0]
    return np.array([x, y, float(se2.wrap(theta))])
