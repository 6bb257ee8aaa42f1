"""Parameters of plug-ins: declaration, check of given values, defaults.

A plug-in declares its parameters once, as the fields of a dataclass::

    @dataclass(frozen=True)
    class Settings:
        max_iterations: int = parameter(40, "", "largest number of iterations", low=1)

and derives the table of its spec from them with ``declared_parameters(Settings)``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any

from evalkit.core.errors import BadParameter, UnknownName

Value = bool | int | float | str

NUISANCE, EXCERPT = "nuisance", "nuisance_scans"
"""Reserved parameters of a recording: the number of its perturbation, and the scans of an excerpt (0: all)."""

MAP, MAP_START, ALIGN_TRUTH = "map", "map_start", "align_truth"
"""Reserved parameters of a sequence on which methods track the robot in a known map: the map's file or ``TRUE_MAP``,
the start in the map as "x,y,yaw" (m, m, deg), "" to search it, and whether the ground truth is in another frame."""

TRUE_MAP = "truth"
"""In place of a file: the true map of the sequence."""

RESERVED = (NUISANCE, EXCERPT, MAP, MAP_START, ALIGN_TRUTH)

_KEY = "evalkit parameter"
_EXPECTED: dict[type, str] = {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of a plug-in; the type of ``default`` is the type of its values.

    ``low``, ``high``: inclusive bounds of a number. ``choices``: the values allowed for a text, () for any.
    """

    name: str
    default: Value
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()

    def check(self, owner: str, value: object) -> Value:
        """Return the value in the type of the default; raises BadParameter for another type or a value out of range."""
        wanted = type(self.default)
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, wanted) or isinstance(value, bool) != (wanted is bool):
            raise BadParameter(owner, self.name, value, f"{_EXPECTED[wanted]} ({self.meaning})")
        if isinstance(value, (int, float)) and not self.low <= value <= self.high:
            raise BadParameter(
                owner, self.name, value, f"a number within [{self.low:g}, {self.high:g}] {self.unit}".rstrip()
            )
        if self.choices and value not in self.choices:
            raise BadParameter(owner, self.name, value, f"one of {', '.join(self.choices)}")
        return value


def parameter(
    default: Value,
    unit: str,
    meaning: str,
    low: float = -math.inf,
    high: float = math.inf,
    choices: tuple[str, ...] = (),
) -> Any:
    """Return a dataclass field that declares a parameter; arguments as in ``Parameter``, the name is the field's."""
    declared = Parameter("", default, unit, meaning, low, high, choices)
    return field(default=default, metadata={_KEY: declared})


def declared_parameters(settings: type) -> tuple[Parameter, ...]:
    """Return the parameters that a dataclass declares with ``parameter``, in the order of its fields.

    Raises TypeError for another class.
    """
    if not is_dataclass(settings):
        raise TypeError(f"{settings.__name__} declares parameters but is no dataclass: is @dataclass missing?")
    declared = ((item.name, item.metadata[_KEY]) for item in fields(settings) if _KEY in item.metadata)
    return tuple(replace(found, name=name) for name, found in declared)


def check_fields(owner: str, settings: object) -> None:
    """Check the declared fields of a dataclass instance and convert them to their types; raises BadParameter."""
    for declared in declared_parameters(type(settings)):
        object.__setattr__(settings, declared.name, declared.check(owner, getattr(settings, declared.name)))


def split_settings(owner: str, words: Iterable[str], expected: str = "NAME=VALUE") -> dict[str, str]:
    """Return ``["a=1", "b=x"]`` as a dictionary. Raises BadParameter for a word without "=" or a name given twice."""
    given: dict[str, str] = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise BadParameter(owner, word, word, expected)
        if name in given:
            raise BadParameter(owner, name, text, f"one value, but {given[name]!r} is given too")
        given[name] = text
    return given


def resolve_parameters(owner: str, parameters: tuple[Parameter, ...], given: Mapping[str, object]) -> dict[str, Value]:
    """Return every parameter with its given value or its default.

    Raises UnknownName for a name that is not declared. Raises BadParameter for a value that does not fit, or for a name
    that is declared twice, as by a registration that has a parameter of the front end's name.
    """
    known = {parameter.name: parameter for parameter in parameters}
    if len(known) < len(parameters):
        names = [parameter.name for parameter in parameters]
        twice = next(name for name in names if names.count(name) > 1)
        raise BadParameter(owner, twice, "two of this name", "one: rename that of the plug-in")
    for name in given:
        if name not in known:
            raise UnknownName("parameter", name, known, owner)
    return {name: known[name].check(owner, given.get(name, known[name].default)) for name in known}


def with_defaults(parameters: tuple[Parameter, ...], /, **defaults: Value) -> tuple[Parameter, ...]:
    """Return the same parameters with other defaults; raises UnknownName for a name that is not among them."""
    names = [parameter.name for parameter in parameters]
    for name in defaults:
        if name not in names:
            raise UnknownName("parameter", name, names)
    return tuple(replace(p, default=defaults.get(p.name, p.default)) for p in parameters)
