"""The five synthetic floor plans and the routes driven through them, in metres."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline
from evalkit_datasets.robot import Route

Point = tuple[float, float]


@dataclass(frozen=True)
class FloorPlan:
    """A world and one closed route through it, at least 0.3 m from every boundary."""

    world: World
    route: Route


def room() -> FloorPlan:
    """The paper's room: [0, 10] x [0, 10] with a round obstacle at (2, 8) of radius 1.5 (figures 6 to 8)."""
    world = World(closed_outline([(0, 0), (10, 0), (10, 10), (0, 10)]), np.array([[2.0, 8.0, 1.5]]))
    route = Route.from_corners(
        [
            (1.8, 1.8, 0.8), (8.2, 1.6, 0.5), (8.5, 5.0, 4.0), (7.5, 8.0, 0.25),
            (5.2, 7.4, 0.6), (4.8, 4.6, 0.6), (1.9, 4.4, 0.25),
        ]
    )  # fmt: skip
    return FloorPlan(world, route)


def lab() -> FloorPlan:
    """A laboratory of 10.5 x 8 m: an alcove, a door, desks, cupboards, boxes, chair legs and a pillar."""
    walls = closed_outline(
        [
            (0.0, 0.0), (9.7, 0.0), (10.5, 0.8), (10.5, 8.0), (6.6, 8.0), (6.6, 8.6), (4.4, 8.6), (4.4, 8.0),
            (0.0, 8.0), (0.0, 4.6), (-0.15, 4.6), (-0.15, 3.6), (0.0, 3.6),
        ]
    )  # fmt: skip
    furniture = [
        _box((4.9, 4.0), 2.4, 1.2, 8.0),  # the island in the middle of the route
        _box((2.1, 7.6), 3.0, 0.8),  # bench along the wall
        _box((10.15, 5.2), 0.7, 1.8),  # cupboard
        _box((9.2, 7.6), 1.4, 0.5),
        _box((6.3, 0.35), 1.2, 0.7),
        _box((8.3, 3.9), 0.5, 0.4, 25.0),  # boxes
        _box((0.5, 2.2), 0.6, 0.6, -15.0),
        _box((2.9, 5.1), 0.4, 0.3, 40.0),
    ]
    legs = [
        *_legs((3.0, 0.55), 1.6, 0.7),  # a table
        *_legs((4.4, 2.95), 0.42, 0.42, 20.0),  # chairs
        *_legs((5.9, 5.15), 0.42, 0.42, -30.0),
        *_legs((2.2, 6.9), 0.42, 0.42, 10.0),
    ]
    world = World(np.concatenate([walls, *furniture]), np.array([*legs, (7.6, 7.2, 0.25)]))
    route = Route.from_corners(
        [
            (1.8, 1.6, 0.5), (4.6, 1.75, 6.0), (7.4, 1.5, 2.0), (9.2, 2.4, 0.25), (9.1, 4.2, 6.0),
            (9.3, 6.6, 0.25), (7.2, 6.2, 2.5), (4.6, 6.8, 2.0), (1.7, 5.9, 0.25), (1.4, 3.6, 3.0),
        ]
    )  # fmt: skip
    return FloorPlan(world, route)


