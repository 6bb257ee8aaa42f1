"""An office building, and a route through it, drawn from a seed: another building for each seed.

Rooms lie on both sides of a hallway that is straight, an L or a ring. The route drives along the hallway, through doors
into some rooms, and back to its start. Lengths are whole centimetres until the plan is complete, and only exact
arithmetic is used, so that a seed gives the same plan on every machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.core.world import World, closed_outline
from evalkit_datasets.worlds.draws import Draws
from evalkit_datasets.worlds.floorplans import LEG_RADIUS_M, FloorPlan, build_partition
from evalkit_datasets.worlds.robot import Route

_ROUTE_CM = (2_400, 4_800)  # bounds of the route's length with square corners
_MIN_SIDE_CM = 100  # of the route, so that two curves fit
_RADIUS_CM = (40, 60)  # of the route's curves
_CLEAR_CM = 50  # furniture keeps this distance from the route before its corners are rounded
_MIN_ROOM_CM = 320
_CLOSED_DOOR_CM = 4  # thickness
_TILTS = ((1.0, 0.0), (0.8, 0.6), (0.96, 0.28), (0.6, -0.8), (0.96, -0.28))  # cosine and sine

Spot = tuple[int, int]
Rectangle = tuple[int, int, int, int]  # smallest x and y, largest x and y


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
        return _bounds([self.at(u[0], v[0]), self.at(u[1], v[1])])


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
class _Shape:
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
    world = _build(draws, shape, rooms, tour)
    return _mirror(draws, world, _add_radii(draws, tour.corners))


def _draw_straight(draws: Draws) -> _Shape:
    hall, length, below, above = draws.between(180, 240), draws.between(1200, 1700), *_draw_depths(draws)
    lane, top = hall // 2 + draws.between(-15, 15), below + hall
    rows = [
        _Row((0, below), (1, 0), (0, -1), length, below, lane),
        _Row((0, top), (1, 0), (0, 1), length, above, hall - lane),
    ]
    return _Shape([(0, 0), (length, 0), (length, top + above), (0, top + above)], rows)


def _draw_bent(draws: Draws) -> _Shape:
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
    return _Shape(outline, rows, [(right - other_lane, below + lane)], [((length, top), (length, end))])


def _draw_ring(draws: Draws) -> _Shape:
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
    return _Shape([(0, 0), (width, 0), (width, end), (0, end)], rows, corners, walls)


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


def _plan_tour(draws: Draws, shape: _Shape, rooms: list[list[_Room]]) -> _Tour | None:
    """Return a route through the hallway and rooms; None if a room is missing, visited twice, or it does not fit."""
    stops = _stops_on_ring(shape, rooms) if len(shape.corners) == 4 else _stops_there_and_back(draws, shape, rooms)
    if not all(stops):
        return None
    parts = [stop if isinstance(stop, tuple) else _draw_visit(draws, draws.pick(stop), rooms) for stop in stops]
    corners = [corner for part in parts for corner in (part.corners if isinstance(part, _Visit) else [part])]
    visits = [part for part in parts if isinstance(part, _Visit)]
    visited = [room.entry for visit in visits for room in visit.rooms]
    sides = _side_lengths(corners)
    if len(set(visited)) < len(visited) or min(sides) < _MIN_SIDE_CM or not _ROUTE_CM[0] <= sum(sides) <= _ROUTE_CM[1]:
        return None
    return _Tour(visits, [corners[-1], *corners[:-1]])  # a route starts behind its first corner: in the hallway


def _stops_there_and_back(draws: Draws, shape: _Shape, rooms: list[list[_Room]]) -> list[Stop]:
    """Return the stops of a drive to one end of the hallway and back to the other."""
    hallway, third = rooms[0] + rooms[1], shape.rows[0].length // 3
    near = [room for room in hallway if room.door < third]
    far = rooms[2] if shape.corners else [room for room in hallway if room.door > 2 * third]
    middle = [room for room in hallway if third <= room.door <= 2 * third]
    on_the_way: list[Stop] = [middle] if draws.between(0, 1) else []
    there: list[Stop] = [*on_the_way, *shape.corners, far, *shape.corners]
    return [*(there if draws.between(0, 1) else reversed(there)), near]


def _stops_on_ring(shape: _Shape, rooms: list[list[_Room]]) -> list[Stop]:
    """Return the stops of a drive around a ring; rooms with a door at its corners are left out."""
    left, right = shape.corners[0][0] + _MIN_SIDE_CM, shape.corners[1][0] - _MIN_SIDE_CM
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


def _side_lengths(corners: list[Spot]) -> list[int]:
    """Return the lengths from each corner of a route to the next; all are parallel to x or y."""
    return [abs(x - u) + abs(y - v) for (x, y), (u, v) in pairwise([*corners, corners[0]])]


def _add_radii(draws: Draws, corners: list[Spot]) -> Floats:
    """Return the corners of a route in m with a radius each."""
    sides = _side_lengths(corners)
    radii = [min(draws.between(*_RADIUS_CM), side // 2, sides[n - 1] // 2) for n, side in enumerate(sides)]
    return np.column_stack([corners, radii]) / 100.0


def _mirror(draws: Draws, world: World, corners: Floats) -> FloorPlan:
    """Return the plan, mirrored and with x and y exchanged by chance."""
    order = draws.pick(([0, 1], [1, 0]))
    signs = np.array([draws.pick((1.0, -1.0)), draws.pick((1.0, -1.0))])

    def mirror(points: Floats) -> Floats:
        return np.asarray((points * signs)[:, order])

    walls = np.hstack([mirror(world.segments[:, :2]), mirror(world.segments[:, 2:])])
    circles = np.column_stack([mirror(world.circles[:, :2]), world.circles[:, 2]])
    return FloorPlan(
        World(walls, circles), Route.from_corners(np.column_stack([mirror(corners[:, :2]), corners[:, 2]]))
    )


def _build(draws: Draws, shape: _Shape, rooms: list[list[_Room]], tour: _Tour) -> World:
    """Return the walls with their doors, and furniture beside the route."""
    passed = {room.entry for visit in tour.visits for room in visit.rooms}
    passages = {visit.rooms[0].row.at(visit.passage[0], 0): visit.passage[1] for visit in tour.visits if visit.passage}
    pieces = _Pieces([closed_outline(np.array(shape.outline) / 100.0)])
    taken = [_grown(_bounds(side), _CLEAR_CM) for side in pairwise([*tour.corners, tour.corners[0]])]
    for wall in shape.walls:
        pieces.add_wall(*wall, [])
    for row, own in zip(shape.rows, rooms, strict=True):
        doors = [_draw_door(draws, room.door, room.entry in passed or draws.between(0, 2) == 0) for room in own]
        pieces.add_wall(row.at(0, 0), row.at(row.length, 0), doors)
        taken += [row.rectangle((room.door - 60, room.door + 60), (-60, 60)) for room in own]
        for room in own[1:]:
            start, middle = row.at(room.first, 0), draws.between(100, row.depth - 100)
            is_open = start in passages or draws.between(0, 2) == 0
            v = passages.get(start, middle)
            pieces.add_wall(start, row.at(room.first, row.depth), [_draw_door(draws, v, True)] if is_open else [])
            taken += [row.rectangle((room.first - 60, room.first + 60), (v - 60, v + 60))] if is_open else []
    for row, own in zip(shape.rows, rooms, strict=True):
        for room in own:
            _furnish(draws, room, taken, pieces)
        _furnish_hallway(draws, row, taken, pieces)
    return World(np.concatenate(pieces.walls), np.array(pieces.circles, dtype=np.float64).reshape(-1, 3) / 100.0)


@dataclass
class _Pieces:
    """Walls (N, 4) in m and circles in cm, so far."""

    walls: list[Floats]
    circles: list[tuple[float, float, float]] = field(default_factory=list)

    def add_wall(self, start: Spot, end: Spot, doors: Sequence[tuple[float, float, float]]) -> None:
        """Add a wall with doors in m, given as for a partition in floorplans.toml."""
        self.walls += build_partition([each / 100.0 for each in start], [each / 100.0 for each in end], doors)


def _draw_door(draws: Draws, middle: int, is_open: bool) -> tuple[float, float, float]:
    """Return the distance from the wall's start, the width and the thickness of a door in m; 0: open."""
    half = draws.between(45, 60)
    return (middle - half) / 100.0, 2 * half / 100.0, 0.0 if is_open else _CLOSED_DOOR_CM / 100.0


