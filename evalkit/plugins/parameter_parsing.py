"""Parameters given as words on the command line, in the types their plug-in declares."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from evalkit.core.errors import BadParameter
from evalkit.plugins.parameters import Parameter, Value

WORDS: dict[type, str] = {int: "a whole number", float: "a number"}
"""What is asked for where a text is none of its type."""


def from_text(owner: str, parameters: Iterable[Parameter], texts: Mapping[str, str]) -> dict[str, Value]:
    """The given values in the types of the parameters' defaults; unknown names stay as they are, to be refused later.

    BadParameter names a text that is none of its type.
    """
    known = {parameter.name: parameter for parameter in parameters}
    return {name: _value(owner, known[name], text) if name in known else text for name, text in texts.items()}


def _value(owner: str, parameter: Parameter, text: str) -> Value:
    kind = type(parameter.default)
    if kind is bool and text.lower() in ("true", "false"):
        return text.lower() == "true"
    try:
        return text if kind in (str, bool) else kind(text)
    except ValueError:
        raise BadParameter(owner, parameter.name, text, f"{WORDS[kind]} ({parameter.meaning})") from None
