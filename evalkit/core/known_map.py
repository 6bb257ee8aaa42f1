"""The walls of a known map as points."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.core.arrays import freeze
from evalkit.core.errors import BadData
from evalkit.core.se2 import Floats


@dataclass(frozen=True, eq=False)
class KnownMap:
    """The centres (N, 2) of the occupied cells in the map's frame (m), the side of a cell, and the map's name.

    Raises BadData without an occupied cell.
    """

    walls: Floats
    resolution_m: float
    name: str

    def __post_init__(self) -> None:
        freeze(self, "walls", self.walls, (None, 2))
        if not len(self.walls):
            raise BadData(self.name, "", "the map has no occupied cell", "give a map with walls")
