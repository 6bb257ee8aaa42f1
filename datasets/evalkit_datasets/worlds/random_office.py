"""An office building, and a route through it, drawn from a seed: another building for each seed.

Rooms lie on both sides of a hallway that is straight, an L or a ring. The route drives along the hallway, through doors
into some rooms, and back to its start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

from evalkit_datasets.worlds.drawn_plan import (
    DOOR_CM,
    MIN_SIDE_CM,
    WALL_CM,
    Pieces,
    Rectangle,
    Shape,
    Spot,
    bounds,
    contains,
    draw_door,
    finish,
    side_lengths,
)
from evalkit_datasets.worlds.draws import Draws
from evalkit_datasets.worlds.floorplans import FloorPlan

_ROUTE_CM = (2_400, 4_800)  # bounds of the route's length with square corners
_MIN_ROOM_CM = 320
_SHAPES: dict[str, Shape] = {
    "cupboard": "block",
    "box": "tilted",
    "column": "round",
    "extinguisher": "round",
    "chair": "chair",
    "table": "legs",
}


@dataclass(frozen=True)
class _Row:
    """Rooms side by side at one wall of the hallway, in coordinates u along that wall and v from it into the rooms.

    ``lane``: distance from the wall at which the route drives in the hallway.
    """

    origin: Spot
    along: Spot
    into: Spot
    length: int
    depth: int
    lane: int

    def at(self, u: int, v: int) -> Spot:
        """Return the place of u and v in the building."""
        return tuple(o + u * a + v * i for o, a, i in zip(self.origin, self.along, self.into, strict=True))  # type: ignore[return-value]

    def rectangle(self, u: tuple[int, int], v: tuple[int, int]) -> Rectangle:
        """Return the rectangle between two u and two v."""
        return bounds([self.at(u[0], v[0]), self.at(u[1], v[1])])

    def around_door(self, u: int, v: int) -> Rectangle:
        """Return the place around a door that is kept clear."""
        return self.rectangle((u - DOOR_CM, u + DOOR_CM), (v - DOOR_CM, v + DOOR_CM))


@dataclass(frozen=True)
class _Room:
    """From ``first`` to ``last`` along its row; the middle of its door to the hallway is at ``door``."""

    row: _Row
    first: int
    last: int
    door: int

    @property
    def entry(self) -> Spot:
        """Spot on the route in front of the door."""
        return self.row.at(self.door, -self.row.lane)


@dataclass(frozen=True)
class _Layout:
    """The outer walls, the rows of rooms, and walls without doors.

    ``corners`` of the route in the hallway: of a ring in driving order, of an L one.
    """

    outline: list[Spot]
    rows: list[_Row]
    corners: list[Spot] = field(default_factory=list)
    walls: list[tuple[Spot, Spot]] = field(default_factory=list)


@dataclass(frozen=True)
class _Visit:
    """Corners of the route from the hallway through a room, or through two neighbours, and back.

    ``passage``: u and v of the door between the two.
    """

    rooms: tuple[_Room, ...]
    corners: list[Spot]
    passage: Spot | None = None


Stop = Spot | list[_Room]  # a corner of the hallway, or rooms to choose a visit from


@dataclass(frozen=True)
class _Tour:
    """The visits of the route, and all its corners."""

    visits: list[_Visit]
    corners: list[Spot]


def draw_office(seed: int) -> FloorPlan:
    """Return the building and the route of a seed, at least 0.4 m from every boundary.

    Three seeds in a row have three shapes, so that few seeds suffice for all of them.
    """
    draws = Draws(seed)
    draw_shape = (_draw_straight, _draw_bent, _draw_ring)[seed % 3]
    while True:
        shape = draw_shape(draws)
        rooms = [list(_divide(draws, row)) for row in shape.rows]
        tour = _plan_tour(draws, shape, rooms)
        if tour is not None:
            break
    return finish(draws, _build(draws, shape, rooms, tour), tour.corners)


def _draw_straight(draws: Draws) -> _Layout:
    hall, length, below, above = draws.between(180, 240), draws.between(1200, 1700), *_draw_depths(draws)
    lane, top = hall // 2 + draws.between(-15, 15), below + hall
    rows = [
        _Row((0, below), (1, 0), (0, -1), length, below, lane),
        _Row((0, top), (1, 0), (0, 1), length, above, hall - lane),
    ]
    return _Layout([(0, 0), (length, 0), (length, top + above), (0, top + above)], rows)


def _draw_bent(draws: Draws) -> _Layout:
    hall, length, below, beside = draws.between(180, 240), draws.between(500, 900), *_draw_depths(draws)
    above = draws.between(400, 650)
    lane, other_lane, top = hall // 2 + draws.between(-15, 15), hall // 2 + draws.between(-15, 15), below + hall
    rows = [
        _Row((0, below), (1, 0), (0, -1), length + hall, below, lane),
        _Row((0, top), (1, 0), (0, 1), length, above, hall - lane),
        _Row((length + hall, below), (0, 1), (1, 0), hall + above, beside, other_lane),
    ]
    right, end = length + hall, top + above
    outline = [(0, 0), (right, 0), (right, below), (right + beside, below), (right + beside, end), (0, end)]
    return _Layout(outline, rows, [(right - other_lane, below + lane)], [((length, top), (length, end))])


def _draw_ring(draws: Draws) -> _Layout:
    hall, length, below, above = draws.between(180, 240), draws.between(640, 900), *_draw_depths(draws)
    inside, lane = draws.between(330, 420), hall // 2 + draws.between(-15, 15)
    bottom, top, right = below + hall, below + hall + inside, hall + length
    width, end = right + hall, top + hall + above
    rows = [
        _Row((0, below), (1, 0), (0, -1), width, below, lane),
        _Row((hall, bottom), (1, 0), (0, 1), length, inside, hall - lane),
        _Row((0, top + hall), (1, 0), (0, 1), width, above, lane),
    ]
    near, far = below + lane, top + hall - lane
    corners = [(lane, near), (width - lane, near), (width - lane, far), (lane, far)]
    walls = [((hall, bottom), (hall, top)), ((hall, top), (right, top)), ((right, bottom), (right, top))]
    return _Layout([(0, 0), (width, 0), (width, end), (0, end)], rows, corners, walls)


def _draw_depths(draws: Draws) -> tuple[int, int]:
    return draws.between(350, 500), draws.between(350, 500)


def _divide(draws: Draws, row: _Row) -> Iterator[_Room]:
    """Yield the rooms of a row, each with its door near one of its sides."""
    count = max(row.length // draws.between(_MIN_ROOM_CM, 480), 1)
    spare = (row.length // count - _MIN_ROOM_CM) // 2
    cuts = [row.length * n // count + draws.between(-spare, spare) for n in range(1, count)]
    for first, last in pairwise([0, *cuts, row.length]):
        aside = draws.between(80, 120)
        yield _Room(row, first, last, draws.pick((first + aside, last - aside)))


def _plan_tour(draws: Draws, shape: _Layout, rooms: list[list[_Room]]) -> _Tour | None:
    """Return a route through the hallway and rooms; None if a room is missing, visited twice, or it does not fit."""
    stops = _stops_on_ring(shape, rooms) if len(shape.corners) == 4 else _stops_there_and_back(draws, shape, rooms)
    if not all(stops):
        return None
    parts = [stop if isinstance(stop, tuple) else _draw_visit(draws, draws.pick(stop), rooms) for stop in stops]
    corners = [corner for part in parts for corner in (part.corners if isinstance(part, _Visit) else [part])]
    visits = [part for part in parts if isinstance(part, _Visit)]
    visited = [room.entry for visit in visits for room in visit.rooms]
    sides = side_lengths(corners)
    if len(set(visited)) < len(visited) or min(sides) < MIN_SIDE_CM or not _ROUTE_CM[0] <= sum(sides) <= _ROUTE_CM[1]:
        return None
    return _Tour(visits, [corners[-1], *corners[:-1]])  # a route starts behind its first corner: in the hallway


def _stops_there_and_back(draws: Draws, shape: _Layout, rooms: list[list[_Room]]) -> list[Stop]:
    """Return the stops of a drive to one end of the hallway and back to the other."""
    hallway, third = rooms[0] + rooms[1], shape.rows[0].length // 3
    near = [room for room in hallway if room.door < third]
    far = rooms[2] if shape.corners else [room for room in hallway if room.door > 2 * third]
    middle = [room for room in hallway if third <= room.door <= 2 * third]
    on_the_way: list[Stop] = [middle] if draws.between(0, 1) else []
    there: list[Stop] = [*on_the_way, *shape.corners, far, *shape.corners]
    return [*(there if draws.between(0, 1) else reversed(there)), near]


def _stops_on_ring(shape: _Layout, rooms: list[list[_Room]]) -> list[Stop]:
    """Return the stops of a drive around a ring; rooms with a door at its corners are left out."""
    left, right = shape.corners[0][0] + MIN_SIDE_CM, shape.corners[1][0] - MIN_SIDE_CM
    below, above = ([room for room in row if left <= room.entry[0] <= right] for row in (rooms[0] + rooms[1], rooms[2]))
    start, *others = shape.corners
    return [below, *others[:2], above, others[2], start]


def _draw_visit(draws: Draws, room: _Room, rooms: list[list[_Room]]) -> _Visit:
    """Return the way around in a room, or through the door to a neighbour and out by the neighbour's."""
    row, own = room.row, next(each for each in rooms if room in each)
    if len(own) > 1 and draws.between(0, 1):
        place = own.index(room)
        other = own[place + 1 if place == 0 or (place + 1 < len(own) and draws.between(0, 1)) else place - 1]
        v = draws.between(100, row.depth - 100)
        inside = [row.at(room.door, v), row.at(other.door, v)]
        return _Visit((room, other), [room.entry, *inside, other.entry], (max(room.first, other.first), v))
    aside = room.last - room.door if room.door < (room.first + room.last) // 2 else room.first - room.door
    width = min(draws.between(120, 200), abs(aside) - 60)
    near = draws.between(70, 90)
    far = near + min(draws.between(120, 200), row.depth - 60 - near)
    u = room.door + (width if aside > 0 else -width)
    around = [(room.door, near), (u, near), (u, far), (room.door, far)]
    around = [around[0], *(around[1:] if draws.between(0, 1) else around[:0:-1]), around[0]]
    # at its first and last corner the route goes straight on or turns: a corner without a turn is none
    turns = around[1:] if around[1][0] == room.door else around[:-1]
    return _Visit((room,), [room.entry, *(row.at(*each) for each in turns), room.entry])


