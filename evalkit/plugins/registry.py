"""Names to specs, by entry points: the same way for what ships with evalkit and for a stranger's package.

Listing names imports nothing; loading one name imports only the module it stands in.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from types import FunctionType
from typing import TypeVar

from evalkit.core.errors import EvalkitError, NotInstalled, UnknownName
from evalkit.plugins.code_hash import fingerprint
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Odometry
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, OdometrySpec

Spec = TypeVar("Spec")

_PLACE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


MARK = "EVALKIT_CHILD"
"""Environment variable by which a child's descendants are known, wherever they have gone."""

LOADING_S = 60.0
"""How long importing somebody else's plug-in may take."""


def names(kind: str) -> list[str]:
    """All names of a kind: "backends", "mappers", "datasets" or "metrics", sorted."""
    return sorted(_found(kind))


def backend(name: str) -> BackendSpec:
    """The back end of a name: registered, of a scheme ("exec:./my_icp --fast"), or in a module ("my.icp:SPEC")."""
    scheme, colon, rest = name.partition(":")
    if not colon:
        return load("backends", name, BackendSpec)
    if point := _in_module(name):
        return _loaded(name, point, BackendSpec)
    made: BackendSpec = load("schemes", scheme, FunctionType)(rest)
    return made


def find_backend(name: str) -> BackendSpec:
    """Like ``backend``, but a plug-in that does not load gives a spec whose ``missing()`` returns the reason."""
    try:
        spec = backend(name)
        spec.missing()
    except NotInstalled as error:
        reason = str(error)
    except EvalkitError:
        raise
    except Exception as error:  # noqa: BLE001 - third-party code; the other plug-ins stay usable
        reason = f"its plug-in failed: {type(error).__name__}: {error}"
    else:
        return spec

    def make(**_parameters: Value) -> Odometry:
        raise NotInstalled(name, "cannot be used", reason)

    unknown = "not told: its plug-in does not load"
    return OdometrySpec(make, unknown, unknown, unknown, missing=lambda: reason)


def mapper(name: str) -> MapperSpec:
    """The mapper registered under a name."""
    return load("mappers", name, MapperSpec)


def dataset(name: str) -> DatasetSpec:
    """The data set or reader registered under a name."""
    return load("datasets", name, DatasetSpec)


def run_fingerprint(method: str, dataset: str) -> str:
    """A digest of the code a run stands on: evalkit's part in it, the two plug-ins and the libraries they require."""
    spec = backend(method)
    plug_in = plug_in_of("backends", method)
    modules = ("evalkit.execution.worker", plug_in.module, _found("datasets")[dataset].module)
    return fingerprint(modules, ("numpy", "scipy", *spec.requires)) + spec.digest


def plug_in_of(kind: str, name: str) -> EntryPoint:
    """Where the plug-in of a name of a kind stands; a back end of a scheme stands where the scheme does."""
    scheme, colon, _ = name.partition(":")
    if not colon:
        return _point(kind, name)
    return _in_module(name) or _point("schemes", scheme)


def score_fingerprint(mapper: str) -> str:
    """A digest of the code the scores and the map of a run stand on."""
    return fingerprint(
        ("evalkit.metrics.evaluate", "evalkit.metrics.evaluate_map", _found("mappers")[mapper].module),
        ("numpy", "scipy"),
    )


def _found(kind: str) -> dict[str, EntryPoint]:
    return _listed(kind, tuple(sys.path))


@cache  # looking through every installed package takes 30 ms, and a plan asks hundreds of times
def _listed(kind: str, _path: tuple[str, ...]) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=f"evalkit.{kind}")}


def load(kind: str, name: str, wanted: type[Spec]) -> Spec:
    """What is registered under a name of a kind; UnknownName lists the known ones."""
    return _loaded(name, _point(kind, name), wanted)


def _point(kind: str, name: str) -> EntryPoint:
    points = _found(kind)
    if name not in points:
        raise UnknownName(kind.removesuffix("s"), name, points)
    return points[name]


def _in_module(name: str) -> EntryPoint | None:
    """The place a name "module:SPEC" spells out, None where it is no such name: schemes come first."""
    module, _, attribute = name.partition(":")
    if module in _found("schemes") or not _PLACE.fullmatch(name):
        return None
    try:
        found = find_spec(module)
    except (ImportError, ValueError):  # a part of it is no package
        return None
    return EntryPoint(attribute, name, "evalkit.backends") if found else None


def _loaded(name: str, point: EntryPoint, wanted: type[Spec]) -> Spec:
    if _foreign(point) and (why := _fatal(point.module)):
        raise NotInstalled(name, f"its plug-in {point.value} does not load ({why})", "mend or remove its package")
    try:
        spec = point.load()
    except Exception as error:  # a plug-in is a third party's code; it must not take the others along
        raise NotInstalled(
            name, f"its plug-in {point.value} does not load ({error})", "reinstall its package"
        ) from error
    if not isinstance(spec, wanted):
        raise NotInstalled(name, f"{point.value} is a {type(spec).__name__}", f"expected a {wanted.__name__}")
    return spec


def _foreign(point: EntryPoint) -> bool:
    """Whether a plug-in is somebody else's, and nobody has been put into a process of his own to run it."""
    dist = getattr(point, "dist", None)
    return (dist is None or dist.name != "evalkit") and MARK not in os.environ


@cache  # once a process: it takes as long as the import
def _fatal(module: str) -> str:
    """How importing a module ends or stops the process that does it, "" where it does neither: tried in another one.

    What it raises is for whoever imports it: that does no harm.
    """
    path = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-P", "-c", f"try:\n import {module}\nexcept Exception: pass"]
    try:
        tried = subprocess.run(
            command, env={**os.environ, "PYTHONPATH": path}, stdin=subprocess.DEVNULL, capture_output=True,
            timeout=LOADING_S, check=False, start_new_session=True,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"importing it takes more than {LOADING_S:g} s"
    if tried.returncode < 0:
        return f"importing it ends the process by signal {-tried.returncode}"
    return f"importing it ends the process with code {tried.returncode}" if tried.returncode else ""
