"""A furnished flat of 60 to 120 m2, and a route through all its rooms, drawn from a seed: another flat for each seed.

Rooms lie along a hallway, around a living room, or in a ring. The route drives as a vacuum cleaner does: through each
door, around in each room, and back to its start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

from evalkit_datasets.worlds.drawn_plan import (
    DOOR_CM,
    MIN_SIDE_CM,
    WALL_CM,
    Pieces,
    Rectangle,
    Shape,
    Spot,
    contains,
    draw_door,
    finish,
    grow,
    side_lengths,
)
from evalkit_datasets.worlds.draws import Draws
from evalkit_datasets.worlds.floorplans import FloorPlan

_AREA_CM2 = (600_000, 1_200_000)
_ROUTE_CM = (2_400, 6_000)  # bounds of the route's length with square corners
_HALF_DOOR_CM = (45, 50)
_DOOR_LANE_CM = 65  # distance from a door to a corner of the route
_BESIDE_CM = 62  # distance from the route to the middle of a wall
_ROOM_CM = (240, 270)  # smallest width of a room in a row: of any, and on average
_ASIDE_CM = 75  # distance from the middle of a door to the side of its room
_MAX_TURNS = 4  # of the route in a room; one with a single door takes as many
_TRIES = 40  # to place a piece of furniture


class _Piece(NamedTuple):
    """A piece of furniture: bounds of its width along a wall and of its depth, and whether it stands at a wall."""

    shape: Shape
    width: tuple[int, int]
    depth: tuple[int, int]
    at_wall: bool = True


_WARDROBE, _SHELF = _Piece("block", (100, 220), (55, 62)), _Piece("block", (60, 120), (28, 40))
_DESK, _CHAIR = _Piece("legs", (110, 160), (65, 80)), _Piece("chair", (60, 60), (60, 60), at_wall=False)
_PLANT, _CHEST = _Piece("round", (24, 44), (24, 44)), _Piece("block", (60, 120), (40, 50))
_ARMCHAIR = _Piece("tilted", (130, 150), (130, 150), at_wall=False)
_FURNITURE: dict[str, tuple[_Piece, ...]] = {
    "living": (
        _Piece("block", (170, 250), (85, 95)),  # sofa
        _Piece("legs", (140, 180), (80, 95), at_wall=False),  # dining table
        _CHAIR,
        _CHAIR,
        _Piece("block", (120, 180), (38, 48)),  # television
        _Piece("legs", (70, 110), (50, 65), at_wall=False),  # low table
        _ARMCHAIR,
        _SHELF,
        _SHELF,
        _PLANT,
        _CHEST,
        _PLANT,
        _CHAIR,
        _Piece("round", (50, 70), (50, 70), at_wall=False),  # stool
    ),
    "bedroom": (
        _Piece("block", (120, 180), (200, 210)),  # bed, its head at the wall
        _Piece("block", (200, 205), (90, 120)),  # bed along the wall
        _WARDROBE,
        _CHEST,
        _CHAIR,
        _Piece("block", (40, 50), (38, 45)),
        _PLANT,
        _SHELF,
        _CHAIR,
    ),
    "kitchen": (
        _Piece("block", (180, 300), (60, 62)),  # cupboards with sink and stove
        _Piece("block", (120, 180), (60, 62)),
        _Piece("block", (60, 65), (60, 66)),  # refrigerator
        _Piece("legs", (80, 140), (70, 85), at_wall=False),
        _CHAIR,
        _CHAIR,
        _Piece("round", (30, 40), (30, 40)),  # bin
    ),
    "bath": (
        _Piece("block", (160, 175), (70, 78)),  # tub
        _Piece("block", (80, 90), (80, 90)),  # shower
        _Piece("block", (60, 62), (58, 62)),  # washing machine
        _Piece("round", (40, 50), (40, 50)),  # washbasin
        _Piece("block", (36, 40), (50, 65)),  # toilet
    ),
    "study": (_DESK, _CHAIR, _WARDROBE, _SHELF, _SHELF, _ARMCHAIR, _PLANT, _CHEST, _CHAIR),
    "hallway": (
        _Piece("block", (60, 120), (12, 18)),  # shoes
        _Piece("block", (50, 90), (12, 18)),
        _Piece("round", (22, 26), (22, 26)),
        _CHEST,
    ),
}
_ROOMS = ("living", "bedroom", "kitchen", "study", "bedroom", "study", "study")  # from the largest on; the last: bath


@dataclass(frozen=True)
class _Door:
    """Between two rooms, in a wall that is normal to ``axis`` (0: x)."""

    axis: int
    middle: Spot

    @property
    def place(self) -> Rectangle:
        """What is kept clear around it."""
        return grow((*self.middle, *self.middle), DOOR_CM)


@dataclass(frozen=True)
class _Flat:
    """Rooms as rectangles, and the inner walls between them.

    ``cycle``: rooms that the route drives through one after the other, and back into the first; the others have a
    single door on it. ``hallways``: how many of the first rooms are no living space.
    """

    size: Spot
    rooms: list[Rectangle]
    walls: list[tuple[Spot, Spot]]
    cycle: list[int]
    hallways: int = 0


_Stop = tuple[int, _Door]  # a room, and the door by which the route leaves it


def draw_home(seed: int) -> FloorPlan:
    """Return the flat and the route of a seed, at least 0.4 m from every boundary.

    Three seeds in a row have three layouts, so that few seeds suffice for all of them.
    """
    draws = Draws(seed)
    draw_flat = (_draw_along_hallway, _draw_around_living_room, _draw_ring)[seed % 3]
    while True:
        flat = draw_flat(draws)
        tour = _plan_tour(draws, flat)
        corners = _plan_route(draws, flat, tour)
        if corners and _AREA_CM2[0] <= flat.size[0] * flat.size[1] <= _AREA_CM2[1]:
            return finish(draws, _build(draws, flat, tour, corners), corners)


def _draw_along_hallway(draws: Draws) -> _Flat:
    """Return a flat with rooms on both sides of a hallway."""
    below, hall, above = draws.between(300, 420), draws.between(142, 170), draws.between(300, 420)
    length, top = draws.between(720, 1_250), below + hall
    lower, upper = _cut(draws, length), _cut(draws, length)
    rooms = [(0, below, length, top), *_rooms_between(lower, 0, below), *_rooms_between(upper, top, top + above)]
    walls = [((0, below), (length, below)), ((0, top), (length, top))]
    return _Flat(
        (length, top + above),
        rooms,
        walls + _walls_between(lower, 0, below) + _walls_between(upper, top, top + above),
        [0],
        1,
    )


def _draw_around_living_room(draws: Draws) -> _Flat:
    """Return a flat with a living room that most other rooms have their doors in."""
    depth, above, beside = draws.between(420, 560), draws.between(320, 420), draws.between(260, 380)
    width = draws.between(480, 760)
    length = width + beside
    upper = _cut(draws, length)
    rooms = [(0, 0, width, depth), (width, 0, length, depth), *_rooms_between(upper, depth, depth + above)]
    walls = [((0, depth), (length, depth)), ((width, 0), (width, depth))]
    return _Flat((length, depth + above), rooms, walls + _walls_between(upper, depth, depth + above), [0])


def _draw_ring(draws: Draws) -> _Flat:
    """Return a flat with two rows of rooms that have doors to the next, and two small rooms at one end."""
    below, above, beside = draws.between(330, 430), draws.between(330, 430), draws.between(240, 270)
    length, end = draws.between(680, 1_100), below + above
    lower, upper = _cut(draws, length), _cut(draws, length)
    ring = [*_rooms_between(lower, 0, below), *reversed(_rooms_between(upper, below, end))]
    rooms = [*ring, (length, 0, length + beside, below), (length, below, length + beside, end)]
    walls = [((0, below), (length + beside, below)), ((length, 0), (length, end))]
    return _Flat(
        (length + beside, end),
        rooms,
        walls + _walls_between(lower, 0, below) + _walls_between(upper, below, end),
        list(range(len(ring))),
    )


def _cut(draws: Draws, length: int) -> list[int]:
    """Return the places of the walls between two or more rooms in a row, and of its ends."""
    count = draws.between(2, min(length // _ROOM_CM[1], 3))
    spare = (length // count - _ROOM_CM[0]) // 2
    return [0, *(length * n // count + draws.between(-spare, spare) for n in range(1, count)), length]


def _rooms_between(cuts: list[int], low: int, high: int) -> list[Rectangle]:
    """Return the rooms of a row."""
    return [(left, low, right, high) for left, right in pairwise(cuts)]


def _walls_between(cuts: list[int], low: int, high: int) -> list[tuple[Spot, Spot]]:
    """Return the walls between the rooms of a row."""
    return [((x, low), (x, high)) for x in cuts[1:-1]]


def _plan_tour(draws: Draws, flat: _Flat) -> list[_Stop]:
    """Return the rooms in the order of the route, each as often as it is left; empty if a room has no door."""
    found = {*flat.cycle}
    beyond: dict[int, list[tuple[int, _Door]]] = {}
    queue = [*flat.cycle]
    for room in queue:  # grows below
        for other in range(len(flat.rooms)):
            door = None if other in found else _draw_door_between(draws, flat.rooms[room], flat.rooms[other])
            if door is not None:
                beyond.setdefault(room, []).append((other, door))
                found.add(other)
                queue.append(other)
    if len(found) < len(flat.rooms):
        return []
    tour: list[_Stop] = []
    for room, following in zip(flat.cycle, [*flat.cycle[1:], flat.cycle[0]], strict=True):
        tour += _visit_beyond(draws, room, beyond)
        if following != room:
            door = _draw_door_between(draws, flat.rooms[room], flat.rooms[following])
            if door is None:
                return []
            tour.append((room, door))
    return tour


def _visit_beyond(draws: Draws, room: int, beyond: dict[int, list[tuple[int, _Door]]]) -> Iterator[_Stop]:
    """Yield the stops from a room into those beyond it, one after the other, and back."""
    left = [*beyond.get(room, [])]
    while left:
        other, door = left.pop(draws.between(0, len(left) - 1))
        yield room, door
        yield from _visit_beyond(draws, other, beyond)
        yield other, door


def _draw_door_between(draws: Draws, one: Rectangle, other: Rectangle) -> _Door | None:
    """Return a door between two rooms, near a corner of one; None if they do not share enough of a wall."""
    for axis in (0, 1):
        wall = {one[axis], one[axis + 2]} & {other[axis], other[axis + 2]}
        low, high = max(one[1 - axis], other[1 - axis]), min(one[3 - axis], other[3 - axis])
        if wall and high - low >= 2 * _ASIDE_CM:
            aside = draws.between(_ASIDE_CM, min(_ASIDE_CM + 20, (high - low) // 2))
            along, across = draws.pick((low + aside, high - aside)), wall.pop()
            return _Door(axis, (along, across) if axis else (across, along))
    return None


def _plan_route(draws: Draws, flat: _Flat, tour: list[_Stop]) -> list[Spot]:
    """Return the corners of the route; empty if it does not fit."""
    stops = [(room, entry, leave) for (_, entry), (room, leave) in zip([*tour[-1:], *tour[:-1]], tour, strict=True)]
    ways: dict[int, list[Spot]] = {}
    for n, (room, entry, leave) in sorted(enumerate(stops), key=lambda stop: stop[1][0]):  # a hallway is tight: first
        paths = list(_find_paths(draws, flat.rooms[room], entry, leave))
        if not paths:
            return []
        turns = draws.pick(sorted({len(path) for path in paths})[: 1 if room < flat.hallways else None])
        ways[n] = draws.pick([path for path in paths if len(path) == turns])
    corners = [corner for n in range(len(stops)) for corner in ways[n]]
    sides = side_lengths(corners) if corners else [0]
    fits = min(sides) >= MIN_SIDE_CM and _ROUTE_CM[0] <= sum(sides) <= _ROUTE_CM[1]
    return corners if fits else []


def _find_paths(draws: Draws, room: Rectangle, entry: _Door, leave: _Door) -> Iterator[list[Spot]]:
    """Yield the corners of ways from a door of a room to another one, or to the same."""
    inner = grow(room, -_BESIDE_CM)
    lanes: tuple[set[int], set[int]] = (set(), set())
    for door in (entry, leave):
        near, far = draws.between(_DOOR_LANE_CM, 80), draws.between(MIN_SIDE_CM, 180)
        into, along = door.axis, 1 - door.axis
        sign = 1 if door.middle[into] == room[into] else -1
        lanes[into].update(door.middle[into] + sign * each for each in (near, near + far))
        lanes[along].update(door.middle[along] + each for each in (-draws.between(MIN_SIDE_CM, 180), 0, far))
    within = [sorted(each for each in lanes[axis] if inner[axis] <= each <= inner[axis + 2]) for axis in (0, 1)]
    for turns in range(_MAX_TURNS + 1):
        yield from _find_turns([entry.middle], entry.axis, leave, within, turns)


def _find_turns(path: list[Spot], axis: int, leave: _Door, lanes: list[list[int]], turns: int) -> Iterator[list[Spot]]:
    """Yield the corners of paths that go on along an axis and reach a door after so many turns."""
    here = path[-1]
    if turns == 0:
        is_ahead = (axis, here[1 - axis]) == (leave.axis, leave.middle[1 - axis])
        if is_ahead and _distance(here, leave.middle) >= _DOOR_LANE_CM:
            yield path[1:]
        return
    for lane in lanes[axis]:
        corner = (here[0], lane) if axis else (lane, here[1])
        if _distance(here, corner) >= (_DOOR_LANE_CM if len(path) == 1 else MIN_SIDE_CM):
            yield from _find_turns([*path, corner], 1 - axis, leave, lanes, turns - 1)


def _distance(one: Spot, other: Spot) -> int:
    """Return the distance of two spots on a line along x or y."""
    return abs(one[0] - other[0]) + abs(one[1] - other[1])


def _build(draws: Draws, flat: _Flat, tour: list[_Stop], corners: list[Spot]) -> Pieces:
    """Return the walls with their doors, and furniture beside the route."""
    width, depth = flat.size
    pieces = Pieces.within([(0, 0), (width, 0), (width, depth), (0, depth)], corners)
    doors = list(dict.fromkeys(door for _, door in tour))
    pieces.taken += [door.place for door in doors]
    for start, end in flat.walls:
        axis = 0 if start[0] == end[0] else 1
        along = 1 - axis
        own = [door.middle for door in doors if door.axis == axis and door.middle[axis] == start[axis]]
        middles = sorted(each[along] - start[along] for each in own if start[along] < each[along] < end[along])
        pieces.add_wall(start, end, [draw_door(draws, middle, True, _HALF_DOOR_CM) for middle in middles])
    largest_first = sorted(flat.rooms[flat.hallways :], key=lambda room: (room[0] - room[2]) * (room[3] - room[1]))
    kinds = ["hallway"] * flat.hallways + [*_ROOMS[: len(largest_first) - 1], "bath"]
    for room, kind in zip([*flat.rooms[: flat.hallways], *largest_first], kinds, strict=True):
        for piece in _FURNITURE[kind]:
            _place(draws, piece, room, pieces)
    return pieces


def _place(draws: Draws, piece: _Piece, room: Rectangle, pieces: Pieces) -> None:
    """Add a piece of furniture to a room where it fits."""
    width, depth = draws.between(*piece.width), draws.between(*piece.depth)
    if piece.shape in ("round", "tilted", "chair"):
        depth = width
    for _ in range(_TRIES):
        gap, side = draws.between(WALL_CM + 1, WALL_CM + 6), draws.between(0, 3)
        size = (width, depth) if side < 2 else (depth, width)
        left, low = (
            draws.between(room[axis] + gap, max(room[axis + 2] - gap - size[axis], room[axis] + gap)) for axis in (0, 1)
        )
        if piece.at_wall:
            low = (room[1] + gap, room[3] - gap - size[1], low, low)[side]
            left = (left, left, room[0] + gap, room[2] - gap - size[0])[side]
        place = (left, low, left + size[0], low + size[1])
        if contains(grow(room, -WALL_CM), place) and pieces.add_if_free(draws, piece.shape, place):
            return
