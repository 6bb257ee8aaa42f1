"""What is varied in a study: factors with levels, each level a handful of settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from evalkit.commands.study.design import Axis
from evalkit.core.errors import BadExperiment, brief
from evalkit.plugins.parameters import Value

Scale = Literal["linear", "log"]
Settings = Mapping[str, Value]
"""Values by their full names: "method.epsilon", "sequence.speed_mps", "mapper.resolution_m"."""

ROOMS = ("method", "sequence", "mapper")
KEYS = ("name", "sets", "levels", "scale", "unit")


@dataclass(frozen=True)
class Level:
    """One level: how it is called, what it sets, and its number where the factor has an order."""

    label: str
    sets: Settings
    number: float | None = None


@dataclass(frozen=True)
class Factor:
    """A factor: ``levels`` in the order given; ``default`` is the study's own setting, None: no level is."""

    name: str
    levels: tuple[Level, ...]
    default: int | None = None
    scale: Scale = "linear"
    unit: str = ""
    sets: tuple[str, ...] = ()

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The levels' numbers, None where they are names."""
        found = tuple(level.number for level in self.levels if level.number is not None)
        return found if len(found) == len(self.levels) else None

    @property
    def axis(self) -> Axis:
        """The factor as a design sees it."""
        numbers = self.numbers
        return Axis(self.name, len(self.levels), None if numbers is None else tuple(map(self.coordinate, numbers)))

    def coordinate(self, number: float) -> float:
        """A number on the factor's scale."""
        return math.log10(number) if self.scale == "log" else number

    def at(self, share: float) -> tuple[Level, float]:
        """The level a share (0 to 1) of the way from the first to the last, and its position.

        Ordered factors that are no whole numbers are met between their levels, rounded to three digits.
        """
        numbers = self.numbers
        if numbers is None or not isinstance(next(iter(self.levels[0].sets.values())), float):
            number = min(int(share * len(self.levels)), len(self.levels) - 1)
            return self.levels[number], float(number)
        ends = self.coordinate(numbers[0]), self.coordinate(numbers[-1])
        place = ends[0] + share * (ends[1] - ends[0])
        number_at = float(f"{10.0**place if self.scale == 'log' else place:.3g}")
        number_at = min(max(number_at, numbers[0]), numbers[-1])
        return Level(f"{number_at:g}", dict.fromkeys(self.sets, number_at), number_at), self.position(number_at)

    def position(self, number: float) -> float:
        """Where a number lies among the levels: 0 at the first, 1 at the second."""
        known = [self.coordinate(level) for level in self.numbers or ()]
        place = self.coordinate(number)
        low = max((i for i, level in enumerate(known[:-1]) if level <= place), default=0)
        return low + (place - known[low]) / (known[low + 1] - known[low])

    def index(self, label: str) -> int | None:
        """The level of a label, None if there is none."""
        return next((i for i, level in enumerate(self.levels) if level.label == label), None)


def factor(table: Mapping[str, Any], file: str, place: str, base: Settings) -> Factor:
    """The factor of a table: ``sets = NAME`` (or names) with a list of levels, or ``levels.LABEL = { NAME = VALUE }``.

    Its default is the level that agrees with ``base``. BadExperiment names the key that is wrong.
    """
    for key in table:
        if key not in KEYS:
            raise BadExperiment(file, place, f"no key '{key}'; known: {', '.join(KEYS)}")
    levels = table.get("levels")
    if not levels or not isinstance(levels, (list, Mapping)):
        expected = "a list of at least two values, or a table of named settings"
        raise BadExperiment(file, place, f"'levels': found {brief(levels)}, expected {expected}")
    sets = _sets(table, file, place) if isinstance(levels, list) else ()
    made = _plain(levels, sets, file, place) if isinstance(levels, list) else _named(levels, file, place)
    if len(made) < 2 or len({level.label for level in made}) < len(made):
        raise BadExperiment(file, place, f"'levels': found {brief(levels)}, expected at least two that differ")
    name, scale, unit = (
        table.get(key, other) for key, other in (("name", "".join(sets[:1])), ("scale", "linear"), ("unit", ""))
    )
    if not name or not isinstance(name, str) or not isinstance(unit, str):
        raise BadExperiment(
            file, place, f"'name': found {brief(name)}, expected a text (a factor of named levels needs one)"
        )
    if scale not in ("linear", "log"):
        raise BadExperiment(file, place, f"'scale': found {brief(scale)}, expected linear or log")
    default = next((i for i, level in enumerate(made) if level.sets.items() <= base.items()), None)
    found = Factor(name, made, default, scale, unit, sets)
    _ordered(found, file, place)
    return found


def _sets(table: Mapping[str, Any], file: str, place: str) -> tuple[str, ...]:
    found = table.get("sets")
    names: list[Any] = found if isinstance(found, list) else [found]
    for name in names or [None]:
        if not isinstance(name, str) or name.partition(".")[0] not in ROOMS or not name.partition(".")[2]:
            expected = "method.NAME, sequence.NAME or mapper.NAME, or a list of them"
            raise BadExperiment(file, place, f"'sets': found {brief(found)}, expected {expected}")
    return tuple(map(str, names))


def _plain(levels: list[Any], sets: tuple[str, ...], file: str, place: str) -> tuple[Level, ...]:
    for value in levels:
        if not isinstance(value, (bool, int, float, str)):
            raise BadExperiment(file, place, f"'levels': found {brief(value)}, expected numbers, texts, true or false")
    kinds: set[type] = {type(value) for value in levels}
    numbers = kinds <= {int, float}
    if len(kinds) > 1 and not numbers:
        raise BadExperiment(file, place, f"'levels': found {brief(levels)}, expected values of one type")
    same: list[Value] = [float(value) for value in levels] if kinds == {int, float} else levels
    return tuple(Level(_label(value), dict.fromkeys(sets, value), float(value) if numbers else None) for value in same)


def _named(levels: Mapping[str, Any], file: str, place: str) -> tuple[Level, ...]:
    made = []
    for label, table in levels.items():
        if not isinstance(table, Mapping) or not table:
            raise BadExperiment(
                file, place, f"'levels.{label}': found {brief(table)}, expected {{ NAME = VALUE, ... }}"
            )
        for name, value in table.items():
            if name.partition(".")[0] not in ROOMS or not isinstance(value, (bool, int, float, str)):
                raise BadExperiment(file, place, f"'levels.{label}': found {name} = {value!r}, expected values for "
                                    '"method.NAME", "sequence.NAME" or "mapper.NAME" (in quotes)')  # fmt: skip
        made.append(Level(label, dict(table)))
    return tuple(made)


def _ordered(made: Factor, file: str, place: str) -> None:
    numbers = made.numbers
    if numbers is None and made.scale == "log":
        raise BadExperiment(file, place, "'scale': log is for numbers; remove the key")
    if numbers is not None and made.scale == "log" and numbers[0] <= 0.0:
        raise BadExperiment(file, place, f"'levels': found {numbers[0]:g}, expected positive numbers on a log scale")
    if numbers is not None and any(b <= a for a, b in pairwise(numbers)):
        raise BadExperiment(file, place, f"'levels': found {list(numbers)}, expected numbers in rising order")


def _label(value: Value) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else f"{value:g}"
