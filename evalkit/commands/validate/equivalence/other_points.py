"""Mistakes in the points themselves: coordinates that are rounded, and points that are moved by another motion."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from evalkit.commands.validate.equivalence.diagnosis import DivergenceKind, wrong_sines
from evalkit.core import se2
from evalkit.core.se2 import Floats

DECIMALS = range(1, 7)
BINARY_PLACES = (4, 6, 7, 8, 10, 12, 14, 15, 16, 20)
MAX_DECIMALS = 9
"""Of numbers that are written as text; a number in double precision has so few by chance once in a million times."""

WRITTEN = 1e-14
"""The effect of wrapping a heading on a number that was read from text."""

PointMistake = tuple[DivergenceKind, str, Floats, Floats]
"""Class, description, target points (M, 2) and moved source points (N, 2)."""


def mistaken_points(before: Floats, target: Floats, source: Floats) -> Iterator[PointMistake]:
    """The points that mistakes in their coordinates or their motion by the pose before (3,) lead to."""
    for what, moved in _other_motions(before, source):
        yield "step", what, target, moved
    for step_m, name in _grids():
        for rounding, how in ((np.round, "rounded"), (np.trunc, "cut")):
            points, other = rounding(source / step_m) * step_m, rounding(target / step_m) * step_m
            what = f"coordinates are {how} to {name}"
            yield "rounding", what, other, se2.transform(before, points)
            yield "rounding", what, other, rounding(se2.transform(before, points) / step_m) * step_m
    half, onto = (each.astype(np.float16).astype(np.float64) for each in (source, target))
    yield "rounding", "coordinates are kept in half precision", onto, se2.transform(before, half)


def written_decimals(row: Floats) -> int | None:
    """The number of decimals (1 to 9) that all numbers of a pose (3,) end at; None if they have more, or are all 0."""
    if not np.isfinite(row).all() or not row.any():
        return None
    for decimals in range(1, MAX_DECIMALS + 1):
        if np.abs(row - np.round(row, decimals)).max() < WRITTEN:
            return decimals
    return None


def _series(angle: float, terms: int) -> tuple[float, float]:
    """Sine and cosine of an angle (rad) by the first terms of their series."""
    sine = sum((-1.0) ** k * angle ** (2 * k + 1) / math.factorial(2 * k + 1) for k in range(terms))
    cosine = sum((-1.0) ** k * angle ** (2 * k) / math.factorial(2 * k) for k in range(terms))
    return sine, cosine


def _grids() -> Iterator[tuple[float, str]]:
    for places in DECIMALS:
        yield 10.0**-places, f"{10.0**-places:g} m"
    for places in BINARY_PLACES:
        yield 2.0**-places, f"{places} bits behind the point"


def _other_motions(before: Floats, source: Floats) -> Iterator[tuple[str, Floats]]:
    c, s = math.cos(before[2]), math.sin(before[2])
    shift, theta = before[:2], float(before[2])

    def by(a: float, b: float, d: float, e: float) -> Floats:
        return np.asarray(source @ np.array([[a, b], [d, e]]).T + shift)

    yield "points are moved by the transposed rotation", by(c, s, -s, c)
    yield "points are moved by a rotation linearised in the angle", by(1.0, -theta, theta, 1.0)
    for terms in (2, 3, 4):
        sine, cosine = _series(theta, terms)
        what = f"points are moved by sine and cosine as series of {terms} terms: the rotation is inexact"
        yield what, by(cosine, -sine, sine, cosine)
    for where, first, second in wrong_sines(theta):
        yield f"points are turned with {where} of the angle in degrees", by(c, -first, second, c)
    yield "x is overwritten before y is computed from it", by(c, -s, s * c, c - s * s)
    yield "points are shifted before they are turned", se2.transform(np.array([0.0, 0.0, theta]), source + shift)
    yield "points are not shifted", by(c, -s, s, c) - shift
    yield "points are not turned", source + shift
    for steps in (256, 360, 512, 1024, 2048, 3600, 4096, 8192, 65536):
        for rounding, how in ((round, "nearest"), (math.floor, "lower")):
            angle = rounding(theta * steps / (2.0 * math.pi)) * 2.0 * math.pi / steps
            what = f"sine and cosine have {steps} steps a turn, the {how} one is taken: the rotation is rounded"
            yield what, se2.transform(np.array([*shift, angle]), source)
