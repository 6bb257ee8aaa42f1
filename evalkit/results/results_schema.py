"""The JSON Schema of results.json, and whether a content has its keys and types."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from evalkit.core.errors import brief

_TYPES: Mapping[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "boolean": (bool,), "null": (type(None),),
    "integer": (int,), "number": (int, float),
}  # fmt: skip


def load_schema() -> str:
    """Return the JSON Schema (draft 2020-12) of results.json."""
    return files("evalkit.results").joinpath("results.schema.json").read_text(encoding="utf-8")


def check_schema(content: Mapping[str, Any]) -> None:
    """Raise ValueError with the place of a key that is missing, or of a value of another type than the schema's.

    Checks the keywords that decide whether a reader finds what it expects: type, enum, minimum, required, properties,
    additionalProperties, items and references to definitions. Numbers are finite: int and float of 64 bits.
    """
    _check(content, _schema(), "")


@cache
def _schema() -> dict[str, Any]:
    schema: dict[str, Any] = json.loads(load_schema())
    return schema


def _check(value: Any, schema: Mapping[str, Any], place: str) -> None:
    if "$ref" in schema:
        _check(value, _schema()["$defs"][schema["$ref"].rpartition("/")[2]], place)
    kinds = schema.get("type", [])
    kinds = [kinds] if isinstance(kinds, str) else kinds
    if kinds and not any(_is_of(value, kind) for kind in kinds):
        raise ValueError(f"{place}: found {brief(value)}, expected {' or '.join(kinds)}")
    if "enum" in schema and value not in schema["enum"]:
        raise ValueError(f"{place}: found {brief(value)}, expected one of {', '.join(map(str, schema['enum']))}")
    if "minimum" in schema and value is not None and value < schema["minimum"]:
        raise ValueError(f"{place}: found {brief(value)}, expected at least {schema['minimum']}")
    if isinstance(value, dict):
        _check_object(value, schema, place)
    elif isinstance(value, list) and "items" in schema:
        for index, item in enumerate(value):
            _check(item, schema["items"], f"{place}[{index}]")


def _check_object(value: Mapping[str, Any], schema: Mapping[str, Any], place: str) -> None:
    if missing := [key for key in schema.get("required", ()) if key not in value]:
        raise ValueError(f"{place}: no key '{missing[0]}'" if place else f"no key '{missing[0]}'")
    known, others = schema.get("properties", {}), schema.get("additionalProperties", True)
    for key, item in value.items():
        own = known.get(key, others)
        if isinstance(own, Mapping):
            _check(item, own, f"{place}.{key}".lstrip("."))


def _is_of(value: Any, kind: str) -> bool:
    if isinstance(value, bool) and kind != "boolean":
        return False
    if kind in ("integer", "number") and isinstance(value, int):
        return abs(value) < 2**63
    return isinstance(value, _TYPES[kind])
