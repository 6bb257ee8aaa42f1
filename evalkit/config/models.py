"""The form of experiment, study and tuning files, as models: all mistakes of a file at once, and its JSON Schema.

The models are made of ``forms``, as are the readers of these files, which stop at the first mistake. Only then, and for
a schema, are the models loaded: reading a correct file does not import pydantic.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, model_validator

from evalkit.config.forms import FORMS, MAX_WHOLES, FileKind, Form, Key, Type
from evalkit.config.toml_tables import flatten
from evalkit.core.errors import BadExperiment, BadParameter, EvalkitError, NotInstalled, UnknownName, brief
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter

# What stands behind a likely name; further mistakes leave it out.
KNOWN = r"(\(did you mean '[^']*'\?\)); known: [^;]*"
MAX_MISTAKES, MAX_CHARACTERS = 100, 800
"""More mistakes of a file are counted, not listed; those beyond this length of the message are counted too."""


class _Closed(BaseModel):
    """A table whose keys are all known."""

    model_config = ConfigDict(extra="forbid", populate_by_name=False)


class _Plugin(BaseModel):
    """A table that names a plug-in with ``use``; every other key that is not a field is a parameter of the plug-in."""

    model_config = ConfigDict(extra="allow")

    def _check_parameters(self, known: tuple[Parameter, ...]) -> None:
        """Raises ValueError with every unknown parameter and every wrong value."""
        by_name = {each.name: each for each in known}
        found = []
        for name, value in flatten(self.model_extra or {}).items():
            try:
                if name not in by_name:
                    raise UnknownName("parameter", name, by_name)
                by_name[name].check(str(self.__dict__["use"]), value)
            except (UnknownName, BadParameter) as error:
                found.append(str(error))
        if found:
            raise ValueError("; ".join(found))


class _Method(_Plugin):
    @model_validator(mode="after")
    def _check(self) -> _Method:
        spec = _load(registry.find_backend, self.__dict__["use"])
        if spec is not None and not spec.broken and not spec.missing():
            self._check_parameters(frontend.settable_parameters(spec))
        return self


class _Sequence(_Plugin):
    @model_validator(mode="after")
    def _check(self) -> _Sequence:
        if (spec := _load(registry.dataset, self.__dict__["use"])) is not None:
            self._check_parameters(spec.parameters)
        return self


_BASES: Mapping[str, type[BaseModel]] = {
    "": _Closed, "backends": _Method, "datasets": _Sequence, "mappers": _Plugin,
}  # fmt: skip


@cache
def make_model(kind: FileKind) -> type[BaseModel]:
    """Return the model of a kind of file."""
    return _make_model(FORMS[kind], {})


def _make_model(form: Form, made: dict[str, type[BaseModel]]) -> type[BaseModel]:
    """Return the model of a form; ``made``: those there are, by name."""
    if form.name not in made:
        fields: dict[str, Any] = {
            name.replace("-", "_"): _make_field(name, key, made) for name, key in form.keys.items()
        }
        made[form.name] = create_model(form.name, __base__=_BASES[form.plugins], __doc__=form.meaning, **fields)
    return made[form.name]


def _make_field(name: str, key: Key, made: dict[str, type[BaseModel]]) -> tuple[Any, Any]:
    """Return type and field of a key; a key without a default may be absent, and is then none."""
    low = 0 if key.low is None else key.low
    content: Any = dict[str, Any] if key.form is None else _make_model(key.form, made)
    whole = Annotated[int, Field(ge=low, strict=True)]
    kinds: dict[Type, Any] = {
        "text": Annotated[str, Field(strict=True)],
        "texts": list[Annotated[str, Field(strict=True)]],
        "flag": Annotated[bool, Field(strict=True)],
        "whole": whole,
        "wholes": Annotated[list[whole], Field(max_length=MAX_WHOLES)],
        "number": Annotated[float, Field(strict=True, ge=key.low)],
        "positive": Annotated[float, Field(strict=True, gt=0.0, allow_inf_nan=False)],
        "table": content,
        "tables": Annotated[list[content], Field(min_length=1)] if key.required else list[content],
        "any": Any,
    }
    default: Any = ... if key.required else key.default
    alias = name if "-" in name else None
    return kinds[key.type], Field(default, description=key.meaning or None, alias=alias)


def add_further_mistakes(first: BadExperiment, content: Mapping[str, Any], kind: FileKind) -> BadExperiment:
    """Return the first mistake of a file with all others behind it, each with its place."""
    file, place, what = first.args
    text = what
    lines = [
        re.sub(KNOWN, r"\1", line)
        for where, line in find_mistakes(content, kind)
        if not _is_told(where, line, place, what)
    ]
    for told, line in enumerate(lines):
        if len(text) + len(line) > MAX_CHARACTERS:
            text += f"; and {len(lines) - told} more"
            break
        text += f"; also {line}"
    return BadExperiment(file, place, text)


def find_mistakes(content: Mapping[str, Any], kind: FileKind) -> Iterator[tuple[str, str]]:
    """Yield the place of every mistake of a file's content, such as "method 2", and the mistake with its place."""
    try:
        make_model(kind).model_validate(content)
    except ValidationError as error:
        if error.error_count() > MAX_MISTAKES:  # each takes memory
            yield "", f"{error.error_count():,} mistakes"
            return
        for one in error.errors(include_url=False):
            place, what = _describe(kind, dict(one))
            yield place, f"{place}: {what}" if place else what


