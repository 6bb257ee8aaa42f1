"""The factors of a study: each has levels, and each level gives values to some settings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

from evalkit.config.forms import FACTOR
from evalkit.config.toml_tables import TomlTable
from evalkit.core.errors import brief
from evalkit.design.designs import DesignAxis
from evalkit.plugins.parameters import Value

Scale = Literal["linear", "log"]
FactorSettings = Mapping[str, Value]
"""Values by their full names: "method.epsilon", "sequence.speed_mps", "mapper.resolution_m"."""

GROUPS = ("method", "sequence", "mapper")


@dataclass(frozen=True)
class FactorLevel:
    """One level: its label, the settings it gives, and its number if the factor is ordered (None if not)."""

    label: str
    sets: FactorSettings
    number: float | None = None


@dataclass(frozen=True)
class Factor:
    """A factor with its levels in the order given.

    ``default``: the index of the level that equals the study's own settings, None if no level does. ``sets``: the
    settings that all levels give, if the levels are plain values.
    """

    name: str
    levels: tuple[FactorLevel, ...]
    default: int | None = None
    scale: Scale = "linear"
    unit: str = ""
    sets: tuple[str, ...] = ()

    @property
    def numbers(self) -> tuple[float, ...] | None:
        """The levels' numbers, None if the levels are not ordered."""
        numbers = tuple(level.number for level in self.levels if level.number is not None)
        return numbers if len(numbers) == len(self.levels) else None

    @property
    def axis(self) -> DesignAxis:
        """The factor as an axis of a design."""
        numbers = self.numbers
        return DesignAxis(
            self.name, len(self.levels), None if numbers is None else tuple(map(self.coordinate, numbers))
        )

    def coordinate(self, number: float) -> float:
        """A number on the factor's scale."""
        return math.log10(number) if self.scale == "log" else number

    def at(self, share: float) -> tuple[FactorLevel, float]:
        """The level at a share (0 to 1) of the way from the first level to the last, and its position.

        Between the levels for numbers that are not whole, rounded to three digits; otherwise one of the levels.
        """
        numbers = self.numbers
        if numbers is None or not isinstance(next(iter(self.levels[0].sets.values())), float):
            number = min(int(share * len(self.levels)), len(self.levels) - 1)
            return self.levels[number], float(number)
        ends = self.coordinate(numbers[0]), self.coordinate(numbers[-1])
        place = ends[0] + share * (ends[1] - ends[0])
        number_at = float(f"{10.0**place if self.scale == 'log' else place:.3g}")
        number_at = min(max(number_at, numbers[0]), numbers[-1])
        return FactorLevel(f"{number_at:g}", dict.fromkeys(self.sets, number_at), number_at), self.position(number_at)

    def position(self, number: float) -> float:
        """The position of a number among the levels: 0 at the first, 1 at the second, linear on the scale between."""
        known = [self.coordinate(level) for level in self.numbers or ()]
        place = self.coordinate(number)
        low = max((i for i, level in enumerate(known[:-1]) if level <= place), default=0)
        return low + (place - known[low]) / (known[low + 1] - known[low])


def read_factor(table: TomlTable, base: FactorSettings) -> Factor:
    """The factor of a table: ``sets = NAME`` (or names) with a list of levels, or ``levels.LABEL = { NAME = VALUE }``.

    Its default is the level that agrees with ``base``. Raises BadExperiment with the key that is wrong.
    """
    table.check_keys(FACTOR.keys)
    given = table.content.get("levels")
    if not given or not isinstance(given, (list, Mapping)):
        raise table.bad_value("levels", "a list of at least two values, or a table of named settings")
    sets = _read_sets(table) if isinstance(given, list) else ()
    levels = _read_plain_levels(table, given, sets) if isinstance(given, list) else _read_named_levels(table, given)
    if len(levels) < 2 or len({level.label for level in levels}) < len(levels):
        raise table.bad_value("levels", "at least two that differ")
    name, scale = table.content.get("name", "".join(sets[:1])), table.content.get("scale", FACTOR.default("scale"))
    if not name or not isinstance(name, str):
        raise table.bad_value("name", "a text (a factor of named levels needs one)")
    if scale not in ("linear", "log"):
        raise table.bad_value("scale", "linear or log")
    default = next((i for i, level in enumerate(levels) if level.sets.items() <= base.items()), None)
    factor = Factor(name, levels, default, scale, table.text("unit", ""), sets)
    _check_order(table, factor)
    return factor


def _read_sets(table: TomlTable) -> tuple[str, ...]:
    """The settings that a factor with plain levels changes, by their full names."""
    value = table.content.get("sets")
    names: list[Any] = value if isinstance(value, list) else [value]
    for name in names or [None]:
        if not isinstance(name, str) or name.partition(".")[0] not in GROUPS or not name.partition(".")[2]:
            raise table.bad_value("sets", "method.NAME, sequence.NAME or mapper.NAME, or a list of them")
    return tuple(map(str, names))


def _read_plain_levels(table: TomlTable, values: list[Any], sets: tuple[str, ...]) -> tuple[FactorLevel, ...]:
    for value in values:
        if not isinstance(value, (bool, int, float, str)):
            raise table.error(f"'levels': found {brief(value)}, expected numbers, texts, true or false")
    kinds: set[type] = {type(value) for value in values}
    numbers = kinds <= {int, float}
    if len(kinds) > 1 and not numbers:
        raise table.bad_value("levels", "values of one type")
    same: list[Value] = [float(value) for value in values] if kinds == {int, float} else values
    return tuple(
        FactorLevel(_format_level(value), dict.fromkeys(sets, value), float(value) if numbers else None)
        for value in same
    )


def _read_named_levels(table: TomlTable, values: Mapping[str, Any]) -> tuple[FactorLevel, ...]:
    levels = []
    for label, settings in values.items():
        if not isinstance(settings, Mapping) or not settings:
            raise table.error(f"'levels.{label}': found {brief(settings)}, expected {{ NAME = VALUE, ... }}")
        for name, value in settings.items():
            if name.partition(".")[0] not in GROUPS or not isinstance(value, (bool, int, float, str)):
                raise table.error(
                    f"'levels.{label}': found {name} = {value!r}, expected values for "
                    '"method.NAME", "sequence.NAME" or "mapper.NAME" (in quotes)'
                )
        levels.append(FactorLevel(label, dict(settings)))
    return tuple(levels)


def _check_order(table: TomlTable, factor: Factor) -> None:
    """Refuses a log scale without positive numbers, and numbers that do not rise."""
    numbers = factor.numbers
    if numbers is None and factor.scale == "log":
        raise table.error("'scale': log is for numbers; remove the key")
    if numbers is not None and factor.scale == "log" and numbers[0] <= 0.0:
        raise table.error(f"'levels': found {numbers[0]:g}, expected positive numbers on a log scale")
    if numbers is not None and any(b <= a for a, b in pairwise(numbers)):
        raise table.error(f"'levels': found {list(numbers)}, expected numbers in rising order")


def _format_level(value: Value) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    return value if isinstance(value, str) else f"{value:g}"