def _furnish(draws: Draws, room: _Room, taken: list[Rectangle], pieces: _Pieces) -> None:
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
        inside = row.rectangle((room.first + 6, room.last - 6), (6, row.depth - 6))
        if _contains(inside, place) and not any(_overlap(place, each) for each in taken):
            taken.append(place)
            _add_piece(draws, kind, place, pieces)


def _furnish_hallway(draws: Draws, row: _Row, taken: list[Rectangle], pieces: _Pieces) -> None:
    """Add cabinets and fire extinguishers to a wall of the hallway where they fit."""
    for _ in range(draws.between(1, 4)):
        kind = draws.pick(("cupboard", "extinguisher"))
        width, depth = (draws.between(60, 120), draws.between(20, 35)) if kind == "cupboard" else (24, 12)
        u = draws.between(10, row.length - 10 - width)
        place = row.rectangle((u, u + width), (-6 - depth, -6) if kind == "cupboard" else (-depth, depth))
        if not any(_overlap(place, each) for each in taken):
            taken.append(place)
            _add_piece(draws, kind, place, pieces)


def _draw_size(draws: Draws, kind: str, along: bool) -> Spot:
    """Return the extent along the hallway and into the room."""
    if kind in ("box", "column", "chair"):
        size = {"box": draws.between(60, 120), "column": draws.between(20, 60), "chair": 60}[kind]
        return size, size
    long, short = (
        (draws.between(60, 180), draws.between(30, 80)) if kind == "cupboard" else (draws.between(120, 180), 80)
    )
    return (long, short) if along else (short, long)


