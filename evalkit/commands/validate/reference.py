"""What belongs to a back end without anybody saying so: the twin it is held against, the mapper it comes with."""

from __future__ import annotations

from evalkit.core.errors import NotInstalled
from evalkit.plugins import registry

ROLE = "paper"


def twin() -> tuple[str, str]:
    """The name of the twin where nobody names one, and how it was chosen; NotInstalled where there is none."""
    for name in registry.names("backends"):
        spec = registry.entrant(name)
        if spec.role == ROLE and not spec.missing():
            return name, f'the first back end by name with the role "{ROLE}"'
    raise NotInstalled("twin", f'no back end has the role "{ROLE}"', "name one with --twin")


def bars() -> list[str]:
    """The back ends all others have to beat."""
    return [name for name in registry.names("backends") if registry.entrant(name).role == "baseline"]


def mapper_of(backend: str) -> str:
    """The first mapper that stands in the very module the back end stands in, or ""."""
    home = registry.plug_in_of("backends", backend).module
    mappers = registry.names("mappers")
    return next((name for name in mappers if registry.plug_in_of("mappers", name).module == home), "")
