"""Two mappers drawing the same scans: the first cell that differs, and why, cell by cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.commands.validate.equivalence.diagnosis import Kind
from evalkit.commands.validate.equivalence.divergence import Divergence
from evalkit.commands.validate.equivalence.lockstep import REMEDY
from evalkit.commands.validate.rules.rule import raised
from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BackendFailed
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Mapper

Drawn = tuple[Scan, Pose]
"""A scan and its ``world_from_sensor``."""

MOST = 0.9
"""A rule explains a scan if it explains this share of the differing cells; corners and shared cells are the rest."""

FLOAT32_STEP = 2.0**-23
"""Relative distance of two neighbouring numbers of single precision."""


@dataclass(frozen=True)
class Drawing:
    """What came out: the first difference, and for each scan the largest difference of a cell (log-odds)."""

    first: Divergence | None
    largest: tuple[float, ...]
    cells: tuple[int, ...]


def compared(
    label_a: str, make_a: Callable[[], Mapper], make_b: Callable[[], Mapper], drawn: Iterable[Drawn], margin: float
) -> Drawing:
    """Both mappers over the same scans, held against each other after each; ``margin`` in log-odds.

    Raises BackendFailed, with its label, where the first mapper raises.
    """
    a, b = make_a(), make_b()
    first: Divergence | None = None
    largest: list[float] = []
    cells: list[int] = []
    past = Layers.none()
    for number, (scan, world_from_sensor) in enumerate(drawn, start=1):
        try:
            drawn_a = _updated(a, scan, world_from_sensor)
        except Exception as error:  # a third party's code: what it raises is not ours to let through
            raise BackendFailed(label_a, f"scan {number}: {raised(error)}", REMEDY) from error
        try:
            grids = drawn_a, _updated(b, scan, world_from_sensor)
        except Exception as error:  # noqa: BLE001 - a third party's crash is a difference to report
            first = first or _found(number, "different", f"B {raised(error)}")
            return Drawing(first, (*largest, np.inf), (*cells, 0))
        if misplaced := _misplaced(*grids):
            return Drawing(first or _found(number, "different", misplaced), (*largest, np.inf), (*cells, 0))
        now = Layers.of(*grids)
        differing = now.differing(margin)
        largest.append(now.largest)
        cells.append(int(np.count_nonzero(differing)))
        if first is None and differing.any():
            first = _Change(past.on(now), now, differing, _ends(scan, world_from_sensor, now)).divergence(number)
        past = now
    return Drawing(first, tuple(largest), tuple(cells))


@dataclass(frozen=True, eq=False)
class Layers:
    """Both grids on the same cells (H, W): log-odds, 0 where a grid has no cell, and which are observed."""

    low: Ints
    resolution_m: float
    a: Floats
    b: Floats
    observed_a: Bools
    observed_b: Bools

    @classmethod
    def none(cls) -> Layers:
        """Before the first scan."""
        empty, marks = np.zeros((0, 0)), np.zeros((0, 0), dtype=np.bool_)
        return cls(np.zeros(2, dtype=np.int64), 1.0, empty, empty, marks, marks)

    @classmethod
    def of(cls, a: OccupancyGrid, b: OccupancyGrid) -> Layers:
        """Two grids of the same cells."""
        corners = [(_low(grid), _low(grid) + np.array(grid.shape[::-1])) for grid in (a, b) if grid.log_odds.size]
        if not corners:
            return cls.none()
        low = np.min([corner[0] for corner in corners], axis=0)
        size = np.max([corner[1] for corner in corners], axis=0) - low
        layers = [
            _placed(layer, _low(grid) - low, size)
            for grid, layer in ((a, a.log_odds), (b, b.log_odds), (a, a.observed), (b, b.observed))
        ]
        return cls(low, a.resolution_m, layers[0], layers[1], layers[2] > 0.0, layers[3] > 0.0)

    def on(self, other: Layers) -> Layers:
        """The same on the cells of later grids, which reach at least as far."""
        size = np.array(other.a.shape[::-1])
        at = self.low - other.low if self.a.size else np.zeros(2, dtype=np.int64)
        marks = [_placed(layer, at, size) > 0.0 for layer in (self.observed_a, self.observed_b)]
        values = [_placed(layer, at, size) for layer in (self.a, self.b)]
        return Layers(other.low, other.resolution_m, values[0], values[1], marks[0], marks[1])

    @property
    def largest(self) -> float:
        """The largest difference of a cell (log-odds)."""
        return float(np.abs(self.a - self.b).max(initial=0.0))

    def differing(self, margin: float) -> Bools:
        """Cells (H, W) that differ by more than a margin, or that only one has seen."""
        return np.asarray((np.abs(self.a - self.b) > margin) | (self.observed_a != self.observed_b))


class _Change:
    """What one scan added to both grids, where they differ after it and did not before."""

    def __init__(self, before: Layers, now: Layers, differing: Bools, ends: Bools) -> None:
        self._before, self._now, self._differing, self._ends = before, now, differing, ends
        self._on_beam = differing & ~ends
        self._added_a, self._added_b = now.a - before.a, now.b - before.b

    def divergence(self, number: int) -> Divergence:
        """The class of the difference, and the first cell that shows it."""
        kind, what = self._told()
        return _found(number, kind, f"{what}; {self._first_cell()}, {np.count_nonzero(self._differing)} cells differ")

    def _told(self) -> tuple[Kind, str]:
        if rounding := self._rounding():
            return "precision", rounding
        if what := self._clamped():
            return "clamp", what
        opposite = np.isclose(self._added_a, -self._added_b, atol=1e-3) & (np.abs(self._added_a) > 1e-3)
        if self._share(opposite, self._on_beam):
            return "sign", "what A adds along a beam, B takes away"
        if self._share(opposite, self._differing & self._ends):
            return "sign", "what A adds where a beam ends, B takes away"
        if self._share(self._one_only(self._on_beam), self._on_beam):
            return "traversal", "cells that only one of them lets a beam pass"
        return self._told_of_increments()

    def _told_of_increments(self) -> tuple[Kind, str]:
        if not self._on_beam.any():
            return "endpoint rule", "they agree along the beams and differ where beams end"
        if self._multiples():
            return "counting rule", "one of them adds to a cell several times a scan"
        ratio = self._added_b[self._on_beam] / np.where(self._added_a == 0.0, np.nan, self._added_a)[self._on_beam]
        if np.nanstd(ratio) < 1e-3:
            return "increment", f"B adds {np.nanmean(ratio):.4g} times what A adds"
        return "different", "no usual rule explains it"

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

    def _clamped(self) -> str:
        """Values stop at a bound on one side, and what was added there is less than on the other."""
        at = self._differing
        added_a, added_b = np.abs(self._added_a[at]), np.abs(self._added_b[at])
        for name, values, less, more, past in (
            ("A", self._now.a, added_a, added_b, self._before.a),
            ("B", self._now.b, added_b, added_a, self._before.b),
        ):
            pinned = (values[at] == values.max()) | (values[at] == values.min())
            if pinned.all() and (less < more).all() and (past[at] != 0.0).all():
                bounds = ", ".join(f"{bound:.4g}" for bound in np.unique(values[at]))
                return f"{name} stops at {bounds}"
        return ""

    def _one_only(self, among: Bools) -> Bools:
        """Cells (H, W) among these that only one of them has touched in this scan."""
        touched = [
            (added != 0.0) | (now & ~before)
            for added, now, before in (
                (self._added_a, self._now.observed_a, self._before.observed_a),
                (self._added_b, self._now.observed_b, self._before.observed_b),
            )
        ]
        return np.asarray(among & (touched[0] != touched[1]))

    def _multiples(self) -> bool:
        """Whether one side's increments are several times the other's, differing from cell to cell."""
        for once, often, values in (
            (self._added_a, self._added_b, self._now.b),
            (self._added_b, self._added_a, self._now.a),
        ):
            free = self._on_beam & (once != 0.0) & (values != values.max()) & (values != values.min())
            times = often[free] / once[free]
            whole = np.abs(times - np.rint(times)) < 1e-2
            if len(times) and whole.mean() >= MOST and len(np.unique(np.rint(times))) > 1:
                return True
        return False

    @staticmethod
    def _share(holds: Bools, among: Bools) -> bool:
        return bool(among.any()) and float(holds[among].mean()) >= MOST

    def _first_cell(self) -> str:
        row, column = np.argwhere(self._differing)[0]
        x, y = self._now.low + np.array([column, row])
        a, b = self._now.a[row, column], self._now.b[row, column]
        return f"first at cell ({x}, {y}) from the world's origin: {a:.4g} against {b:.4g}"


def _updated(mapper: Mapper, scan: Scan, world_from_sensor: Pose) -> OccupancyGrid:
    mapper.update(scan, world_from_sensor)
    return mapper.grid()


def _misplaced(a: OccupancyGrid, b: OccupancyGrid) -> str:
    """Why cells of the two cannot be held against each other, or ""."""
    if not np.isclose(a.resolution_m, b.resolution_m, rtol=1e-6):
        return f"cells of {a.resolution_m:g} m against {b.resolution_m:g} m"
    away = np.array([a.origin_x - b.origin_x, a.origin_y - b.origin_y]) / a.resolution_m
    if a.log_odds.size and b.log_odds.size and np.abs(away - np.rint(away)).max() > 1e-3:
        return f"cells are shifted by part of a cell: {(away - np.floor(away)).round(3).tolist()}"
    return ""


def _ends(scan: Scan, world_from_sensor: Pose, layers: Layers) -> Bools:
    """Cells (H, W) in which a beam of the scan ends."""
    marks: Bools = np.zeros_like(layers.a, dtype=np.bool_)
    ends = se2.transform(world_from_sensor.row, scan.points()) / layers.resolution_m - layers.low
    columns, rows = np.floor(ends).astype(np.int64).T
    inside = (columns >= 0) & (columns < marks.shape[1]) & (rows >= 0) & (rows < marks.shape[0])
    marks[rows[inside], columns[inside]] = True
    return marks


def _low(grid: OccupancyGrid) -> Ints:
    return np.rint(np.array([grid.origin_x, grid.origin_y]) / grid.resolution_m).astype(np.int64)


def _placed(layer: ArrayLike, at: Ints, size: Ints) -> Floats:
    """A layer (h, w) within zeros of ``size`` (columns, rows), its lowest cell at ``at``."""
    values: Floats = np.asarray(layer, dtype=np.float64)
    column, row = at.tolist()
    columns, rows = size.tolist()
    height, width = np.shape(values)
    return np.pad(values, ((row, rows - row - height), (column, columns - column - width)))


def _found(number: int, kind: Kind, what: str) -> Divergence:
    return Divergence(number, "map", None, "cells", kind, what)
