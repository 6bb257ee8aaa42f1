"""Conversion of parameter texts from the command line into the types that a plug-in declares."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Mapping

from evalkit.core.errors import BadParameter
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value

WORDS: dict[type, str] = {int: "a whole number", float: "a number"}
"""Name of the expected type in an error message."""


def from_text(owner: str, parameters: Iterable[Parameter], texts: Mapping[str, str]) -> dict[str, Value]:
    """Convert texts to the types of the parameters' defaults.

    Unknown names keep their text; ``resolve_parameters`` refuses them. Raises BadParameter where a text does not
    convert.
    """
    known = {parameter.name: parameter for parameter in parameters}
    return {name: _convert(owner, known[name], text) if name in known else text for name, text in texts.items()}


def parse_dataset(text: str) -> tuple[str, dict[str, Value]]:
    """The data set and the given parameters of a text such as "NAME laps=0.3"; raises UnknownName or BadParameter."""
    try:
        name, *words = shlex.split(text) or [""]
    except ValueError as error:
        raise BadParameter("data set", "on", text, f"a data set's name and NAME=VALUE ({error})") from error
    spec = registry.dataset(name)
    for word in words:
        if "=" not in word:
            raise BadParameter(name, word, word, "NAME=VALUE after the name of the data set")
    return name, from_text(name, spec.parameters, dict(word.split("=", 1) for word in words))


def _convert(owner: str, parameter: Parameter, text: str) -> Value:
    kind = type(parameter.default)
    if kind is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return text if kind in (str, bool) else kind(text)
    except ValueError:
        raise BadParameter(owner, parameter.name, text, f"{WORDS[kind]} ({parameter.meaning})") from None