def loop() -> FloorPlan:
    """A ring of corridors, 1.8 m wide and about 40 m around its middle, with unevenly spaced door niches."""
    outer = [
        *_wall((0.0, 0.0), (14.2, 0.0), [(2.3, 0.9, 0.2), (5.1, 0.9, 0.2), (9.6, 1.4, 0.25)]),
        *_wall((14.2, 0.0), (14.2, 10.2), [(2.9, 0.9, 0.2), (7.2, 1.8, 0.4)]),
        *_wall((14.2, 10.2), (0.0, 10.2), [(1.9, 0.9, 0.2), (4.0, 0.9, 0.2), (7.7, 0.9, 0.3), (11.2, 0.9, 0.2)]),
        *_wall((0.0, 10.2), (0.0, 0.0), [(3.4, 1.2, 0.3), (6.0, 0.9, 0.2)]),
    ]
    inner = [
        *_wall((1.8, 1.8), (1.8, 8.4), [(1.1, 0.9, 0.2), (4.6, 0.9, 0.2)]),
        *_wall((1.8, 8.4), (12.4, 8.4), [(2.2, 0.9, 0.2), (6.3, 1.2, 0.3)]),
        *_wall((12.4, 8.4), (12.4, 1.8), [(2.7, 0.9, 0.2)]),
        *_wall((12.4, 1.8), (1.8, 1.8), [(0.9, 0.9, 0.2), (3.8, 0.9, 0.2), (8.3, 0.9, 0.2)]),
    ]
    extinguishers = np.array([[4.4, 0.0, 0.12], [14.2, 5.6, 0.12], [6.0, 8.4, 0.12]])
    route = Route.from_corners(
        [
            (0.9, 0.9, 0.5), (4.5, 1.05, 12.0), (8.0, 0.8, 12.0), (13.3, 0.9, 0.25), (13.2, 5.0, 12.0),
            (13.3, 9.3, 0.5), (9.5, 9.4, 12.0), (5.0, 9.2, 12.0), (0.9, 9.3, 0.25), (1.0, 5.0, 12.0),
        ]
    )  # fmt: skip
    return FloorPlan(World(np.concatenate([closed_outline(outer), closed_outline(inner)]), extinguishers), route)


def corridor() -> FloorPlan:
    """Two bare parallel walls, 2 m apart, that extend more than the lidar's 12 m beyond both ends of the route."""
    world = World(np.array([[0.0, 0.0, 36.0, 0.0], [0.0, 2.0, 36.0, 2.0]]))
    route = Route.from_corners([(13.0, 0.6, 0.4), (23.0, 0.6, 0.4), (23.0, 1.4, 0.4), (13.0, 1.4, 0.4)])
    return FloorPlan(world, route)


def office() -> FloorPlan:
    """Four furnished rooms on both sides of a hallway, connected by open doors 1 m wide; further doors are closed."""
    partitions = [
        *_partition((0.0, 5.0), (16.0, 5.0), [(2.0, 1.0), (7.5, 1.0)], [(11.6, 0.9), (14.0, 0.9)]),
        *_partition((0.0, 7.0), (16.0, 7.0), [(7.5, 1.0), (13.0, 1.0)], [(1.4, 0.9), (4.2, 0.9)]),
        *_partition((5.0, 0.0), (5.0, 5.0), [(2.0, 1.0)]),
        *_partition((10.5, 0.0), (10.5, 5.0)),
        *_partition((5.5, 7.0), (5.5, 12.0)),
        *_partition((10.8, 7.0), (10.8, 12.0), [(2.0, 1.0)]),
    ]
    furniture = [
        _box((0.35, 2.5), 0.7, 1.8),  # desks
        _box((3.3, 0.4), 1.6, 0.8),
        _box((6.6, 4.2), 1.6, 0.8, 5.0),
        _box((9.9, 1.2), 0.8, 1.6),
        _box((6.0, 11.0), 0.8, 1.6),
        _box((9.2, 11.6), 1.8, 0.7),
        _box((15.5, 9.2), 0.8, 2.0),
        _box((12.2, 11.5), 1.8, 0.8),
        _box((0.3, 4.5), 0.5, 0.6),  # cupboards
        _box((7.4, 0.2), 1.2, 0.4),
        _box((11.6, 7.35), 1.0, 0.4),
        _box((6.4, 7.4), 0.9, 0.5),
        _box((15.7, 6.6), 0.4, 0.5),  # hallway
        _box((5.2, 5.2), 0.5, 0.3),
    ]
    legs = [
        *_legs((1.1, 2.7), 0.42, 0.42, 15.0),
        *_legs((3.1, 1.2), 0.42, 0.42, -20.0),
        *_legs((6.5, 3.45), 0.42, 0.42),
        *_legs((9.1, 11.0), 0.42, 0.42, 30.0),
        *_legs((14.7, 9.0), 0.42, 0.42, -10.0),
        *_legs((12.0, 10.8), 0.42, 0.42, 5.0),
    ]
    walls = closed_outline([(0.0, 0.0), (16.0, 0.0), (16.0, 12.0), (0.0, 12.0)])
    world = World(np.concatenate([walls, *partitions, *furniture]), np.array([*legs, (9.6, 8.2, 0.2)]))
    route = Route.from_corners(
        [(2.5, 6.0, 0.5), (2.5, 2.5, 0.8), (8.0, 2.5, 0.25), (8.0, 9.5, 0.5), (13.5, 9.5, 0.25), (13.5, 6.0, 0.5)]
    )
    return FloorPlan(world, route)


