"""What somebody else's implementation says of itself, made a spec."""

from __future__ import annotations

import hashlib
import math
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from evalkit.core.errors import BackendFailed, BadParameter, brief
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Parameter, Value, with_defaults
from evalkit.plugins.protocols import Odometry
from evalkit.plugins.specs import BackendSpec, OdometrySpec, RegistrationSpec

UNTOLD = "not told: it is somebody else's"

SPEC_TYPES: dict[object, type[RegistrationSpec | OdometrySpec]] = {
    "registration": RegistrationSpec,
    "odometry": OdometrySpec,
}
"""Kinds that a declaration can name."""


@dataclass(frozen=True)
class Declaration:
    """Kind, one line of summary, what can be set, and the device it runs on ("": this machine)."""

    spec_type: type[RegistrationSpec | OdometrySpec]
    summary: str
    parameters: tuple[Parameter, ...]
    device: str = ""


def declaration(name: str, content: Mapping[str, Any]) -> Declaration:
    """The declaration in what a program or a library said; BackendFailed names the key that is wrong.

    ``failed`` in its place holds why there is none, and what to do.
    """
    if "failed" in content:
        raise BackendFailed(name, *content["failed"])
    kind = content.get("kind")
    if kind not in SPEC_TYPES:
        raise _malformed(name, "kind", kind, "'registration' or 'odometry'")
    listed = content.get("parameters", [])
    if not isinstance(listed, list):
        raise _malformed(name, "parameters", listed, "a list")
    parameters = tuple(_parameter(name, entry) for entry in listed)
    spec_type = SPEC_TYPES[kind]
    reserved = {p.name for p in frontend.PARAMETERS} if spec_type is RegistrationSpec else set()
    for index, parameter in enumerate(parameters):
        if parameter.name in reserved or parameter.name in {p.name for p in parameters[:index]}:
            raise _malformed(name, "parameters", parameter.name, "names of its own, each once")
    summary = _text(name, content, "summary") or "somebody else's: it does not say what it is"
    return Declaration(spec_type, summary, parameters, _text(name, content, "device"))


def listed(text: str) -> list[dict[str, Value]]:
    """The parameters in lines ``NAME DEFAULT UNIT MEANING`` as a program would list them; a short line stays short."""
    words = (line.split(maxsplit=3) for line in text.splitlines() if line.strip())
    keys = ("name", "default", "unit", "meaning")
    entries = [dict(zip(keys, line, strict=False)) for line in words]
    return [{key: value(word) if key == "default" else word for key, word in entry.items()} for entry in entries]


def value(word: str) -> Value:
    """A word as the value it is written like: a bool, a whole number, a number or a text.

    >>> value("true"), value("40"), value("4e-1"), value("fast")
    (True, 40, 0.4, 'fast')
    """
    if word in ("true", "false"):
        return word == "true"
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word


def text(setting: Value) -> str:
    """The word that ``value`` reads back."""
    return str(setting).lower() if isinstance(setting, bool) else str(setting)


def split(name: str, rest: str) -> list[str]:
    """The file and the words ``NAME=VALUE`` behind a scheme, as a shell would split them."""
    try:
        return shlex.split(rest) or [""]
    except ValueError as error:
        raise BadParameter(name, "file", rest, f"a file and NAME=VALUE words ({error})") from None


def settings(name: str, parameters: tuple[Parameter, ...], words: list[str]) -> tuple[Parameter, ...]:
    """The parameters with defaults from words ``NAME=VALUE``, as they stand behind a file's name."""
    for word in words:
        if "=" not in word:
            raise BadParameter(name, word, word, "NAME=VALUE behind the file's name")
    chosen = dict(word.split("=", 1) for word in words)
    known = {parameter.name: parameter for parameter in parameters}
    typed = {key: known[key].check(name, _like(known[key], word)) for key, word in chosen.items() if key in known}
    unknown = {key: word for key, word in chosen.items() if key not in known}
    return with_defaults(parameters, **typed, **unknown)  # which refuses the unknown by name


def spec(
    declared: Declaration, parameters: tuple[Parameter, ...], make: Callable[..., Any], digest: str
) -> BackendSpec:
    """The spec of an implementation that is here; ``parameters``: those it declares and those of evalkit's side."""
    summary = declared.summary + (f" (on {declared.device})" if declared.device else "")
    made = declared.spec_type(make, summary, UNTOLD, UNTOLD, parameters=parameters, digest=digest)
    return replace(made, guess="its own") if declared.spec_type is OdometrySpec else made


def absent(name: str, why: str, digest: str = "") -> BackendSpec:
    """The spec of an implementation that is not here; nobody knows what could be set on it."""
    return replace(_unusable(name, why), missing=lambda: why, digest=digest)


def broken(name: str, why: str, digest: str = "") -> BackendSpec:
    """The spec of an implementation that is here and does not work: its runs fail, with the reason."""
    return replace(_unusable(name, why), broken=why, digest=digest_of(words=f"{digest} {why}"))


def _unusable(name: str, why: str) -> BackendSpec:
    def make(**_parameters: Value) -> Odometry:
        raise BackendFailed(name, "cannot be used", why)

    return OdometrySpec(make, "cannot be used here", UNTOLD, UNTOLD)


def digest_of(*files: Path, words: str = "") -> str:
    """A digest of files' content and of words; a file that cannot be read counts by its name."""
    digest = hashlib.sha256(words.encode())
    for file in files:
        try:
            digest.update(hashlib.sha256(file.read_bytes()).digest())
        except OSError:
            digest.update(str(file).encode())
    return digest.hexdigest()


def _parameter(name: str, entry: object) -> Parameter:
    if not isinstance(entry, Mapping) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", str(entry.get("name", ""))):
        raise _malformed(name, "parameters", entry, "a name of letters, digits and underscores")
    default = entry.get("default")
    if not isinstance(default, (bool, int, float, str)) or (isinstance(default, float) and not math.isfinite(default)):
        raise _malformed(name, "parameters", entry, "a default that is true or false, a finite number or a text")
    unit = _text(name, entry, "unit")
    return Parameter(str(entry["name"]), default, "" if unit == "-" else unit, _text(name, entry, "meaning"))


def _like(parameter: Parameter, word: str) -> Value:
    return word if isinstance(parameter.default, str) else value(word)


def _text(name: str, content: Mapping[str, Any], key: str) -> str:
    found = content.get(key, "")
    if not isinstance(found, str):
        raise _malformed(name, key, found, "a text")
    return found


def _malformed(name: str, key: str, found: object, expected: str) -> BackendFailed:
    what = f"describes itself wrongly: '{key}': found {brief(found)}, expected {expected}"
    return BackendFailed(name, what, "mend it")
