"""A mapper under test, and scans of a room from known poses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property

import numpy as np

from evalkit.commands.validate.equivalence.map_cells import PosedScan
from evalkit.commands.validate.rules import scenes
from evalkit.commands.validate.rules.rule import RuleBroken
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import Value
from evalkit.plugins.protocols import Mapper

WORLD_FROM_ROOM = Pose(0.513, 0.227, 0.5)
"""The room lies around the corner of four cells, where truncation is not floor, and its walls cross cells."""

SCANS, BEAMS = 20, scenes.BEAMS


class MapperFixture:
    """A mapper under test, and scans of the room from known poses."""

    def __init__(self, make: Callable[..., Mapper], parameters: Mapping[str, Value]) -> None:
        self.parameters = parameters
        self._make = make
        self.scans = tuple(_cast(index) for index in range(SCANS))

    def make(self) -> Mapper:
        """A new mapper."""
        return self._make(**self.parameters)

    def draw(self, scans: Iterable[PosedScan]) -> OccupancyGrid:
        """The map that a new mapper draws."""
        mapper = self.make()
        for scan, pose in scans:
            mapper.update(scan, pose)
        return grid_of(mapper)

    @cached_property
    def grid(self) -> OccupancyGrid:
        """The map of all scans."""
        return self.draw(self.scans)


def grid_of(mapper: Mapper) -> OccupancyGrid:
    """The map of a mapper; raises RuleBroken for anything else."""
    grid: object = mapper.grid()
    if not isinstance(grid, OccupancyGrid):
        raise RuleBroken(f"grid() returns a {type(grid).__name__}, expected an evalkit.OccupancyGrid")
    return grid


def _cast(index: int) -> PosedScan:
    """A scan of the room without noise, and the pose of the sensor in the world; the sensor moves and turns."""
    pose = Pose(-2.0 + 0.03 * index, -1.5 + 0.02 * index, 0.4 + 0.015 * index)
    angles: Floats = np.arange(BEAMS, dtype=np.float64) * (2.0 * np.pi / BEAMS)
    ranges = scenes.ROOM.cast(np.tile(pose.row[:2], (BEAMS, 1)), pose.theta + angles)
    return Scan(index, ranges, angles, 0.15, 12.0), WORLD_FROM_ROOM @ pose
