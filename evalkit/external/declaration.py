"""Specs of external back ends, made from the description that a program or a library gives of itself."""

from __future__ import annotations

import hashlib
import math
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeGuard

from evalkit.core.errors import BackendFailed, BadParameter, brief
from evalkit.odometry import frontend
from evalkit.plugins.parameters import Parameter, Value, split_settings, with_defaults
from evalkit.plugins.protocols import Odometry
from evalkit.plugins.specs import BackendSpec, OdometrySpec, RegistrationSpec, SlamSpec
from evalkit.results.descriptions import UNKNOWN

NOT_DECLARED = "not declared: external implementation"

SPEC_TYPES: dict[object, type[RegistrationSpec | OdometrySpec]] = {
    "registration": RegistrationSpec,
    "odometry": OdometrySpec,
    "slam": SlamSpec,
}
"""Spec types by the kind in a declaration."""

MAX_PARAMETERS, MAX_TEXT = 1000, 2000
"""Limits of a description: parameters, and characters of each text."""


@dataclass(frozen=True)
class Declaration:
    """Description of an external back end.

    ``summary``: one line. ``device``: the device it runs on, "" for this machine.
    """

    spec_type: type[RegistrationSpec | OdometrySpec]
    summary: str
    parameters: tuple[Parameter, ...]
    device: str = ""


def read_declaration(name: str, content: Mapping[str, Any], own: tuple[Parameter, ...] = ()) -> Declaration:
    """Read the description that a program or a library gives; raises BackendFailed with the key that is wrong.

    A key ``failed`` holds the reason for a missing description, and the remedy. ``own``: parameters that evalkit adds.
    """
    if "failed" in content:
        what, remedy = content["failed"]
        raise BackendFailed(name, what, remedy)
    kind = content.get("kind")
    if not isinstance(kind, str) or kind not in SPEC_TYPES:
        raise _make_error(name, "kind", kind, "'registration', 'odometry' or 'slam'")
    listed = content.get("parameters", [])
    if not isinstance(listed, list) or len(listed) > MAX_PARAMETERS:
        raise _make_error(name, "parameters", listed, f"a list of at most {MAX_PARAMETERS}")
    parameters = tuple(_parse_parameter(name, entry) for entry in listed)
    spec_type = SPEC_TYPES[kind]
    taken = {p.name for p in own} | ({p.name for p in frontend.PARAMETERS} if spec_type is RegistrationSpec else set())
    for parameter in parameters:
        if parameter.name in taken:
            raise _make_error(name, "parameters", parameter.name, "unique names, none of them a parameter of evalkit")
        taken.add(parameter.name)
    summary = _get_text(name, content, "summary") or "external implementation without a summary"
    return Declaration(spec_type, summary, parameters, _get_text(name, content, "device"))


def parse_parameter_lines(text: str) -> list[dict[str, Value]]:
    """Parse lines ``NAME DEFAULT UNIT MEANING`` into the form in which a program lists parameters.

    A line with fewer words gives an entry with fewer keys.
    """
    words = (line.split(maxsplit=3) for line in text.splitlines() if line.strip())
    keys = ("name", "default", "unit", "meaning")
    entries = [dict(zip(keys, line, strict=False)) for line in words]
    return [{key: parse_value(word) if key == "default" else word for key, word in entry.items()} for entry in entries]


