"""Correlative scan matching: search all motions of a window for the best score of a scan in a grid.

The grid holds, for every cell, how well a point there fits the target: 255 if a target point is at its centre, falling
with the distance to the nearest one like a Gaussian (Olson 2009, section III.B, in 8 bits). The score of a motion is
the mean over the points of the source, 0 to 1. The search returns the best motion of a window on a lattice of cells and
angles. It is exact: maxima over 2^h by 2^h cells bound the score of 4^h motions at once (the low-resolution grid of
Olson 2009, the precomputed grids of Hess et al. 2016, algorithm 3), so that most motions are never evaluated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.odometry.local_map import voxel_means

CellScores: TypeAlias = NDArray[np.uint8]
Cells: TypeAlias = NDArray[np.int32]
Prior: TypeAlias = Callable[[Floats, Floats, Floats], Floats]
"""Factor within [0, 1] of the score for offsets dx, dy (m) and dtheta (rad) from the window's centre, arrays (K,).

It must not increase with |dx|, |dy| or |dtheta|: it is bounded by its value at the nearest offset of a block.
"""

FULL = 255  # the score of a cell whose centre is a target point
CUT = 3.0  # standard deviations: farther cells have no score
MAX_CELLS = 1 << 24  # per level: 200 m by 200 m at 5 cm
NODES = 48  # blocks divided at once: fewer waste time between calls, more evaluate what would have been pruned
FAR = 1 << 30  # cells: whole numbers of 32 bits hold sums of two such
PEAK_M, PEAK_RAD = 0.5, math.radians(20.0)
"""Motions closer than both to the best one are the same peak."""

GATHER = 1 << 18  # point lookups at once: the index arrays stay in the cache


@dataclass(frozen=True, eq=False)
class ScoreGrid:
    """Scores (H, W) of a target cloud in its frame, row 0 at the lowest y, and their maxima over growing squares.

    ``levels[h][row, column]`` is the maximum over the 2^h by 2^h cells from (row, column) upwards; all levels have the
    same shape, with a border of zeros. ``(origin_x, origin_y)`` is the lower left corner of cell (0, 0) (m).
    """

    levels: tuple[CellScores, ...]
    cell_m: float
    origin_x: float
    origin_y: float

    @classmethod
    def from_points(cls, points: Floats, cell_m: float, sigma_m: float, depth: int) -> ScoreGrid:
        """Make the grid of target points (N, 2) (m) with ``depth`` levels of maxima above the scores.

        Several points of a cell count as their mean. ``sigma_m`` is the standard deviation of the Gaussian of the
        distance from a cell's centre to the nearest mean; beyond three of it the score is 0. Raises ValueError without
        points, and where they spread over more than ``MAX_CELLS`` cells.
        """
        if not len(points):
            raise ValueError("points: a score grid needs at least one target point")
        kernel = math.ceil(CUT * sigma_m / cell_m) + 1
        border = (1 << depth) + kernel
        low = np.floor(points.min(axis=0) / cell_m) - border
        width, height = np.floor(points.max(axis=0) / cell_m) - low + kernel + 2
        if not width * height <= MAX_CELLS:
            raise ValueError(
                f"points: they spread over {width * cell_m:.0f} m by {height * cell_m:.0f} m, "
                f"more than {MAX_CELLS} cells of {cell_m:g} m; leave out far points or take larger cells"
            )
        scores = _smear(voxel_means(points, cell_m) / cell_m - low, (int(height), int(width)), sigma_m / cell_m, kernel)
        levels = [scores]
        for level in range(depth):
            levels.append(_maximum_of_four(levels[-1], 1 << level))
        return cls(tuple(levels), cell_m, float(low[0] * cell_m), float(low[1] * cell_m))

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the grid (m)."""
        height, width = self.levels[0].shape
        return self.origin_x + 0.5 * width * self.cell_m, self.origin_y + 0.5 * height * self.cell_m

    def score(self, points: Floats) -> Floats:
        """Return the scores (...,), 0 to 1, of points (..., 2) in the grid's frame (m); 0 outside the grid.

        Interpolated between the centres of the four cells around a point.
        """
        height, width = self.levels[0].shape
        x = np.clip((points[..., 0] - self.origin_x) / self.cell_m - 0.5, 0.0, width - 1.001)
        y = np.clip((points[..., 1] - self.origin_y) / self.cell_m - 0.5, 0.0, height - 1.001)
        left, low = x.astype(np.int64), y.astype(np.int64)
        right, up = x - left, y - low
        flat, at = self.levels[0].ravel(), low * width + left
        lower = flat.take(at) * (1.0 - right) + flat.take(at + 1) * right
        upper = flat.take(at + width) * (1.0 - right) + flat.take(at + width + 1) * right
        return np.asarray((lower * (1.0 - up) + upper * up) / FULL)


