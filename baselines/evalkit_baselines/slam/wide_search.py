"""Search where on the map a doubted scan without odometry lies, farther from the prediction than ICP finds back.

A robot that turns quickly, or begins or ends to turn between two sparse scans, is up to 50 deg and 0.7 m from where
constant velocity puts it. Branch and bound finds the best score of the scan there. Where something near hides the
walls, all headings score alike, and the best one says nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats, wrap
from evalkit.odometry.correlative import ScoreGrid, Window, branch_and_bound, mild_prior

SIDE_M, TURN_RAD = 0.8, math.radians(60.0)
"""The search goes so far from the prediction."""

CELL_M = 0.1
_DEPTH = 5
_SIGMAS = 3.0

RIVAL_SHARE, OTHER_RAD = 0.92, math.radians(20.0)
"""A place is alone if no heading farther than this from its own has this share of its score. Other positions at its
heading do not count: along a corridor all score alike, and the nearest to the prediction is taken."""


class FoundPlace(NamedTuple):
    """The motion ``target_from_source`` of the best score, and whether no other heading scores nearly as well."""

    pose: Pose
    alone: bool


@dataclass
class WideSearch:
    """Finds scans on a map, whose scores are kept while it is the same object."""

    _target: Cloud | None = field(default=None, init=False)
    _grid: ScoreGrid | None = field(default=None, init=False)

    def find(self, target: Cloud, points: Floats, predicted: Pose) -> FoundPlace | None:
        """Return where points (N, 2) lie on a target around a prediction; None: nowhere."""
        if self._grid is None or self._target is not target:
            self._target, self._grid = target, ScoreGrid.from_points(target.points, CELL_M, CELL_M, _DEPTH)
        window = Window(predicted, SIDE_M, SIDE_M, TURN_RAD)
        prior = mild_prior(np.full(2, SIDE_M / _SIGMAS), TURN_RAD / _SIGMAS)
        best = branch_and_bound(self._grid, points, window, prior=prior)
        if best is None:
            return None
        least, offset = RIVAL_SHARE * best.score, float(wrap(best.target_from_source.theta - predicted.theta))
        rivals = [_window_between(predicted, *ends) for ends in _other_headings(offset)]
        alone = all(branch_and_bound(self._grid, points, rival, least) is None for rival in rivals)
        return FoundPlace(best.target_from_source, alone)


def _other_headings(offset: float) -> list[tuple[float, float]]:
    """Return the ranges of headings, from the prediction's, that are more than ``OTHER_RAD`` from an offset."""
    sides = [(offset + side * OTHER_RAD, side * TURN_RAD) for side in (-1.0, 1.0)]
    return [(start, end) for start, end in sides if abs(end) > math.copysign(1.0, end) * start]


def _window_between(predicted: Pose, start: float, end: float) -> Window:
    heading = predicted.theta + 0.5 * (start + end)
    return Window(Pose(predicted.x, predicted.y, heading), SIDE_M, SIDE_M, 0.5 * abs(end - start))
