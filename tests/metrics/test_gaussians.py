"""Distances between Gaussians: compared with SciPy, with hand calculations, and for maps of a few walls."""

import numpy as np
import pytest
from scipy.linalg import sqrtm

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics import gaussians
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap


def covariance(short, long, degrees):
    turn = np.radians(degrees)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    return axes @ np.diag([long**2, short**2]) @ axes.T


def one(mean, cov, other_mean, other_cov):
    rows = [np.array([value], dtype=float) for value in (mean, cov, other_mean, other_cov)]
    return float(gaussians.wasserstein_distances(*rows)[0])


def test_the_distance_equals_the_matrix_root_form() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        roots = rng.normal(size=(2, 2, 2))
        s1, s2 = (root @ root.T for root in roots)
        m1, m2 = rng.normal(size=(2, 2))
        r1 = sqrtm(s1)
        square = np.sum((m1 - m2) ** 2) + np.trace(s1 + s2 - 2.0 * np.real(sqrtm(r1 @ s2 @ r1)))
        assert one(m1, s1, m2, s2) == pytest.approx(np.sqrt(square), rel=1e-6)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 45.0, 75.0])
def test_a_tilted_wall_has_distance_zero_to_itself(degrees) -> None:
    wall = covariance(0.02, 0.3, degrees)
    assert one([1, 2], wall, [1, 2], wall) == pytest.approx(0.0, abs=1e-7)
    assert one([1, 2], wall, [1, 2.5], wall) == pytest.approx(0.5)


def test_covariances_on_the_same_axes_differ_by_their_standard_deviations() -> None:
    assert one([0, 0], covariance(0.1, 0.4, 20), [0, 0], covariance(0.2, 0.7, 20)) == pytest.approx(np.hypot(0.1, 0.3))


def test_voxel_counts_equal_those_of_numpy() -> None:
    points = np.random.default_rng(2).uniform(-2.0, 2.0, (300, 2))
    found = gaussians.fit_voxels(points)
    assert len(found.at) == 16
    for at, mean, cov in zip(found.at, found.means, found.covariances, strict=True):
        inside = points[(np.floor(points) == at).all(axis=1)]
        assert np.allclose(mean, inside.mean(axis=0))
        assert np.allclose(cov, np.cov(inside.T, bias=True))


@pytest.mark.parametrize("size_m", [1.5, 2.0])
def test_squares_of_any_size_have_a_corner_at_the_origin_and_at_least_five_points(size_m) -> None:
    points = np.random.default_rng(3).uniform(-4.0, 4.0, (70, 2))
    squares, counts = np.unique(np.floor(points / size_m).astype(int), axis=0, return_counts=True)
    assert counts.min() < 5
    assert gaussians.fit_voxels(points, size_m).at.tolist() == squares[counts >= 5].tolist()
    five = np.array([[0.1, 0.1], [0.2, 0.1], [0.3, 0.1], [0.4, 0.1], [0.5, 0.1]])
    assert [len(gaussians.fit_voxels(five[:count]).at) for count in (5, 4)] == [1, 0]


def test_a_uniform_error_is_consistent_and_a_varying_error_is_not() -> None:
    at = np.array([[0, 0], [1, 0], [2, 0]])
    assert gaussians.spatial_consistency(at, np.array([0.3, 0.3, 0.3])) == pytest.approx(0.0, abs=1e-7)
    assert gaussians.spatial_consistency(at, np.array([1.0, 2.0, 3.0])) == pytest.approx(np.sqrt(2 / 3) / 2)
    assert np.isnan(gaussians.spatial_consistency(np.array([[0, 0], [5, 5]]), np.array([1.0, 2.0])))
    elsewhere = np.concatenate([at, at + 20])  # without any error there: no ratio
    found = gaussians.spatial_consistency(elsewhere, np.array([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]))
    assert found == pytest.approx(np.sqrt(2 / 3) / 2)


def grid(shift_cells):
    occupied = np.zeros((60, 100), np.bool_)
    occupied[10 + shift_cells, :] = True
    log_odds = np.where(occupied, 4.0, -4.0).astype(np.float32)
    return OccupancyGrid(log_odds, np.ones_like(occupied), 0.05, 0.0, 0.0)


def scores(mapped, true):
    run = RunResult(np.zeros(0, STEP), 0)
    evidence = Evidence(run, Truth("exact", grid=true), grid=mapped or MissingMap(NO_POSES))
    return {metric.name: metric.compute(evidence) for metric in gaussians.METRICS}


def test_a_wall_two_cells_off_has_distance_two_cells_in_every_square() -> None:
    found = scores(grid(2), grid(0))
    assert found["map_awd_m"].value == pytest.approx(0.1)
    assert found["map_awd_m"].support == 5
    assert found["map_scs"].value == pytest.approx(0.0, abs=1e-6)


def test_three_squares_with_walls_in_both_maps_are_enough() -> None:
    def cut(columns):
        whole = grid(0)
        return OccupancyGrid(whole.log_odds[:, :columns], whole.observed[:, :columns], 0.05, 0.0, 0.0)

    assert scores(cut(60), grid(0))["map_awd_m"].support == 3
    assert scores(cut(40), grid(0))["map_awd_m"].reason == "the maps share 2 squares with walls, at least 3 are needed"
    assert gaussians.spatial_consistency(np.array([[0, 0], [1, 1], [-1, 1]]), np.array([1.0, 2.0, 3.0])) > 0.0
    lonely = gaussians.spatial_consistency(np.array([[0, 0], [2, 0], [0, 2]]), np.array([1.0, 2.0, 3.0]))
    assert np.isnan(lonely)


def test_a_missing_map_or_missing_walls_give_a_reason() -> None:
    nothing = OccupancyGrid(np.zeros((2, 2), np.float32), np.zeros((2, 2), np.bool_), 0.05, 0.0, 0.0)
    assert scores(grid(0), None)["map_awd_m"].reason == "no ground-truth map"
    assert scores(None, grid(0))["map_awd_m"].reason == "no map: the run has no poses"
    assert scores(nothing, grid(0))["map_awd_m"].reason == "the maps share 0 squares with walls, at least 3 are needed"
