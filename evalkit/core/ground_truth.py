"""Ground truth of a sequence: trajectory, relations, grid, measured distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core.arrays import freeze
from evalkit.core.grid import OccupancyGrid
from evalkit.core.measured_distances import Span
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Relations:
    """Measured motions between pairs of times (Kuemmerle 2009): ``first_from_second`` (M, 3) of the robot's base."""

    first_ns: Stamps
    second_ns: Stamps
    first_from_second: Floats

    def __post_init__(self) -> None:
        freeze(self, "first_ns", self.first_ns, (None,), np.int64)
        freeze(self, "second_ns", self.second_ns, (len(self.first_ns),), np.int64)
        freeze(self, "first_from_second", self.first_from_second, (len(self.first_ns), 3))

    def __len__(self) -> int:
        return len(self.first_ns)


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of a sequence; every part is optional.

    ``how``: origin and accuracy for the report ("exact: simulated", "graph-optimised poses, ~3 cm"). ``plan``: a map of
    the place in its own frame, shown but not used for scores. ``spans``: distances measured with a tape.
    """

    how: str
    trajectory: Trajectory | None = None
    relations: Relations | None = None
    grid: OccupancyGrid | None = None
    plan: OccupancyGrid | None = None
    spans: tuple[Span, ...] = ()
