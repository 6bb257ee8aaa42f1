"""Structural similarity: equal pictures, the closed form of plain ones, and maps on other lattices."""

import numpy as np
import pytest

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics import images
from evalkit.metrics.table import NO_POSES, Evidence, MissingMap


def grid(p, resolution_m=0.05, origin=(0.0, 0.0), observed=None):
    p = np.asarray(p, dtype=np.float64)
    observed = np.ones(p.shape, np.bool_) if observed is None else observed
    return OccupancyGrid(np.log(p / (1.0 - p)).astype(np.float32), observed, resolution_m, *origin)


def scored(mapped, true):
    (metric,) = images.METRICS
    run = RunResult(np.zeros(0, STEP), 0)
    return metric.compute(Evidence(run, Truth("exact", grid=true), grid=mapped or MissingMap(NO_POSES)))


def room(cells=60, wall=12):
    p = np.full((cells, cells), 0.05)
    p[wall, wall:-wall] = p[-wall, wall:-wall] = p[wall:-wall, wall] = 0.9
    return p


def test_equal_pictures_are_wholly_alike() -> None:
    picture = np.random.default_rng(0).random((30, 40))
    assert images.ssim(picture, picture) == pytest.approx(np.ones((30, 40)))
    assert scored(grid(room()), grid(room())).value == pytest.approx(1.0)


def test_plain_pictures_differ_by_their_brightness_alone() -> None:
    one, other = 0.3, 0.8
    found = images.ssim(np.full((20, 20), one), np.full((20, 20), other))
    assert found == pytest.approx((2 * one * other + 1e-4) / (one**2 + other**2 + 1e-4))


def test_one_window_is_that_of_the_formula_by_hand() -> None:
    rng = np.random.default_rng(1)
    one, other = rng.random((2, 11, 11))
    weights = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    weights = np.outer(weights, weights) / weights.sum() ** 2
    m, n = (weights * one).sum(), (weights * other).sum()
    v, w = (weights * (one - m) ** 2).sum(), (weights * (other - n) ** 2).sum()
    both = (weights * (one - m) * (other - n)).sum()
    expected = (2 * m * n + 1e-4) * (2 * both + 9e-4) / ((m * m + n * n + 1e-4) * (v + w + 9e-4))
    assert images.ssim(one, other)[5, 5] == pytest.approx(expected)


def test_whole_cells_of_shift_are_taken_out_and_more_than_three_are_not() -> None:
    near, far = (scored(grid(room(), origin=(cells * 0.05, 0.0)), grid(room())) for cells in (2, 5))
    assert near.value == pytest.approx(1.0)
    assert far.value is not None
    assert far.value < 0.9


def test_a_finer_true_map_is_brought_to_the_cells_of_the_coarser_one() -> None:
    fine = np.repeat(np.repeat(room(), 2, axis=0), 2, axis=1)
    found = scored(grid(room(), 0.05, (-1.0, 2.0)), grid(fine, 0.025, (-1.0, 2.0)))
    assert (found.value, found.support) == (pytest.approx(1.0, abs=1e-6), 3600)


def test_maps_that_do_not_meet_are_not_compared() -> None:
    found = scored(grid(room(), origin=(100.0, 0.0)), grid(room()))
    assert found.reason == "both maps have observed only 0 common cells"
    half = np.zeros((60, 60), np.bool_)
    half[:, :1] = True
    assert scored(grid(room(), observed=half), grid(room())).reason == "both maps have observed only 60 common cells"
    assert scored(None, grid(room())).reason.startswith("no map:")
    assert scored(grid(room()), None).reason == "no ground-truth map"


def test_what_one_map_shows_beyond_the_other_is_not_compared() -> None:
    """Both fill their grids, 2 cells apart: what they share is the same, and nothing stands beyond a border."""
    world = np.random.default_rng(3).random((40, 44))
    value, cells = images.mean_similarity(grid(world[:, 2:42], origin=(0.1, 0.0)), grid(world[:, :40]))
    assert (round(value, 9), cells) == (1.0, 38 * 40)
    value, cells = images.mean_similarity(
        grid(world[:, 2:42]), grid(world[:, :40])
    )  # the same, said to stand elsewhere
    assert (round(value, 9), cells) == (1.0, 38 * 40)
