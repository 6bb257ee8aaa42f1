"""The rules of a mapper, checked on a few scans of a room in this process; they hold whatever it adds to a cell."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.equivalence.map_cells import GridPair, PosedScan
from evalkit.commands.validate.rules import scenes
from evalkit.commands.validate.rules.mapper_fixture import BEAMS, WORLD_FROM_ROOM, MapperFixture, grid_of
from evalkit.commands.validate.rules.rule import (
    RuleBroken,
    RuleNotApplicable,
    RuleReport,
    check_rules_once,
    require_accepted,
    rule_table,
)
from evalkit.core.arrays import Bools
from evalkit.core.errors import NotInstalled
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.metrics.neighbourhoods import build_kd_tree
from evalkit.plugins.address import label_of, mapper_at
from evalkit.plugins.parameters import resolve_parameters
from evalkit.plugins.specs import MapperSpec

SHIFT = (2000, -2400)
"""Cells by which the room is moved."""

MOST = 0.9
"""The share of hits, or of cells, that a rule needs: beams that graze a wall may free some of its cells."""

FEW = 0.02
"""The share of cells that may be decided by rounding."""

BESIDE_CELLS = 2.0
"""Cells this far from a hit may still belong to it, or lie behind the wall."""

NO_RETURNS, INVALID = slice(0, 90), slice(180, 270)
"""Beams of the scans with gaps."""


def check(mapper: str | MapperSpec, parameters: Mapping[str, object]) -> RuleReport:
    """The results of all rules for a mapper: a registered name, "module:SPEC", or a spec.

    Raises NotInstalled if it cannot run here, BadParameter or UnknownName for parameters.
    """
    spec = mapper_at(mapper)
    label = label_of(mapper, "this mapper")
    if why := spec.missing():
        raise NotInstalled(label, "cannot be checked here", why)
    fixture = MapperFixture(spec.make, resolve_parameters(label, spec.parameters, parameters))
    return RuleReport(label, check_rules_once(RULES, fixture))


def check_parameters(fixture: MapperFixture) -> str:
    """It can be created with the parameters it declares."""
    require_accepted(fixture.make)
    return f"accepts {', '.join(fixture.parameters) or 'none'}"


def check_empty(fixture: MapperFixture) -> str:
    """Before the first scan there is a map, and nothing in it is observed."""
    if observed := int(np.count_nonzero(grid_of(fixture.make()).observed)):
        raise RuleBroken(f"{observed} cells are observed before the first scan")
    return "no cell is observed"


def check_cells(fixture: MapperFixture) -> str:
    """Cells have the size of the parameter resolution_m; log-odds are finite, and 0 where nothing was observed."""
    grid = fixture.grid
    wanted = fixture.parameters.get("resolution_m")
    if wanted is not None and grid.resolution_m != wanted:
        raise RuleBroken(f"cells of {grid.resolution_m:g} m, expected resolution_m = {wanted:g} m")
    if strange := int(np.count_nonzero(~np.isfinite(grid.log_odds))):
        raise RuleBroken(f"the log-odds of {strange} cells are not finite")
    if strange := int(np.count_nonzero(grid.log_odds[~grid.observed])):
        raise RuleBroken(f"{strange} cells have log-odds, but are not observed")
    return f"{grid.shape[1]} x {grid.shape[0]} cells of {grid.resolution_m:g} m"


def check_walls(fixture: MapperFixture) -> str:
    """Cells with a hit are occupied, others are not: row 0 is the lowest y, the origin a corner, poses are applied."""
    return _require_walls(fixture, fixture.grid, fixture.scans)


def check_free(fixture: MapperFixture) -> str:
    """What beams crossed is free, what lies behind walls is not."""
    grid = fixture.grid
    free = grid.free()
    if not free.any():
        raise RuleNotApplicable("it marks no free cells")
    crossed = np.concatenate([pose.transform(0.5 * scan.points()) for scan, pose in fixture.scans])
    share = _share_in(grid, free, crossed)
    if share < MOST:
        raise RuleBroken(f"{100 * share:.0f} % of the beams have a free cell half-way to their hit")
    behind = ~_lies_in_room(grid.centres(free), BESIDE_CELLS * grid.resolution_m)
    if np.mean(behind) > FEW:
        raise RuleBroken(f"{np.count_nonzero(behind)} of {len(behind)} free cells lie behind the walls")
    return f"{100 * share:.0f} % of the beams, {np.count_nonzero(behind)} of {len(behind)} free cells behind walls"


def check_gaps(fixture: MapperFixture) -> str:
    """Beams without a return (inf), invalid ones (nan) and a scan without beams draw no wall."""
    none = np.zeros(0)
    scans: list[PosedScan] = []
    for scan, pose in fixture.scans:
        ranges = scan.ranges.copy()
        ranges[NO_RETURNS], ranges[INVALID] = np.inf, np.nan
        scans += [(replace(scan, ranges=ranges), pose), (replace(scan, ranges=none, angles=none), pose)]
    walls = _require_walls(fixture, fixture.draw(scans), scans)
    for value in (np.inf, np.nan):
        empty = [(replace(scan, ranges=np.full(BEAMS, value)), pose) for scan, pose in fixture.scans]
        if occupied := int(np.count_nonzero(fixture.draw(empty).occupied())):
            raise RuleBroken(f"scans whose ranges are all {value} draw {occupied} occupied cells")
    return walls


def check_again(fixture: MapperFixture) -> str:
    """The same scans give the same map, also where the map is asked for after each scan."""
    mapper = fixture.make()
    for scan, pose in fixture.scans:
        mapper.update(scan, pose)
        grid_of(mapper)
    for again, how in ((grid_of(mapper), "asked for after each scan"), (grid_of(mapper), "asked for twice"),
                       (fixture.draw(fixture.scans), "of a new mapper")):  # fmt: skip
        if _bits(again) != _bits(fixture.grid):
            raise RuleBroken(f"the map {how} differs")
    return f"{len(fixture.scans)} scans, equal to the bit"


def check_shifted(fixture: MapperFixture) -> str:
    """A world moved by whole cells, also across 0, gives the same map moved."""
    grid = fixture.grid
    x, y = (cells * grid.resolution_m for cells in SHIFT)
    moved = fixture.draw((scan, Pose(x, y, 0.0) @ pose) for scan, pose in fixture.scans)
    back = replace(moved, origin_x=moved.origin_x - x, origin_y=moved.origin_y - y)
    return _require_alike(grid, back, f"moved by ({x:g} m, {y:g} m)")


def check_clockwise(fixture: MapperFixture) -> str:
    """The beams of a scan in the opposite order, as of a lidar that turns clockwise, give the same map."""
    scans = [(replace(scan, ranges=scan.ranges[::-1], angles=scan.angles[::-1]), pose) for scan, pose in fixture.scans]
    return _require_alike(fixture.grid, fixture.draw(scans), "with its beams in the opposite order")


def _require_walls(fixture: MapperFixture, grid: OccupancyGrid, scans: Sequence[PosedScan]) -> str:
    """Return where hits and occupied cells are; raises RuleBroken where walls are missing, elsewhere or too many."""
    occupied, hits = grid.occupied(), _hits(scans)
    share = _share_in(grid, _widen(occupied), hits)
    if share < MOST:
        found = f"{100 * share:.0f} % of the hits have an occupied cell within one cell"
        raise RuleBroken(found + _find_mistake(fixture))
    _require_corner(grid, hits)
    centres = grid.centres(occupied)
    apart_m = np.asarray(build_kd_tree(hits).query(centres, p=np.inf)[0])
    near = apart_m < BESIDE_CELLS * grid.resolution_m
    if np.mean(near) < MOST:
        where = centres[int(np.argmin(near))]
        raise RuleBroken(
            f"{np.count_nonzero(~near)} of {len(near)} occupied cells have no hit within {BESIDE_CELLS:g} cells, one "
            f"of them at ({where[0]:.2f} m, {where[1]:.2f} m)"
        )
    return (
        f"{100 * share:.0f} % of {len(hits)} hits at an occupied cell, {100 * np.mean(near):.0f} % of {len(near)} "
        "occupied cells at a hit"
    )


def _require_corner(grid: OccupancyGrid, hits: Floats) -> None:
    """Raise RuleBroken where the hits fit better to the occupied cells if the origin is moved by half a cell."""
    half, occupied = 0.5 * grid.resolution_m, grid.occupied()
    shares = {
        (x, y): _share_in(grid, occupied, np.add(hits, (x, y))) for x in (0.0, half, -half) for y in (0.0, half, -half)
    }
    best = max(shares, key=lambda shift: shares[shift])
    if shares[best] > shares[0.0, 0.0]:
        raise RuleBroken(
            f"{100 * shares[0.0, 0.0]:.0f} % of the hits lie in an occupied cell, {100 * shares[best]:.0f} % if they "
            f"are moved by half a cell: the origin is the lower left corner of cell (0, 0), not its centre"
        )


def _widen(cells: Bools) -> Bools:
    """Return the marked cells (H, W) and their eight neighbours."""
    from scipy.ndimage import binary_dilation  # noqa: PLC0415 - takes long to import

    return np.asarray(binary_dilation(cells, np.ones((3, 3), dtype=np.bool_)))


def _find_mistake(fixture: MapperFixture) -> str:
    """Return what would explain where the walls of the first scan are drawn, as a clause, or ""."""
    scan, pose = fixture.scans[0]
    grid = fixture.draw([(scan, pose)] * 5)
    wide = _widen(grid.occupied())
    _, _, bottom, top = grid.extent
    x, y = pose.transform(scan.points()).T
    mistakes: dict[str, Floats] = {
        "row 0 is the highest y": np.stack([x, bottom + top - y], axis=1),
        "x and y are exchanged": np.stack([y, x], axis=1),
        "the pose is not applied": scan.points(),
        "the inverse of the pose is applied": pose.inverse().transform(scan.points()),
    }
    shares = {mistake: _share_in(grid, wide, points) for mistake, points in mistakes.items()}
    best = max(shares, key=lambda mistake: shares[mistake])
    return f"; of the first scan {100 * shares[best]:.0f} % if {best}" if shares[best] >= MOST else ""


def _hits(scans: Iterable[PosedScan]) -> Floats:
    """Return the hits (N, 2) of scans in the world (m)."""
    return np.concatenate([pose.transform(scan.points()) for scan, pose in scans])


def _share_in(grid: OccupancyGrid, cells: Bools, points: Floats) -> float:
    """Return the share of points (N, 2) in the marked cells (H, W)."""
    if not cells.size:
        return 0.0
    rows, columns, inside = grid.find_cells(points)
    return float(np.mean(inside & cells[rows, columns]))


def _lies_in_room(points: Floats, beside_m: float) -> Bools:
    """Return which points (N, 2) of the world lie in the room, or at most ``beside_m`` behind a wall."""
    x, y = WORLD_FROM_ROOM.inverse().transform(points).T
    (left, bottom), (right, top) = scenes.CORNERS.min(axis=0), scenes.CORNERS.max(axis=0)
    inner_x, inner_y = scenes.INNER_CORNER
    whole = (x > left - beside_m) & (x < right + beside_m) & (y > bottom - beside_m) & (y < top + beside_m)
    return np.asarray(whole & ((x < inner_x + beside_m) | (y < inner_y + beside_m)))


def _require_alike(grid: OccupancyGrid, other: OccupancyGrid, how: str) -> str:
    """Return how many cells have another state in the other map; raises RuleBroken where they are not few."""
    if other.resolution_m != grid.resolution_m:
        raise RuleBroken(f"the map {how} has cells of {other.resolution_m:g} m instead of {grid.resolution_m:g} m")
    pair = GridPair.of(_states(grid), _states(other))
    marked = int(np.count_nonzero((pair.a != 0.0) | (pair.b != 0.0)))
    differing = int(np.count_nonzero(pair.a != pair.b))
    said = f"{differing} of {marked} cells are occupied or free in one map only"
    if differing > FEW * marked:
        raise RuleBroken(f"{how}, {said}")
    return said


def _states(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the grid with 1 for occupied cells, -1 for free ones, and 0."""
    return replace(grid, log_odds=grid.occupied().astype(np.float32) - grid.free())


def _bits(grid: OccupancyGrid) -> tuple[object, ...]:
    return grid.log_odds.tobytes(), grid.observed.tobytes(), grid.shape, grid.resolution_m, grid.origin_x, grid.origin_y


RULES = rule_table(
    check_parameters, check_empty, check_cells, check_walls, check_free, check_gaps, check_again, check_shifted,
    check_clockwise,
)  # fmt: skip
