"""Check the tables of a configuration file; errors name file, table, key, what was found and what is expected."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from evalkit.config.forms import MAX_WHOLES, OPEN, FileKind, Form, Key
from evalkit.core.errors import BadExperiment, BadParameter, UnknownName, brief

T = TypeVar("T")


@contextmanager
def all_mistakes(content: Mapping[str, Any], kind: FileKind) -> Iterator[None]:
    """Add to the first mistake of a file, raised within the block, all others, each with its place."""
    try:
        yield
    except BadExperiment as error:
        from evalkit.config.mistakes import add_further_mistakes  # noqa: PLC0415 - it stands on this module

        raise add_further_mistakes(error, content, kind) from error


@dataclass(frozen=True)
class TomlTable:
    """A table of a configuration file. ``file`` and ``place`` (the table in words) are named in errors.

    ``form``: its keys, with their defaults and bounds; those that a method is given are used instead. Every method
    raises BadExperiment if a value is not what it reads. A key without a default is required.
    """

    content: Mapping[str, Any]
    file: str
    place: str = ""
    form: Form = OPEN

    def error(self, what: str) -> BadExperiment:
        """The error to raise for this table."""
        return BadExperiment(self.file, self.place, what)

    def bad_value(self, key: str, expected: str) -> BadExperiment:
        """The error to raise for the value of a key."""
        return self.error(f"'{key}': found {brief(self.content.get(key))}, expected {expected}")

    def with_label(self, label: str) -> TomlTable:
        """The same table with a label behind its place, as in "method 2 (icp)"."""
        return replace(self, place=f"{self.place} ({label})") if label else self

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Turn UnknownName and BadParameter within the block into errors of this table."""
        try:
            yield
        except (UnknownName, BadParameter) as error:
            raise self.error(str(error)) from error

    def check_keys(self, known: Iterable[str] = ()) -> None:
        """Refuses a key that is not among the known ones, which are those of the form if none are given."""
        known = tuple(known) or tuple(self.form.keys)
        for key in self.content:
            if key not in known:
                raise self.error(str(UnknownName("key", key, known)))

    def describe_missing(self, key: str) -> str:
        """Return that a key is missing; where others are parameters of a plug-in, that one near to it is no key."""
        others = [name for name in self.content if name not in self.form.keys] if self.form.plugins else []
        near = difflib.get_close_matches(key, others, n=1)
        return f"no key named {brief(near[0])} (did you mean '{key}'?)" if near else f"missing key '{key}'"

    def text(self, key: str, default: str | None = None) -> str:
        """A text."""
        value = self._find(key, default)
        if value is None and key not in self.content:
            raise self.error(self.describe_missing(key))
        if not isinstance(value, str):
            raise self.bad_value(key, "a text")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts, empty if the key is missing."""
        values = self.content.get(key, [])
        if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
            raise self.bad_value(key, "a list of texts")
        return tuple(values)

    def flag(self, key: str) -> bool:
        """True or false."""
        value, meaning = self._find(key), self._key(key).meaning
        if not isinstance(value, bool):
            raise self.bad_value(key, f"true or false ({meaning})" if meaning else "true or false")
        return value

    def number(self, key: str) -> float:
        """A number; with a lower bound, finite and at least that."""
        value, low = self._find(key), self._key(key).low
        number = isinstance(value, (int, float)) and not isinstance(value, bool)
        if not number or (low is not None and not low <= value < math.inf):
            raise self.bad_value(key, "a number" if low is None else f"a number from {low:g}")
        return float(value)

    def positive_number(self, key: str) -> float:
        """A number above 0, as it is written."""
        value: Any = self._find(key)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
            raise self.bad_value(key, "a positive number")
        return value

    def whole_number(self, key: str, default: int | None = None) -> int:
        """A whole number within its bounds; the lower one is 0 where it has none."""
        value, low, high = self._find(key, default), self._key(key).low or 0, self._key(key).high
        if type(value) is not int or value < low or (high is not None and value > high):
            raise self.bad_value(key, f"a whole number from {low:g}" + (f" to {high}" if high is not None else ""))
        return value

    def whole_numbers(self, key: str, empty: bool = False) -> tuple[int, ...]:
        """A list of at most ``MAX_WHOLES`` whole numbers from 0, without repetitions; ``empty``: it may have none."""
        values = self._find(key)
        if not isinstance(values, list) or not (values or empty) or not all(type(v) is int and v >= 0 for v in values):
            raise self.bad_value(key, "a list of whole numbers from 0" + (", at least one" if values == [] else ""))
        if len(values) > MAX_WHOLES:
            raise self.error(f"'{key}': found {len(values)} numbers, expected at most {MAX_WHOLES}")
        return tuple(dict.fromkeys(values))

    def choice(self, key: str, kind: str, known: Mapping[str, T], where: str = "") -> T:
        """The value in ``known`` with the name under a key; the error message contains ``kind`` and ``where``."""
        name = self._find(key)
        if not isinstance(name, str) or name not in known:
            raise self.error(str(UnknownName(kind, str(name), known, where)))
        return known[name]

    def table(self, key: str, keys: str) -> TomlTable:
        """The table of a key, empty if there is none; ``keys`` describes its keys in errors."""
        value = self.content.get(key, {})
        if not isinstance(value, Mapping):
            raise BadExperiment(self.file, key, f"found {brief(value)}, expected a table [{key}]{keys}")
        return TomlTable(value, self.file, key, self._key(key).form or OPEN)

    def tables(self, key: str, owner: str = "") -> list[TomlTable]:
        """The tables [[key]], placed as "key 1", "key 2", ...; ``owner`` ("a study"): needs at least one."""
        values = self.content.get(key, [])
        if not isinstance(values, list) or not all(isinstance(value, Mapping) for value in values):
            raise BadExperiment(self.file, key, f"expected tables [[{key}]]")
        if owner and not values:
            raise BadExperiment(self.file, "", f"no [[{key}]]: {owner} needs at least one")
        form = self._key(key).form or OPEN
        return [TomlTable(value, self.file, f"{key} {number + 1}", form) for number, value in enumerate(values)]

    def _key(self, name: str) -> Key:
        return self.form.keys.get(name, Key("any"))

    def _find(self, key: str, default: Any = None) -> Any:
        """The value of a key, else the default given, else that of the form."""
        return self.content.get(key, self._key(key).default if default is None else default)


def flatten(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """The values of nested tables by dotted names; TOML reads ``s2s.one_to_one = false`` as such a table."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat.update(flatten(value, f"{prefix}{key}.") if isinstance(value, Mapping) else {prefix + key: value})
    return flat
