"""The known map of a run, and the start in it, by the reserved parameters of its sequence."""

from __future__ import annotations

import math
from collections.abc import Mapping

from evalkit.core.errors import BadData, BadParameter
from evalkit.core.known_map import KnownMap
from evalkit.core.pose import Pose
from evalkit.plugins.parameters import MAP, MAP_START, TRUE_MAP, Value
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.result_files import read_map


def load_known_map(parameters: Mapping[str, Value], sequence: Sequence) -> KnownMap | None:
    """Return the map in which the methods of a run track the robot; None where its sequence has none.

    Raises BadData or DataMissing where the map cannot be read, or the sequence has no true map.
    """
    name = str(parameters.get(MAP, ""))
    if not name:
        return None
    if name == TRUE_MAP:
        grid, map_from_grid = sequence.truth().grid, Pose()
        if grid is None:
            raise BadData(MAP, TRUE_MAP, "the sequence has no true map", "give the YAML file of a map")
    else:
        grid, map_from_grid = read_map(name)
    return KnownMap(map_from_grid.transform(grid.centres(grid.occupied())), grid.resolution_m, name)


def parse_start(text: str) -> Pose | None:
    """Return the start ``map_from_base`` of "x,y,yaw" (m, m, deg), None for "". Raises BadParameter."""
    if not text:
        return None
    try:
        x, y, yaw = (float(word) for word in text.split(","))
        return Pose(x, y, math.radians(yaw))
    except ValueError:
        raise BadParameter(MAP, MAP_START, text, "x,y,yaw in the frame of the map (m, m, deg)") from None
