"""What is searched of a back end: its own parameters, each a factor with bounds or a list of values."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evalkit.commands.study.factors import Factor, Level
from evalkit.core.se2 import Floats
from evalkit.external.library import TRACE
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import FIRST_STAGE, BackendSpec

METHOD = "method."
DECADE = 10.0
"""An open bound of a number is this many times its default away."""

OCTAVES = (0.25, 0.5, 1.0, 2.0, 4.0)
"""What a whole number with an open bound is tried at, in units of its default."""

FEW = 8
"""A range of at most so many whole numbers is tried in full; a longer one at so many of them."""

SHARED = frozenset(parameter.name for parameter in frontend.PARAMETERS)
"""The front end's settings: they belong to all methods alike, whoever implements them."""


@dataclass(frozen=True)
class Candidate:
    """A point: where it lies in the unit cube (D,), the values that makes, and how it was found."""

    shares: tuple[float, ...]
    values: Mapping[str, Value]
    found: str

    @property
    def key(self) -> str:
        """Equal for equal values."""
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

    def at(self, shares: Sequence[float] | Floats, found: str) -> Candidate:
        """The point at a place in the unit cube: between the ends of a float's levels, else one of the levels."""
        values = dict(self.default)
        for factor, share in zip(self.factors, shares, strict=True):
            values |= settings(factor.at(float(share))[0])
        return Candidate(tuple(map(float, shares)), values, found)

    def start(self) -> Candidate:
        """The default, exactly, even where it lies outside the bounds; its place is then at the border."""
        shares = tuple(_share(factor, self.default) for factor in self.factors)
        return Candidate(shares, dict(self.default), "default")

    @property
    def size(self) -> int | None:
        """How many points there are, None where a factor is continuous."""
        if any(is_continuous(factor) for factor in self.factors):
            return None
        return math.prod(len(factor.levels) for factor in self.factors)


def is_continuous(factor: Factor) -> bool:
    """Whether points lie between its levels: its values are numbers and no whole ones."""
    return factor.numbers is not None and isinstance(next(iter(factor.levels[0].sets.values())), float)


def settings(level: Level) -> dict[str, Value]:
    """What a level sets, by parameter."""
    return {name.removeprefix(METHOD): value for name, value in level.sets.items()}


def own(spec: BackendSpec) -> tuple[Parameter, ...]:
    """The parameters that are the back end's own to tune: what it declares, without the front end's settings.

    An odometry that brings its own front end declares such settings under the same names; they stay as they are too.
    """
    known = frontend.settable_parameters(spec)
    return tuple(p for p in known if p.name not in SHARED)


def derived(parameters: Sequence[Parameter], default: Mapping[str, Value]) -> tuple[tuple[Factor, ...], dict[str, str]]:
    """Factors from what parameters declare, and why the others are not searched, by name.

    Choices and switches: all of them. Numbers: between both bounds where these are within two decades of each other or
    include zero; else a decade to both sides of the default, as far as the bounds let it (whole numbers: two octaves).
    """
    factors: list[Factor] = []
    left: dict[str, str] = {}
    for parameter in parameters:
        levels = _values(parameter, default[parameter.name])
        if isinstance(levels, str):
            left[parameter.name] = levels
        else:
            factors.append(_factor(parameter, levels))
    return tuple(factors), left


def _values(parameter: Parameter, default: Value) -> Sequence[Value] | str:
    """The levels of a parameter, or why there are none."""
    if parameter.name.removeprefix(FIRST_STAGE) == TRACE.name:
        return "tells more, finds nothing else"
    if isinstance(default, bool):
        return (False, True)
    if isinstance(default, str):
        return parameter.choices if len(parameter.choices) > 1 else "a text without declared choices"
    bounded = math.isfinite(parameter.low) and math.isfinite(parameter.high)
    if bounded and (parameter.low <= 0.0 or parameter.high <= DECADE**2 * parameter.low):
        ends = (parameter.low, parameter.high)
    elif default > 0:
        ends = (default / DECADE, default * DECADE)
    else:
        return f"its default is {default:g} and it has no bounds: name its levels"
    if isinstance(default, float):
        low, high = max(ends[0], parameter.low), min(ends[1], parameter.high)
        return (low, high) if low < high else "its bounds leave one value"
    whole = _whole(parameter, default, ends, bounded)
    return whole if len(whole) > 1 else "its bounds leave one value"


def _whole(parameter: Parameter, default: int, ends: tuple[float, float], bounded: bool) -> tuple[int, ...]:
    if bounded and ends == (parameter.low, parameter.high):
        span = np.linspace(*ends, min(FEW, int(ends[1] - ends[0]) + 1))
    else:
        span = default * np.array(OCTAVES)
    kept = np.clip(np.rint(span), parameter.low, parameter.high)
    return tuple(int(value) for value in np.unique(kept))


def _factor(parameter: Parameter, levels: Sequence[Value]) -> Factor:
    name = METHOD + parameter.name
    numbers = isinstance(levels[0], (int, float)) and not isinstance(levels[0], bool)
    made = tuple(Level(str(value), {name: value}, float(value) if numbers else None) for value in levels)
    wide = numbers and (made[0].number or 0.0) > 0.0 and (made[-1].number or 0.0) >= DECADE * (made[0].number or 0.0)
    return Factor(parameter.name, made, None, "log" if wide else "linear", parameter.unit, (name,))


def _share(factor: Factor, default: Mapping[str, Value]) -> float:
    """Where the default lies between a factor's ends, or the middle of the share of its level."""
    numbers = factor.numbers
    if numbers is not None:
        value = float(default[settings_name(factor)])
        known = [factor.coordinate(number) for number in numbers]
        if factor.scale == "log" and value <= 0.0:
            return 0.0
        if is_continuous(factor):
            return float(np.clip((factor.coordinate(value) - known[0]) / (known[-1] - known[0]), 0.0, 1.0))
        nearest = int(np.argmin(np.abs(np.array(known) - factor.coordinate(value))))
        return (nearest + 0.5) / len(known)
    at = next((i for i, level in enumerate(factor.levels) if settings(level).items() <= default.items()), 0)
    return (at + 0.5) / len(factor.levels)


def settings_name(factor: Factor) -> str:
    """The parameter a factor of plain values sets."""
    return factor.sets[0].removeprefix(METHOD)
