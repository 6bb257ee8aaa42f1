"""Find all mistakes of an experiment, study or tuning file at once.

The reader of such a file stops at its first mistake. Only then is the file searched for others, with the forms and the
checks of the reader.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice
from typing import Any

from evalkit.config.forms import FORMS, FileKind, Key, Plugins, Type
from evalkit.config.toml_tables import TomlTable, flatten
from evalkit.core.errors import BadExperiment, BadParameter, EvalkitError, NotInstalled, UnknownName
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters

# What stands behind a likely name; further mistakes leave it out.
KNOWN = r"(\(did you mean '[^']*'\?\)); known: [^;]*"
MAX_MISTAKES, MAX_CHARACTERS = 100, 800
"""The search ends after so many mistakes; those beyond this length of the message are counted, not listed."""

Find = Callable[[str], Any]
Resolve = Callable[[str, Any, Mapping[str, object]], object]

PLUGINS: Mapping[Plugins, tuple[Find, Resolve]] = {
    "backends": (registry.find_backend, frontend.complete_parameters),
    "datasets": (registry.dataset, lambda owner, spec, given: resolve_parameters(owner, spec.parameters, given)),
    "mappers": (registry.mapper, lambda owner, spec, given: resolve_parameters(owner, spec.parameters, given)),
}
"""How the plug-in of a table is found, and its parameters checked."""

CHECKS: Mapping[Type, Callable[[TomlTable, str], object]] = {
    "text": TomlTable.text,
    "texts": TomlTable.texts,
    "flag": TomlTable.flag,
    "whole": TomlTable.whole_number,
    "wholes": partial(TomlTable.whole_numbers, empty=True),
    "number": TomlTable.number,
    "positive": TomlTable.positive_number,
    "table": partial(TomlTable.table, keys=""),
    "tables": TomlTable.tables,
}


def add_further_mistakes(first: BadExperiment, content: Mapping[str, Any], kind: FileKind) -> BadExperiment:
    """Return the first mistake of a file with all others behind it, each with its place."""
    file, place, what = first.args
    found = list(islice(find_mistakes(content, kind), MAX_MISTAKES))
    lines = [re.sub(KNOWN, r"\1", _join(*one)) for one in found if not _is_told(*one, place, what)]
    text = what
    for listed, line in enumerate(lines):
        if len(text) + len(line) > MAX_CHARACTERS:
            text += f"; and {'at least ' if len(found) == MAX_MISTAKES else ''}{len(lines) - listed} more"
            break
        text += f"; also {line}"
    return BadExperiment(file, place, text)


def find_mistakes(content: Mapping[str, Any], kind: FileKind) -> Iterator[tuple[str, str]]:
    """Yield every mistake of a file's content: its place, such as "method 2" (or ""), and what is wrong there."""
    return _find_in(TomlTable(content, "", form=FORMS[kind]))


def _find_in(table: TomlTable) -> Iterator[tuple[str, str]]:
    """Yield the mistakes of a table and of those in it."""
    if not table.form.plugins:
        for name in table.content:
            if name not in table.form.keys:
                yield table.place, str(UnknownName("key", name, table.form.keys))
    for name, key in table.form.keys.items():
        if name in table.content:
            yield from _find_in_value(table, name, key)
        elif key.required:
            yield table.place, _describe_missing(table, name, key)
    if table.form.plugins and isinstance(table.content.get("use"), str):
        yield from _find_in_plugin(table, *PLUGINS[table.form.plugins])


def _find_in_value(table: TomlTable, name: str, key: Key) -> Iterator[tuple[str, str]]:
    """Yield the mistakes of the value of a key and, if it holds tables, of those."""
    if key.type == "any":
        return
    try:
        value = CHECKS[key.type](table, name)
    except BadExperiment as error:
        yield error.args[1], error.args[2]
        return
    if key.form is not None:
        inner: Any = [value] if key.type == "table" else value
        for each in inner:
            yield from _find_in(each)


def _find_in_plugin(table: TomlTable, find: Find, resolve: Resolve) -> Iterator[tuple[str, str]]:
    """Yield an unknown plug-in, and the mistakes of its parameters: the other keys of its table."""
    try:
        spec = find(table.content["use"])
    except NotInstalled:
        return
    except EvalkitError as error:
        yield table.place, str(error)
        return
    label = table.content.get("label", table.content["use"])
    owner = table.place if table.form.plugins == "mappers" else table.with_label(label).place  # as in the reader
    given = flatten({name: value for name, value in table.content.items() if name not in table.form.keys})
    for name, value in given.items():
        try:
            resolve(owner, spec, {name: value})
        except (UnknownName, BadParameter) as error:
            yield "", str(error)


def _describe_missing(table: TomlTable, name: str, key: Key) -> str:
    if key.type in ("table", "tables"):
        return f"no table [{name}]" if key.type == "table" else f"no [[{name}]]"
    return table.describe_missing(name)


def _join(place: str, what: str) -> str:
    return f"{place}: {what}" if place else what


def _is_told(place: str, what: str, first_place: str, first: str) -> bool:
    """Return whether a mistake is the first one, whose place may have a label and whose text may go on."""
    same_place = first_place == place or first_place.startswith(f"{place} (")
    return (same_place and first.startswith(what)) or _join(first_place, first).startswith(_join(place, what))
