"""People who walk about in a floor plan: where they are at any time, and where beams meet them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats
from evalkit.core.world import World
from evalkit_datasets.robot import RouteDrive

RADIUS_M = 0.25
"""A person is a disc this wide each side."""
FROM_WALLS_M = 0.05
FROM_ROBOT_M = 0.65  # between a person's middle and the base's
_ASIDE_M = 1.5  # how far from the route people come
_SHORTEST_M = 0.5
_TRIES = 200
_LOOK_NS = 100_000_000  # how often a planned way is held against the robot's


@dataclass(frozen=True, eq=False)
class Walk:
    """A person's way: at ``points`` (K, 2) in the world (m) at ``seconds`` (K,), straight and steady in between."""

    points: Floats
    seconds: Floats

    def at(self, stamps_ns: ArrayLike) -> Floats:
        """Where the person's middle is (N, 2) at times (N,)."""
        seconds = np.asarray(stamps_ns, dtype=np.int64) * 1e-9
        return np.stack([np.interp(seconds, self.seconds, self.points[:, axis]) for axis in (0, 1)], axis=1)

    def met(self, origins: Floats, bearings: Floats, stamps_ns: ArrayLike) -> Floats:
        """The distances (B,) at which beams from origins (B, 2) meet the person, each at its own time; inf: missed."""
        to_middle = self.at(stamps_ns) - origins
        directions = np.stack([np.cos(bearings), np.sin(bearings)], axis=1)
        ahead = (to_middle * directions).sum(axis=1)
        half_chord = RADIUS_M**2 - ((to_middle**2).sum(axis=1) - ahead**2)
        near = ahead - np.sqrt(np.maximum(half_chord, 0.0))
        return np.where((half_chord > 0.0) & (near >= 0.0), near, np.inf)


def walks(
    people: int, world: World, drive: RouteDrive, speed_mps: float, generator: np.random.Generator
) -> tuple[Walk, ...]:
    """The ways of so many people for as long as a drive lasts: from place to place near its route, not through walls.

    They keep out of the robot's way as long as there is another; where 200 draws find none, they take the widest berth.
    """
    return tuple(_walk(world, drive, speed_mps, generator) for _ in range(people))


def _walk(world: World, drive: RouteDrive, speed_mps: float, generator: np.random.Generator) -> Walk:
    places = _places(world, drive, generator)
    begin = max((next(places) for _ in range(20)), key=lambda place: _berth(drive, place, place, 0.0, 1.0))
    points, seconds = [begin], [0.0]
    while seconds[-1] < drive.duration_ns * 1e-9:
        widest, chosen, arrival = -np.inf, points[-1], seconds[-1]
        for _ in range(_TRIES):
            place = next(places)
            length = float(np.hypot(*(place - points[-1])))
            if length < _SHORTEST_M or not _clear(world, points[-1], place):
                continue
            arrives = seconds[-1] + length / speed_mps
            berth = _berth(drive, points[-1], place, seconds[-1], arrives)
            if berth > widest:
                widest, chosen, arrival = berth, place, arrives
            if berth >= FROM_ROBOT_M:
                break
        else:
            arrival = max(arrival, seconds[-1] + 1.0)  # nowhere to go: stay for a second
        points.append(chosen)
        seconds.append(arrival)
    return Walk(np.array(points), np.array(seconds))


def _places(world: World, drive: RouteDrive, generator: np.random.Generator) -> Iterator[Floats]:
    """Places (2,) a person can stand at, in sight of the route."""
    while True:
        on_route = drive.route.at(generator.uniform(0.0, drive.route.length_m, 1))[0, :2]
        bearing, aside = generator.uniform(-np.pi, np.pi), generator.uniform(0.0, _ASIDE_M)
        place = on_route + aside * np.array([np.cos(bearing), np.sin(bearing)])
        if world.cast([on_route], [bearing])[0] > aside and world.clearance([place])[0] > RADIUS_M + FROM_WALLS_M:
            yield place


def _clear(world: World, start: Floats, end: Floats) -> bool:
    steps = np.linspace(0.0, 1.0, int(np.hypot(*(end - start)) / FROM_WALLS_M) + 2)
    return bool(world.clearance(start + steps[:, None] * (end - start)).min() > RADIUS_M)


def _berth(drive: RouteDrive, start: Floats, end: Floats, begins_s: float, ends_s: float) -> float:
    """How near (m) the robot's base comes to somebody who walks from start to end meanwhile."""
    stamps = np.arange(int(begins_s * 1e9), int(ends_s * 1e9) + _LOOK_NS, _LOOK_NS)
    share = np.clip((stamps * 1e-9 - begins_s) / (ends_s - begins_s), 0.0, 1.0)
    person = start + share[:, None] * (end - start)
    return float(np.hypot(*(drive.pose(stamps)[:, :2] - person).T).min())
