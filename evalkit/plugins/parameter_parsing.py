"""Conversion of parameter texts from the command line into the types that a plug-in declares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from evalkit.core.errors import BadParameter
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


def _convert(owner: str, parameter: Parameter, text: str) -> Value:
    kind = type(parameter.default)
    if kind is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return text if kind in (str, bool) else kind(text)
    except ValueError:
        raise BadParameter(owner, parameter.name, text, f"{WORDS[kind]} ({parameter.meaning})") from None
