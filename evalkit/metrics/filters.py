"""Gaussian filters of images with few steps in a block of rows, so that what is between them stays in the cache."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from evalkit.core.se2 import Floats

Real = TypeVar("Real", np.float32, np.float64)

_BLOCK = 64_000
"""Cells that are filtered at once."""


def gaussian_weights(sigma: float, reach: int, order: int = 0) -> Floats:
    """Return the weights (2 reach + 1,) of a Gaussian, or of its first or second derivative (``order`` 1 or 2).

    ``sigma``: the standard deviation in cells. The Gaussian is cut off ``reach`` cells from its middle and has a sum of
    1; applied by ``filter_image``.
    """
    places = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 / sigma**2 * places**2)
    weights /= weights.sum()
    factors = (1.0, places / sigma**2, places**2 / sigma**4 - 1.0 / sigma**2)
    return np.asarray(weights * factors[order])


def filter_image(image: NDArray[Real], down: Floats, across: Floats) -> NDArray[Real]:
    """Return the weighted sums of neighbouring cells of an image (H, W) along columns, then along rows.

    ``down``, ``across`` (2 R + 1,): symmetric or antisymmetric weights. Only cells with all neighbours in the image
    have a sum: the result is (H - 2 R, W - 2 R), in the precision of the image.
    """
    height, width = (size - len(weights) + 1 for size, weights in zip(image.shape, (down, across), strict=True))
    if min(height, width) <= 0:
        return np.zeros((max(height, 0), max(width, 0)), image.dtype)
    columns = _correlate(np.ascontiguousarray(image).ravel(), down, image.shape[1])[: height * image.shape[1]]
    rows = _correlate(columns, across, 1)  # also across the ends of rows, which are left out
    return rows.reshape(height, -1)[:, :width]


def _correlate(values: NDArray[Real], weights: Floats, stride: int) -> NDArray[Real]:
    """Return the weighted sums (N,) of values (N,) that are ``stride`` apart; the last 2 R ``stride`` are arbitrary."""
    reach, join = len(weights) // 2, np.add if weights[-1] == weights[0] else np.subtract
    own = weights.astype(values.dtype)
    count = len(values) - 2 * reach * stride
    sums = np.empty_like(values)
    for begin in range(0, count, _BLOCK):
        end = min(begin + _BLOCK, count)
        near = [values[begin + by * stride : end + by * stride] for by in range(2 * reach + 1)]
        into = np.multiply(near[reach], own[reach], out=sums[begin:end])
        pair = np.empty_like(into)
        for before in range(reach):  # from the farthest pair, as SciPy does: in double precision its bits
            after = 2 * reach - before
            join(near[after], near[before], out=pair)
            pair *= own[after]
            into += pair
    return sums
