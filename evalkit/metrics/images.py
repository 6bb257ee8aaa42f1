"""Holds the picture of a map against that of the true map: how alike both look, window by window."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.maps import find_cells
from evalkit.metrics.table import Evidence, Metric, make_score, with_support

Cell = TypeVar("Cell", bound=np.generic)

WINDOW_CELLS = 1.5
"""Standard deviation of the Gaussian window; it ends 5 cells from its middle, which makes it 11 x 11."""

LUMINANCE, CONTRAST = 0.01**2, 0.03**2
REACH_CELLS = 3
MIN_CELLS = 100


def ssim(one: Floats, other: Floats) -> Floats:
    """The structural similarity (H, W) of two pictures (H, W) of values within 0 and 1, cell by cell.

    Wang et al., IEEE TIP 13(4), 2004, eq. 13: (2 m m' + C1)(2 s + C2) / ((m^2 + m'^2 + C1)(v + v' + C2)) with the
    means, variances and covariance under a Gaussian window of 11 x 11.
    """
    from scipy import ndimage

    def smooth(picture: Floats) -> Floats:
        return np.asarray(ndimage.gaussian_filter(picture, WINDOW_CELLS, mode="nearest", radius=5))

    mean, other_mean = smooth(one), smooth(other)
    product = mean * other_mean
    squares = mean**2 + other_mean**2
    variances = smooth(one * one + other * other) - squares
    covariance = smooth(one * other) - product
    return np.asarray(
        (2.0 * product + LUMINANCE) * (2.0 * covariance + CONTRAST) / ((squares + LUMINANCE) * (variances + CONTRAST))
    )


def resample_to_common_cells(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[Floats, Floats, Bools, Bools]:
    """The probabilities (H, W) of both maps on the cells of the coarser one, and where each has observed.

    A cell holds the mean over the observed cells whose centre lies in it, 0.5 where there is none. Of the plane, what
    both grids cover.
    """
    grids = mapped, true
    lattice = max(true, mapped, key=lambda grid: grid.resolution_m)
    places = [find_cells(grid, lattice) for grid in grids]
    top, left = (max(int(each[axis][0]) for each in places) for axis in (0, 1))
    bottom, right = (min(int(each[axis][-1]) for each in places) + 1 for axis in (0, 1))
    shape = max(bottom - top, 0), max(right - left, 0)
    (p, seen), (q, known) = (
        _resampled(grid, rows - top, columns - left, shape) for grid, (rows, columns) in zip(grids, places, strict=True)
    )
    return p, q, seen, known


def _resampled(grid: OccupancyGrid, rows: Ints, columns: Ints, shape: tuple[int, int]) -> tuple[Floats, Bools]:
    """A grid's mean probability (H, W) in cells of that shape, for the cell (row, column) of each of its own ones."""
    kept = [(at >= 0) & (at < size) for at, size in zip((rows, columns), shape, strict=True)]
    own = np.ix_(*kept)
    observed, p = grid.observed[own], grid.probability()[own]
    flat = (rows[kept[0]][:, None] * shape[1] + columns[kept[1]])[observed]
    counts = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    sums = np.bincount(flat, p[observed], minlength=shape[0] * shape[1]).reshape(shape)
    return np.where(counts > 0, sums / np.maximum(counts, 1), 0.5), np.asarray(counts > 0)


def find_best_shift(one: Floats, other: Floats, reach: int = REACH_CELLS) -> tuple[int, int]:
    """Rows and columns by which to roll one picture (H, W) onto the other: where they correlate most.

    Of equals the shortest.
    """
    ours, theirs = (np.asarray(picture - 0.5, dtype=np.float32) for picture in (one, other))
    shifts = sorted(np.ndindex(2 * reach + 1, 2 * reach + 1), key=lambda at: np.hypot(at[0] - reach, at[1] - reach))
    steps = [(row - reach, column - reach) for row, column in shifts]
    sums = [float(np.einsum("ij,ij->", _moved(ours, step), _moved(theirs, (-step[0], -step[1])))) for step in steps]
    return steps[int(np.argmax(np.round(sums, 1)))]


def _moved(picture: NDArray[Cell], step: tuple[int, int]) -> NDArray[Cell]:
    """What of a picture moved by that many rows and columns still lies on one that was not."""
    rows, columns = (
        slice(max(-by, 0), max(size - max(by, 0), 0)) for by, size in zip(step, picture.shape, strict=True)
    )
    return picture[rows, columns]


def mean_similarity(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[float, int]:
    """Mean structural similarity over the cells that both maps have observed, and how many they are.

    The map is moved by up to 3 whole cells to where both correlate most first. (nan, 0) without a common cell.
    """
    p, q, seen, known = resample_to_common_cells(mapped, true)
    if not p.size:
        return float("nan"), 0
    step = find_best_shift(p, q)
    back = -step[0], -step[1]
    both = _moved(seen, step) & _moved(known, back)
    if not both.any():
        return float("nan"), 0
    return float(ssim(_moved(p, step), _moved(q, back))[both].mean()), int(both.sum())


def _similarity(evidence: Evidence) -> Score:
    true, mapped = evidence.truth.grid, evidence.grid
    if true is None:
        return Score(None, 0, "no true map")
    if mapped is None:
        return Score(None, 0, f"no map: {evidence.no_grid}")
    value, cells = mean_similarity(mapped, true)
    if cells < MIN_CELLS:
        return Score(None, cells, f"both maps have observed only {cells} common cells")
    return make_score(value, cells)


_ROWS = (
    Metric("map_ssim", "structural similarity", "", "higher", "map against truth",
           "Structural similarity of the pictures of probabilities (Gaussian window of 11 x 11 cells, at the coarser "
           f"resolution of both), mean over cells that both have observed, after the shift of up to {REACH_CELLS} "
           "whole cells that makes them most alike.", "Wang et al., IEEE TIP 13(4), 2004",
           "shifts of up to three cells; what either map has not observed. A shift by less than a cell costs it more "
           "than it should: read it last", _similarity),
)  # fmt: skip

METRICS = with_support(
    _ROWS,
    {
        "*": (
            "cells that both maps have observed",
            ("no true map", "no map: ...", "both maps have observed only ... common cells"),
        )
    },
)
