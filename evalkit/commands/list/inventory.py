"""The registered names of a kind, with their summaries and with the reason if one cannot be used here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from evalkit.core.errors import NotInstalled
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value


@dataclass(frozen=True)
class Entry:
    """One name. ``missing``: why it cannot be used here, or "". ``parameters``: its parameters and their defaults."""

    name: str
    summary: str
    missing: str
    parameters: dict[str, Value]


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
    spec = registry.backend(name)
    return Entry(name, spec.summary, spec.missing(), _defaults(frontend.settable_parameters(spec)))


def _mapper(name: str) -> Entry:
    spec = registry.mapper(name)
    return Entry(name, spec.summary, spec.missing(), _defaults(spec.parameters))


def _dataset(name: str) -> Entry:
    spec = registry.dataset(name)
    defaults = _defaults(spec.parameters)
    # without a file nothing is missing for a reader
    missing = "" if spec.suffixes else spec.missing(**{k: v for k, v in defaults.items() if k != "seed"})
    return Entry(name, spec.summary, missing, defaults)


def _defaults(parameters: tuple[Parameter, ...]) -> dict[str, Value]:
    return {parameter.name: parameter.default for parameter in parameters}


KINDS: Mapping[str, Callable[[str], Entry]] = {"backends": _backend, "mappers": _mapper, "datasets": _dataset}
"""The kinds of plug-ins that are listed, with the function that describes one."""
