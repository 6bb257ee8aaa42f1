"""The pages of back ends, mappers and data sets, from the registry and their specs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, RegistrationSpec
from evalkit_docs.markup import code, facts, fold, heading, page, table, text

COLUMNS = ("name", "default", "unit", "limits", "meaning")


def back_ends() -> str:
    """Markdown: every back end with what can be set on it, the front end's settings, and the mappers."""
    names = registry.names("backends")
    return page(
        "# Back ends",
        "What takes part in a comparison. `evalkit list backends` says which of them run on this machine, and what the "
        "others miss. [Add your own](../back-end.md), or bring one in "
        "[another language](../external/examples.md).",
        *(_back_end(name, registry.backend(name)) for name in names),
        "## The front end",
        "Makes an odometry of every *registration*, the same for all: scan-to-scan, then scan-to-map. These can be set "
        "on any registration, in an experiment like its own parameters.",
        parameters(frontend.PARAMETERS),
        "## Mappers",
        "All trajectories are drawn by the same mapper, so that map metrics compare trajectories.",
        *(_mapper(name, registry.mapper(name)) for name in registry.names("mappers")),
    )


def data_sets() -> str:
    """Markdown: every data set and reader with its card and what can be set on it."""
    return page(
        "# Data sets",
        "Synthetic worlds with exact truth, recordings, and the readers of your own. The recordings are never part of "
        "evalkit: `evalkit datasets list` says where they are, `evalkit datasets fetch NAME` downloads what has a "
        "public address, and the environment variable `EVALKIT_DATA` names a folder that holds them.",
        *(_data_set(name, registry.dataset(name)) for name in registry.names("datasets")),
    )


def parameters(given: Iterable[Parameter]) -> str:
    """A table of parameters (HTML)."""
    rows = [
        (code(one.name), code(_value(one.default)), text(one.unit), text(_limits(one)), text(one.meaning))
        for one in given
    ]
    return table(COLUMNS, rows) if rows else ""


def _back_end(name: str, spec: BackendSpec) -> str:
    frontend: Mapping[str, Value] = spec.frontend if isinstance(spec, RegistrationSpec) else {}
    first_stage: Mapping[str, Value] = spec.scan_to_scan if isinstance(spec, RegistrationSpec) else {}
    own = {parameter.name for parameter in spec.parameters}
    other = {key: value for key, value in frontend.items() if key not in own}
    rows = [
        ("What", text(spec.summary)),
        ("Kind", text(spec.kind)),
        ("Starts from", text(spec.guess)),
        ("Source", text(spec.citation)),
        ("Licence", text(spec.licence)),
        ("Needs", text(", ".join(spec.requires))),
        ("Front end", ", ".join(code(f"{key} = {_value(value)}") for key, value in other.items())),
        ("First stage", ", ".join(code(f"{key} = {_value(value)}") for key, value in first_stage.items())),
    ]
    return page(heading(2, name, name), facts(rows), parameters(spec.parameters)).rstrip()


def _mapper(name: str, spec: MapperSpec) -> str:
    rows = [
        ("What", text(spec.summary)),
        ("Source", text(spec.citation)),
        ("Licence", text(spec.licence)),
        ("Needs", text(", ".join(spec.requires))),
    ]
    return page(heading(3, name, f"mapper-{name}"), facts(rows), parameters(spec.parameters)).rstrip()


def _data_set(name: str, spec: DatasetSpec) -> str:
    rows = [
        ("What", text(spec.summary)),
        ("Sensor", text(spec.sensor)),
        ("Truth", text(spec.truth)),
        ("Source", text(spec.citation)),
        ("Licence", text(spec.licence)),
        ("Reads", text(", ".join(spec.suffixes))),
        ("Known defects", "<br>".join(map(text, spec.defects))),
        ("Degenerate", text(spec.degenerate)),
        ("Published", "<br>".join(text(f"{one.label}: {_published(one.value, one.spread)} ({one.source})")
                                  for one in spec.published)),
    ]  # fmt: skip
    told = parameters(spec.parameters)
    return page(
        heading(2, name, name), facts(rows), fold(f"{len(spec.parameters)} parameters", told) if told else ""
    ).rstrip()


def _published(value: float, spread: float | None) -> str:
    return f"{value:g}" if spread is None else f"{value:g} \u00b1 {spread:g}"


def _value(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else f'"{value}"' if isinstance(value, str) else str(value)


def _limits(one: Parameter) -> str:
    if one.choices:
        return ", ".join(one.choices)
    if math.isfinite(one.low) and math.isfinite(one.high):
        return f"{one.low:g} to {one.high:g}"
    if math.isfinite(one.low):
        return f"at least {one.low:g}"
    return f"at most {one.high:g}" if math.isfinite(one.high) else ""
