"""Structural similarity: equal images, the closed form of uniform images, and maps on different lattices."""

import numpy as np
import pytest

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics import images
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap


def grid(p, resolution_m=0.05, origin=(0.0, 0.0), observed=None):
    p = np.asarray(p, dtype=np.float64)
    observed = np.ones(p.shape, np.bool_) if observed is None else observed
    return OccupancyGrid(np.log(p / (1.0 - p)).astype(np.float32), observed, resolution_m, *origin)


def compute_similarity(mapped, true):
    (metric,) = images.METRICS
    run = RunResult(np.zeros(0, STEP), 0)
    return metric.compute(Evidence(run, Truth("exact", grid=true), grid=mapped or MissingMap(NO_POSES)))


def room(cells=60, wall=12):
    p = np.full((cells, cells), 0.05)
    p[wall, wall:-wall] = p[-wall, wall:-wall] = p[wall:-wall, wall] = 0.9
    return p


def test_equal_images_have_similarity_one() -> None:
    picture = np.random.default_rng(0).random((30, 40))
    assert images.ssim(picture, picture) == pytest.approx(np.ones((30, 40)))
    assert compute_similarity(grid(room()), grid(room())).value == pytest.approx(1.0)


def test_uniform_images_differ_only_in_brightness() -> None:
    one, other = 0.3, 0.8
    found = images.ssim(np.full((20, 20), one), np.full((20, 20), other))
    assert found == pytest.approx((2 * one * other + 1e-4) / (one**2 + other**2 + 1e-4))


def test_one_window_equals_the_formula_by_hand() -> None:
    rng = np.random.default_rng(1)
    one, other = rng.random((2, 11, 11))
    weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights = np.outer(weights, weights) / weights.sum() ** 2
    m, n = (weights * one).sum(), (weights * other).sum()
    v, w = (weights * (one - m) ** 2).sum(), (weights * (other - n) ** 2).sum()
    both = (weights * (one - m) * (other - n)).sum()
    expected = (2 * m * n + 1e-4) * (2 * both + 9e-4) / ((m * m + n * n + 1e-4) * (v + w + 9e-4))
    assert images.ssim(one, other)[5, 5] == pytest.approx(expected)


def test_shifts_up_to_three_whole_cells_are_compensated() -> None:
    near, far = (compute_similarity(grid(room(), origin=(cells * 0.05, 0.0)), grid(room())) for cells in (2, 5))
    assert near.value == pytest.approx(1.0)
    assert far.value is not None
    assert far.value < 0.9


def test_a_finer_true_map_is_resampled_to_the_coarser_cells() -> None:
    fine = np.repeat(np.repeat(room(), 2, axis=0), 2, axis=1)
    found = compute_similarity(grid(room(), 0.05, (-1.0, 2.0)), grid(fine, 0.025, (-1.0, 2.0)))
    assert (found.value, found.support) == (pytest.approx(1.0, abs=1e-6), 3600)


def test_maps_that_do_not_overlap_are_not_compared() -> None:
    found = compute_similarity(grid(room(), origin=(100.0, 0.0)), grid(room()))
    assert found.reason == "both maps have observed only 0 common cells"
    half = np.zeros((60, 60), np.bool_)
    half[:, :1] = True
    assert (
        compute_similarity(grid(room(), observed=half), grid(room())).reason
        == "both maps have observed only 60 common cells"
    )
    assert compute_similarity(None, grid(room())).reason.startswith("no map:")
    assert compute_similarity(grid(room()), None).reason == "no ground-truth map"


def test_only_the_overlap_of_both_maps_is_compared() -> None:
    """Both maps fill their grids and are 2 cells apart: the overlap is equal, and no map is padded at its border."""
    world = np.random.default_rng(3).random((40, 44))
    value, cells = images.mean_similarity(grid(world[:, 2:42], origin=(0.1, 0.0)), grid(world[:, :40]))
    assert (round(value, 9), cells) == (1.0, 38 * 40)
    value, cells = images.mean_similarity(grid(world[:, 2:42]), grid(world[:, :40]))  # the same map at another origin
    assert (round(value, 9), cells) == (1.0, 38 * 40)


def test_a_cell_that_a_finer_map_has_not_observed_is_undecided() -> None:
    """Two by two cells of 5 cm, of which the finer map has observed three, with two of their four parts each."""
    observed = np.array([[1, 0, 1, 0], [0, 1, 0, 1], [1, 1, 0, 0], [0, 0, 0, 0]], dtype=np.bool_)
    fine = grid(np.where(observed, 0.9, 0.2), 0.025, observed=observed)
    coarse, found, _, seen = images.resample_to_common_cells(grid(np.full((2, 2), 0.7)), fine)
    np.testing.assert_allclose(coarse, 0.7, atol=1e-6)
    np.testing.assert_allclose(found, [[0.9, 0.9], [0.9, 0.5]], atol=1e-6)
    assert seen.tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize(("cells", "enough"), [(100, True), (99, False)])
def test_a_similarity_needs_a_hundred_common_cells(cells, enough) -> None:
    observed = np.zeros((60, 60), np.bool_)
    observed.ravel()[:cells] = True
    found = compute_similarity(grid(room(), observed=observed), grid(room()))
    assert (found.value is not None, found.support) == (enough, cells)


def test_of_shifts_that_fit_alike_the_shortest_is_taken_and_each_is_searched() -> None:
    """Stripes with a period of four cells fit at -4, 0 and 4, at most three of which are searched."""
    stripes = np.tile(np.where(np.arange(40) % 4 < 2, 0.9, 0.1), (30, 1))
    assert images.find_best_shift(stripes, stripes) == (0, 0)
    dot = np.full((20, 20), 0.5)
    for row, column in np.ndindex(7, 7):
        one, other = dot.copy(), dot.copy()
        one[10:13, 10:13] = other[7 + row : 10 + row, 7 + column : 10 + column] = 0.9
        assert images.find_best_shift(one, other) == (row - 3, column - 3)
