"""What evalkit knows by name, and what is missing and why: rows for a table or for JSON."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from evalkit.core.errors import NotInstalled
from evalkit.metrics import all_metrics
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.protocols import Parameter, Value


@dataclass(frozen=True)
class Entry:
    """One name: what it is, why it cannot be used here ("" where it can), and what can be set on it."""

    name: str
    summary: str
    missing: str
    parameters: dict[str, Value]


def backends() -> list[Entry]:
    """Every registered back end."""
    return _entries("backends", _backend)


def mappers() -> list[Entry]:
    """Every registered mapper."""
    return _entries("mappers", _mapper)


def datasets() -> list[Entry]:
    """Every registered data set and reader."""
    return _entries("datasets", _dataset)


def metrics() -> list[Entry]:
    """Every metric."""
    arrow = {"lower": "lower is better", "higher": "higher is better", "": "neither direction is better"}
    return [
        Entry(metric.name, f"{metric.label} [{metric.unit or '-'}], {arrow[metric.better]}", "", {})
        for metric in all_metrics()
    ]


KINDS: dict[str, Callable[[], list[Entry]]] = {
    "backends": backends,
    "mappers": mappers,
    "datasets": datasets,
    "metrics": metrics,
}


def _entries(kind: str, entry: Callable[[str], Entry]) -> list[Entry]:
    rows = []
    for name in registry.names(kind):
        try:
            rows.append(entry(name))
        except NotInstalled as error:  # a plug-in that does not load is a row with a reason
            rows.append(Entry(name, "", str(error), {}))
        except Exception as error:  # noqa: BLE001 - so is one that fails to say what it misses
            rows.append(Entry(name, "", f"its plug-in failed: {type(error).__name__}: {error}", {}))
    return rows


def _backend(name: str) -> Entry:
    spec = registry.backend(name)
    return Entry(name, spec.summary, spec.missing(), _defaults(frontend.parameters_of(spec)))


def _mapper(name: str) -> Entry:
    spec = registry.mapper(name)
    return Entry(name, spec.summary, spec.missing(), _defaults(spec.parameters))


def _dataset(name: str) -> Entry:
    spec = registry.dataset(name)
    defaults = _defaults(spec.parameters)
    # a reader needs a file before anything can be missing
    missing = "" if spec.suffixes else spec.missing(**{k: v for k, v in defaults.items() if k != "seed"})
    return Entry(name, spec.summary, missing, defaults)


def _defaults(parameters: tuple[Parameter, ...]) -> dict[str, Value]:
    return {parameter.name: parameter.default for parameter in parameters}
