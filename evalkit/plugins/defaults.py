"""Defaults of commands, chosen from the installed plug-ins by the declarations in their specs."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from evalkit.core.errors import NotInstalled
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Excerpt, Role


def find_reference_backend() -> str:
    """Return the first back end by name with role "reference" that runs here; raises NotInstalled if there is none."""
    for name in find_backends_with_role("reference"):
        if not registry.find_backend(name).missing():
            return name
    raise NotInstalled("reference", 'no installed back end has the role "reference"', "name a back end explicitly")


def find_backends_with_role(role: Role) -> list[str]:
    """Return the registered back ends with a role, by name, also those that cannot run here."""
    return [name for name in registry.names("backends") if registry.find_backend(name).role == role]


def find_default_backends() -> list[str]:
    """Return the back ends that a comparison without named methods runs; all if none declares itself a default."""
    names = registry.names("backends")
    return [name for name in names if registry.find_backend(name).default] or names


def find_mapper_of(backend: str) -> str:
    """Return the first mapper that is defined in the same module as a back end, or ""."""
    home = registry.plug_in_of("backends", backend).module
    mappers = registry.names("mappers")
    return next((name for name in mappers if registry.plug_in_of("mappers", name).module == home), "")


def find_default_mapper() -> str:
    """Return the first mapper by name that declares itself the default; raises NotInstalled if there is none."""
    for name in registry.names("mappers"):
        with contextlib.suppress(NotInstalled):  # a plug-in that does not load
            if registry.mapper(name).default:
                return name
    raise NotInstalled("mapper", "no installed mapper is declared as the default", "name a mapper explicitly")


def find_excerpts(size: Excerpt) -> dict[str, Mapping[str, Value]]:
    """Return the parameters of each data set with an excerpt of a size, simulated data sets first, then by name."""
    specs = {name: registry.dataset(name) for name in registry.names("datasets")}
    ordered = sorted(specs, key=lambda name: (not specs[name].seeded, name))
    return {name: specs[name].excerpts[size] for name in ordered if size in specs[name].excerpts}


def find_simulated_dataset() -> str:
    """Return the first simulated data set by name that declares excerpts; raises NotInstalled if there is none."""
    for name in find_excerpts("quick"):
        if registry.dataset(name).seeded:
            return name
    raise NotInstalled("sequence", "no installed simulated data set declares an excerpt", "name a data set explicitly")
