"""Defaults of commands, chosen from the installed plug-ins by the declarations in their specs."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping

from evalkit.core.errors import NotInstalled
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Excerpt, Role


def reference_backend() -> str:
    """The first back end by name whose role is "reference" and that runs here; NotInstalled if there is none."""
    for name in backends_with_role("reference"):
        if not registry.find_backend(name).missing():
            return name
    raise NotInstalled("reference", 'no installed back end has the role "reference"', "name a back end explicitly")


def backends_with_role(role: Role) -> list[str]:
    """The registered back ends with a role, by name, also those that cannot run here."""
    return [name for name in registry.names("backends") if registry.find_backend(name).role == role]


def mapper_of(backend: str) -> str:
    """The first mapper that is defined in the same module as a back end, or ""."""
    home = registry.plug_in_of("backends", backend).module
    mappers = registry.names("mappers")
    return next((name for name in mappers if registry.plug_in_of("mappers", name).module == home), "")


def default_mapper() -> str:
    """The first mapper by name that declares itself the default; raises NotInstalled if there is none."""
    for name in registry.names("mappers"):
        with contextlib.suppress(NotInstalled):  # a plug-in that does not load
            if registry.mapper(name).default:
                return name
    raise NotInstalled("mapper", "no installed mapper is declared as the default", "name a mapper explicitly")


def excerpts(size: Excerpt) -> dict[str, Mapping[str, Value]]:
    """The parameters of every data set that declares an excerpt of a size, simulated data sets first, then by name."""
    specs = {name: registry.dataset(name) for name in registry.names("datasets")}
    ordered = sorted(specs, key=lambda name: (not specs[name].seeded, name))
    return {name: specs[name].excerpts[size] for name in ordered if size in specs[name].excerpts}


def simulated_dataset() -> str:
    """The first data set by name that is simulated and declares excerpts; NotInstalled if there is none."""
    for name in excerpts("quick"):
        if registry.dataset(name).seeded:
            return name
    raise NotInstalled("sequence", "no installed simulated data set declares an excerpt", "name a data set explicitly")