def parse_value(word: str) -> Value:
    """Parse a word as a bool, a whole number, a number or else a text.

    >>> parse_value("true"), parse_value("40"), parse_value("4e-1"), parse_value("fast")
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


def format_value(setting: Value) -> str:
    """Format a value so that ``parse_value`` reads it back."""
    return str(setting).lower() if isinstance(setting, bool) else str(setting)


def split_words(name: str, rest: str) -> list[str]:
    """Split the file and the words ``NAME=VALUE`` after a scheme like a shell; raises BadParameter."""
    try:
        return shlex.split(rest) or [""]
    except ValueError as error:
        raise BadParameter(name, "file", rest, f"a file and NAME=VALUE words ({error})") from None


def find_missing(*files: Path) -> str:
    """Return which files do not exist, as the reason why a method cannot run; "" if all do."""
    absent = [file.name for file in files if not file.exists()]
    return f"no such file: {', '.join(absent)}; correct its path" if absent else ""


def override_defaults(name: str, parameters: tuple[Parameter, ...], words: list[str]) -> tuple[Parameter, ...]:
    """Return the parameters with defaults from the words ``NAME=VALUE`` after a file's name.

    Raises BadParameter or UnknownName.
    """
    chosen = split_settings(name, words, "NAME=VALUE after the file's name")
    known = {parameter.name: parameter for parameter in parameters}
    typed = {key: known[key].check(name, _parse_like(known[key], word)) for key, word in chosen.items() if key in known}
    unknown = {key: word for key, word in chosen.items() if key not in known}
    return with_defaults(parameters, **typed, **unknown)  # raises UnknownName for the unknown


def make_spec(
    declared: Declaration, parameters: tuple[Parameter, ...], make: Callable[..., Any], digest: str
) -> BackendSpec:
    """Make the spec of an available implementation; ``parameters``: those it declares and those that evalkit adds."""
    summary = declared.summary + (f" (on {declared.device})" if declared.device else "")
    made = declared.spec_type(make, summary, NOT_DECLARED, NOT_DECLARED, parameters=parameters, digest=digest)
    return made if declared.spec_type is RegistrationSpec else replace(made, guess="its own")


def missing_spec(name: str, why: str, digest: str = "") -> BackendSpec:
    """Make the spec of an implementation that does not exist here; its parameters are unknown."""
    return replace(_unusable(name, why), missing=lambda: why, digest=digest)


def broken_spec(name: str, why: str, digest: str = "") -> BackendSpec:
    """Make the spec of an implementation that exists but does not work; its runs fail with the reason."""
    return replace(_unusable(name, why), broken=why, digest=compute_digest(words=f"{digest} {why}"))


def undescribed_spec(name: str, digest: str) -> BackendSpec:
    """Make the spec of an implementation that is not asked for its description: no run of it is known."""
    return replace(broken_spec(name, UNKNOWN, digest), summary=UNKNOWN)


def _unusable(name: str, why: str) -> BackendSpec:
    def make(**_parameters: Value) -> Odometry:
        raise BackendFailed(name, "cannot be used", why)

    return OdometrySpec(make, "cannot be used here", NOT_DECLARED, NOT_DECLARED)


def compute_digest(*files: Path, words: str = "") -> str:
    """Return a digest of words and of the contents of files and of the files in folders; else of their names."""
    digest = hashlib.sha256(words.encode())
    for file in (each for path in files for each in (sorted(path.iterdir()) if path.is_dir() else [path])):
        try:
            with file.open("rb") as content:
                digest.update(hashlib.file_digest(content, "sha256").digest())
        except OSError:
            digest.update(str(file).encode())
    return digest.hexdigest()


def _parse_parameter(name: str, entry: object) -> Parameter:
    if not isinstance(entry, Mapping) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{,99}", str(entry.get("name", ""))):
        raise _make_error(name, "parameters", entry, "a name of at most 100 letters, digits and underscores")
    default = entry.get("default")
    if not _is_value(default):
        what = f"a default that is true or false, a finite number or a text of at most {MAX_TEXT} characters"
        raise _make_error(name, "parameters", entry, what)
    unit = _get_text(name, entry, "unit")
    return Parameter(str(entry["name"]), default, "" if unit == "-" else unit, _get_text(name, entry, "meaning"))


def _is_value(found: object) -> TypeGuard[Value]:
    """Whether a value of JSON can be one of a parameter: whole numbers have 64 bits, as in an experiment."""
    if isinstance(found, int):
        return -(2**63) <= found < 2**63
    return math.isfinite(found) if isinstance(found, float) else isinstance(found, str) and len(found) <= MAX_TEXT


def _parse_like(parameter: Parameter, word: str) -> Value:
    return word if isinstance(parameter.default, str) else parse_value(word)


def _get_text(name: str, content: Mapping[str, Any], key: str) -> str:
    found = content.get(key, "")
    if not isinstance(found, str) or len(found) > MAX_TEXT:
        raise _make_error(name, key, found, f"a text of at most {MAX_TEXT} characters")
    return found


def _make_error(name: str, key: str, found: object, expected: str) -> BackendFailed:
    what = f"wrong description: '{key}': found {brief(found)}, expected {expected}"
    return BackendFailed(name, what, "correct the description")
