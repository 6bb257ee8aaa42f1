"""Planted faults of mappers break the rule that states them, and no other mapper breaks one."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate.rules import mapper_rules
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import MapperSpec
from evalkit.testing import RulesBroken, check_mapper
from evalkit_baselines import paper

CELL_M = 0.05
RESOLUTION = Parameter("resolution_m", CELL_M, "m", "size of a cell", low=0.01, high=1.0)


class Correct:
    """The default mapper; the faults change what it is given or what it gives."""

    def __init__(self, resolution_m):
        self.mapper = paper.MAPPER.make(
            **{one.name: one.default for one in paper.MAPPER.parameters} | {"resolution_m": resolution_m}
        )

    def update(self, scan, pose):
        self.mapper.update(scan, pose)

    def grid(self):
        return self.mapper.grid()


class RowsFromTheTop(Correct):
    def grid(self):
        grid = super().grid()
        return replace(grid, log_odds=grid.log_odds[::-1], observed=grid.observed[::-1])


class ColumnsFirst(Correct):
    def grid(self):
        grid = super().grid()
        return replace(
            grid, log_odds=grid.log_odds.T, observed=grid.observed.T, origin_x=grid.origin_y, origin_y=grid.origin_x
        )


class OriginAtTheCentre(Correct):
    def grid(self):
        grid = super().grid()
        return replace(grid, origin_x=grid.origin_x + CELL_M / 2, origin_y=grid.origin_y + CELL_M / 2)


class WithoutPose(Correct):
    def update(self, scan, _pose):
        super().update(scan, Pose())


class InversePose(Correct):
    def update(self, scan, pose):
        super().update(scan, pose.inverse())


class WallAtTheRangeLimit(Correct):
    def update(self, scan, pose):
        super().update(replace(scan, ranges=np.where(scan.no_returns, scan.range_max_m, scan.ranges)), pose)


class WallWhereAllIsOpen(WallAtTheRangeLimit):
    def update(self, scan, pose):
        (super().update if scan.no_returns.all() else self.mapper.update)(scan, pose)


class NeedsBeams(Correct):
    def update(self, scan, pose):
        super().update(replace(scan, stamp_ns=int(scan.angles.min())), pose)


class CounterClockwiseOnly(Correct):
    def update(self, scan, pose):
        if len(scan.angles) and scan.angles[-1] > scan.angles[0]:
            super().update(scan, pose)


class FreeBehindWalls(Correct):
    def grid(self):
        grid = super().grid()
        unknown = np.where(grid.observed, grid.log_odds, -3.0)
        return replace(grid, log_odds=unknown, observed=np.ones(grid.shape, bool))


class FreeOnlyNear(Correct):
    def grid(self):
        grid = super().grid()
        x, y = np.meshgrid(*(np.arange(size) for size in grid.shape[::-1]))
        far = grid.free() & (x + y > sum(grid.shape) / 3)
        return replace(grid, log_odds=np.where(far, 0.0, grid.log_odds))


class Forgets(Correct):
    def grid(self):
        grid = super().grid()
        self.__init__(CELL_M)
        return grid


class Twice(Correct):
    made = 0

    def __init__(self, resolution_m):
        super().__init__(resolution_m)
        Twice.made += 1

    def grid(self):
        grid = super().grid()
        return replace(grid, log_odds=np.where(grid.observed, grid.log_odds + 1e-3 * Twice.made, 0.0))


class OtherCells(Correct):
    def __init__(self, resolution_m):
        super().__init__(2 * resolution_m)


class NotFinite(Correct):
    def grid(self):
        grid = super().grid()
        return replace(grid, log_odds=np.where(grid.log_odds > 2.0, np.inf, grid.log_odds))


class Unobserved(Correct):
    def grid(self):
        grid = super().grid()
        return replace(grid, observed=grid.observed & (grid.log_odds > 0.0))


class SeenAtOnce(Correct):
    def grid(self):
        grid = super().grid()
        return grid if grid.log_odds.size else OccupancyGrid(np.zeros((1, 1)), np.ones((1, 1), bool), CELL_M, 0.0, 0.0)


class NoGrid(Correct):
    def grid(self):
        return super().grid().log_odds


class Refuses(Correct):
    def __init__(self):
        super().__init__(CELL_M)


class Truncates:
    """Numbers cells by int() instead of floor(): the cells around 0 are twice as wide."""

    def __init__(self, resolution_m):
        self.resolution_m, self.points = resolution_m, [np.zeros((0, 2))]

    def update(self, scan, pose):
        self.points.append(pose.transform(scan.points()))

    def grid(self):
        cells = (np.concatenate(self.points) / self.resolution_m).astype(int)
        low = cells.min(axis=0, initial=0)
        marks = np.zeros(cells.max(axis=0, initial=0)[::-1] - low[::-1] + 1, np.float32)
        marks[tuple((cells - low).T[::-1])] = 2.0
        return OccupancyGrid(marks, marks > 0.0, self.resolution_m, *(low * self.resolution_m))


@pytest.mark.parametrize(
    ("made", "rule", "observed"),
    [
        (Refuses, "parameters", "make() rejects its declared parameters"),
        (NoGrid, "empty", "grid() returns a ndarray, expected an evalkit.OccupancyGrid"),
        (SeenAtOnce, "empty", "1 cells are observed before the first scan"),
        (OtherCells, "cells", "cells of 0.1 m, expected resolution_m = 0.05 m"),
        (NotFinite, "cells", "cells are not finite"),
        (Unobserved, "cells", "cells have log-odds, but are not observed"),
        (RowsFromTheTop, "walls", "if row 0 is the highest y"),
        (ColumnsFirst, "walls", "if x and y are exchanged"),
        (WithoutPose, "walls", "if the pose is not applied"),
        (InversePose, "walls", "if the inverse of the pose is applied"),
        (OriginAtTheCentre, "walls", "moved by half a cell: the origin is the lower left corner of cell (0, 0)"),
        (FreeOnlyNear, "free", "of the beams have a free cell half-way to their hit"),
        (FreeBehindWalls, "free", "free cells lie behind the walls"),
        (WallAtTheRangeLimit, "gaps", "occupied cells have no hit within 2 cells"),
        (WallWhereAllIsOpen, "gaps", "scans whose ranges are all inf draw"),
        (NeedsBeams, "gaps", "ValueError"),
        (Forgets, "again", "the map asked for after each scan differs"),
        (Twice, "again", "the map asked for after each scan differs"),
        (Truncates, "shifted", "cells are occupied or free in one map only"),
        (CounterClockwiseOnly, "clockwise", "with its beams in the opposite order"),
    ],
)
def test_a_planted_fault_breaks_its_rule(made, rule, observed):
    with pytest.raises(RulesBroken) as broken:
        check_mapper(MapperSpec(made, "planted", "-", "MIT", parameters=(RESOLUTION,)))
    _, results, _ = broken.value.args
    found = {one.rule: one.observed for one in results}
    assert observed in found.get(rule, f"passed; broken: {found}")


@pytest.mark.parametrize(
    "changes", [{"resolution_m": 0.02}, {"resolution_m": 0.05}, {"resolution_m": 0.2}, {"clear_no_returns": True}]
)
@pytest.mark.parametrize("name", registry.names("mappers"))
def test_the_mappers_of_evalkit_keep_the_rules(name, changes):
    if why := registry.mapper(name).missing():
        pytest.skip(why)
    check_mapper(name, **changes)


def test_the_scans_begin_on_both_sides_of_0_and_have_hits_in_every_direction():
    fixture = mapper_rules.MapperFixture(Correct, {"resolution_m": CELL_M})
    hits = np.concatenate([pose.transform(scan.points()) for scan, pose in fixture.scans])
    assert (hits.min(axis=0) < -2.0).all()
    assert (hits.max(axis=0) > 2.0).all()
    assert all(isinstance(scan, Scan) and scan.hits.all() for scan, _ in fixture.scans)
