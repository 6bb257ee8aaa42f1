"""Search the place of some points in a known map."""

from __future__ import annotations

import math
from functools import cached_property
from typing import NamedTuple

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.known_map import KnownMap
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.odometry.correlative import ScoreGrid, Window, branch_and_bound, other_headings, windows_around
from evalkit.odometry.local_map import voxel_means

SEARCH_CELL_M, SEARCH_DEPTH, SEARCH_POINTS = 0.1, 6, 300
FINE_CELL_M, FINE_STEP_RAD = 0.02, math.radians(0.25)
FINE_M, FINE_RAD = 0.12, math.radians(2.5)
GIVEN_M, GIVEN_RAD = 0.5, math.radians(15.0)
"""A given start is corrected within these."""

MIN_SCORE = 0.55
"""Smallest score of a place: points 0.11 m from the walls (root mean square) have it."""

MIN_GIVEN_SCORE = 0.3

RIVAL_SHARE = 0.92
"""A place is ambiguous where another one has this share of its score."""


class Place(NamedTuple):
    """The best place of some points in a map, ``map_from_base``, its score and the best score of another place.

    ``rival`` is 0 where no other place reaches ``RIVAL_SHARE`` of the score.
    """

    map_from_base: Pose
    score: float
    rival: float

    @property
    def is_ambiguous(self) -> bool:
        """Whether another place fits nearly as well."""
        return self.rival > 0.0


class MapSearch:
    """Finds places in a known map."""

    def __init__(self, known: KnownMap) -> None:
        self._known = known

    @cached_property
    def coarse(self) -> ScoreGrid:
        """The scores of places for the search of the whole map."""
        try:
            return ScoreGrid.from_points(self._known.walls, SEARCH_CELL_M, SEARCH_CELL_M, SEARCH_DEPTH)
        except ValueError as error:
            raise BadData(self._known.name, "", str(error), "cut the map to the part around the robot") from None

    def find_place(self, points: Floats) -> Place | None:
        """Return where in the whole map points (N, 2) of the base frame lie, at any heading; None where nowhere."""
        thinned = thin_evenly(points)
        window = Window.whole(self.coarse)
        best = branch_and_bound(self.coarse, thinned, window, MIN_SCORE)
        if best is None:
            return None
        rival, bound = 0.0, RIVAL_SHARE * best.score
        for part in (other_headings(best.target_from_source), *windows_around(window, best.target_from_source)):
            other = branch_and_bound(self.coarse, thinned, part, bound)
            if other is not None:
                rival = other.score
                break
        return Place(self._refine(thinned, best.target_from_source), best.score, rival)

    def correct_place(self, points: Floats, map_from_base: Pose) -> Place | None:
        """Return the best place of points (N, 2) within ``GIVEN_M`` and ``GIVEN_RAD`` of a given one."""
        thinned = thin_evenly(points)
        window = Window(map_from_base, GIVEN_M, GIVEN_M, GIVEN_RAD)
        best = branch_and_bound(self.coarse, thinned, window, MIN_GIVEN_SCORE)
        return None if best is None else Place(self._refine(thinned, best.target_from_source), best.score, 0.0)

    def score(self, points: Floats) -> float:
        """Return how well points (N, 2) of the map's frame lie on walls, 0 to 1; 0 without points."""
        return float(self.coarse.score(points).mean()) if len(points) else 0.0

    def _refine(self, points: Floats, found: Pose) -> Pose:
        reach = float(np.hypot(points[:, 0], points[:, 1]).max()) + 1.0
        near = self._known.walls[np.hypot(*(self._known.walls - [found.x, found.y]).T) <= reach]
        grid = ScoreGrid.from_points(near, FINE_CELL_M, 0.5 * SEARCH_CELL_M, 3)
        best = branch_and_bound(grid, points, Window(found, FINE_M, FINE_M, FINE_RAD, FINE_STEP_RAD))
        return found if best is None else best.target_from_source


def thin_evenly(points: Floats) -> Floats:
    """Return at most ``SEARCH_POINTS`` of the means of points (N, 2) in cells of the search, evenly chosen."""
    means = voxel_means(points, SEARCH_CELL_M)
    return means[:: max(1, math.ceil(len(means) / SEARCH_POINTS))]
