"""The search space of a back end: its own parameters, each a factor with bounds or a list of values."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.design.factors import Factor, FactorLevel
from evalkit.external.library import TRACE
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import FIRST_STAGE, BackendSpec

METHOD = "method."
DECADE = 10.0
"""Ratio of an open bound to the default."""

OCTAVES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Levels of a whole number with an open bound, in units of its default."""

MAX_LEVELS = 8
"""Levels of a bounded whole number; a shorter range is tried in full."""

SHARED = frozenset(parameter.name for parameter in frontend.PARAMETERS)
"""The front end's parameters: they are the same for all methods, also for a back end with its own front end."""


@dataclass(frozen=True)
class TuningCandidate:
    """A point: its place in the unit cube (D,), its values by parameter, and how it was found."""

    shares: tuple[float, ...]
    values: Mapping[str, Value]
    found: str

    @property
    def key(self) -> str:
        """A text that is equal for equal values."""
        return json.dumps(dict(self.values), sort_keys=True)

    @property
    def name(self) -> str:
        """Eight digits that change with the values."""
        return hashlib.sha256(self.key.encode()).hexdigest()[:8]


@dataclass(frozen=True)
class Space:
    """The factors of one back end, and its default values by parameter."""

    factors: tuple[Factor, ...]
    default: Mapping[str, Value]

    def at(self, shares: Sequence[float] | Floats, found: str) -> TuningCandidate:
        """The point at a place in the unit cube: between the ends of a float's levels, otherwise one of the levels."""
        values = dict(self.default)
        for factor, share in zip(self.factors, shares, strict=True):
            values |= settings(factor.at(float(share))[0])
        return TuningCandidate(tuple(map(float, shares)), values, found)

    def start(self) -> TuningCandidate:
        """The default exactly, even if it lies outside the bounds; its place is then at the border."""
        shares = tuple(_find_share(factor, self.default) for factor in self.factors)
        return TuningCandidate(shares, dict(self.default), "default")

    @property
    def size(self) -> int | None:
        """The number of points, None if a factor is continuous."""
        if any(is_continuous(factor) for factor in self.factors):
            return None
        return math.prod(len(factor.levels) for factor in self.factors)


def is_continuous(factor: Factor) -> bool:
    """Whether a factor takes values between its levels: numbers that are not whole."""
    return factor.numbers is not None and isinstance(next(iter(factor.levels[0].sets.values())), float)


def settings(level: FactorLevel) -> dict[str, Value]:
    """The values of a level by parameter."""
    return {name.removeprefix(METHOD): value for name, value in level.sets.items()}


def list_own_parameters(spec: BackendSpec) -> tuple[Parameter, ...]:
    """The parameters to tune: those that the back end declares, without the front end's.

    An odometry with its own front end declares those under the same names; they are not tuned either.
    """
    return tuple(p for p in frontend.settable_parameters(spec) if p.name not in SHARED)


def make_declared_factors(
    parameters: Sequence[Parameter], default: Mapping[str, Value]
) -> tuple[tuple[Factor, ...], dict[str, str]]:
    """Factors from the declarations of parameters, and why other parameters are not searched, by name.

    Choices and switches: all values. Numbers: between both bounds if these are within two decades of each other or
    include zero; otherwise a decade to both sides of the default (whole numbers: two octaves), within the bounds.
    """
    factors: list[Factor] = []
    excluded: dict[str, str] = {}
    for parameter in parameters:
        try:
            factors.append(_make_factor(parameter, _choose_levels(parameter, default[parameter.name])))
        except NotSearchable as error:
            excluded[parameter.name] = str(error)
    return tuple(factors), excluded


class NotSearchable(Exception):
    """A parameter declares too little to be searched; the message names what is missing."""


def _choose_levels(parameter: Parameter, default: Value) -> Sequence[Value]:
    """The levels of a parameter. Raises NotSearchable if its declaration gives none."""
    if parameter.name.removeprefix(FIRST_STAGE) == TRACE.name:
        raise NotSearchable("it adds a trace to the output, it does not change the result")
    if isinstance(default, bool):
        return (False, True)
    if isinstance(default, str):
        if len(parameter.choices) < 2:
            raise NotSearchable("a text without declared choices")
        return parameter.choices
    bounded = math.isfinite(parameter.low) and math.isfinite(parameter.high)
    if bounded and (parameter.low <= 0.0 or parameter.high <= DECADE**2 * parameter.low):
        ends = (parameter.low, parameter.high)
    elif default > 0:
        ends = (default / DECADE, default * DECADE)
    else:
        raise NotSearchable(f"its default is {default:g} and it has no bounds: name its levels")
    if isinstance(default, float):
        low, high = max(ends[0], parameter.low), min(ends[1], parameter.high)
        levels: Sequence[Value] = (low, high) if low < high else ()
    else:
        levels = _choose_whole_levels(parameter, default, ends, bounded)
    if len(levels) < 2:
        raise NotSearchable("its bounds leave one value")
    return levels


def _choose_whole_levels(
    parameter: Parameter, default: int, ends: tuple[float, float], bounded: bool
) -> tuple[int, ...]:
    if bounded and ends == (parameter.low, parameter.high):
        span = np.linspace(*ends, min(MAX_LEVELS, int(ends[1] - ends[0]) + 1))
    else:
        span = default * np.array(OCTAVES)
    inside = np.clip(np.rint(span), parameter.low, parameter.high)
    return tuple(int(value) for value in np.unique(inside))


def _make_factor(parameter: Parameter, levels: Sequence[Value]) -> Factor:
    name = METHOD + parameter.name
    numbers = isinstance(levels[0], (int, float)) and not isinstance(levels[0], bool)
    factor_levels = tuple(FactorLevel(str(value), {name: value}, float(value) if numbers else None) for value in levels)
    low, high = factor_levels[0].number or 0.0, factor_levels[-1].number or 0.0
    wide = numbers and low > 0.0 and high >= DECADE * low
    return Factor(parameter.name, factor_levels, None, "log" if wide else "linear", parameter.unit, (name,))


def _find_share(factor: Factor, default: Mapping[str, Value]) -> float:
    """The place of the default between a factor's ends, or the middle of its level's share."""
    numbers = factor.numbers
    if numbers is not None:
        value = float(default[get_parameter_name(factor)])
        known = [factor.coordinate(number) for number in numbers]
        if factor.scale == "log" and value <= 0.0:
            return 0.0
        if is_continuous(factor):
            return float(np.clip((factor.coordinate(value) - known[0]) / (known[-1] - known[0]), 0.0, 1.0))
        nearest = int(np.argmin(np.abs(np.array(known) - factor.coordinate(value))))
        return (nearest + 0.5) / len(known)
    at = next((i for i, level in enumerate(factor.levels) if settings(level).items() <= default.items()), 0)
    return (at + 0.5) / len(factor.levels)


def get_parameter_name(factor: Factor) -> str:
    """The parameter that a factor of plain values sets."""
    return factor.sets[0].removeprefix(METHOD)