def _describe(kind: FileKind, error: dict[str, Any]) -> tuple[str, str]:
    """Return the table and what is wrong in it."""
    path = list(error["loc"])
    key = "" if error["type"] == "value_error" else str(path.pop())
    words = [f"{part + 1}" if isinstance(part, int) else str(part) for part in path]
    place = " ".join(words)
    if error["type"] == "extra_forbidden":
        return place, str(UnknownName("key", key, _find_form(kind, path).keys))
    if error["type"] == "missing":
        return place, f"missing key '{key}'"
    if error["type"] == "value_error":
        return place, str(error["ctx"]["error"])
    return place, f"'{key}': found {brief(error['input'])}, {error['msg'][:1].lower()}{error['msg'][1:]}"


def _find_form(kind: FileKind, path: list[Any]) -> Form:
    """Return the form of the table at a place of a file."""
    form = FORMS[kind]
    for part in path:
        form = (form.keys[part].form or form) if isinstance(part, str) else form
    return form


def _is_told(place: str, text: str, first_place: str, first: str) -> bool:
    """Return whether the first mistake is this one: in the same table, about the same name."""
    if not (first_place == place or first_place.startswith(f"{place} (")):
        return False
    return _first_quoted(text.removeprefix(f"{place}: ")) in ("", _first_quoted(first))


def _first_quoted(text: str) -> str:
    """Return the first name between quotes, "" if there is none."""
    return [*text.split("'"), "", ""][1]


def _load(find: Any, name: str) -> Any:
    """Return a plug-in, None where it does not load; raises ValueError for an unknown name."""
    try:
        return find(name)
    except NotInstalled:
        return None
    except EvalkitError as error:
        raise ValueError(str(error)) from None


def make_schema(kind: FileKind) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file, with the names and parameters of the installed plug-ins."""
    schema = make_model(kind).model_json_schema(by_alias=True)
    tables: Mapping[str, tuple[Any, Any]] = {
        "backends": (registry.find_backend, frontend.settable_parameters),
        "datasets": (registry.dataset, lambda spec: spec.parameters),
        "mappers": (registry.mapper, lambda spec: spec.parameters),
    }
    for form in _list_forms(FORMS[kind]):
        if not form.plugins:
            continue
        find, parameters_of = tables[form.plugins]
        definition, names = schema["$defs"][form.name], registry.names(form.plugins)
        named: dict[str, Any] = {"enum": names}
        free = form.plugins == "backends"  # also an address
        definition["properties"]["use"] |= {"anyOf": [named, {"pattern": ":"}]} if free else named
        definition["allOf"] = [_condition(name, parameters_of(spec)) for name in names if (spec := _load(find, name))]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _list_forms(form: Form) -> Iterator[Form]:
    """Yield a form and those of its tables."""
    yield form
    for key in form.keys.values():
        yield from _list_forms(key.form) if key.form is not None else ()


def _condition(name: str, parameters: tuple[Parameter, ...]) -> dict[str, Any]:
    properties = {each.name: _parameter_schema(each) for each in parameters if "." not in each.name}
    return {"if": {"properties": {"use": {"const": name}}, "required": ["use"]}, "then": {"properties": properties}}


def _parameter_schema(parameter: Parameter) -> dict[str, Any]:
    kinds: dict[type, str] = {bool: "boolean", int: "integer", float: "number", str: "string"}
    unit = f" [{parameter.unit}]" if parameter.unit else ""
    schema: dict[str, Any] = {
        "type": kinds[type(parameter.default)], "default": parameter.default, "description": parameter.meaning + unit,
    }  # fmt: skip
    if parameter.choices:
        schema["enum"] = list(parameter.choices)
    bounds = {"minimum": parameter.low, "maximum": parameter.high}
    return schema | {name: value for name, value in bounds.items() if abs(value) != float("inf")}
