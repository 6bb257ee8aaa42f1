"""Compare the map with the ground-truth map as images: structural similarity."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import Bools, Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import Score
from evalkit.core.se2 import Floats
from evalkit.metrics.filters import filter_image, gaussian_weights
from evalkit.metrics.maps import find_cells
from evalkit.metrics.metric import find_probabilities, make_metrics, make_score, with_true_grid

Element = TypeVar("Element", bound=np.generic)

_WINDOW = gaussian_weights(1.5, 5)
"""The Gaussian window, which is cut off 5 cells from its centre (11 x 11 cells)."""

_ROWS = 64
"""Rows whose similarity is computed at once, so that their means and variances stay in the cache."""

LUMINANCE, CONTRAST = 0.01**2, 0.03**2
REACH_CELLS = 3
MIN_CELLS = 100


def ssim(one: Floats, other: Floats) -> Floats:
    """Return the structural similarity (H, W) of two images (H, W) with values between 0 and 1, cell by cell.

    Wang et al., IEEE TIP 13(4), 2004, eq. 13: (2 m m' + C1)(2 s + C2) / ((m^2 + m'^2 + C1)(v + v' + C2)) with the
    means, variances and covariance under a Gaussian window of 11 x 11 cells.
    """
    reach = len(_WINDOW) // 2
    one, other = (np.pad(image, reach, mode="edge") for image in (one, other))
    height, width = (size - 2 * reach for size in one.shape)
    similarity = np.empty((height, width))
    for begin in range(0, height, _ROWS):
        end = min(begin + _ROWS, height)
        rows = slice(begin, end + 2 * reach)
        similarity[begin:end] = _ssim_inside(one[rows], other[rows])
    return similarity


def _ssim_inside(one: Floats, other: Floats) -> Floats:
    """Return the structural similarity of the cells whose whole window lies in both images."""

    def smooth(image: Floats) -> Floats:
        return filter_image(image, _WINDOW, _WINDOW)

    mean, other_mean = smooth(one), smooth(other)
    product = mean * other_mean
    squares = mean**2 + other_mean**2
    variances = smooth(one * one + other * other) - squares
    covariance = smooth(one * other) - product
    return np.asarray(
        (2.0 * product + LUMINANCE) * (2.0 * covariance + CONTRAST) / ((squares + LUMINANCE) * (variances + CONTRAST))
    )


def resample_to_common_cells(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[Floats, Floats, Bools, Bools]:
    """Return the probabilities (H, W) of both maps on the cells of the coarser map, and the cells that each has
    observed.

    A cell contains the mean of the observed cells whose centre lies in it, or 0.5 without such a cell. The result
    covers the area covered by both grids.
    """
    grids = mapped, true
    lattice = max(true, mapped, key=lambda grid: grid.resolution_m)
    places = [find_cells(grid, lattice) for grid in grids]
    top, left = (max(int(each[axis][0]) for each in places) for axis in (0, 1))
    bottom, right = (min(int(each[axis][-1]) for each in places) + 1 for axis in (0, 1))
    shape = max(bottom - top, 0), max(right - left, 0)
    (p, seen), (q, known) = (
        _resample(grid, rows - top, columns - left, shape) for grid, (rows, columns) in zip(grids, places, strict=True)
    )
    return p, q, seen, known


def _resample(grid: OccupancyGrid, rows: Ints, columns: Ints, shape: tuple[int, int]) -> tuple[Floats, Bools]:
    """Return a grid's mean probability (H, W) in cells of ``shape``, and which are observed.

    ``rows``, ``columns``: the cell of each row and column of the grid.
    """
    lines = [np.flatnonzero((at >= 0) & (at < size)) for at, size in zip((rows, columns), shape, strict=True)]
    own = tuple(slice(at[0], at[-1] + 1) if len(at) else slice(0) for at in lines)  # rows and columns ascend
    observed, p = grid.observed[own], find_probabilities(grid)[own]
    rows, columns = rows[own[0]], columns[own[1]]
    if all((np.diff(at) == 1).all() for at in (rows, columns)) and observed.size:  # one cell of the grid in each
        mean, seen = np.full(shape, 0.5), np.zeros(shape, np.bool_)
        into = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        mean[into], seen[into] = np.where(observed, p, 0.5), observed
        return mean, seen
    flat = (rows[:, None] * shape[1] + columns)[observed]
    counts = np.bincount(flat, minlength=shape[0] * shape[1]).reshape(shape)
    sums = np.bincount(flat, p[observed], minlength=shape[0] * shape[1]).reshape(shape)
    return np.where(counts > 0, sums / np.maximum(counts, 1), 0.5), np.asarray(counts > 0)


def find_best_shift(one: Floats, other: Floats, reach: int = REACH_CELLS) -> tuple[int, int]:
    """Return rows and columns by which to shift one image (H, W) to the maximum correlation with the other.

    Among equal maxima, the shortest shift.
    """
    ours, theirs = (np.asarray(image - 0.5, dtype=np.float32) for image in (one, other))
    theirs = np.pad(theirs, reach)
    height, width = ours.shape
    steps = sorted(np.ndindex(2 * reach + 1, 2 * reach + 1), key=lambda at: np.hypot(at[0] - reach, at[1] - reach))
    sums = np.zeros(len(steps))
    for begin in range(0, height, _ROWS):  # all shifts of these rows, while they are in the cache
        rows = ours[begin : begin + _ROWS]
        for index, (row, column) in enumerate(steps):
            beside = theirs[begin + row : begin + row + len(rows), column : column + width]
            sums[index] += np.einsum("ij,ij->", rows, beside)
    row, column = steps[int(np.argmax(np.round(sums, 1)))]
    return row - reach, column - reach


def _crop_shifted(image: NDArray[Element], step: tuple[int, int]) -> NDArray[Element]:
    """Return the part of an image, shifted by ``step``, that overlaps the image that is not shifted."""
    rows, columns = (slice(max(-by, 0), max(size - max(by, 0), 0)) for by, size in zip(step, image.shape, strict=True))
    return image[rows, columns]


def mean_similarity(mapped: OccupancyGrid, true: OccupancyGrid) -> tuple[float, int]:
    """Return the mean structural similarity over the cells that both maps have observed, and their number.

    The map is first shifted by up to 3 whole cells to the maximum correlation. (nan, 0) without a common cell.
    """
    p, q, seen, known = resample_to_common_cells(mapped, true)
    if not p.size:
        return float("nan"), 0
    step = find_best_shift(p, q)
    back = -step[0], -step[1]
    both = _crop_shifted(seen, step) & _crop_shifted(known, back)
    if not both.any():
        return float("nan"), 0
    return float(ssim(_crop_shifted(p, step), _crop_shifted(q, back))[both].mean()), int(np.count_nonzero(both))


def _score_similarity(mapped: OccupancyGrid, true: OccupancyGrid) -> Score:
    value, cells = mean_similarity(mapped, true)
    if cells < MIN_CELLS:
        return Score(None, cells, f"both maps have observed only {cells} common cells")
    return make_score(value, cells)


METRICS = make_metrics(
    "images",
    {
        "map_ssim": with_true_grid(_score_similarity),
    },
    REACH_CELLS=REACH_CELLS,
)
