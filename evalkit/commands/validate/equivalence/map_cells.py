"""Comparison of two mappers over the same scans, cell by cell: the first cell that differs, and the cause."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.commands.validate.equivalence.diagnosis import DivergenceKind
from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import REMEDY
from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BackendFailed, format_exception
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Mapper

PosedScan = tuple[Scan, Pose]
"""A scan and its ``world_from_sensor``."""

MIN_EXPLAINED = 0.9
"""A cause explains a scan if it explains at least this share of the differing cells, not corners and shared cells."""

FLOAT32_STEP = 2.0**-23
"""Relative distance of two neighbouring single-precision numbers."""


@dataclass(frozen=True)
class MapComparison:
    """The first difference, and for each scan the largest difference of a cell (log-odds) and the cells that differ."""

    first: Divergence | None
    largest: tuple[float, ...]
    cells: tuple[int, ...]


def compare_mappers(
    label_a: str, make_a: Callable[[], Mapper], make_b: Callable[[], Mapper], scans: Iterable[PosedScan], margin: float
) -> MapComparison:
    """Run both mappers over the same scans and compare them after each; ``margin`` in log-odds.

    Raises BackendFailed, with its label, if the first mapper raises.
    """
    a, b = make_a(), make_b()
    first: Divergence | None = None
    largest: list[float] = []
    cells: list[int] = []
    before = GridPair.none()
    for number, (scan, world_from_sensor) in enumerate(scans, start=1):
        try:
            grid_a = _update(a, scan, world_from_sensor)
        except Exception as error:  # a third party's code
            raise BackendFailed(label_a, f"scan {number}: {format_exception(error)}", REMEDY) from error
        try:
            grids = grid_a, _update(b, scan, world_from_sensor)
        except Exception as error:  # noqa: BLE001 - a third party's exception is a difference to report
            first = first or _divergence(number, "different", f"B {format_exception(error)}")
            return MapComparison(first, (*largest, np.inf), (*cells, 0))
        if mismatch := _cell_mismatch(*grids):
            return MapComparison(first or _divergence(number, "different", mismatch), (*largest, np.inf), (*cells, 0))
        now = GridPair.of(*grids)
        differing = now.differing(margin)
        largest.append(now.largest)
        cells.append(int(np.count_nonzero(differing)))
        if first is None and differing.any():
            first = _ScanIncrement(before.on(now), now, differing, _ends(scan, world_from_sensor, now)).divergence(
                number
            )
        before = now
    return MapComparison(first, tuple(largest), tuple(cells))


@dataclass(frozen=True, eq=False)
class GridPair:
    """Two grids on the same cells (H, W): log-odds, 0 if a grid has no such cell, and which cells are observed."""

    low: Ints
    resolution_m: float
    a: Floats
    b: Floats
    observed_a: Bools
    observed_b: Bools

    @classmethod
    def none(cls) -> GridPair:
        """Two empty grids."""
        empty, marks = np.zeros((0, 0)), np.zeros((0, 0), dtype=np.bool_)
        return cls(np.zeros(2, dtype=np.int64), 1.0, empty, empty, marks, marks)

    @classmethod
    def of(cls, a: OccupancyGrid, b: OccupancyGrid) -> GridPair:
        """Two grids of the same resolution on their common extent."""
        corners = [(_low(grid), _low(grid) + np.array(grid.shape[::-1])) for grid in (a, b) if grid.log_odds.size]
        if not corners:
            return cls.none()
        low = np.min([corner[0] for corner in corners], axis=0)
        size = np.max([corner[1] for corner in corners], axis=0) - low
        layers = [
            _pad(layer, _low(grid) - low, size)
            for grid, layer in ((a, a.log_odds), (b, b.log_odds), (a, a.observed), (b, b.observed))
        ]
        return cls(low, a.resolution_m, layers[0], layers[1], layers[2] > 0.0, layers[3] > 0.0)

    def on(self, other: GridPair) -> GridPair:
        """The same values on the cells of larger grids."""
        size = np.array(other.a.shape[::-1])
        at = self.low - other.low if self.a.size else np.zeros(2, dtype=np.int64)
        marks = [_pad(layer, at, size) > 0.0 for layer in (self.observed_a, self.observed_b)]
        values = [_pad(layer, at, size) for layer in (self.a, self.b)]
        return GridPair(other.low, other.resolution_m, values[0], values[1], marks[0], marks[1])

    @property
    def largest(self) -> float:
        """The largest difference of a cell (log-odds)."""
        return float(np.abs(self.a - self.b).max(initial=0.0))

    def differing(self, margin: float) -> Bools:
        """Cells (H, W) that differ by more than a margin, or that only one grid has observed."""
        return np.asarray((np.abs(self.a - self.b) > margin) | (self.observed_a != self.observed_b))


class _ScanIncrement:
    """The increments of one scan to both grids, in which the grids first differ."""

    def __init__(self, before: GridPair, now: GridPair, differing: Bools, ends: Bools) -> None:
        self._before, self._now, self._differing, self._ends = before, now, differing, ends
        self._on_beam = differing & ~ends
        self._added_a, self._added_b = now.a - before.a, now.b - before.b

    def divergence(self, number: int) -> Divergence:
        """The class of the difference, and the first cell that differs."""
        kind, what = self._explain()
        return _divergence(
            number, kind, f"{what}; {self._first_cell()}, {np.count_nonzero(self._differing)} cells differ"
        )

    def _explain(self) -> tuple[DivergenceKind, str]:
        if rounding := self._rounding():
            return "precision", rounding
        if what := self._find_clamp():
            return "clamp", what
        opposite = np.isclose(self._added_a, -self._added_b, atol=1e-3) & (np.abs(self._added_a) > 1e-3)
        if self._share(opposite, self._on_beam):
            return "sign", "A adds along a beam what B subtracts"
        if self._share(opposite, self._differing & self._ends):
            return "sign", "A adds at the end of a beam what B subtracts"
        if self._share(self._one_only(self._on_beam), self._on_beam):
            return "traversal", "cells that a beam passes in one of them only"
        return self._explain_increments()

    def _explain_increments(self) -> tuple[DivergenceKind, str]:
        if not self._on_beam.any():
            return "endpoint rule", "equal along the beams, different at their ends"
        if self._multiples():
            return "counting rule", "one of them adds to a cell several times per scan"
        ratio = self._added_b[self._on_beam] / np.where(self._added_a == 0.0, np.nan, self._added_a)[self._on_beam]
        if np.nanstd(ratio) < 1e-3:
            return "increment", f"B adds {np.nanmean(ratio):.4g} times what A adds"
        return "different", "no common cause explains it"

    def _rounding(self) -> str:
        if not np.array_equal(self._now.observed_a, self._now.observed_b):
            return ""
        largest = max(float(np.abs(self._now.a).max()), 1.0)
        if self._now.largest <= 8.0 * FLOAT32_STEP * largest:
            return "within rounding to float32"
        for bits in range(3, 17):  # fixed point: a step of 2^-bits explains a difference of a few of them
            step = 2.0**-bits
            whole = [np.array_equal(np.rint(layer / step), layer / step) for layer in (self._now.a, self._now.b)]
            if any(whole) and not all(whole) and self._now.largest <= 2.0 * step:
                return f"{'A' if whole[0] else 'B'} counts in steps of 2^-{bits}"
        return ""

    def _find_clamp(self) -> str:
        """The bound at which the values of one side stop while the other side adds more; "" if there is none."""
        at = self._differing
        added_a, added_b = np.abs(self._added_a[at]), np.abs(self._added_b[at])
        for name, values, less, more, old in (
            ("A", self._now.a, added_a, added_b, self._before.a),
            ("B", self._now.b, added_b, added_a, self._before.b),
        ):
            pinned = (values[at] == values.max()) | (values[at] == values.min())
            if pinned.all() and (less < more).all() and (old[at] != 0.0).all():
                bounds = ", ".join(f"{bound:.4g}" for bound in np.unique(values[at]))
                return f"{name} stops at {bounds}"
        return ""

    def _one_only(self, among: Bools) -> Bools:
        """Cells (H, W) of a selection that only one side has changed in this scan."""
        touched = [
            (added != 0.0) | (now & ~before)
            for added, now, before in (
                (self._added_a, self._now.observed_a, self._before.observed_a),
                (self._added_b, self._now.observed_b, self._before.observed_b),
            )
        ]
        return np.asarray(among & (touched[0] != touched[1]))

    def _multiples(self) -> bool:
        """Whether the increments of one side are multiples of the other's, with a factor that varies by cell."""
        for once, often, values in (
            (self._added_a, self._added_b, self._now.b),
            (self._added_b, self._added_a, self._now.a),
        ):
            free = self._on_beam & (once != 0.0) & (values != values.max()) & (values != values.min())
            times = often[free] / once[free]
            whole = np.abs(times - np.rint(times)) < 1e-2
            if len(times) and whole.mean() >= MIN_EXPLAINED and len(np.unique(np.rint(times))) > 1:
                return True
        return False

    @staticmethod
    def _share(holds: Bools, among: Bools) -> bool:
        return bool(among.any()) and float(holds[among].mean()) >= MIN_EXPLAINED

    def _first_cell(self) -> str:
        row, column = np.argwhere(self._differing)[0]
        x, y = self._now.low + np.array([column, row])
        a, b = self._now.a[row, column], self._now.b[row, column]
        return f"first at cell ({x}, {y}) from the origin of the world: {a:.4g} against {b:.4g}"


