"""The JSON Schema of experiment, study and tuning files, made of their forms and of the installed plug-ins."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from evalkit.config.forms import FORMS, MAX_WHOLES, FileKind, Form, Key, Plugins, Type
from evalkit.core.errors import NotInstalled
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter

Schema = dict[str, Any]

PARAMETERS: Mapping[Plugins, Callable[[str], tuple[Parameter, ...]]] = {
    "backends": lambda name: frontend.settable_parameters(registry.find_backend(name)),
    "datasets": lambda name: registry.dataset(name).parameters,
    "mappers": lambda name: registry.mapper(name).parameters,
}


def make_schema(kind: FileKind) -> Schema:
    """Return the JSON Schema of a kind of file, with the names and parameters of the installed plug-ins."""
    form = FORMS[kind]
    definitions = {each.name: _table_schema(each) for each in _list_forms(form) if each is not form}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema", **_table_schema(form), "$defs": definitions
    }  # fmt: skip


def _list_forms(form: Form) -> Iterator[Form]:
    """Yield a form and those of its tables."""
    yield form
    for key in form.keys.values():
        yield from _list_forms(key.form) if key.form is not None else ()


def _table_schema(form: Form) -> Schema:
    schema: Schema = {
        "title": form.name,
        "description": form.meaning,
        "type": "object",
        "properties": {name: _key_schema(key) for name, key in form.keys.items()},
        "required": [name for name, key in form.keys.items() if key.required],
        "additionalProperties": bool(form.plugins),
    }
    if form.plugins:
        names = registry.names(form.plugins)
        named: Schema = {"enum": names}
        free = form.plugins == "backends"  # also an address
        schema["properties"]["use"] |= {"anyOf": [named, {"pattern": ":"}]} if free else named
        schema["allOf"] = list(_conditions(names, PARAMETERS[form.plugins]))
    return schema


def _conditions(names: list[str], parameters_of: Callable[[str], tuple[Parameter, ...]]) -> Iterator[Schema]:
    """Yield, for each plug-in that loads, the parameters that a table which uses it may have."""
    for name in names:
        try:
            parameters = parameters_of(name)
        except NotInstalled:
            continue
        properties = {each.name: _parameter_schema(each) for each in parameters if "." not in each.name}
        yield {"if": {"properties": {"use": {"const": name}}, "required": ["use"]}, "then": {"properties": properties}}


def _key_schema(key: Key) -> Schema:
    table: Schema = {"type": "object"} if key.form is None else {"$ref": f"#/$defs/{key.form.name}"}
    whole: Schema = {"type": "integer", "minimum": key.low or 0} | ({} if key.high is None else {"maximum": key.high})
    types: Mapping[Type, Schema] = {
        "text": {"type": "string"},
        "texts": {"type": "array", "items": {"type": "string"}},
        "flag": {"type": "boolean"},
        "whole": whole,
        "wholes": {"type": "array", "items": whole, "maxItems": MAX_WHOLES},
        "number": {"type": "number"} if key.low is None else {"type": "number", "minimum": key.low},
        "positive": {"type": "number", "exclusiveMinimum": 0},
        "table": table,
        "tables": {"type": "array", "items": table, "minItems": int(key.required)},
        "any": {},
    }
    schema = {**types[key.type]}
    if key.meaning:
        schema["description"] = key.meaning
    if key.default is not None:
        schema["default"] = key.default
    return schema


def _parameter_schema(parameter: Parameter) -> Schema:
    kinds: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    schema: Schema = {
        "type": kinds[type(parameter.default)], "default": parameter.default, "description": parameter.meaning + unit,
    }  # fmt: skip
    if parameter.choices:
        schema["enum"] = list(parameter.choices)
    bounds = {"minimum": parameter.low, "maximum": parameter.high}
    return schema | {name: value for name, value in bounds.items() if abs(value) != float("inf")}
