"""Registered names and their specs, found through entry points of installed packages.

evalkit's own plug-ins and those of other packages are found in the same way. Listing names imports no plug-in; loading
a name imports only the module that defines it.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import signal
import site
import subprocess
import sys
from functools import cache, reduce
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType
from typing import TYPE_CHECKING, TypeVar

from evalkit.core.errors import EvalkitError, NotInstalled, UnknownModule, UnknownName, plain
from evalkit.plugins.code_hash import hash_code
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec, OdometrySpec, spec_of_class

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

    from evalkit.plugins.protocols import Odometry

Spec = TypeVar("Spec")

_MODULE_AND_NAME = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


MARK = "EVALKIT_CHILD"
"""Environment variable that marks the child processes of evalkit and all their descendants."""

CLASH_REMEDY = "rename one of them in the pyproject.toml of its package and install that again, or remove a package"

LOADING_S = 60.0
"""Time limit for importing a third-party plug-in."""


KINDS = ("backends", "mappers", "datasets", "metrics", "commands", "schemes", "result_readers")
"""Kinds of plug-ins; the entry points of each are in the group ``evalkit.KIND``."""


def names(kind: str) -> list[str]:
    """Return all names of a kind of ``KINDS``, sorted."""
    return sorted(_points(kind))


def backend(name: str, address: str = "") -> BackendSpec:
    """Return the back end of a name: registered, of a scheme ("exec:./my_icp --fast"), or in a module ("my.icp:SPEC").

    ``address``: what ``find_address`` returns, where it is known: the installed packages are then not searched. Raises
    UnknownName (UnknownModule for a module), or NotInstalled where the plug-in does not load.
    """
    if address:
        return _load_address(name, address, BackendSpec)
    scheme, colon, rest = name.partition(":")
    if not colon:
        if name not in _points("backends") and name.isidentifier() and (file := _find_here(name)):
            hint = f"{file} is in this folder: give {name}:SPEC, with PYTHONPATH=."
            raise UnknownName("backend", name, _points("backends"), hint=hint)
        return load("backends", name, BackendSpec)
    if point := _module_point(name):
        return _load_point(name, point, BackendSpec)
    if scheme not in _points("schemes") and _MODULE_AND_NAME.fullmatch(name):
        raise UnknownModule(scheme, _points("schemes"), _find_here(scheme))
    spec: BackendSpec = load("schemes", scheme, FunctionType)(rest)
    return spec


def find_backend(name: str) -> BackendSpec:
    """Return the back end of a name; if its plug-in does not load, a spec with the reason in ``missing()``."""
    try:
        spec = backend(name)
        spec.missing()
    except NotInstalled as error:
        reason = str(error)
    except EvalkitError:
        raise
    except Exception as error:  # noqa: BLE001 - third-party code; the other plug-ins stay usable
        reason = plain(f"its plug-in failed: {type(error).__name__}: {error}")
    else:
        return spec

    def make(**_parameters: Value) -> Odometry:
        raise NotInstalled(name, "cannot be used", reason)

    unknown = "unknown: its plug-in does not load"
    return OdometrySpec(make, unknown, unknown, unknown, missing=lambda: reason)


def mapper(name: str) -> MapperSpec:
    """Return the mapper of a name; raises UnknownName or NotInstalled."""
    return load("mappers", name, MapperSpec)


def dataset(name: str) -> DatasetSpec:
    """Return the data set or reader of a name; raises UnknownName or NotInstalled."""
    return load("datasets", name, DatasetSpec)


def hash_run_code(method: str, dataset: str) -> str:
    """Return a digest of the code of a run: evalkit, both plug-ins and the libraries that the back end requires."""
    spec = backend(method)
    modules = (
        "evalkit.execution.one_run",
        plug_in_of("backends", method).module,
        _point("datasets", dataset).module,
    )
    return hash_code(modules, ("numpy", "scipy", *spec.requires)) + spec.digest


def hash_scoring_code(mapper: str) -> str:
    """Return a digest of the code that computes the scores and the map of a run, metrics of other packages included."""
    metrics = (_point("metrics", name).module for name in names("metrics"))
    return hash_code(("evalkit.metrics.evaluate", _point("mappers", mapper).module, *metrics), ("numpy", "scipy"))


def plug_in_of(kind: str, name: str) -> EntryPoint:
    """Return the entry point of a name; for a back end of a scheme, the entry point of the scheme."""
    scheme, colon, _ = name.partition(":")
    if not colon:
        return _point(kind, name)
    return _module_point(name) or _point("schemes", scheme)


def find_address(kind: str, name: str) -> str:
    """Return "module:SPEC" of a registered name, "" of a name that is none."""
    return _address(_point(kind, name)) if name in _points(kind) else ""


def find_search_path(method: str, dataset: str) -> str:
    """Return the entries of PYTHONPATH that hold the plug-ins of a run, joined as there; "" for installed ones."""
    entries = dict.fromkeys(filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)))
    if not entries:
        return ""
    found = {_find_root(point) for point in (plug_in_of("backends", method), plug_in_of("datasets", dataset))}
    found -= {Path(folder).resolve() for folder in (*site.getsitepackages(), site.getusersitepackages())}
    kept = (entry for entry in entries if Path(entry).resolve() in found)
    return os.pathsep.join("." if Path(entry).resolve() == Path.cwd() else entry for entry in kept)


def _find_root(point: EntryPoint) -> Path | None:
    """Return the folder that makes a plug-in known: of its package's metadata, or of a module without any."""
    if dist := getattr(point, "dist", None):
        return Path(str(dist.locate_file(""))).resolve()
    found = find_spec(point.module.partition(".")[0])
    places = [] if found is None else [*(found.submodule_search_locations or ()), found.origin]
    return Path(places[0]).resolve().parent if places and places[0] else None


