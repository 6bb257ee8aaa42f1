"""The paper's occupancy grid: log-odds added along every beam of scans with known poses (eq. 10, 11; figure 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Bools, Ints
from evalkit.core.errors import BadParameter
from evalkit.core.grid import OccupancyGrid
from evalkit.core.pose import Pose
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.plugins.parameters import check_fields, declared_parameters, parameter

Counts: TypeAlias = NDArray[np.signedinteger]

CHUNK = 256  # cells: growth step of the array, so that copies are rare
MAX_CELLS = 64_000_000  # 400 m x 400 m at 5 cm, 320 MB: a diverged trajectory must not use all memory
FARTHEST_CELL = 2**40  # farther out, rounding loses the position within a cell


class Crossed(NamedTuple):
    """Cells that beams cross, in no order.

    ``beams`` (K,): number of the beam. ``offsets`` (K,): offset from the start's cell, columns + rows x width.
    """

    beams: Ints
    offsets: Ints


@dataclass
class LogOddsGrid:
    """The paper's mapper.

    Cells are half open, [i, i + 1) times the resolution from the world's origin. Invalid beams (nan) are ignored. The
    printed update adds l_free, which is negative. The paper has no bounds; here they are 5, a probability of 0.993.
    A map of more than ``MAX_CELLS`` raises BadParameter.
    """

    resolution_m: float = parameter(0.05, "m", "side of a cell", low=0.005, high=10.0)
    l_occ: float = parameter(0.847, "", "added to the cell where a beam ends; ln(0.7 / 0.3)", low=0.0)
    l_free: float = parameter(-0.847, "", "added to the cells that a beam crosses; ln(0.3 / 0.7), negative", high=0.0)
    l_min: float = parameter(-5.0, "", "smallest log-odds of a cell", high=0.0)
    l_max: float = parameter(5.0, "", "largest log-odds of a cell", low=0.0)
    once_per_scan: bool = parameter(
        True, "", "a scan adds to a cell once, occupied before free; otherwise every beam adds"
    )
    traversal: Literal["exact", "bresenham"] = parameter(
        "exact", "", "which cells a beam crosses", choices=("exact", "bresenham")
    )
    clear_no_returns: bool = parameter(False, "", "beams without return free their cells up to the maximum range")
    _low: Ints = field(default_factory=lambda: np.zeros(2, dtype=np.int64), init=False, repr=False)
    _log_odds: NDArray[np.float32] = field(
        default_factory=lambda: np.zeros((0, 0), dtype=np.float32), init=False, repr=False
    )
    _observed: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_), init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields("log-odds", self)

    def update(self, scan: Scan, world_from_sensor: Pose) -> None:
        """Add one scan whose beams all start at the sensor."""
        beams = scan.hits | (scan.no_returns & self.clear_no_returns)
        if not beams.any():
            return
        ranges = np.where(scan.hits, scan.ranges, scan.range_max_m)[beams]
        angles = scan.angles[beams]
        ends = world_from_sensor.transform(np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=1))
        self._add(world_from_sensor.row[:2] / self.resolution_m, ends / self.resolution_m, scan.hits[beams])

    def grid(self) -> OccupancyGrid:
        """Return the map of all scans so far, cut to the observed cells; (0, 0) cells before the first scan."""
        (left, right), (bottom, top) = (_span(self._observed, axis) for axis in (0, 1))
        part = np.s_[bottom:top, left:right]
        x, y = (self._low + np.array([left, bottom])) * self.resolution_m
        return OccupancyGrid(self._log_odds[part], self._observed[part], self.resolution_m, float(x), float(y))

    def _add(self, start: Floats, ends: Floats, hits: Bools) -> None:
        """Add one scan, in cells: from ``start`` (2,) to ``ends`` (B, 2); the ends with ``hits`` (B,) are occupied."""
        farthest = max(np.abs(start).max(), np.abs(ends).max())
        if not farthest <= FARTHEST_CELL:
            raise self._too_large(f"{farthest * self.resolution_m:.3g} m")
        first, last = np.floor(start).astype(np.int64), np.floor(ends).astype(np.int64)
        low, high = np.minimum(first, last.min(axis=0)), np.maximum(first, last.max(axis=0)) + 1
        width, height = (high - low).tolist()
        window = self._window(low, high)
        beams, offsets = TRAVERSALS[self.traversal](start, ends, width)
        passed = offsets + (first - low) @ (1, width)
        ended = (last - low) @ (1, width)
        count = self._count_once if self.once_per_scan else self._count_every
        free, occupied = count(beams, passed, ended, hits, width * height)
        cells = self._log_odds[window]
        cells += (self.l_free * free + self.l_occ * occupied).reshape(height, width)  # eq. 10 adds ln(0.3 / 0.7), too
        np.clip(cells, self.l_min, self.l_max, out=cells)
        self._observed[window] |= ((free + occupied) > 0).reshape(height, width)

    def _count_once(self, beams: Ints, passed: Ints, ended: Ints, hits: Bools, size: int) -> tuple[Counts, Counts]:
        """Count how often a scan marks each cell (size,) free and occupied: at most once, occupied first."""
        del beams
        free, occupied = np.zeros(size, dtype=np.int8), np.zeros(size, dtype=np.int8)
        free[passed] = 1
        occupied[ended[hits]] = 1
        free[ended[hits]] = 0
        return free, occupied

    def _count_every(self, beams: Ints, passed: Ints, ended: Ints, hits: Bools, size: int) -> tuple[Counts, Counts]:
        """The same if every beam counts: free once a beam in each cell before its end, occupied in its end."""
        before_end = (passed != ended.take(beams)) | ~hits.take(beams)
        keys = np.sort((beams * size + passed)[before_end])
        keys = keys[np.diff(keys, prepend=-1) > 0]
        return np.bincount(keys % size, minlength=size), np.bincount(ended[hits], minlength=size)

    def _window(self, low: Ints, high: Ints) -> tuple[slice, slice]:
        """Return the slices of cells [low, high) in the arrays; the arrays grow where needed."""
        size = np.array(self._log_odds.shape[::-1])
        if (low < self._low).any() or (high > self._low + size).any():
            self._grow(low, high, size)
        (left, bottom), (right, top) = low - self._low, high - self._low
        return np.s_[bottom:top, left:right]

    def _grow(self, low: Ints, high: Ints, size: Ints) -> None:
        if size.any():
            low, high = np.minimum(low, self._low), np.maximum(high, self._low + size)
        low, high = low // CHUNK * CHUNK, -(-high // CHUNK) * CHUNK
        columns, rows = (high - low).tolist()
        if columns * rows > MAX_CELLS:
            raise self._too_large(f"{columns * self.resolution_m:.0f} m x {rows * self.resolution_m:.0f} m")
        (left, bottom), (width, height) = self._low - low, size
        old = np.s_[bottom : bottom + height, left : left + width] if size.any() else np.s_[:0, :0]
        log_odds, observed = np.zeros((rows, columns), dtype=np.float32), np.zeros((rows, columns), dtype=np.bool_)
        log_odds[old], observed[old] = self._log_odds, self._observed
        self._low, self._log_odds, self._observed = low, log_odds, observed

    def _too_large(self, reach: str) -> BadParameter:
        return BadParameter("log-odds", "resolution_m", self.resolution_m, f"larger cells: the map has reached {reach}")


PARAMETERS = declared_parameters(LogOddsGrid)


def _span(marked: Bools, across: int) -> tuple[int, int]:
    """Return the range of columns (across 0) or rows (across 1) with a mark, end exclusive; (0, 0) without marks."""
    places = np.flatnonzero(marked.any(axis=across))
    return (int(places[0]), int(places[-1]) + 1) if len(places) else (0, 0)


def exact(start: Floats, ends: Floats, width: int) -> Crossed:
    """Return the cells that beams from ``start`` (2,) to ``ends`` (B, 2), in cells, cross, including start and end.

    The cells of Amanatides and Woo 1987, for all beams at once: for each grid line of one axis that a beam crosses, the
    number of lines of the other axis before it is computed. A beam exactly through a corner continues diagonally, and
    that cell occurs twice.
    """
    first, last = np.floor(start), np.floor(ends)
    heading = np.where(ends < start, -1.0, 1.0)
    behind = np.where(heading > 0.0, start - first, first + 1.0 - start)  # 0 to 1, from the edge behind the beam
    reach = np.maximum(np.abs(ends - start), 1e-300)
    lines = np.abs(last - first)
    unit = heading * (1.0, width)
    beams, offsets = [np.arange(len(ends))], [np.zeros(len(ends))]
    for along, across in ((0, 1), (1, 0)):
        counts = lines[:, along].astype(np.int64)
        beam, line = _number_beams(counts)
        line += 1.0
        passed = line - behind[:, along].repeat(counts)  # in place: half of the time goes into new arrays
        passed *= reach[:, across].repeat(counts)
        passed /= reach[:, along].repeat(counts)  # last, so that corners at exact fractions are met exactly
        passed += behind[:, across].repeat(counts)
        np.floor(passed, out=passed)
        np.minimum(passed, lines[:, across].repeat(counts), out=passed)  # rounding must not carry a beam past its end
        line *= unit[:, along].repeat(counts)
        passed *= unit[:, across].repeat(counts)
        line += passed
        beams.append(beam)
        offsets.append(line)
    return Crossed(np.concatenate(beams), np.concatenate(offsets).astype(np.int64))


def bresenham(start: Floats, ends: Floats, width: int) -> Crossed:
    """Return the cells of Bresenham's line (1965) from the start's cell to each end's, one per step of the longer axis.

    Halves are rounded away from the start, as in the publication.
    """
    first, last = np.floor(start), np.floor(ends)
    lines = np.abs(last - first)
    longer = lines.max(axis=1)
    beam, step = _number_beams(longer.astype(np.int64) + 1)
    offsets = np.zeros(len(beam))
    for axis, unit in ((0, 1.0), (1, float(width))):
        passed = np.floor(lines[:, axis].take(beam) * step / np.maximum(longer, 1.0).take(beam) + 0.5)
        offsets += (np.sign(last[:, axis] - first[axis]) * unit).take(beam) * passed
    return Crossed(beam, offsets.astype(np.int64))


def _number_beams(counts: Ints) -> tuple[Ints, Floats]:
    """Return each beam's number, repeated ``counts`` (B,) times, and the repetitions 0, 1, 2, ... (both (K,))."""
    beams = np.repeat(np.arange(len(counts)), counts)
    begins = (np.cumsum(counts) - counts).astype(np.float64)
    return beams, np.arange(len(beams), dtype=np.float64) - begins.repeat(counts)


TRAVERSALS: dict[str, Callable[[Floats, Floats, int], Crossed]] = {"exact": exact, "bresenham": bresenham}