def _add_piece(draws: Draws, kind: str, place: Rectangle, pieces: _Pieces) -> None:
    """Add one piece within its rectangle; of chairs and tables, the lidar sees the legs."""
    left, low, right, high = place
    x, y, width, depth = (left + right) / 2.0, (low + high) / 2.0, float(right - left), float(high - low)
    if kind in ("column", "extinguisher"):
        pieces.circles.append((x, y, width / 2.0))
        return
    cos, sin = 1.0, 0.0
    if kind in ("box", "chair"):
        cos, sin = draws.pick(_TILTS)
        share = draws.between(4, 6) / 10.0 if kind == "box" else 0.7
        width, depth = share * width, (1.0 - share if kind == "box" else 0.7) * depth
    corners = [(u * width, v * depth) for u, v in ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))]
    turned = [(x + cos * u - sin * v, y + sin * u + cos * v) for u, v in corners]
    if kind in ("chair", "table"):
        pieces.circles += [(*corner, 100.0 * LEG_RADIUS_M) for corner in turned]
    else:
        pieces.walls.append(closed_outline(np.array(turned) / 100.0))


def _bounds(points: Sequence[Spot]) -> Rectangle:
    xs, ys = zip(*points, strict=True)
    return min(xs), min(ys), max(xs), max(ys)


def _grown(place: Rectangle, by: int) -> Rectangle:
    return place[0] - by, place[1] - by, place[2] + by, place[3] + by


def _overlap(one: Rectangle, other: Rectangle) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _contains(outer: Rectangle, inner: Rectangle) -> bool:
    return outer[0] <= inner[0] and outer[1] <= inner[1] and inner[2] <= outer[2] and inner[3] <= outer[3]
