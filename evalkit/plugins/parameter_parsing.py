"""Conversion of parameter texts from the command line into the types that a plug-in declares."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType

from evalkit.core.errors import BadParameter
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value, resolve_parameters, split_settings

WORDS: dict[type, str] = {int: "a whole number", float: "a number"}
"""Name of the expected type in an error message."""


def from_text(owner: str, parameters: Iterable[Parameter], texts: Mapping[str, str]) -> dict[str, Value]:
    """Convert texts to the types of the parameters' defaults.

    Unknown names keep their text; ``resolve_parameters`` refuses them. Raises BadParameter where a text does not
    convert.
    """
    known = {parameter.name: parameter for parameter in parameters}
    return {name: _convert(owner, known[name], text) if name in known else text for name, text in texts.items()}


def parse_dataset(text: str, shared: Mapping[str, str] = MappingProxyType({})) -> tuple[str, dict[str, Value]]:
    """The data set and the given parameters of a text such as "NAME laps=0.3"; raises UnknownName or BadParameter.

    ``shared``: parameters of every data set, as text; those of ``text`` come first.
    """
    try:
        name, *words = shlex.split(text) or [""]
    except ValueError as error:
        raise BadParameter("data set", "on", text, f"a data set's name and NAME=VALUE ({error})") from error
    if name and name not in registry.names("datasets") and Path(name).exists():
        expected = (
            f"a data set; of a file its reader, 'READER path={name}', which evalkit inspect {name} names (use = ...)"
        )
        raise BadParameter("data set", "on", name, expected)
    spec = registry.dataset(name)
    own = split_settings(name, words, "NAME=VALUE after the name of the data set")
    given = from_text(name, spec.parameters, {**shared, **own})
    resolve_parameters(name, spec.parameters, given)
    return name, given


def parse_dataset_without_seed(
    text: str, instead: str, shared: Mapping[str, str] = MappingProxyType({})
) -> tuple[str, dict[str, Value]]:
    """As ``parse_dataset``, where the command gives a simulated data set its seeds; a seed is a BadParameter.

    ``instead``: where the seeds come from, for the message.
    """
    name, given = parse_dataset(text, shared)
    if "seed" in given and registry.dataset(name).seeded:
        raise BadParameter(name, "seed", given["seed"], f"none here: {instead}")
    return name, given


def _convert(owner: str, parameter: Parameter, text: str) -> Value:
    kind = type(parameter.default)
    if kind is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return text if kind in (str, bool) else kind(text)
    except ValueError:
        raise BadParameter(owner, parameter.name, text, f"{WORDS[kind]} ({parameter.meaning})") from None
