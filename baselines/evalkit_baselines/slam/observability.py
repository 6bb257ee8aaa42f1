"""Which direction the walls of a scan leave open, and which turn, and an ICP that leaves both to its guess.

Between two bare walls the distance along them is not observable. Point-to-line ICP then follows the noise of the
normals, which holds the scan back: a corridor becomes too short. Nor is a turn about the axis of a round pillar, where
nothing else is seen. The odometry knows better.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.odometry import planar3d
from evalkit.odometry.local_map import voxel_means
from evalkit.plugins.protocols import Registration
from evalkit_baselines.paper.association import CloudCache

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

BLIND, SEEING = 0.045, 0.065
"""Ratio of the eigenvalues of the normals' scatter at which ICP decides nothing, or everything, along the weakest
direction. Measured: at most 0.04 in bare corridors, at least 0.07 in corridors with door niches, 0.2 in rooms."""

ROUND_M, FIXED_M = 0.15, 0.3
"""Root mean square distance of the normals' lines from one place, the one nearest to all, at which ICP decides nothing,
or everything, about a turn around it. Measured: 0.13 at most where only a round pillar is seen, 0.34 at least in
recordings and worlds (0.09 in one dirty scan of 772)."""

ROOM_RATIO = 0.2
"""From this ratio on all directions are equally well known."""

AS_MANY = 0.02
"""Near a keyframe in a room nothing is open, unless the number of hits differs by a larger share: a wall may have come
into view, or have left it."""

_RIDGE = 1e-4
"""Share of the points that hold the place near the origin, where walls leave it open."""

_VOXEL_M = 0.1
_NEIGHBOURS = 8
_SAMPLES = 100
"""Points whose normals count: every n-th, so that so many are left, and less than twice as many."""


@dataclass(frozen=True, eq=False)
class Openness:
    """What the walls fix least, in the scan's frame.

    ``direction`` (2,), and the ratio of eigenvalues, 0 to 1; the turn about ``centre`` (2,), and which share of it,
    0 to 1, they leave open.
    """

    direction: Floats
    ratio: float
    centre: Floats = field(default_factory=lambda: np.zeros(2))
    open_turn: float = 0.0

    @property
    def is_closed(self) -> bool:
        """Whether the walls fix everything."""
        return self.ratio >= SEEING and self.open_turn == 0.0

    @property
    def is_room(self) -> bool:
        """Whether the walls fix everything well."""
        return self.ratio >= ROOM_RATIO and self.open_turn == 0.0


ALL_OPEN = Openness(np.array([1.0, 0.0]), 0.0)
"""What too few points fix."""


def measure_openness(points: Floats, reach_m: float = math.inf) -> Openness:
    """Return what points (N, 2) within reach of the origin fix least; fewer than eight fix no direction (ratio 0).

    What a scan is not matched with fixes nothing: a wall at the end of a corridor, beyond the reach of the map.
    """
    sample = _sample(points)
    return _measure(sample, np.hypot(sample.points[:, 0], sample.points[:, 1]) <= reach_m)


class _Sample(NamedTuple):
    """Some points (K, 2) of a cloud, and the normals (K, 2) of the walls at them."""

    points: Floats
    normals: Floats


class Pairs(NamedTuple):
    """Some points (K, 2) of a scan, the normals (K, 2) of the walls at them, and their target points, in its frame."""

    points: Floats
    normals: Floats
    targets: Floats


def _sample(points: Floats) -> _Sample:
    thinned = voxel_means(points, _VOXEL_M)
    every = max(len(thinned) // _SAMPLES, 1)
    return _Sample(thinned[::every], planar3d.normals(thinned, _NEIGHBOURS, math.inf)[::every])


def _measure(sample: _Sample, counts: Bools) -> Openness:
    """Return what the points that count (K,) fix least."""
    points, normals = sample.points[counts], sample.normals[counts]
    if len(points) < _NEIGHBOURS:
        return ALL_OPEN
    values, vectors = np.linalg.eigh(normals.T @ normals)
    # a turn about c moves a point p along its normal n by p x n - c x n
    across = np.column_stack([normals[:, 1], -normals[:, 0]])
    moments = (points * across).sum(axis=1)
    centre = np.linalg.solve(across.T @ across + _RIDGE * len(points) * np.eye(2), across.T @ moments)
    away_m = math.sqrt(max(float(moments @ moments - centre @ across.T @ moments) / len(points), 0.0))
    open_turn = float(np.clip((FIXED_M - away_m) / (FIXED_M - ROUND_M), 0.0, 1.0))
    return Openness(vectors[:, 0], float(max(values[0], 0.0) / values[1]), centre, open_turn)


@dataclass
class ObservableIcp:
    """A Registration: an ICP whose answer along an open direction, and about an open turn, is the guess.

    Points of the source that are farther than ``paired_m`` from every point of the target fix nothing: a wall that has
    just come into view is in no map yet. ``is_closed``: nothing is known to be open, and the source is not measured.
    """

    icp: Registration
    paired_m: float
    is_closed: bool = False
    _samples: CloudCache[_Sample] = field(default_factory=CloudCache, repr=False, compare=False)
    _trees: CloudCache[cKDTree] = field(default_factory=CloudCache, repr=False, compare=False)

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``."""
        match = self.icp.register(target, source, guess)
        if self.is_closed:
            return match
        open_ = self._measure(target, source, match.target_from_source)
        trust = float(np.clip((open_.ratio - BLIND) / (SEEING - BLIND), 0.0, 1.0))
        if trust == 1.0 and open_.open_turn == 0.0:
            return match
        pose = _turn_back(match.target_from_source, guess, open_)
        along = Pose(0.0, 0.0, pose.theta).transform(open_.direction[None])[0]
        moved = np.array([pose.x - guess.x, pose.y - guess.y])
        x, y = moved - (1.0 - trust) * float(moved @ along) * along
        return replace(match, target_from_source=Pose(guess.x + x, guess.y + y, pose.theta))

    def find_pairs(self, target: Cloud, source: Cloud, target_from_source: Pose) -> Pairs:
        """Return some points of a source whose nearest point of the target is at most ``paired_m`` away."""
        sample, nearest = self._find_nearest(target, source, target_from_source)
        paired = nearest < len(target)
        targets = target_from_source.inverse().transform(target.points[nearest[paired]])
        return Pairs(sample.points[paired], sample.normals[paired], targets)

    def _measure(self, target: Cloud, source: Cloud, target_from_source: Pose) -> Openness:
        sample, nearest = self._find_nearest(target, source, target_from_source)
        return _measure(sample, nearest < len(target))

    def _find_nearest(self, target: Cloud, source: Cloud, target_from_source: Pose) -> tuple[_Sample, Ints]:
        """Return the sample of a source, and the nearest point of the target (K,) to each; len(target): none."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - specs are listed without SciPy

        sample = self._samples.get(source, lambda cloud: _sample(cloud.points))
        tree = self._trees.get(target, lambda cloud: cKDTree(cloud.points, balanced_tree=False))
        moved = target_from_source.transform(sample.points)
        return sample, np.asarray(tree.query(moved, distance_upper_bound=self.paired_m)[1], dtype=np.int64)


def _turn_back(pose: Pose, guess: Pose, openness: Openness) -> Pose:
    """Return a pose turned towards the heading of the guess about the centre of the open turn."""
    theta = pose.theta - openness.open_turn * float(se2.wrap(pose.theta - guess.theta))
    centre = openness.centre[None]
    x, y = pose.transform(centre)[0] - Pose(0.0, 0.0, theta).transform(centre)[0]
    return Pose(x, y, theta)
