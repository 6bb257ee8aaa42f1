"""Four scenes with a known outline, and pairs of simulated scans from two poses close together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evalkit.core import se2
from evalkit.core.errors import UnknownName
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline

RANGE_M = (0.15, 12.0)
"""Shortest and longest range of the lidar (m)."""

NEAR = Pose(0.3, 0.15, float(np.radians(10.0)))
"""The largest motion between the two scans of a pair, by coordinate."""


@dataclass(frozen=True, eq=False)
class SceneModel:
    """A named world, and ``stands``: lower and upper corner (m) of a box of lidar positions clear of all walls."""

    name: str
    what: str
    world: World
    stands: tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class KnownPair:
    """A pair of noisy scans of a scene, each in its sensor's frame, and the exact motion.

    ``world_from_target`` and ``target_from_source`` are true. ``points`` and ``normals`` (N, 2): the points
    of the source scan without noise, relative to the source's sensor, along the axes of the world.
    """

    target: Cloud
    source: Cloud
    world_from_target: Pose
    target_from_source: Pose
    points: Floats
    normals: Floats


def _box(x: float, y: float, width: float, depth: float, degrees: float = 0.0) -> Floats:
    """The four walls of a rotated box with centre (x, y)."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (width / 2.0, depth / 2.0)
    return closed_outline(se2.transform([x, y, np.radians(degrees)], corners))


_CLUTTERED = (
    closed_outline([[-4.0, -3.0], [4.0, -3.0], [4.0, 3.0], [-4.0, 3.0]]),
    *(_box(*row) for row in (
        (-3.2, 2.4, 1.5, 0.8, 0.0), (3.3, -1.9, 0.9, 1.6, 0.0), (2.6, 2.2, 0.7, 0.6, 25.0),
        (-2.9, -2.1, 1.1, 0.5, -40.0), (-3.4, 0.3, 0.4, 0.9, 10.0), (1.9, -2.6, 0.5, 0.4, -15.0),
    )),
)  # fmt: skip
_NICHED = np.array([[-4, -3], [4, -3], [4, 3], [1.5, 3], [1.5, 3.6], [-0.5, 3.6], [-0.5, 3], [-4, 3]], dtype=np.float64)
_LEGS = np.array([
    (2.3, 0.2), (2.9, 0.3), (2.2, 0.9), (2.8, 1.0), (-0.6, 2.1), (0.5, 2.2), (-0.7, 2.6), (0.4, 2.7),
    (-0.2, -2.2), (0.3, -2.1), (-0.1, -2.6), (0.4, -2.5), (-2.3, 1.1), (-2.6, -0.9),
])  # fmt: skip

SCENES = {
    place.name: place
    for place in (
        SceneModel(
            "bare-room",
            "a bare room of 8 x 6 m with a niche and a pillar",
            World(
                closed_outline(_NICHED),
                np.array([[2.4, 0.6, 0.3]]),
            ),
            ((-1.5, -1.5), (1.2, 1.5)),
        ),
        SceneModel(
            "long-corridor",
            "two bare parallel walls 2 m apart that extend beyond the lidar's range",
            World(np.array([[-20.0, -1.0, 20.0, -1.0], [-20.0, 1.0, 20.0, 1.0]])),
            ((-2.0, -0.4), (2.0, 0.4)),
        ),
        SceneModel(
            "corner",
            "two walls of 6 m that meet at a right angle, and nothing else within range",
            World(np.array([[0.0, 0.0, 6.0, 0.0], [0.0, 0.0, 0.0, 6.0]])),
            ((1.0, 1.0), (3.0, 3.0)),
        ),
        SceneModel(
            "clutter",
            "a room of 8 x 6 m full of boxes, cupboards and the legs of tables and chairs",
            World(np.concatenate(_CLUTTERED), np.column_stack([_LEGS, np.full(len(_LEGS), 0.03)])),
            ((-1.2, -1.0), (1.2, 1.0)),
        ),
    )
}
"""By name, in the order of the page."""


def find_scene(name: str) -> SceneModel:
    """The scene with this name; raises UnknownName."""
    if name not in SCENES:
        raise UnknownName("scene", name, SCENES)
    return SCENES[name]


def draw_pair(where: SceneModel, rng: np.random.Generator, beams: int, noise_m: float) -> KnownPair:
    """Draw a pair of scans over a full turn; ``noise_m``: standard deviation of the Gaussian noise of a range."""
    stand = rng.uniform(*where.stands)
    world_from_target = Pose(float(stand[0]), float(stand[1]), float(rng.uniform(-np.pi, np.pi)))
    target_from_source = Pose.of(rng.uniform(-NEAR.row, NEAR.row))
    world_from_source = world_from_target @ target_from_source
    target, _, _ = _scan(where, world_from_target, rng, beams, noise_m)
    source, points, normals = _scan(where, world_from_source, rng, beams, noise_m)
    return KnownPair(target, source, world_from_target, target_from_source, points, normals)


def _scan(
    where: SceneModel, world_from_sensor: Pose, rng: np.random.Generator, beams: int, noise_m: float
) -> tuple[Cloud, Floats, Floats]:
    """The noisy points in the sensor's frame, and exact points (from the sensor) and normals along the world's axes."""
    angles = np.arange(beams) * (2.0 * np.pi / beams)
    heading = angles + world_from_sensor.theta
    origin = world_from_sensor.row[:2]
    ranges = where.world.cast(np.broadcast_to(origin, (beams, 2)), heading)
    measured = ranges + rng.normal(0.0, noise_m, beams)
    met = (measured >= RANGE_M[0]) & (measured <= RANGE_M[1])
    in_sensor = np.stack([np.cos(angles), np.sin(angles)], axis=1)[met] * measured[met, None]
    points = np.stack([np.cos(heading), np.sin(heading)], axis=1)[met] * ranges[met, None]
    return Cloud(in_sensor), points, where.world.normals(origin + points)
