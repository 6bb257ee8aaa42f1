"""Walking people in a floor plan: their positions over time, and the beams that hit them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats
from evalkit.core.world import World
from evalkit_datasets.worlds.robot import RouteDrive

RADIUS_M = 0.25
"""Radius of the disc that models a person."""
FROM_WALLS_M = 0.05
FROM_ROBOT_M = 0.65  # between the centres of a person and of the base
_MAX_ASIDE_M = 1.5  # largest distance of a waypoint from the route
_MIN_LEG_M = 0.5
_MAX_DRAWS = 200
_CHECK_NS = 100_000_000  # interval at which a planned leg is compared with the robot


@dataclass(frozen=True, eq=False)
class Walk:
    """A person's path: at ``points`` (K, 2) in the world (m) at times ``seconds`` (K,), linear in between."""

    points: Floats
    seconds: Floats

    def at(self, stamps_ns: ArrayLike) -> Floats:
        """Return the positions (N, 2) of the person's centre at times (N,)."""
        seconds = np.asarray(stamps_ns, dtype=np.int64) * 1e-9
        return np.stack([np.interp(seconds, self.seconds, self.points[:, axis]) for axis in (0, 1)], axis=1)

    def cast(self, origins: Floats, bearings: Floats, stamps_ns: ArrayLike) -> Floats:
        """Return the distances (B,) at which beams from origins (B, 2) hit the person, each at its own time."""
        to_centre = self.at(stamps_ns) - origins
        directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        ahead = (to_centre * directions).sum(axis=1)
        half_chord = RADIUS_M**2 - ((to_centre**2).sum(axis=1) - ahead**2)
        near = ahead - np.sqrt(np.maximum(half_chord, 0.0))
        return np.where((half_chord > 0.0) & (near >= 0.0), near, np.inf)


def plan_walks(
    people: int, world: World, drive: RouteDrive, speed_mps: float, generator: np.random.Generator
) -> tuple[Walk, ...]:
    """Return random paths of ``people`` for the duration of a drive, near its route and not through walls.

    They keep ``FROM_ROBOT_M`` from the robot; if 200 draws find no such leg, the leg with the largest distance is used.
    """
    return tuple(_plan_walk(world, drive, speed_mps, generator) for _ in range(people))


def _plan_walk(world: World, drive: RouteDrive, speed_mps: float, generator: np.random.Generator) -> Walk:
    places = _draw_waypoints(world, drive, generator)
    begin = max((next(places) for _ in range(20)), key=lambda place: _distance_to_robot(drive, place, place, 0.0, 1.0))
    points, seconds = [begin], [0.0]
    while seconds[-1] < drive.duration_ns * 1e-9:
        widest, chosen, arrival = -np.inf, points[-1], seconds[-1]
        for _ in range(_MAX_DRAWS):
            place = next(places)
            length = float(np.hypot(*(place - points[-1])))
            if length < _MIN_LEG_M or not _is_clear(world, points[-1], place):
                continue
            arrives = seconds[-1] + length / speed_mps
            distance = _distance_to_robot(drive, points[-1], place, seconds[-1], arrives)
            if distance > widest:
                widest, chosen, arrival = distance, place, arrives
            if distance >= FROM_ROBOT_M:
                break
        else:
            arrival = max(arrival, seconds[-1] + 1.0)  # no leg found: stay for a second
        points.append(chosen)
        seconds.append(arrival)
    return Walk(np.array(points), np.array(seconds))


def _draw_waypoints(world: World, drive: RouteDrive, generator: np.random.Generator) -> Iterator[Floats]:
    """Yield random points (2,), visible from the route, where a person can stand."""
    while True:
        on_route = drive.route.poses_at(generator.uniform(0.0, drive.route.length_m, 1))[0, :2]
        bearing, aside = generator.uniform(-np.pi, np.pi), generator.uniform(0.0, _MAX_ASIDE_M)
        place = on_route + aside * np.array([np.cos(bearing), np.sin(bearing)])
        if world.cast([on_route], [bearing])[0] > aside and world.clearance([place])[0] > RADIUS_M + FROM_WALLS_M:
            yield place


def _is_clear(world: World, start: Floats, end: Floats) -> bool:
    steps = np.linspace(0.0, 1.0, int(np.hypot(*(end - start)) / FROM_WALLS_M) + 2)
    return bool(world.clearance(start + steps[:, None] * (end - start)).min() > RADIUS_M)


def _distance_to_robot(drive: RouteDrive, start: Floats, end: Floats, begins_s: float, ends_s: float) -> float:
    """Return the smallest distance (m) between the robot and a person walking from start to end."""
    stamps = np.arange(int(begins_s * 1e9), int(ends_s * 1e9) + _CHECK_NS, _CHECK_NS)
    share = np.clip((stamps * 1e-9 - begins_s) / (ends_s - begins_s), 0.0, 1.0)
    person = start + share[:, None] * (end - start)
    return float(np.hypot(*(drive.poses(stamps)[:, :2] - person).T).min())