@dataclass(frozen=True)
class Window:
    """Motions ``target_from_source`` to search: up to ``x_m``, ``y_m`` and ``theta_rad`` on either side of a centre.

    ``theta_rad`` of pi or more searches the full circle. ``step_rad``: between two angles; 0: as much as moves the
    farthest point of the source by one cell (Hess et al. 2016, eq. 7).
    """

    centre: Pose
    x_m: float
    y_m: float
    theta_rad: float
    step_rad: float = 0.0

    def __post_init__(self) -> None:
        if not min(self.x_m, self.y_m, self.theta_rad, self.step_rad) >= 0.0:
            raise ValueError(f"window: expected extents that are not negative, got {self}")

    @classmethod
    def whole(cls, grid: ScoreGrid) -> Window:
        """All positions of the source's origin within a grid, at all angles."""
        height, width = grid.levels[0].shape
        half = 0.5 * grid.cell_m
        return cls(Pose(*grid.centre), half * width, half * height, math.pi)

    def angles(self, cell_m: float, reach_m: float) -> Floats:
        """Return the angles (A,) from the centre's (rad), 0 among them; ``reach_m``: range of the farthest point."""
        step = self.step_rad or 2.0 * math.asin(min(0.5 * cell_m / max(reach_m, cell_m), 1.0))
        if self.theta_rad < math.pi:
            count = math.floor(self.theta_rad / step + 1e-9)
            return np.arange(-count, count + 1, dtype=np.float64) * step
        count = math.ceil(2.0 * math.pi / step)
        return np.arange(-(count // 2), count - count // 2, dtype=np.float64) * (2.0 * math.pi / count)


class SearchResult(NamedTuple):
    """Best motion of a window, its score (0 to 1, with the prior), and how many blocks and motions were evaluated."""

    target_from_source: Pose
    score: float
    evaluated: int


def branch_and_bound(
    grid: ScoreGrid, points: Floats, window: Window, min_score: float = 0.0, prior: Prior | None = None
) -> SearchResult | None:
    """Return the motion ``target_from_source`` of a window with the best score, or None where none has more than
    ``min_score``.

    ``points`` (N, 2) in metres in the source's frame; a few hundred are enough, the time is proportional to their
    number. The motions form a lattice around the window's centre, one cell and one angle apart. The best score is that
    of an exhaustive search of the lattice; of motions with equal scores the same one is always returned.
    """
    return bounded_search(grid, points, window, min_score, prior)[0]


def bounded_search(
    grid: ScoreGrid, points: Floats, window: Window, min_score: float = 0.0, prior: Prior | None = None
) -> tuple[SearchResult | None, float]:
    """Return as ``branch_and_bound``, and an upper bound (0 to 1) on the score of every motion of the window.

    Where a motion is found that is its score; else the highest bound of a block that was not divided.
    """
    if not len(points):
        return None, 0.0
    lattice = _Lattice.of(grid, points, window)
    weigh = prior or _no_prior
    level = lattice.first_level()
    blocks = lattice.roots(1 << level)
    evaluated = len(blocks)
    best, score, left_out = None, min_score, 0.0
    waiting = [(level, *_best_first(blocks, lattice.scores(blocks, level, weigh)))]
    while waiting:
        level, blocks, bounds = waiting.pop()
        promising = int(np.searchsorted(-bounds, -score))  # the rest can be no better
        if promising < len(bounds):
            left_out = max(left_out, float(bounds[promising]))
        if not promising:
            continue
        if level == 0:
            best, score = blocks[0], float(bounds[0])
            continue
        if promising > NODES:
            waiting.append((level, blocks[NODES:promising], bounds[NODES:promising]))
        children = lattice.divide(blocks[: min(NODES, promising)], 1 << (level - 1))
        evaluated += len(children)
        waiting.append((level - 1, *_best_first(children, lattice.scores(children, level - 1, weigh))))
    return (None, left_out) if best is None else (SearchResult(lattice.motion(best), score, evaluated), score)


def mild_prior(sigma_m: Floats, sigma_rad: float) -> Prior:
    """Return a mild preference for the middle of a window: 0.85 at three sigma in one direction."""

    def weigh(x: Floats, y: Floats, theta: Floats) -> Floats:
        squares = (x / sigma_m[0]) ** 2 + (y / sigma_m[1]) ** 2 + (theta / sigma_rad) ** 2
        return np.asarray(1.0 / (1.0 + 0.02 * squares))

    return weigh


def other_headings(best: Pose) -> Window:
    """Return the motions near the best one in position, more than ``PEAK_RAD`` from it in heading."""
    return Window(Pose(best.x, best.y, best.theta + math.pi), PEAK_M, PEAK_M, math.pi - PEAK_RAD)


def windows_around(window: Window, best: Pose) -> list[Window]:
    """Return the parts of a window that are more than ``PEAK_M`` from its best motion in x or y."""
    low = np.array([window.centre.x - window.x_m, window.centre.y - window.y_m])
    high = np.array([window.centre.x + window.x_m, window.centre.y + window.y_m])
    x, y = best.x, best.y
    boxes = [
        (low[0], x - PEAK_M, low[1], high[1]),
        (x + PEAK_M, high[0], low[1], high[1]),
        (max(low[0], x - PEAK_M), min(high[0], x + PEAK_M), low[1], y - PEAK_M),
        (max(low[0], x - PEAK_M), min(high[0], x + PEAK_M), y + PEAK_M, high[1]),
    ]
    return [
        Window(Pose(0.5 * (a + b), 0.5 * (c + d), window.centre.theta), 0.5 * (b - a), 0.5 * (d - c), window.theta_rad)
        for a, b, c, d in boxes
        if b > a and d > c
    ]


@dataclass(frozen=True, eq=False)
class _Lattice:
    """The motions of a window: angle number, then cells in x and y from the centre, rows (K, 3) of whole numbers.

    A block of side 2^h is named by its lowest cells. ``columns`` and ``rows`` (A, N): the cells of the points at every
    angle, with the centre's translation.
    """

    grid: ScoreGrid
    centre: Pose
    angles: Floats
    half: tuple[int, int]
    columns: Cells
    rows: Cells

    @classmethod
    def of(cls, grid: ScoreGrid, points: Floats, window: Window) -> _Lattice:
        angles = window.angles(grid.cell_m, float(np.hypot(points[:, 0], points[:, 1]).max()))
        theta = (window.centre.theta + angles)[:, None]
        cos, sin, (x, y) = np.cos(theta), np.sin(theta), points.T
        columns = np.floor((cos * x - sin * y + (window.centre.x - grid.origin_x)) / grid.cell_m)
        rows = np.floor((sin * x + cos * y + (window.centre.y - grid.origin_y)) / grid.cell_m)
        near = [np.clip(cells, -FAR, FAR).astype(np.int32) for cells in (columns, rows)]
        half = int(window.x_m / grid.cell_m + 1e-9), int(window.y_m / grid.cell_m + 1e-9)
        return cls(grid, window.centre, angles, half, near[0], near[1])

    def first_level(self) -> int:
        """Return the level of the first blocks: a window is about two of them wide."""
        return min(len(self.grid.levels) - 1, max(self.half).bit_length())

    def roots(self, side: int) -> Cells:
        """Return the blocks (K, 3) of a side that cover the window."""
        x, y = (np.arange(-half, half + 1, side, dtype=np.int32) for half in self.half)
        angles = np.arange(len(self.angles), dtype=np.int32)
        return np.stack(np.meshgrid(angles, x, y, indexing="ij"), axis=-1).reshape(-1, 3)

    def divide(self, blocks: Cells, side: int) -> Cells:
        """Return the blocks of half the side, ``side``, within the window."""
        quarters = np.array([[0, 0, 0], [0, 0, side], [0, side, 0], [0, side, side]], dtype=np.int32)
        children = (blocks[:, None] + quarters).reshape(-1, 3)
        inside = (children[:, 1] <= self.half[0]) & (children[:, 2] <= self.half[1])
        return np.asarray(children[inside])

    def scores(self, blocks: Cells, level: int, weigh: Prior) -> Floats:
        """Return the bounds (K,) of blocks of side 2^level; at level 0 these are the scores of motions."""
        scores = self.grid.levels[level]
        height, width = scores.shape
        flat, points = scores.ravel(), self.columns.shape[1]
        sums = np.empty(len(blocks), dtype=np.int64)
        for start in range(0, len(blocks), max(GATHER // points, 1)):
            part = slice(start, start + max(GATHER // points, 1))
            angle, x, y = blocks[part].T
            cells = self.rows[angle] + y[:, None]
            np.clip(cells, 0, height - 1, out=cells)
            cells *= width
            columns = self.columns[angle] + x[:, None]
            np.clip(columns, 0, width - 1, out=columns)
            cells += columns
            sums[part] = flat.take(cells).sum(axis=1, dtype=np.uint32)
        angle, *low = blocks.T
        nearest = [np.maximum(np.maximum(each, -each - ((1 << level) - 1)), 0) * self.grid.cell_m for each in low]
        return np.asarray(sums / (FULL * points) * weigh(nearest[0], nearest[1], self.angles[angle]))

    def motion(self, node: Cells) -> Pose:
        angle, x, y = node.tolist()
        cell, centre = self.grid.cell_m, self.centre
        return Pose(centre.x + x * cell, centre.y + y * cell, centre.theta + float(self.angles[angle]))


def _best_first(blocks: Cells, bounds: Floats) -> tuple[Cells, Floats]:
    order = np.argsort(-bounds, kind="stable")
    return blocks[order], bounds[order]


def _no_prior(x: Floats, y: Floats, theta: Floats) -> Floats:  # noqa: ARG001 - a Prior
    return np.ones(len(x))


def _smear(means: Floats, shape: tuple[int, int], sigma: float, kernel: int) -> CellScores:
    """Return the scores of a grid from one mean (N, 2) per occupied cell; lengths in cells."""
    scores = np.zeros(shape, dtype=np.uint8)
    flat, cells = scores.ravel(), np.floor(means).astype(np.int64)
    steps = np.arange(-kernel, kernel + 1)
    x, y = np.exp(-0.5 * ((cells[..., None] + steps + 0.5 - means[..., None]) / sigma) ** 2).transpose(1, 2, 0)
    least = math.exp(-0.5 * CUT**2)
    for row, up in zip(y, steps.tolist(), strict=True):
        for column, right in zip(x, steps.tolist(), strict=True):
            value = row * column
            near = np.flatnonzero(value >= least)
            at = (cells[near, 1] + up) * shape[1] + cells[near, 0] + right  # no cell twice: one mean per cell
            flat[at] = np.maximum(flat[at], np.rint(FULL * value[near]).astype(np.uint8))
    return scores


def _maximum_of_four(level: CellScores, step: int) -> CellScores:
    """Return the maxima of each cell and those ``step`` cells higher in x, in y and in both."""
    wide = level.copy()
    np.maximum(wide[:, :-step], level[:, step:], out=wide[:, :-step])
    high = wide.copy()
    np.maximum(high[:-step], wide[step:], out=high[:-step])
    return high