def _box(centre: Point, width: float, depth: float, rotation_deg: float = 0.0) -> Floats:
    """Return the four walls (4, 4) of a box."""
    return closed_outline(_rectangle(centre, width, depth, rotation_deg))


def _legs(centre: Point, width: float, depth: float, rotation_deg: float = 0.0) -> list[tuple[float, float, float]]:
    """Return the four legs of a chair or table, 4 cm thick, as circles."""
    return [(x, y, 0.02) for x, y in _rectangle(centre, width, depth, rotation_deg)]


def _rectangle(centre: Point, width: float, depth: float, rotation_deg: float) -> list[Point]:
    """Return the four corners, counter-clockwise."""
    cos, sin = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    return [
        (
            float(centre[0] + cos * x * width - sin * y * depth),
            float(centre[1] + sin * x * width + cos * y * depth),
        )
        for x, y in corners
    ]


def _wall(start: Point, end: Point, niches: Iterable[tuple[float, float, float]] = ()) -> list[Point]:
    """Return the corners of a wall, except its end, with niches (distance from start, width, depth) on its right."""
    origin, forward, length = _direction(start, end)
    right = np.array([forward[1], -forward[0]])
    corners = [origin]
    for distance, width, depth in niches:
        if distance + width > length:
            raise ValueError(f"niches: one ends {distance + width} m along a wall of {length} m")
        near, far = origin + distance * forward, origin + (distance + width) * forward
        corners += [near, near + depth * right, far + depth * right, far]
    return [(float(x), float(y)) for x, y in corners]


def _partition(
    start: Point, end: Point, doors: Iterable[tuple[float, float]] = (), closed: Iterable[tuple[float, float]] = ()
) -> list[Floats]:
    """Return the boxes of a wall along x or y, 12 cm thick, with open ``doors`` and ``closed`` ones, 4 cm thick.

    A door is given by its distance from the start and its width.
    """
    origin, forward, length = _direction(start, end)
    openings = sorted([*((*door, 0.0) for door in doors), *((*door, 0.04) for door in closed)])
    pieces, done = [], 0.0
    for distance, width, thickness in openings:
        pieces += [(done, distance, 0.12), (distance, distance + width, thickness)]
        done = distance + width
    boxes = []
    for begins, ends, thickness in [*pieces, (done, length, 0.12)]:
        if thickness > 0.0:
            x, y = origin + 0.5 * (begins + ends) * forward
            size = np.abs((ends - begins) * forward) + thickness * np.abs(forward[::-1])
            boxes.append(_box((float(x), float(y)), float(size[0]), float(size[1])))
    return boxes


def _direction(start: Point, end: Point) -> tuple[Floats, Floats, float]:
    """Return the start, the unit direction and the length of a wall."""
    origin = np.asarray(start, dtype=np.float64)
    along = np.asarray(end, dtype=np.float64) - origin
    length = float(np.linalg.norm(along))
    return origin, along / length, length
