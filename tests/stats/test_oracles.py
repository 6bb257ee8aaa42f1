"""Statistics and image measures against statsmodels and scikit-image, written by others."""

import numpy as np
import pytest
from scipy import ndimage

from evalkit.commands.study.effects import ModelFit
from evalkit.core.grid import OccupancyGrid
from evalkit.design.designs import DesignAxis, Model, make_fractional
from evalkit.metrics.corners import find_corners
from evalkit.metrics.images import ssim
from evalkit.stats.intervals import wilson_interval
from evalkit.stats.paired_tests import adjust_by_holm

SEED = 20260101


@pytest.mark.thorough
def test_holm_and_wilson_are_those_of_statsmodels():
    multitest = pytest.importorskip("statsmodels.stats.multitest", reason="statsmodels is not installed")
    proportion = pytest.importorskip("statsmodels.stats.proportion")
    generator = np.random.default_rng(SEED)
    for count in (1, 2, 7, 40):
        p = np.round(generator.uniform(0.0, 0.2, count), 2)  # with ties
        np.testing.assert_allclose(adjust_by_holm(p.tolist()), multitest.multipletests(p, method="holm")[1])
    for successes, trials in ((0, 5), (3, 7), (64, 64), (113, 256)):
        found = wilson_interval(successes, trials, 0.95)
        expected = proportion.proportion_confint(successes, trials, 0.05, method="wilson")
        np.testing.assert_allclose((found.low, found.high), expected, atol=1e-12)


def test_the_structural_similarity_is_that_of_scikit_image():
    metrics = pytest.importorskip("skimage.metrics", reason="scikit-image is not installed")
    generator = np.random.default_rng(SEED)
    one = generator.uniform(0.0, 1.0, (40, 60))
    other = np.clip(one + generator.normal(0.0, 0.1, one.shape), 0.0, 1.0)
    _, expected = metrics.structural_similarity(
        one, other, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True
    )
    inside = slice(5, -5)  # borders are continued differently
    np.testing.assert_allclose(ssim(one, other)[inside, inside], expected[inside, inside], atol=1e-9)


def test_the_corners_of_a_map_are_the_harris_corners_of_scikit_image():
    """A room with a block in it: eight corners, each one cell inside the angle of its walls."""
    feature = pytest.importorskip("skimage.feature", reason="scikit-image is not installed")
    occupied = np.zeros((120, 160), dtype=bool)
    for low, high, left, right in ((10, 110, 10, 150), (40, 70, 50, 90)):
        occupied[[low, high], left : right + 1] = occupied[low : high + 1, [left, right]] = True
    log_odds = np.where(occupied, 3.0, -3.0).astype(np.float32)
    found = find_corners(OccupancyGrid(log_odds, np.ones_like(occupied), 0.05, 0.0, 0.0)) / 0.05 - 0.5
    edges = -ndimage.gaussian_laplace(occupied.astype(float), 1.0)
    response = feature.corner_harris(edges, method="k", k=0.05, sigma=1.5)
    expected = feature.corner_peaks(response, min_distance=4, threshold_rel=0.1)[:, ::-1]
    assert len(expected) == 8
    np.testing.assert_allclose(sorted(found.tolist()), sorted(expected.tolist()), atol=0.5)


def test_intervals_of_a_model_are_those_of_statsmodels_with_hc3():
    regression = pytest.importorskip("statsmodels.api", reason="statsmodels is not installed")
    generator = np.random.default_rng(SEED)
    model = Model(tuple(DesignAxis(name, 2) for name in "abcd"), pairs=False)
    rows = make_fractional(4, 4)
    response = rows @ [0.5, -0.2, 0.0, 0.1] + generator.normal(0.0, 0.1 + 0.1 * (rows[:, 0] > 0), len(rows))
    found = ModelFit(model, rows, response).mean
    expected = regression.OLS(response, model.matrix(rows)).fit(cov_type="HC3", use_t=True)
    np.testing.assert_allclose(found.value, expected.params[0])
    np.testing.assert_allclose((found.low, found.high), expected.conf_int(0.05)[0], rtol=1e-9)
