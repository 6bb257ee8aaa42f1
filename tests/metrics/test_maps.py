"""Maps compared with ground truth: shifted walls, brute force, and grids that differ in origin and resolution."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.metrics import maps
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap


def grid(occupied: Bools, resolution_m: float = 0.05, origin_x: float = 0.0, origin_y: float = 0.0) -> OccupancyGrid:
    log_odds = np.where(occupied, 4.0, -4.0).astype(np.float32)
    return OccupancyGrid(log_odds, np.ones(occupied.shape, np.bool_), resolution_m, origin_x, origin_y)


def wall(column: int, shape: tuple[int, int] = (40, 60)) -> Bools:
    """Return one wall along y, one cell thick."""
    occupied = np.zeros(shape, np.bool_)
    occupied[:, column] = True
    return occupied


def scores(mapped: OccupancyGrid | None, true: OccupancyGrid | None) -> dict[str, Score]:
    run = RunResult(np.zeros(0, STEP), 0)
    evidence = Evidence(run, Truth("exact", grid=true), grid=mapped or MissingMap(NO_POSES))
    return {metric.name: metric.compute(evidence) for metric in maps.METRICS}


def test_the_true_map_has_a_perfect_score_against_itself() -> None:
    same = scores(grid(wall(20)), grid(wall(20)))
    assert same["map_f1"] == same["map_iou"] == Score(1.0, 80)
    assert same["map_chamfer_m"].value == same["map_wall_p95_m"].value == 0.0


def test_a_wall_shifted_by_two_cells_is_within_ten_centimetres_and_by_three_is_not() -> None:
    two, three = (scores(grid(wall(20 + cells)), grid(wall(20))) for cells in (2, 3))
    assert (two["map_f1"].value, two["map_iou"].value) == (1.0, 0.0)
    assert two["map_wall_mean_m"].value == pytest.approx(0.10)
    assert (three["map_f1"].value, three["map_precision"].value, three["map_recall"].value) == (0.0, 0.0, 0.0)
    assert three["map_chamfer_m"].value == pytest.approx(0.15)


def test_a_doubled_wall_costs_precision_and_a_missing_one_recall() -> None:
    doubled = scores(grid(wall(20) | wall(40)), grid(wall(20)))
    assert (doubled["map_precision"].value, doubled["map_recall"].value) == (0.5, 1.0)
    assert doubled["map_f1"].value == pytest.approx(2 / 3)
    assert doubled["map_wall_mean_m"].value == pytest.approx(0.5)
    missing = scores(grid(wall(20)), grid(wall(20) | wall(40)))
    assert (missing["map_precision"].value, missing["map_recall"].value) == (1.0, 0.5)
    assert missing["map_chamfer_m"].value == pytest.approx(0.25)


def test_scores_of_random_maps_equal_brute_force() -> None:
    rng = np.random.default_rng(0)
    mapped = grid(rng.random((20, 25)) < 0.03, 0.05, 0.3, -0.2)
    true = grid(rng.random((24, 18)) < 0.03, 0.04, 0.1, -0.1)
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    distances = np.linalg.norm(ours[:, None] - theirs[None], axis=2)
    precision, recall = (distances.min(axis=1) <= 0.1).mean(), (distances.min(axis=0) <= 0.1).mean()
    found = scores(mapped, true)
    assert found["map_precision"].value == pytest.approx(precision)
    assert found["map_recall"].value == pytest.approx(recall)
    assert found["map_f1"].value == pytest.approx(2 * precision * recall / (precision + recall))
    assert found["map_chamfer_m"].value == pytest.approx(
        (distances.min(axis=1).mean() + distances.min(axis=0).mean()) / 2
    )
    assert found["map_wall_p95_m"].value == pytest.approx(np.percentile(distances.min(axis=1), 95))
    assert found["map_knn_m"].value == pytest.approx(distances.min(axis=0).mean())
    inliers = distances.min(axis=1)[distances.min(axis=1) <= 0.2]
    assert 0 < len(inliers) < len(ours)
    assert found["map_ac_m"].value == pytest.approx(np.sqrt(np.mean(inliers**2)))
    assert found["map_com"].value == pytest.approx((distances.min(axis=0) <= 0.2).mean())


def test_moving_both_grids_or_padding_one_does_not_change_scores() -> None:
    rng = np.random.default_rng(1)
    ours, theirs = rng.random((30, 30)) < 0.05, rng.random((30, 30)) < 0.05
    here = scores(grid(ours), grid(theirs))
    moved = scores(grid(ours, 0.05, 12.3, -4.0), grid(theirs, 0.05, 12.3, -4.0))
    padded = scores(grid(np.pad(ours, 7), 0.05, -0.35, -0.35), grid(theirs))
    for name, score in here.items():
        assert moved[name].value == pytest.approx(score.value), name
        assert padded[name].value == pytest.approx(score.value), name


def test_iou_is_computed_at_the_coarser_resolution() -> None:
    coarse = grid(wall(5, (10, 15)), 0.2)
    fine = grid(np.kron(coarse.occupied(), np.ones((4, 4))) > 0, 0.05)
    assert scores(fine, coarse)["map_iou"].value == 1.0
    assert scores(coarse, fine)["map_iou"].value == 1.0


def mirrored(one: OccupancyGrid) -> OccupancyGrid:
    """Return a map with the signs of x and y changed."""
    height, width = one.shape
    x, y = -one.origin_x - width * one.resolution_m, -one.origin_y - height * one.resolution_m
    return grid(one.occupied()[::-1, ::-1], one.resolution_m, x, y)


@pytest.mark.parametrize(("x", "y"), [(0.025, 0.0), (0.0, 0.025), (0.025, 0.025), (0.05, -0.1)])
def test_iou_of_a_mirrored_world_is_the_same_on_lattices_half_a_cell_apart(x: float, y: float) -> None:
    rng = np.random.default_rng(8)
    mapped, true = grid(rng.random((30, 40)) < 0.3), grid(rng.random((25, 35)) < 0.3, 0.05, x, y)
    here, there = scores(mapped, true), scores(mirrored(mapped), mirrored(true))
    turned = scores(grid(mapped.occupied().T), grid(true.occupied().T, 0.05, y, x))
    for name in ("map_iou", "map_iou_10cm"):
        assert there[name].value == pytest.approx(here[name].value), name
        assert turned[name].value == pytest.approx(here[name].value), name


def test_iou_is_the_mean_over_both_sides_of_the_edges_on_which_centres_lie() -> None:
    half = grid(wall(20), 0.05, 0.025)  # its wall lies in half of column 20 and in half of column 21
    assert scores(grid(wall(20)), half)["map_iou"].value == scores(grid(wall(21)), half)["map_iou"].value == 0.5
    assert scores(grid(wall(20) | wall(21)), half)["map_iou"].value == 0.5
    assert scores(grid(wall(22)), half)["map_iou"].value == 0.0


def test_iou_with_a_tolerance_accepts_two_cells_and_counts_each_cell_once() -> None:
    two, three = (scores(grid(wall(20 + cells)), grid(wall(20)))["map_iou_10cm"].value for cells in (2, 3))
    assert (two, three) == (1.0, 0.0)
    assert scores(grid(wall(20) | wall(40)), grid(wall(20)))["map_iou_10cm"].value == 0.5


def test_accuracy_uses_near_walls_and_completeness_uses_true_walls() -> None:
    found = scores(grid(wall(22) | wall(50)), grid(wall(20) | wall(5)))
    assert found["map_ac_m"].value == pytest.approx(0.10)
    assert found["map_com"].value == 0.5
    assert found["map_knn_m"].value == pytest.approx((0.10 + 0.85) / 2)
    far = scores(grid(wall(50)), grid(wall(20)))
    assert far["map_ac_m"].reason == "no wall of the map is within 0.2 m of a true wall"
    assert far["map_com"].value == 0.0


def test_a_map_without_walls_scores_zero_and_without_ground_truth_has_no_score() -> None:
    empty = grid(np.zeros((5, 5), np.bool_))
    found = scores(empty, grid(wall(20)))
    assert (found["map_f1"].value, found["map_recall"].value) == (0.0, 0.0)
    assert found["map_precision"].reason == "the map has no wall"
    assert scores(empty, None)["map_f1"].reason == "no ground-truth map"
    assert scores(None, grid(wall(20)))["map_f1"].reason == "no map: the run has no poses"


def test_coverage_is_the_observed_share_of_the_observed_cells_of_the_true_map() -> None:
    true = grid(wall(20))
    half = grid(wall(20)[:, :30])
    seen = np.ones((40, 60), np.bool_)
    seen[:10] = False
    holed = OccupancyGrid(true.log_odds, seen, 0.05, 0.0, 0.0)
    away = grid(wall(20), origin_x=100.0)
    found = [scores(mapped, true)["map_coverage_percent"] for mapped in (true, half, holed, away)]
    assert found == [Score(100.0, 2400), Score(50.0, 2400), Score(75.0, 2400), Score(0.0, 2400)]
    assert scores(true, holed)["map_coverage_percent"] == Score(100.0, 1800)
    coarse = grid(wall(5, (10, 15)), 0.2)
    assert scores(coarse, true)["map_coverage_percent"].value == 100.0
    assert scores(true, None)["map_coverage_percent"].reason == "no ground-truth map"
    assert scores(None, true)["map_coverage_percent"].reason.startswith("no map: ")


def test_true_maps_without_walls_or_observed_cells_are_reasons() -> None:
    empty = grid(np.zeros((5, 5), np.bool_))
    assert scores(grid(wall(20)), empty)["map_f1"] == Score(None, 0, "the ground-truth map has no wall")
    unseen = OccupancyGrid(np.zeros((5, 5), np.float32), np.zeros((5, 5), np.bool_), 0.05, 0.0, 0.0)
    reason = "the ground-truth map has no observed cell"
    assert scores(grid(wall(20)), unseen)["map_coverage_percent"] == Score(None, 0, reason)
    for name in ("map_f1", "map_recall", "map_iou_10cm", "map_com"):
        assert scores(empty, grid(wall(20)))[name].value == 0.0


def test_the_shared_cells_of_random_maps_with_other_origins_equal_those_of_sets() -> None:
    rng = np.random.default_rng(5)
    ours, theirs = rng.random((30, 40)) < 0.2, rng.random((25, 35)) < 0.2
    mapped, true = grid(ours, 0.05, -0.75, 1.35), grid(theirs, 0.05, -0.5, 1.2)  # 5 columns and -3 rows apart
    one = {(row, column) for row, column in np.argwhere(ours).tolist()}
    other = {(row - 3, column + 5) for row, column in np.argwhere(theirs).tolist()}
    assert scores(mapped, true)["map_iou"].value == pytest.approx(len(one & other) / len(one | other))
