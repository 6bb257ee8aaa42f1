"""Covariance ellipses of point neighbourhoods, compared with NumPy's covariances and with hand calculations."""

import numpy as np
import pytest

from evalkit.metrics.neighbourhoods import Neighbourhoods, compute_neighbourhoods, thin_evenly


@pytest.mark.parametrize(("count", "places"), [(400, 20), (400, 250), (20_000, 6)], ids=["all", "blocks", "cells"])
def test_the_ellipse_of_each_neighbourhood_equals_numpys_covariance(count: int, places: int) -> None:
    rng = np.random.default_rng(0)
    points, middles = rng.uniform(0.0, 2.0, (count, 2)), rng.uniform(0.0, 2.0, (places, 2))
    found = compute_neighbourhoods(points, middles, 0.4)
    for place, middle in enumerate(middles):
        near = points[np.linalg.norm(points - middle, axis=1) <= 0.4]
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        assert found.counts[place] == len(near)
        assert [found.small[place], found.large[place]] == pytest.approx(values.tolist())
        along = np.arctan2(vectors[1, 1], vectors[0, 1])
        assert np.sin(found.direction[place] - along) == pytest.approx(0.0, abs=1e-6)


def test_a_neighbourhood_without_points_is_not_a_wall() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 50), np.zeros(50)])
    found = compute_neighbourhoods(line, np.array([[0.5, 0.0], [9.0, 9.0]]))
    assert found.flat.tolist() == [True, False]
    assert np.isnan(found.small[1])


def test_the_direction_of_a_wall_is_recovered() -> None:
    angles = np.radians([0.0, 30.0, 90.0, 150.0])
    for angle in angles:
        line = np.outer(np.linspace(-1.0, 1.0, 99), [np.cos(angle), np.sin(angle)])
        assert np.sin(compute_neighbourhoods(line, np.zeros((1, 2))).direction[0] - angle) == pytest.approx(
            0.0, abs=1e-9
        )


def test_evenly_keeps_the_first_and_the_last() -> None:
    assert thin_evenly(np.arange(10), 4).tolist() == [0, 3, 6, 9]
    assert thin_evenly(np.arange(3), 9).tolist() == [0, 1, 2]


def test_a_piece_of_wall_has_five_points_and_more_than_nine_times_the_variance_along_it():
    counts, large = np.array([5, 4, 5, 5]), np.array([9.1, 9.1, 9.0, 0.0])
    found = Neighbourhoods(counts, np.array([1.0, 1.0, 1.0, 0.0]), large, np.zeros(4))
    assert found.flat.tolist() == [True, False, False, False]


def test_a_neighbourhood_has_a_radius_of_half_a_metre_unless_stated():
    line = np.column_stack([np.array([-0.51, -0.49, 0.0, 0.49, 0.51]), np.zeros(5)])
    assert compute_neighbourhoods(line, np.zeros((1, 2))).counts.tolist() == [3]
    assert compute_neighbourhoods(line, np.zeros((1, 2)), 0.52).counts.tolist() == [5]