def _build(draws: Draws, shape: _Layout, rooms: list[list[_Room]], tour: _Tour) -> Pieces:
    """Return the walls with their doors, and furniture beside the route."""
    passed = {room.entry for visit in tour.visits for room in visit.rooms}
    passages = {visit.rooms[0].row.at(visit.passage[0], 0): visit.passage[1] for visit in tour.visits if visit.passage}
    pieces = Pieces.within(shape.outline, tour.corners)
    for wall in shape.walls:
        pieces.add_wall(*wall, [])
    for row, own in zip(shape.rows, rooms, strict=True):
        doors = [draw_door(draws, room.door, room.entry in passed or draws.between(0, 2) == 0) for room in own]
        pieces.add_wall(row.at(0, 0), row.at(row.length, 0), doors)
        pieces.taken += [row.around_door(room.door, 0) for room in own]
        for room in own[1:]:
            start, middle = row.at(room.first, 0), draws.between(100, row.depth - 100)
            is_open = start in passages or draws.between(0, 2) == 0
            v = passages.get(start, middle)
            pieces.add_wall(start, row.at(room.first, row.depth), [draw_door(draws, v, True)] if is_open else [])
            pieces.taken += [row.around_door(room.first, v)] if is_open else []
    for row, own in zip(shape.rows, rooms, strict=True):
        for room in own:
            _furnish(draws, room, pieces)
        _furnish_hallway(draws, row, pieces)
    return pieces


