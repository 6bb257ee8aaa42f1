"""The registered names of a kind, with their summaries and with the reason if one cannot be used here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from evalkit.core.errors import NotInstalled
from evalkit.io.json_values import replace_non_finite
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter


@dataclass(frozen=True)
class Entry:
    """One name. ``missing``: why it cannot be used here, or "". ``parameters``: descriptions of its parameters by name.

    A description has default, unit, meaning, the inclusive bounds low and high (None: none), and the choices of a text.
    """

    name: str
    summary: str
    missing: str
    parameters: dict[str, dict[str, Any]]


def find_entries(kind: str) -> list[Entry]:
    """Return an entry for every registered name of a kind of ``KINDS``; a broken plug-in is an entry with a reason."""
    entries = []
    for name in registry.names(kind):
        try:
            entries.append(KINDS[kind](name))
        except NotInstalled as error:
            entries.append(Entry(name, "", str(error), {}))
        except Exception as error:  # noqa: BLE001 - a plug-in's own code reports what is missing
            entries.append(Entry(name, "", f"its plug-in failed: {type(error).__name__}: {error}", {}))
    return entries


def _backend(name: str) -> Entry:
    from evalkit.odometry import frontend  # noqa: PLC0415 - loads NumPy, which a list of names does not need

    spec = registry.backend(name)
    return Entry(name, spec.summary, spec.missing(), _describe(frontend.settable_parameters(spec)))


def _mapper(name: str) -> Entry:
    spec = registry.mapper(name)
    return Entry(name, spec.summary, spec.missing(), _describe(spec.parameters))


def _dataset(name: str) -> Entry:
    spec = registry.dataset(name)
    defaults = {one.name: one.default for one in spec.parameters}
    # without a file nothing is missing for a reader
    missing = "" if spec.suffixes else spec.missing(**{k: v for k, v in defaults.items() if k != "seed"})
    return Entry(name, spec.summary, missing, _describe(spec.parameters))


def _describe(parameters: tuple[Parameter, ...]) -> dict[str, dict[str, Any]]:
    return {
        one.name: {
            "default": one.default, "unit": one.unit, "meaning": one.meaning, "low": replace_non_finite(one.low),
            "high": replace_non_finite(one.high), "choices": list(one.choices),
        }
        for one in parameters
    }  # fmt: skip


KINDS: Mapping[str, Callable[[str], Entry]] = {"backends": _backend, "mappers": _mapper, "datasets": _dataset}
"""The kinds of plug-ins that are listed, with the function that describes one."""
