"""What plans that are drawn from a seed share: pieces of walls and furniture, and rounded routes.

Lengths are whole centimetres until a plan is complete, and only exact arithmetic is used, so that a seed gives the same
plan on every machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline
from evalkit_datasets.worlds.draws import Draws
from evalkit_datasets.worlds.floorplans import LEG_RADIUS_M, FloorPlan, build_partition
from evalkit_datasets.worlds.robot import Route

MIN_SIDE_CM = 100  # of a route, so that two curves fit
CLEAR_CM = 50  # furniture keeps this distance from a route before its corners are rounded
DOOR_CM = 60  # furniture keeps this distance from the middle of a door
WALL_CM = 6  # from the middle of an inner wall to its face
_RADIUS_CM = (40, 60)  # of a route's curves
_CLOSED_DOOR_CM = 4  # thickness
_TILTS = ((1.0, 0.0), (0.8, 0.6), (0.96, 0.28), (0.6, -0.8), (0.96, -0.28))  # cosine and sine

Spot = tuple[int, int]
Rectangle = tuple[int, int, int, int]  # smallest x and y, largest x and y
Shape = Literal["block", "tilted", "round", "legs", "chair"]


@dataclass
class Pieces:
    """Walls (N, 4) in m and circles in cm, so far; furniture may not be added where ``taken`` is."""

    walls: list[Floats]
    circles: list[tuple[float, float, float]] = field(default_factory=list)
    taken: list[Rectangle] = field(default_factory=list)

    @classmethod
    def within(cls, outline: Sequence[Spot], route: Sequence[Spot]) -> Pieces:
        """Return the outer walls; the route through its corners is kept clear."""
        taken = [grow(bounds(side), CLEAR_CM) for side in pairwise([*route, route[0]])]
        return cls([closed_outline(np.array(outline) / 100.0)], taken=taken)

    def add_wall(self, start: Spot, end: Spot, doors: Sequence[tuple[float, float, float]]) -> None:
        """Add a wall with doors in m, given as for a partition in floorplans.toml."""
        self.walls += build_partition([each / 100.0 for each in start], [each / 100.0 for each in end], doors)

    def is_free(self, place: Rectangle) -> bool:
        """Whether furniture may stand there."""
        return not any(overlap(place, each) for each in self.taken)

    def add_if_free(self, draws: Draws, shape: Shape, place: Rectangle) -> bool:
        """Add one piece within its rectangle, unless that is taken; of chairs and tables, the lidar sees the legs."""
        if not self.is_free(place):
            return False
        self.taken.append(place)
        left, low, right, high = place
        x, y, width, depth = (left + right) / 2.0, (low + high) / 2.0, float(right - left), float(high - low)
        if shape == "round":
            self.circles.append((x, y, width / 2.0))
            return True
        cos, sin = 1.0, 0.0
        if shape in ("tilted", "chair"):
            cos, sin = draws.pick(_TILTS)
            share = draws.between(4, 6) / 10.0 if shape == "tilted" else 0.7
            width, depth = share * width, (1.0 - share if shape == "tilted" else 0.7) * depth
        corners = [(u * width, v * depth) for u, v in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
        turned = [(x + cos * u - sin * v, y + sin * u + cos * v) for u, v in corners]
        if shape in ("chair", "legs"):
            self.circles += [(*corner, 100.0 * LEG_RADIUS_M) for corner in turned]
        else:
            self.walls.append(closed_outline(np.array(turned) / 100.0))
        return True

    def build(self) -> World:
        """Return the world."""
        return World(np.concatenate(self.walls), np.array(self.circles, dtype=np.float64).reshape(-1, 3) / 100.0)


def draw_door(
    draws: Draws, middle: int, is_open: bool, half_cm: tuple[int, int] = (45, 60)
) -> tuple[float, float, float]:
    """Return the distance from the wall's start, the width and the thickness of a door in m; 0: open."""
    half = draws.between(*half_cm)
    return (middle - half) / 100.0, 2 * half / 100.0, 0.0 if is_open else _CLOSED_DOOR_CM / 100.0


def finish(draws: Draws, pieces: Pieces, corners: Sequence[Spot]) -> FloorPlan:
    """Return the plan with curves at the corners of its route, mirrored and with x and y exchanged by chance."""
    world, rounded = pieces.build(), _add_radii(draws, corners)
    order = draws.pick(([0, 1], [1, 0]))
    signs = np.array([draws.pick((1.0, -1.0)), draws.pick((1.0, -1.0))])

    def mirror(points: Floats) -> Floats:
        return np.asarray((points * signs)[:, order])

    walls = np.hstack([mirror(world.segments[:, :2]), mirror(world.segments[:, 2:])])
    circles = np.column_stack([mirror(world.circles[:, :2]), world.circles[:, 2]])
    return FloorPlan(
        World(walls, circles), Route.from_corners(np.column_stack([mirror(rounded[:, :2]), rounded[:, 2]]))
    )


def _add_radii(draws: Draws, corners: Sequence[Spot]) -> Floats:
    """Return the corners of a route in m with a radius each."""
    sides = side_lengths(corners)
    radii = [min(draws.between(*_RADIUS_CM), side // 2, sides[n - 1] // 2) for n, side in enumerate(sides)]
    return np.column_stack([corners, radii]) / 100.0


def side_lengths(corners: Sequence[Spot]) -> list[int]:
    """Return the lengths from each corner of a route to the next; all are parallel to x or y."""
    return [abs(x - u) + abs(y - v) for (x, y), (u, v) in pairwise([*corners, corners[0]])]


def bounds(points: Sequence[Spot]) -> Rectangle:
    """Return the smallest rectangle that contains points."""
    xs, ys = zip(*points, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def grow(place: Rectangle, by: int) -> Rectangle:
    """Return a rectangle that is larger on each side."""
    return place[0] - by, place[1] - by, place[2] + by, place[3] + by


def overlap(one: Rectangle, other: Rectangle) -> bool:
    """Whether two rectangles have more than an edge in common."""
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def contains(outer: Rectangle, inner: Rectangle) -> bool:
    """Whether a rectangle lies within another one."""
    return outer[0] <= inner[0] and outer[1] <= inner[1] and inner[2] <= outer[2] and inner[3] <= outer[3]
