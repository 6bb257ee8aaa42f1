"""Filters of images, compared with SciPy's and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from evalkit.metrics.filters import filter_image, gaussian_weights


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-14), (np.float32, 1e-6)])
@pytest.mark.parametrize("orders", [(0, 0), (1, 0), (0, 1), (2, 0), (0, 2)])
@pytest.mark.parametrize("shape", [(9, 9), (20, 13), (310, 420)])  # of one cell, of one block, of several blocks
def test_filtered_cells_equal_those_of_scipy(
    shape: tuple[int, int], orders: tuple[int, int], dtype: type[np.float64], tolerance: float
) -> None:
    image = np.random.default_rng(0).normal(0.0, 1.0, shape).astype(dtype)
    found = filter_image(image, *(gaussian_weights(1.0, 4, order) for order in orders))
    expected = ndimage.gaussian_filter(image, 1.0, order=orders)[4:-4, 4:-4]
    assert found.dtype == dtype
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance)


def test_columns_and_rows_have_weights_of_their_own() -> None:
    """A step of 1 from row 1 to row 2: its neighbours differ by 1, and by 4 with the sum across."""
    image = np.array([[0.0] * 4, [0.0] * 4, [1.0] * 4, [1.0] * 4])
    difference, total = np.array([-1.0, 0.0, 1.0]), np.array([1.0, 2.0, 1.0])
    assert filter_image(image, difference, total).tolist() == [[4.0, 4.0], [4.0, 4.0]]
    assert filter_image(image, total, difference).tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert filter_image(image[:, ::2], difference, np.array([3.0])).tolist() == [[3.0, 3.0], [3.0, 3.0]]
    assert filter_image(image[:, :1], difference, np.array([3.0])).tolist() == [[3.0], [3.0]]


@pytest.mark.parametrize("shape", [(8, 20), (20, 8), (0, 20), (20, 0)])
def test_an_image_smaller_than_the_weights_has_no_cell_with_all_neighbours(shape: tuple[int, int]) -> None:
    weights = gaussian_weights(1.0, 4)
    assert filter_image(np.ones(shape), weights, weights).size == 0
