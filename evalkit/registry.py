"""Names to specs, by entry points: the same way for what ships with evalkit and for a stranger's package.

Listing names imports nothing; loading one name imports only the module it stands in.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from evalkit.errors import NotInstalled, UnknownName
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


RUN_CODE = ("se2", "types", "protocols", "clock", "lift", "submap", "frontend", "worker")
SCORE_CODE = ("se2", "types", "scoring", "metrics")


def run_fingerprint(backend: str, dataset: str) -> str:
    """A digest of the code a run stands on: evalkit's part in it, the two plug-ins and the libraries they require."""
    plugins = [_found("backends")[backend].module, _found("datasets")[dataset].module]
    libraries = ["numpy", "scipy", *load("backends", backend, BackendSpec).requires]
    return _digest([*(f"evalkit.{name}" for name in RUN_CODE), *plugins], libraries)


def score_fingerprint(mapper: str) -> str:
    """A digest of the code the scores and the map of a run stand on."""
    return _digest([*(f"evalkit.{name}" for name in SCORE_CODE), _found("mappers")[mapper].module], ["numpy", "scipy"])


def _digest(modules: list[str], libraries: list[str]) -> str:
    parts = [*map(_source_digest, modules), *(f"{name} {_version(name)}" for name in libraries)]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


@cache
def _source_digest(module: str) -> str:
    """A digest of a module's file, or of every source file of a package."""
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return module
    origin = Path(spec.origin)
    files = sorted(origin.parent.rglob("*.py")) if spec.submodule_search_locations else [origin]
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()


@cache
def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "absent"


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
