"""Addresses of specs: names and module paths by which another process finds the same spec."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from evalkit.core.errors import NotInstalled
from evalkit.plugins import registry
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec


class LoadingStopped(BaseException):
    """A file that is loaded for its spec has come to a check of that spec: the rest of it is not run."""


_loading: list[str] = []
"""Files that this process is loading for a spec in them."""


def stop_loading() -> None:
    """End the loading of a file here; nothing where no file is being loaded.

    A script without a main guard that checks a spec of its own is loaded once more by the process that checks it.
    """
    if _loading:
        raise LoadingStopped


Spec = TypeVar("Spec", BackendSpec, DatasetSpec, MapperSpec)


@dataclass(frozen=True)
class Address:
    """A registered name in ``label`` alone, or the spec's module, its name there and the module's file.

    ``holds``: what the spec is, where it was given itself: a script may give its name to several in turn.
    """

    label: str
    module: str = ""
    attribute: str = ""
    file: str = ""
    holds: str = ""


def address_of(plug_in: str | BackendSpec | DatasetSpec | MapperSpec | type) -> Address:
    """Find the address of a registered name, of "module:SPEC", of a spec object or of a class that is a back end.

    Raises NotInstalled for an object that another process cannot import.
    """
    if not isinstance(plug_in, str):
        return _address_of_object(plug_in)
    module, colon, attribute = plug_in.partition(":")
    if not colon or module in registry.names("schemes"):
        return Address(plug_in)
    return Address(plug_in, module, attribute)


def require_imported(address: Address) -> None:
    """Raise NotInstalled for a module whose import has not ended: in another process it would not end either."""
    if _is_being_imported(address.module):
        what = f"the module {address.module} is being imported: its import would run this comparison again and again"
        remedy = f"move the comparison to another file, or into a function that is called after import {address.module}"
        raise NotInstalled(address.label, what, remedy)


def _is_being_imported(module: str) -> bool:
    """Return whether the import of a module, or of a package that holds it, has not ended."""
    parts = module.split(".")
    found = (sys.modules.get(".".join(parts[:count])) for count in range(1, len(parts) + 1))
    return any(getattr(getattr(one, "__spec__", None), "_initializing", False) for one in found)


def label_of(plug_in: str | BackendSpec | DatasetSpec | MapperSpec, otherwise: str) -> str:
    """Name a plug-in as its address does, or otherwise if no module has it."""
    if isinstance(plug_in, str):
        return plug_in
    try:
        return address_of(plug_in).label
    except NotInstalled:
        return otherwise


def spec_at(address: Address, wanted: type[Spec], registered: Callable[[str], Spec]) -> Spec:
    """Load the spec at an address; ``registered`` loads registered names. Raises NotInstalled where there is none."""
    if not address.module:
        return registered(address.label)
    try:
        spec = registry.as_spec(getattr(_module(address), address.attribute), wanted)
    except Exception as error:  # third-party code; a plug-in under development may raise anything
        is_library = isinstance(error, ImportError) and error.name not in (None, address.module)
        remedy = _LIBRARY_REMEDY if is_library else _REMEDY
        raise NotInstalled(address.label, f"does not load ({type(error).__name__}: {error})", remedy) from error
    if not isinstance(spec, wanted):
        or_class = " or a class with register or update" if wanted is BackendSpec else ""
        found = f"is a {type(spec).__name__}, expected a {wanted.__name__}{or_class}"
        raise NotInstalled(address.label, found, _REMEDY)
    if address.holds and (other := _identify(spec)) != address.holds:
        what = f"is {other} when its module is loaded by another process, and was given as {address.holds}"
        raise NotInstalled(address.label, what, "give each spec a name of its own, before the first check")
    return spec


def _identify(spec: BackendSpec | DatasetSpec | MapperSpec) -> str:
    """Return what tells a spec from others of its module, equal in every process."""
    made = getattr(spec.make, "__qualname__", type(spec.make).__qualname__)
    defaults = ", ".join(f"{one.name} {one.default}" for one in spec.parameters)
    return f"'{spec.summary}' of {made}({defaults})"


_LIBRARY_REMEDY = "install that; a plug-in imports its library in the code that `make` calls, and says in `missing` how"
_REMEDY = "give a registered name, or module:SPEC of a module that can be imported"


def _module(address: Address) -> ModuleType:
    """Import a module by its name, or by its file where the name belongs to another module (a test, a script)."""
    if address.module != "__main__":
        try:
            module = importlib.import_module(address.module)
        except ModuleNotFoundError:
            if not address.file:
                raise
        else:
            if address.file in ("", getattr(module, "__file__", None)):
                return module
    elif not address.file:  # an interactive session, which no other process can load
        return sys.modules["__main__"]
    return _module_of_file(address.file)


def _module_of_file(file: str) -> ModuleType:
    name = f"_checked_{Path(file).stem}"
    if name not in sys.modules:
        found = importlib.util.spec_from_file_location(name, file)
        if found is None or found.loader is None:
            raise ImportError(f"{file} is not a Python file")
        sys.modules[name] = module = importlib.util.module_from_spec(found)
        _loading.append(file)
        with contextlib.suppress(LoadingStopped):
            found.loader.exec_module(module)
        _loading.pop()
    return sys.modules[name]


def _address_of_object(spec: BackendSpec | DatasetSpec | MapperSpec | type) -> Address:
    if isinstance(spec, type):
        return _address_of_class(spec)
    home = getattr(spec.make, "__module__", "")  # first the module that defines it; others may have imported it
    for name, module in sorted(sys.modules.items(), key=lambda item: item[0] != home):
        for attribute, value in list(vars(module).items()) if isinstance(module, ModuleType) else ():
            if value is spec:
                file = str(getattr(module, "__file__", "") or "")
                return Address(f"{name}:{attribute}", name, attribute, file, _identify(spec))
    raise NotInstalled(
        "this spec", "has no name in any module, so another process cannot find it", "assign it to a name in a module"
    )


def _address_of_class(made: type) -> Address:
    """Return the address of a class that is a back end itself."""
    module, name = made.__module__, made.__qualname__
    if module == "__main__" or "." in name:
        where = "in a notebook or a script" if module == "__main__" else "inside a function or a class"
        remedy = f"move it to a file, say my_icp.py, and give my_icp.{made.__name__}"
        raise NotInstalled(name, f"this class is defined {where}, where no other process can import it", remedy)
    return Address(f"{module}:{name}", module, name, str(getattr(sys.modules.get(module), "__file__", "") or ""))


def backend_at(backend: str | BackendSpec) -> BackendSpec:
    """Return the spec of a registered name, of "module:SPEC", or itself. Raises NotInstalled if there is none."""
    return spec_at(address_of(backend), BackendSpec, registry.backend)


def dataset_at(dataset: str | DatasetSpec) -> DatasetSpec:
    """Return the spec of a registered name, of "module:SPEC", or itself. Raises NotInstalled if there is none."""
    return spec_at(address_of(dataset), DatasetSpec, registry.dataset) if isinstance(dataset, str) else dataset


def mapper_at(mapper: str | MapperSpec) -> MapperSpec:
    """Return the spec of a registered name, of "module:SPEC", or itself. Raises NotInstalled if there is none."""
    return spec_at(address_of(mapper), MapperSpec, registry.mapper) if isinstance(mapper, str) else mapper
