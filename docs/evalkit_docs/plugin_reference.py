"""The reference pages of back ends, mappers and data sets, generated from their specs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, RegistrationSpec
from evalkit_docs.markup import code, facts, fold, heading, page, table, text

COLUMNS = ("name", "default", "unit", "limits", "meaning")


def write_back_ends() -> str:
    """Return the page of back ends, front end and mappers with their parameters (Markdown)."""
    names = registry.names("backends")
    return page(
        "# Back ends",
        "The methods of a comparison. `evalkit list backends` shows which of them run on this machine, and what the "
        "others need. [Add your own](../back-end.md) in Python, or in [another language](../external/examples.md).",
        *(_back_end(name, registry.backend(name)) for name in names),
        "## The front end",
        "The front end turns every *registration* into an odometry in the same way: scan-to-scan, then scan-to-map. "
        "Its parameters can be set on any registration, in an experiment, like the registration's own.",
        render_parameters(frontend.PARAMETERS),
        "## Mappers",
        "One mapper builds the maps of all trajectories, so that map metrics compare trajectories.",
        *(_mapper(name, registry.mapper(name)) for name in registry.names("mappers")),
    )


def write_data_sets() -> str:
    """Return the page of data sets and readers with their parameters (Markdown)."""
    return page(
        "# Data sets",
        "Synthetic worlds with exact ground truth, public recordings, and readers for your own. The recordings are not "
        "part of evalkit: `evalkit datasets list` shows where they are, `evalkit datasets fetch NAME` downloads those "
        "with a public address, and the environment variable `EVALKIT_DATA` names a folder that contains them.",
        *(_data_set(name, registry.dataset(name)) for name in registry.names("datasets")),
    )


def render_parameters(given: Iterable[Parameter]) -> str:
    """Return a table of parameters (HTML), or "" without any."""
    rows = [
        (code(one.name), code(_value(one.default)), text(one.unit), text(_limits(one)), text(one.meaning))
        for one in given
    ]
    return table(COLUMNS, rows) if rows else ""


def _back_end(name: str, spec: BackendSpec) -> str:
    frontend: Mapping[str, Value] = spec.frontend if isinstance(spec, RegistrationSpec) else {}
    first_stage: Mapping[str, Value] = spec.scan_to_scan if isinstance(spec, RegistrationSpec) else {}
    own = {parameter.name for parameter in spec.parameters}
    rows = [
        ("Kind", text(spec.kind)),
        ("Starts from", text(spec.guess)),
        ("Needs", text(", ".join(spec.requires))),
        ("Front end", _settings({key: value for key, value in frontend.items() if key not in own})),
        ("First stage", _settings(first_stage)),
    ]
    return _card(heading(2, name, name), spec, rows, render_parameters(spec.parameters))


def _mapper(name: str, spec: MapperSpec) -> str:
    rows = [("Needs", text(", ".join(spec.requires)))]
    return _card(heading(3, name, f"mapper-{name}"), spec, rows, render_parameters(spec.parameters))


def _data_set(name: str, spec: DatasetSpec) -> str:
    published = (f"{one.label}: {_format_published(one.value, one.spread)} ({one.source})" for one in spec.published)
    rows = [
        ("Sensor", text(spec.sensor)),
        ("Truth", text(spec.truth)),
        ("Reads", text(", ".join(spec.suffixes))),
        ("Known defects", "<br>".join(map(text, spec.defects))),
        ("Degenerate", text(spec.degenerate)),
        ("Published", "<br>".join(map(text, published))),
    ]
    parameters = render_parameters(spec.parameters)
    folded = fold(f"{len(spec.parameters)} parameters", parameters) if parameters else ""
    return _card(heading(2, name, name), spec, rows, folded)


def _card(
    title: str, spec: BackendSpec | MapperSpec | DatasetSpec, rows: list[tuple[str, str]], parameters: str
) -> str:
    """Return the facts that all specs have, then the others, then the parameters."""
    common = [("What", spec.summary), ("Source", spec.citation), ("Licence", spec.licence)]
    return page(title, facts([*((name, text(value)) for name, value in common), *rows]), parameters).rstrip()


def _settings(values: Mapping[str, Value]) -> str:
    return ", ".join(code(f"{name} = {_value(value)}") for name, value in values.items())


def _format_published(value: float, spread: float | None) -> str:
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
