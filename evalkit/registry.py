"""Names to specs, by entry points: the same way for what ships with evalkit and for a stranger's package.

Listing names imports nothing; loading one name imports only the module it stands in.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar

from evalkit.errors import NotInstalled, UnknownName
from evalkit.fingerprint import fingerprint
from evalkit.protocols import BackendSpec, DatasetSpec, MapperSpec

Spec = TypeVar("Spec")


def names(kind: str) -> list[str]:
    """All names of a kind: "backends", "mappers", "datasets" or "metrics", sorted."""
    return sorted(_found(kind))


def backend(name: str) -> BackendSpec:
    """The back end registered under a name."""
    return load("backends", name, BackendSpec)


def mapper(name: str) -> MapperSpec:
    """The mapper registered under a name."""
    return load("mappers", name, MapperSpec)


def dataset(name: str) -> DatasetSpec:
    """The data set or reader registered under a name."""
    return load("datasets", name, DatasetSpec)


def run_fingerprint(backend: str, dataset: str) -> str:
    """A digest of the code a run stands on: evalkit's part in it, the two plug-ins and the libraries they require."""
    modules = ("evalkit.worker", _found("backends")[backend].module, _found("datasets")[dataset].module)
    return fingerprint(modules, ("numpy", "scipy", *load("backends", backend, BackendSpec).requires))


def score_fingerprint(mapper: str) -> str:
    """A digest of the code the scores and the map of a run stand on."""
    return fingerprint(("evalkit.scoring", _found("mappers")[mapper].module), ("numpy", "scipy"))


def _found(kind: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=f"evalkit.{kind}")}


def load(kind: str, name: str, wanted: type[Spec]) -> Spec:
    """What is registered under a name of a kind; UnknownName lists the known ones."""
    points = _found(kind)
    if name not in points:
        raise UnknownName(kind.removesuffix("s"), name, points)
    try:
        spec = points[name].load()
    except (ImportError, AttributeError) as error:
        raise NotInstalled(
            name, f"its plug-in {points[name].value} does not load ({error})", "reinstall its package"
        ) from error
    if not isinstance(spec, wanted):
        raise NotInstalled(name, f"{points[name].value} is a {type(spec).__name__}", f"expected a {wanted.__name__}")
    return spec