def _furnish(draws: Draws, room: _Room, pieces: Pieces) -> None:
    """Add furniture where it fits: cupboards and desks along the walls, boxes, columns, chairs and tables."""
    row = room.row
    for _ in range(draws.between(6, 12)):
        kind = draws.pick(("cupboard", "cupboard", "cupboard", "box", "column", "chair", "table"))
        side, gap = draws.between(0, 3), draws.between(6, 12)
        width, depth = _draw_size(draws, kind, along=side < 2)
        u = draws.between(room.first + gap, max(room.last - gap - width, room.first + gap))
        v = draws.between(gap, max(row.depth - gap - depth, gap))
        if kind == "cupboard":  # at one of four walls
            u = (u, u, room.first + gap, room.last - gap - width)[side]
            v = (gap, row.depth - gap - depth, v, v)[side]
        place = row.rectangle((u, u + width), (v, v + depth))
        if contains(row.rectangle((room.first + WALL_CM, room.last - WALL_CM), (WALL_CM, row.depth - WALL_CM)), place):
            pieces.add_if_free(draws, _SHAPES[kind], place)


def _furnish_hallway(draws: Draws, row: _Row, pieces: Pieces) -> None:
    """Add cabinets and fire extinguishers to a wall of the hallway where they fit."""
    for _ in range(draws.between(1, 4)):
        kind = draws.pick(("cupboard", "extinguisher"))
        width, depth = (draws.between(60, 120), draws.between(20, 35)) if kind == "cupboard" else (24, 12)
        u = draws.between(10, row.length - 10 - width)
        v = (-WALL_CM - depth, -WALL_CM) if kind == "cupboard" else (-depth, depth)
        pieces.add_if_free(draws, _SHAPES[kind], row.rectangle((u, u + width), v))


def _draw_size(draws: Draws, kind: str, along: bool) -> Spot:
    """Return the extent along the hallway and into the room."""
    if kind in ("box", "column", "chair"):
        size = {"box": draws.between(60, 120), "column": draws.between(20, 60), "chair": 60}[kind]
        return size, size
    long, short = (
        (draws.between(60, 180), draws.between(30, 80)) if kind == "cupboard" else (draws.between(120, 180), 80)
    )
    return (long, short) if along else (short, long)
