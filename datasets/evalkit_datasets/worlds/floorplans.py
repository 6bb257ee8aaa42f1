"""The synthetic floor plans (floorplans.toml) and the routes driven through them, in metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline
from evalkit.io.toml import parse_toml
from evalkit_datasets.worlds.robot import Route

LEG_RADIUS_M = 0.02
PARTITION_M = 0.12

Numbers = Sequence[float]


@dataclass(frozen=True)
class FloorPlan:
    """A world and one closed route through it, at least 0.3 m from every boundary."""

    world: World
    route: Route


def load_plan(name: str) -> FloorPlan:
    """Return a floor plan by its name in floorplans.toml."""
    plan = _load_plans()[name]
    walls = [
        np.asarray(plan.get("segments", ()), dtype=np.float64).reshape(-1, 4),
        *(closed_outline(_outline(each["corners"], each.get("niches", ()))) for each in plan.get("outlines", ())),
        *(
            wall
            for each in plan.get("partitions", ())
            for wall in build_partition(each["from"], each["to"], each.get("doors", ()))
        ),
        *(closed_outline(_rectangle(*box)) for box in plan.get("boxes", ())),
    ]
    legs = [(x, y, LEG_RADIUS_M) for each in plan.get("legs", ()) for x, y in _rectangle(*each)]
    circles = np.array([*legs, *plan.get("circles", ())], dtype=np.float64).reshape(-1, 3)
    return FloorPlan(World(np.concatenate(walls), circles), Route.from_corners(plan["route"]))


@cache
def _load_plans() -> Mapping[str, Any]:
    file = resources.files("evalkit_datasets.worlds").joinpath("floorplans.toml")
    return parse_toml(file.read_text(encoding="utf-8"))


def _rectangle(x: float, y: float, width: float, depth: float, rotation_deg: float) -> Floats:
    """Return the four corners (4, 2), counter-clockwise."""
    cos, sin = np.cos(np.radians(rotation_deg)), np.sin(np.radians(rotation_deg))
    corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
    return np.array(
        [(x + cos * u * width - sin * v * depth, y + sin * u * width + cos * v * depth) for u, v in corners]
    )


def _outline(corners: Sequence[Numbers], niches: Sequence[Numbers]) -> Floats:
    """Return the corners (N, 2) of a polygon with niches (side, distance from its start, width, depth)."""
    points: list[Floats] = []
    for side, corner in enumerate(corners):
        origin, forward, length = _direction(corner, corners[(side + 1) % len(corners)])
        right = np.array([forward[1], -forward[0]])
        points.append(origin)
        for distance, width, depth in (niche[1:] for niche in niches if niche[0] == side):
            if distance + width > length:
                raise ValueError(f"niches: one ends {distance + width} m along a wall of {length} m")
            near, far = origin + distance * forward, origin + (distance + width) * forward
            points += [near, near + depth * right, far + depth * right, far]
    return np.array(points)


def build_partition(start: Numbers, end: Numbers, doors: Sequence[Numbers]) -> list[Floats]:
    """Return the boxes of a wall along x or y with doors (distance from its start, width, thickness; 0: open)."""
    origin, forward, length = _direction(start, end)
    pieces, done = [], 0.0
    for distance, width, thickness in doors:
        pieces += [(done, distance, PARTITION_M), (distance, distance + width, thickness)]
        done = distance + width
    boxes = []
    for begins, ends, thickness in [*pieces, (done, length, PARTITION_M)]:
        if thickness > 0.0:
            x, y = origin + 0.5 * (begins + ends) * forward
            width, depth = np.abs((ends - begins) * forward) + thickness * np.abs(forward[::-1])
            boxes.append(closed_outline(_rectangle(float(x), float(y), float(width), float(depth), 0.0)))
    return boxes


def _direction(start: ArrayLike, end: ArrayLike) -> tuple[Floats, Floats, float]:
    """Return the start, the unit direction and the length of a wall."""
    origin = np.asarray(start, dtype=np.float64)
    along = np.asarray(end, dtype=np.float64) - origin
    length = float(np.linalg.norm(along))
    return origin, along / length, length
