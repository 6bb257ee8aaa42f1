"""The form of experiment, study and tuning files, as models: all mistakes of a file at once, and its JSON Schema.

The readers of these files check what they read and stop at the first mistake. Only then, and for a schema, are the
models loaded: reading a correct file does not import pydantic.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from evalkit.config.toml_tables import flatten
from evalkit.core.errors import BadExperiment, BadParameter, EvalkitError, NotInstalled, UnknownName, brief
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter

Kind = Literal["experiment", "study", "tuning"]
Whole = Annotated[int, Field(ge=0, strict=True)]
Positive = Annotated[float, Field(gt=0.0)]
Text = Annotated[str, Field(strict=True)]
Flag = Annotated[bool, Field(strict=True)]

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


class MethodTable(_Plugin):
    """A method: a back end and its parameters."""

    use: Text = Field(description="a back end, 'module:SPEC', 'lib:FILE', 'exec:COMMAND' or 'file:POSES'")
    label: Text = Field("", description="its name in the report")
    tuned_on: list[Text] = Field([], description="data sets that its parameters were chosen on")
    search: dict[str, Any] = Field({}, description="of a tuning: the ranges of the parameters to search")

    @model_validator(mode="after")
    def _check(self) -> MethodTable:
        spec = _load(registry.find_backend, self.use)
        if spec is not None and not spec.broken and not spec.missing():
            self._check_parameters(frontend.settable_parameters(spec))
        return self


class SequenceTable(_Plugin):
    """A sequence: a data set or a reader, and its parameters."""

    use: Text = Field(description="a data set, or the reader of a recording")
    label: Text = Field("", description="its name in the report")
    seeds: list[Whole] = Field([0], description="one simulated drive each")
    confirm: list[Whole] = Field([], description="of a tuning: the seeds that confirm the best settings")
    nuisance: Whole = Field(0, description="number of small perturbations of a recording")
    nuisance_scans: Whole = Field(0, description="scans of each perturbation; 0: all")
    map: Text = Field("", description="a known map (map_server YAML) that every method tracks the robot in")
    map_start: Text = Field("", description="where the robot starts in the known map: 'x,y,yaw' in m, m, deg")
    align_truth: Flag = Field(False, description="the ground truth is in another frame than the known map")

    @model_validator(mode="after")
    def _check(self) -> SequenceTable:
        if (spec := _load(registry.dataset, self.use)) is not None:
            self._check_parameters(spec.parameters)
        return self


class MapperTable(_Plugin):
    """The mapper and its parameters."""

    use: Text = Field("", description="a mapper")
    scans: Annotated[int, Field(ge=2, strict=True)] = Field(400, description="scans of a map, at most")


class LimitsTable(_Closed):
    """Limits of one run."""

    run_s: Positive = Field(900.0, description="s")
    scan_s: Positive = Field(60.0, description="s without an answer")
    run_cpu_s: Positive = Field(3600.0, description="s of CPU time")
    scan_cpu_s: Positive = Field(240.0, description="s of CPU time without an answer")
    memory_mib: Positive = Field(2048, description="MiB")


class _File(_Closed):
    """What all files have."""

    title: Text = ""
    description: Text = ""
    mapper: MapperTable | None = None
    limits: LimitsTable | None = None


class ExperimentFile(_File):
    """An experiment: methods on sequences (``evalkit compare FILE``)."""

    timed: Flag = Field(True, description="whether times count")
    skip_tuned: Flag = Field(False, description="no method runs on data sets that it was tuned on")
    nuisance: Whole = Field(0, description="number of small perturbations of each recording")
    nuisance_scans: Whole = Field(0, description="scans of each perturbation; 0: all")
    method: list[MethodTable] = Field(min_length=1)
    sequence: list[SequenceTable] = Field(min_length=1)


class StudyFile(_File):
    """A study: factors, designs and responses (``evalkit study FILE``)."""

    seeds: list[Whole] = []
    method: MethodTable
    sequence: SequenceTable
    response: list[dict[str, Any]] = Field(min_length=1)
    factor: list[dict[str, Any]] = Field(min_length=1)
    design: list[dict[str, Any]] = Field(min_length=1)
    envelope: list[dict[str, Any]] = []


class TuningFile(_File):
    """A tuning with equal budgets (``evalkit tune FILE``)."""

    points: Annotated[int, Field(ge=2, strict=True)] = 24
    seed: Whole = 0
    run_cpu_s: Positive = 60.0
    objective: dict[str, Any] = {}
    method: list[MethodTable] = Field(min_length=1)
    training: list[SequenceTable] = Field(min_length=1)
    held_out: list[SequenceTable] = Field(alias="held-out", min_length=1)


MODELS: Mapping[Kind, type[_File]] = {"experiment": ExperimentFile, "study": StudyFile, "tuning": TuningFile}


def add_further_mistakes(first: BadExperiment, content: Mapping[str, Any], kind: Kind) -> BadExperiment:
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


def find_mistakes(content: Mapping[str, Any], kind: Kind) -> Iterator[tuple[str, str]]:
    """Yield the place of every mistake of a file's content, such as "method 2", and the mistake with its place."""
    try:
        MODELS[kind].model_validate(content)
    except ValidationError as error:
        if error.error_count() > MAX_MISTAKES:  # each takes memory
            yield "", f"{error.error_count():,} mistakes"
            return
        for one in error.errors(include_url=False):
            place, what = _describe(kind, dict(one))
            yield place, f"{place}: {what}" if place else what


def _describe(kind: Kind, error: dict[str, Any]) -> tuple[str, str]:
    """Return the table and what is wrong in it."""
    path = list(error["loc"])
    key = "" if error["type"] == "value_error" else str(path.pop())
    words = [f"{part + 1}" if isinstance(part, int) else str(part) for part in path]
    place = " ".join(words)
    if error["type"] == "extra_forbidden":
        known = LimitsTable.model_fields if "limits" in path else MODELS[kind].model_fields
        return place, str(UnknownName("key", key, [field.alias or name for name, field in known.items()]))
    if error["type"] == "missing":
        return place, f"missing key '{key}'"
    if error["type"] == "value_error":
        return place, str(error["ctx"]["error"])
    return place, f"'{key}': found {brief(error['input'])}, {error['msg'][:1].lower()}{error['msg'][1:]}"


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


def make_schema(kind: Kind) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file, with the names and parameters of the installed plug-ins."""
    schema = MODELS[kind].model_json_schema(by_alias=True)
    tables = {
        "MethodTable": ("backends", registry.find_backend, frontend.settable_parameters),
        "SequenceTable": ("datasets", registry.dataset, lambda spec: spec.parameters),
        "MapperTable": ("mappers", registry.mapper, lambda spec: spec.parameters),
    }
    for table, (plugins, find, parameters_of) in tables.items():
        definition = schema["$defs"][table]
        names = registry.names(plugins)
        named: dict[str, Any] = {"enum": names}
        definition["properties"]["use"] |= {"anyOf": [named, {"pattern": ":"}]} if plugins == "backends" else named
        definition["allOf"] = [_condition(name, parameters_of(spec)) for name in names if (spec := _load(find, name))]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


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