def load(kind: str, name: str, wanted: type[Spec]) -> Spec:
    """Load what is registered under a name; raises UnknownName (with the known names) or NotInstalled."""
    return _load_point(name, _point(kind, name), wanted)


def _points(kind: str) -> dict[str, tuple[EntryPoint, ...]]:
    return _find_points(tuple(sys.path))[kind]


@cache  # searching all installed packages takes 30 ms, and a plan does it hundreds of times
def _find_points(_path: tuple[str, ...]) -> dict[str, dict[str, tuple[EntryPoint, ...]]]:
    """Return by kind and name the entry points; more than one where packages register different things under a name."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - loads much, and a run searches nothing

    found = entry_points()
    points: dict[str, dict[str, tuple[EntryPoint, ...]]] = {kind: {} for kind in KINDS}
    for kind, by_name in points.items():
        for point in found.select(group=f"evalkit.{kind}"):
            known = by_name.get(point.name, ())
            if all(point.value != one.value for one in known):
                by_name[point.name] = (*known, point)
    return points


def _point(kind: str, name: str) -> EntryPoint:
    """Return the entry point of a name; raises UnknownName, or NotInstalled where packages register it twice."""
    points = _points(kind)
    if name not in points:
        raise UnknownName(kind.removesuffix("s"), name, points, hint=_find_elsewhere(kind, name))
    if len(points[name]) > 1:
        raise NotInstalled(name, f"is registered by {' and by '.join(map(_describe, points[name]))}", CLASH_REMEDY)
    return points[name][0]


def _find_elsewhere(kind: str, name: str) -> str:
    """Return where a name is registered instead, in a group of another kind or in one that evalkit does not read."""
    from importlib.metadata import entry_points  # noqa: PLC0415 - as above

    others = (point for point in entry_points().select(name=name) if point.group.startswith("evalkit"))
    return next((f"{_describe(point)} is registered as {point.group}, not as evalkit.{kind}" for point in others), "")


def _describe(point: EntryPoint) -> str:
    dist = getattr(point, "dist", None)
    return point.value if dist is None else f"{_find_name(dist)} ({point.value})"


def _module_point(name: str) -> EntryPoint | None:
    """Return the entry point of a name "module:SPEC", None for any other name; schemes take precedence."""
    from importlib.metadata import EntryPoint  # noqa: PLC0415 - as above

    module, _, attribute = name.partition(":")
    if module in _points("schemes") or not _MODULE_AND_NAME.fullmatch(name):
        return None
    try:
        found = find_spec(module)
    except (ImportError, ValueError):  # a parent is not a package
        return None
    return EntryPoint(attribute, name, "evalkit.backends") if found else None


def _find_here(module: str) -> str:
    """Return the file of a module below the working directory, which is not on the path; "" if there is none."""
    path = Path(*module.split("."))
    return next((str(file) for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), "")


def _load_point(name: str, point: EntryPoint, wanted: type[Spec]) -> Spec:
    if _needs_trial_import(point) and (reason := _import_failure(point.module)):
        raise NotInstalled(name, f"its plug-in {point.value} does not load ({reason})", "repair or remove its package")
    return _load_address(name, _address(point), wanted)


def _address(point: EntryPoint) -> str:
    return f"{point.module}:{point.attr}"


def _load_address(name: str, address: str, wanted: type[Spec]) -> Spec:
    """Load a spec from "module:SPEC"; see ``load``."""
    module, _, attributes = address.partition(":")
    try:
        spec = as_spec(reduce(getattr, attributes.split("."), import_module(module)), wanted)
    except (Exception, SystemExit) as error:  # third-party code may raise anything; the other plug-ins stay usable
        why = f"importing it calls sys.exit({error})" if isinstance(error, SystemExit) else error
        what = f"its plug-in {address} does not load ({why})"
        raise NotInstalled(
            name, what, "correct its entry point, install what it imports, or remove its package"
        ) from error
    if not isinstance(spec, wanted):
        raise NotInstalled(name, f"{address} is a {type(spec).__name__}", f"expected a {wanted.__name__}")
    return spec


def as_spec(loaded: object, wanted: type[Spec]) -> object:
    """Return the spec of a class that is a back end itself, anything else as it is."""
    if isinstance(loaded, type) and wanted is BackendSpec:
        return spec_of_class(loaded) or loaded
    return loaded


def _needs_trial_import(point: EntryPoint) -> bool:
    """Return whether a plug-in is third-party and this process is not a child that may crash."""
    dist = getattr(point, "dist", None)
    return (dist is None or _find_name(dist) != "evalkit") and MARK not in os.environ


@cache  # a distribution reads its metadata anew each time
def _find_name(dist: Distribution) -> str:
    return dist.name


@cache  # once per process: it takes as long as the import
def _import_failure(module: str) -> str:
    """Return how importing a module ends or blocks a process, "" if it does neither; tried in a separate process.

    An exception is not a failure here: the caller's own import raises it again without harm. The supervisor of child
    processes stands on this module, and takes longer than most imports; so the trial only ends its own session, and
    an alarm ends it where evalkit was killed.
    """
    path = os.pathsep.join(filter(None, sys.path))
    alarm = f"import signal\ngetattr(signal, 'alarm', int)({math.ceil(LOADING_S) + 1})"
    nowhere = subprocess.DEVNULL  # a pipe would stay open as long as a process that the import leaves behind
    trial = subprocess.Popen(
        [sys.executable, "-P", "-c", f"{alarm}\ntry:\n import {module}\nexcept Exception: pass"],
        env={**os.environ, "PYTHONPATH": path}, stdin=nowhere, stdout=nowhere, stderr=nowhere, start_new_session=True,
    )  # fmt: skip
    try:
        code = trial.wait(LOADING_S)
    except subprocess.TimeoutExpired:
        return f"importing it takes more than {LOADING_S:g} s"
    finally:
        _kill_session(trial)
    if code < 0:
        return f"importing it ends the process by signal {-code}"
    return f"importing it ends the process with code {code}" if code else ""


def _kill_session(trial: subprocess.Popen[bytes]) -> None:
    """Kill a process that was started in a session of its own, with what it has left there."""
    if os.name == "posix":
        with contextlib.suppress(ProcessLookupError, PermissionError):  # none left, which macOS calls not permitted
            os.killpg(trial.pid, signal.SIGKILL)
    else:
        trial.kill()
    trial.wait()
