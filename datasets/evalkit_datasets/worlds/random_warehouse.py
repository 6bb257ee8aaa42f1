"""A warehouse with sides of 15 to 30 m, and a route through it, drawn from a seed: another one for each seed.

Aisles cross between blocks of racks, machines or goods on the floor. Walls are far away, often beyond the range of the
lidar, and racks, posts and columns repeat. The route drives up one aisle and down the next, and back to its start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from evalkit_datasets.worlds.drawn_plan import Pieces, Rectangle, Shape, Spot, contains, finish, grow, side_lengths
from evalkit_datasets.worlds.draws import Draws
from evalkit_datasets.worlds.floorplans import FloorPlan

_SIDE_CM = (1_500, 3_000)
_ROUTE_CM = (4_000, 8_000)  # bounds of the route's length with square corners
_AISLE_CM = (220, 300)
_POST_CM = 5  # radius of the posts of racks
_TRIES = 10  # to place a piece

_KINDS = {  # of blocks: bounds of their width and depth
    "racks": ((200, 240), (620, 900)),
    "machines": ((380, 560), (420, 640)),
    "floor": ((380, 560), (380, 560)),
}
_LOOSE: dict[str, tuple[tuple[Shape, tuple[int, int], tuple[int, int]], ...]] = {  # bounds of both sides
    "machines": (
        ("block", (150, 320), (110, 200)),
        ("tilted", (220, 320), (220, 320)),
        ("round", (80, 200), (80, 200)),
        ("block", (60, 120), (50, 80)),
        ("legs", (140, 220), (70, 90)),  # a bench
        ("block", (100, 200), (90, 160)),
    ),
    "floor": (
        ("block", (115, 125), (75, 85)),  # a pallet
        ("block", (235, 250), (75, 165)),  # pallets side by side
        ("tilted", (180, 260), (180, 260)),  # a truck
        ("round", (50, 62), (50, 62)),  # a drum
    ),
}


@dataclass(frozen=True)
class _Hall:
    """Where the aisles are, along x and along y, and the blocks between them with their kinds."""

    size: Spot
    lanes: tuple[list[int], list[int]]
    blocks: list[tuple[str, Rectangle]]


def draw_warehouse(seed: int) -> FloorPlan:
    """Return the warehouse and the route of a seed, at least 0.4 m from every boundary.

    Three seeds in a row have racks alone, racks behind an open floor, and machines, so that few seeds suffice for all.
    """
    draws = Draws(seed)
    kinds = (("racks", "racks"), ("floor", "racks"), ("machines", "machines"))[seed % 3]
    while True:
        hall = _draw_hall(draws, kinds)
        corners = _draw_route(draws, hall)
        fits = all(_SIDE_CM[0] <= side <= _SIDE_CM[1] for side in hall.size)
        if fits and _ROUTE_CM[0] <= sum(side_lengths(corners)) <= _ROUTE_CM[1]:
            return finish(draws, _build(draws, hall, corners), corners)


def _draw_hall(draws: Draws, kinds: tuple[str, ...]) -> _Hall:
    """Return a hall with as many rows of blocks as kinds."""
    broad, columns = _KINDS[kinds[-1]][0], draws.between(2, 3) if kinds[-1] == "machines" else draws.between(3, 5)
    width = draws.between(*broad)
    length, x_lanes, x_blocks = _alternate(draws, [width] * columns)
    depth, y_lanes, y_blocks = _alternate(draws, [draws.between(*_KINDS[kind][1]) for kind in kinds])
    blocks = [
        (kind, (left, low, right, high))
        for kind, (low, high) in zip(kinds, y_blocks, strict=True)
        for left, right in x_blocks
    ]
    return _Hall((length, depth), (x_lanes, y_lanes), blocks)


def _alternate(draws: Draws, blocks: list[int]) -> tuple[int, list[int], list[tuple[int, int]]]:
    """Return the length of blocks with aisles on all sides, the middles of the aisles, and the ends of the blocks."""
    at, lanes, ends = 0, [], []
    for length in [*blocks, 0]:
        aisle = draws.between(*_AISLE_CM)
        lanes.append(at + aisle // 2)
        ends.append((at + aisle, at + aisle + length))
        at += aisle + length
    return at, lanes, ends[:-1]


def _draw_route(draws: Draws, hall: _Hall) -> list[Spot]:
    """Return the corners of a route up and down two or four aisles along y, and back along the aisle of its start."""
    x_lanes, y_lanes = hall.lanes
    count = draws.pick((2, 4, 4)) if len(x_lanes) > 3 else 2
    chosen = [*x_lanes]
    for _ in range(len(x_lanes) - count):
        chosen.remove(draws.pick(chosen))
    first, *others = chosen
    at, corners = y_lanes[0], [(first, y_lanes[0])]
    for n, x in enumerate(others):
        up = n % 2 == 0
        at = draws.pick([y for y in y_lanes if (y > at if up else y < at)])
        corners += [(corners[-1][0], at), (x, at)]
    return [*corners, (corners[-1][0], y_lanes[0])]


def _build(draws: Draws, hall: _Hall, corners: list[Spot]) -> Pieces:
    """Return the outer walls, columns, racks, machines and goods beside the route."""
    pieces = Pieces.within(list(_draw_outline(draws, hall.size)), corners)
    loose = "machines" if hall.blocks[0][0] == "machines" else "floor"
    _add_columns(draws, hall, pieces)
    bay = draws.between(180, 280)
    for kind, block in hall.blocks:
        if kind == "racks":
            _add_racks(draws, block, bay, pieces)
        else:
            for _ in range(draws.between(4, 8)):
                _add_loose(draws, kind, block, pieces)
    for _ in range(draws.between(24, 40)):
        _add_at_wall(draws, loose, hall.size, pieces)
    return pieces


def _draw_outline(draws: Draws, size: Spot) -> Iterator[Spot]:
    """Yield the corners of the outer walls: one corner perhaps moved outwards, gates, alcoves and slanted bays."""
    width, depth = size
    aside = draws.pick((0, 0, draws.between(80, 300)))
    walls = [
        ((0, 0), (1, 0), width),
        ((width, 0), (0, 1), depth),
        ((width, depth + aside), (-1, 0), width),
        ((0, depth), (0, -1), depth),
    ]
    for n, ((x, y), (along_x, along_y), length) in enumerate(walls):
        yield x, y
        at = 0
        while aside == 0 or n not in (1, 2):
            at += draws.between(150, 900)
            wide, deep = draws.pick(((draws.between(300, 420), 25), (draws.between(120, 400), draws.between(40, 160))))
            if at + wide > length - 150:
                break
            slant = draws.pick((0, 0, draws.between(20, wide // 3)))
            for u, v in ((at, 0), (at + slant, deep), (at + wide - slant, deep), (at + wide, 0)):
                yield x + along_x * u + along_y * v, y + along_y * u - along_x * v
            at += wide


def _add_columns(draws: Draws, hall: _Hall, pieces: Pieces) -> None:
    """Add columns in a grid, where they stand beside the route."""
    step_x, step_y, radius = draws.between(480, 720), draws.between(480, 720), draws.between(14, 24)
    shape: Shape = draws.pick(("round", "block"))
    for x in range(step_x, hall.size[0] - 100, step_x):
        for y in range(step_y, hall.size[1] - 100, step_y):
            pieces.add_if_free(draws, shape, grow((x, y, x, y), radius))


def _add_racks(draws: Draws, block: Rectangle, bay: int, pieces: Pieces) -> None:
    """Add two racks back to back: posts between their bays, and pallets in most bays, empty ones are seen through."""
    left, low, right, high = block
    count, half = (high - low) // bay, (right - left) // 2
    for n in range(count + 1):
        for x in (left + _POST_CM, left + half, right - _POST_CM):
            y = low + n * bay
            pieces.add_if_free(draws, "round", grow((x, y, x, y), _POST_CM))
    for n in range(count):
        for face in (left + draws.between(4, 14), left + half + draws.between(2, 10)):
            for place in range(2):
                begin = low + n * bay + 8 + place * (bay - 16) // 2 + draws.between(0, 8)
                length = (bay - 16) // 2 - draws.between(8, 18)
                if draws.between(0, 3):
                    pieces.add_if_free(draws, "block", (face, begin, face + draws.between(78, 84), begin + length))


def _add_loose(draws: Draws, kind: str, within: Rectangle, pieces: Pieces) -> None:
    """Add a machine or goods somewhere within a rectangle, where they fit."""
    shape, *sides = draws.pick(_LOOSE[kind])
    width, depth = (draws.between(*each) for each in draws.pick((sides, sides[::-1])))
    if shape in ("round", "tilted"):
        depth = width
    for _ in range(_TRIES):
        left = draws.between(within[0], max(within[2] - width, within[0]))
        low = draws.between(within[1], max(within[3] - depth, within[1]))
        place = (left, low, left + width, low + depth)
        if contains(within, place) and pieces.add_if_free(draws, shape, place):
            return


def _add_at_wall(draws: Draws, kind: str, size: Spot, pieces: Pieces) -> None:
    """Add a piece at an outer wall, where it fits beside the route."""
    width, depth = size
    strip = draws.pick(
        (
            (4, 4, width - 4, 150),
            (4, depth - 150, width - 4, depth - 4),
            (4, 4, 150, depth - 4),
            (width - 150, 4, width - 4, depth - 4),
        )
    )
    _add_loose(draws, kind, strip, pieces)
