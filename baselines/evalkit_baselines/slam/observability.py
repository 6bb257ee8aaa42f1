"""Which direction the walls of a scan leave open, and an ICP that leaves that direction to its guess.

Between two bare walls the distance along them is not observable. Point-to-line ICP then follows the noise of the
normals, which holds the scan back: a corridor becomes too short. The odometry knows better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.protocols import Registration
from evalkit_baselines.embedded import normals_2d
from evalkit_baselines.paper.association import CloudCache

BLIND, SEEING = 0.045, 0.065
"""Ratio of the eigenvalues of the normals' scatter at which ICP decides nothing, or everything, along the weakest
direction. Measured: at most 0.04 in bare corridors, at least 0.07 in corridors with door niches, 0.2 in rooms."""

_VOXEL_M = 0.1
_NEIGHBOURS = 8
_SAMPLES = 100
"""Points whose normals count: every n-th, so that so many are left, and less than twice as many."""


@dataclass(frozen=True, eq=False)
class Openness:
    """The direction (2,) in the scan's frame that the walls fix least, and the ratio of eigenvalues, 0 to 1."""

    direction: Floats
    ratio: float


def measure_openness(points: Floats, reach_m: float = math.inf) -> Openness:
    """Return the weakest direction of points (N, 2) within reach of the origin; with fewer than eight all are open (ratio 0).

    What a scan is not matched with fixes nothing: a wall at the end of a corridor, beyond the reach of the map.
    """
    thinned = voxel_means(points, _VOXEL_M)
    every = max(len(thinned) // _SAMPLES, 1)
    near = np.flatnonzero(np.hypot(thinned[::every, 0], thinned[::every, 1]) <= reach_m) * every
    if len(near) < _NEIGHBOURS:
        return Openness(np.array([1.0, 0.0]), 0.0)
    normals = normals_2d(thinned, _NEIGHBOURS)[near]
    values, vectors = np.linalg.eigh(normals.T @ normals)
    return Openness(vectors[:, 0], float(max(values[0], 0.0) / values[1]))


@dataclass
class ObservableIcp:
    """A Registration: an ICP whose answer along an open direction is the guess.

    ``reach_m``: source points farther from its origin are not matched. ``is_closed``: nothing is known to be open, and the
    source is not measured.
    """

    icp: Registration
    reach_m: float = math.inf
    is_closed: bool = False
    _recent: CloudCache[Openness] = field(default_factory=CloudCache, repr=False, compare=False)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        match = self.icp.register(target, source, guess)
        if self.is_closed:
            return match
        open_ = self._recent.get(source, lambda cloud: measure_openness(cloud.points, self.reach_m))
        trust = float(np.clip((open_.ratio - BLIND) / (SEEING - BLIND), 0.0, 1.0))
        if trust == 1.0:
            return match
        pose = match.target_from_source
        along = Pose(0.0, 0.0, pose.theta).transform(open_.direction[None])[0]
        moved = np.array([pose.x - guess.x, pose.y - guess.y])
        x, y = moved - (1.0 - trust) * float(moved @ along) * along
        return replace(match, target_from_source=Pose(guess.x + x, guess.y + y, pose.theta))