def _update(mapper: Mapper, scan: Scan, world_from_sensor: Pose) -> OccupancyGrid:
    mapper.update(scan, world_from_sensor)
    return mapper.grid()


def _cell_mismatch(a: OccupancyGrid, b: OccupancyGrid) -> str:
    """Why the cells of two grids cannot be compared, "" if they can."""
    if not np.isclose(a.resolution_m, b.resolution_m, rtol=1e-6):
        return f"cells of {a.resolution_m:g} m against {b.resolution_m:g} m"
    away = np.array([a.origin_x - b.origin_x, a.origin_y - b.origin_y]) / a.resolution_m
    if a.log_odds.size and b.log_odds.size and np.abs(away - np.rint(away)).max() > 1e-3:
        return f"cells are shifted by part of a cell: {(away - np.floor(away)).round(3).tolist()}"
    return ""


def _ends(scan: Scan, world_from_sensor: Pose, layers: GridPair) -> Bools:
    """Cells (H, W) in which a beam of the scan ends."""
    marks: Bools = np.zeros_like(layers.a, dtype=np.bool_)
    ends = se2.transform(world_from_sensor.row, scan.points()) / layers.resolution_m - layers.low
    columns, rows = np.floor(ends).astype(np.int64).T
    inside = (columns >= 0) & (columns < marks.shape[1]) & (rows >= 0) & (rows < marks.shape[0])
    marks[rows[inside], columns[inside]] = True
    return marks


def _low(grid: OccupancyGrid) -> Ints:
    return np.rint(np.array([grid.origin_x, grid.origin_y]) / grid.resolution_m).astype(np.int64)


def _pad(layer: ArrayLike, at: Ints, size: Ints) -> Floats:
    """A layer (h, w) padded with zeros to ``size`` (columns, rows), with its lowest cell at ``at``."""
    values: Floats = np.asarray(layer, dtype=np.float64)
    column, row = at.tolist()
    columns, rows = size.tolist()
    height, width = np.shape(values)
    return np.pad(values, ((row, rows - row - height), (column, columns - column - width)))


def _divergence(number: int, kind: DivergenceKind, what: str) -> Divergence:
    return Divergence(number, "map", None, "cells", kind, what)
