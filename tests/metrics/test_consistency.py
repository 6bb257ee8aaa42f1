"""Consistency metrics of maps without ground truth: closed forms for bands, squares, slivers and probabilities."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from evalkit.core import se2
from evalkit.core.arrays import Bools
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.metrics import consistency, corners
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap, PlacedScans


def grid(occupied: Bools, free: Bools | None = None, resolution_m: float = 0.05) -> OccupancyGrid:
    """Build a grid from occupied cells and free cells (default: all others); the rest is unobserved."""
    free = ~occupied if free is None else free
    log_odds = np.where(occupied, 4.0, np.where(free, -4.0, 0.0)).astype(np.float32)
    return OccupancyGrid(log_odds, occupied | free, resolution_m, 0.0, 0.0)


def band(cells: int, length: int = 200) -> Bools:
    """Return a wall along x with the given thickness in cells."""
    occupied = np.zeros((60, length), np.bool_)
    occupied[20 : 20 + cells] = True
    return occupied


def square(side: int, thick: int, shape: tuple[int, int] = (160, 160)) -> Bools:
    """Return the walls of a square room in the centre of the grid."""
    occupied = np.zeros(shape, np.bool_)
    low, high = (shape[0] - side) // 2, (shape[0] + side) // 2
    occupied[low:high, low:high] = True
    occupied[low + thick : high - thick, low + thick : high - thick] = False
    return occupied


def scores(
    whole: OccupancyGrid | None,
    first: OccupancyGrid | None = None,
    second: OccupancyGrid | None = None,
    mapped: PlacedScans = (),
) -> dict[str, Score]:
    run = RunResult(np.zeros(0, STEP), 0)
    whole_map, first_map, second_map = (grid or MissingMap(NO_POSES) for grid in (whole, first, second))
    evidence = Evidence(run, Truth("none"), grid=whole_map, mapped=mapped, first_half=first_map, second_half=second_map)
    return {metric.name: metric.compute(evidence) for metric in consistency.METRICS}


def test_entropy_uses_only_observed_cells() -> None:
    log_odds = np.array([[0.0, np.log(3.0)], [-np.log(3.0), 0.0]], np.float32)
    observed = np.array([[True, True], [True, False]])
    quarter = -(0.25 * np.log(0.25) + 0.75 * np.log(0.75))
    found = consistency.map_entropy(OccupancyGrid(log_odds, observed, 0.05, 0.0, 0.0))
    assert found == pytest.approx((np.log(2.0) + 2 * quarter) / 3, rel=1e-6)


def wall_hits(width_m: float, count: int = 20_000) -> Floats:
    """Return hits spread evenly over a wall 20 m long."""
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(0.0, 20.0, count), rng.uniform(0.0, width_m, count)])


@pytest.mark.parametrize("width_m", [0.02, 0.1, 0.2])
def test_a_wall_of_width_w_has_thickness_w_over_root_twelve(width_m: float) -> None:
    found, share = consistency.wall_thicknesses(wall_hits(width_m))
    assert found.mean() == pytest.approx(width_m / np.sqrt(12.0), rel=0.01)
    assert share > 0.97  # the ends of a thick wall do not form a line


def test_thickness_is_independent_of_the_frame_and_of_the_number_of_hits() -> None:
    hits = wall_hits(0.1)
    here = consistency.wall_thicknesses(hits)[0].mean()
    assert consistency.wall_thicknesses(se2.transform([3.0, 4.0, 1.0], hits))[0].mean() == pytest.approx(here)
    assert consistency.wall_thicknesses(hits[::4])[0].mean() == pytest.approx(here, rel=0.02)


def test_a_doubled_wall_is_thicker() -> None:
    once = wall_hits(0.0)
    twice = np.concatenate([once[::2], np.add(once[1::2], [0.0, 0.15])])
    assert consistency.wall_thicknesses(once)[0].max() == pytest.approx(0.0, abs=1e-9)
    assert consistency.wall_thicknesses(twice)[0].mean() == pytest.approx(0.075, rel=0.01)


def test_at_most_a_thousand_places_are_measured() -> None:
    y = np.linspace(-1.0, 1.0, 1500)
    scan = Scan(0, np.hypot(2.0, y), np.arctan2(y, 2.0), 0.0, 20.0), np.zeros(3)
    found = scores(None, mapped=(scan,))
    assert found["wall_share_percent"] == Score(100.0, 1000)
    assert found["wall_thickness_m"].support == 1000
    assert scores(None, mapped=(wall_scan(2.5),))["wall_share_percent"].support == 200


@pytest.mark.parametrize(("share", "enough"), [(0.05, True), (0.049, False)])
def test_a_thickness_needs_a_twentieth_of_the_hits_along_walls(share: float, enough: bool) -> None:
    """Of 1,000 hits up to 50 lie on five walls, of thickness 0 to 4 cm; the others are 2 m apart."""
    rows = [[10.0 * wall + 0.05 * k, 0.01 * wall * (1, -1, -1, 1)[k % 4]] for wall in range(5) for k in range(10)]
    alone = [[100.0 + 2.0 * (k % 50), 100.0 + 2.0 * (k // 50)] for k in range(1000)]
    count = round(1000 * share)
    x, y = np.array(rows[-count:] + alone[count:]).T
    found = scores(None, mapped=((Scan(0, np.hypot(x, y), np.arctan2(y, x), 0.0, 400.0), np.zeros(3)),))
    expected = (pytest.approx(0.02, abs=1e-3), pytest.approx(0.04, abs=1e-3)) if enough else (None, None)
    assert (found["wall_thickness_m"].value, found["wall_thickness_p95_m"].value) == expected
    assert found["wall_thickness_m"].support == count


def test_scattered_hits_are_not_a_wall() -> None:
    rng = np.random.default_rng(0)
    scan = Scan(0, np.sqrt(rng.uniform(0.0, 25.0, 5000)), rng.uniform(-np.pi, np.pi, 5000), 0.0, 5.0)
    found = scores(None, mapped=((scan, np.zeros(3)),))
    assert found["wall_thickness_m"].value is None
    assert found["wall_thickness_m"].reason.endswith("of the hits lie along a wall")


@pytest.mark.parametrize("thick", [2, 3, 4])
def test_a_square_room_has_four_corners_and_a_second_copy_adds_four(thick: int) -> None:
    one = square(60, thick)
    assert len(corners.find_corners(grid(one))) == 4
    two = np.concatenate([one, one])
    assert len(corners.find_corners(grid(two))) == 8
    assert len(corners.find_corners(grid(np.pad(one, 13)))) == 4
    assert len(corners.find_corners(grid(band(thick) & False))) == 0


def test_slivers_between_wall_copies_count_without_the_room_and_the_border() -> None:
    occupied = square(60, 2) | np.roll(square(60, 2), 6, axis=1)
    free = np.zeros_like(occupied)
    free[52:108, 52:116] = ~occupied[52:108, 52:116]
    free[0, :10] = True
    # one sliver on each side of the room, 4 columns wide and 56 rows high; the room is 50 columns wide
    assert consistency.find_enclosed_areas(grid(occupied, free)).tolist() == [224, 224]
    found = scores(grid(occupied, free))
    assert found["enclosed_areas"].value == 2
    assert found["enclosed_m2"].value == pytest.approx(2 * 224 * 0.05**2)


def test_unknown_cells_enclose_an_area_and_three_cells_are_not_an_area() -> None:
    free = np.zeros((30, 30), np.bool_)
    free[2:12, 2:12] = True
    free[20, 4:8] = True
    free[25, 4:7] = True
    occupied = np.zeros_like(free)
    occupied[2, 2] = True
    assert consistency.find_enclosed_areas(grid(occupied, free & ~occupied)).tolist() == [4]


def test_occupied_share_excludes_unknown_cells() -> None:
    occupied, free = band(1), np.zeros((60, 200), np.bool_)
    free[30:33] = True
    found = scores(grid(occupied, free))["occupied_percent"]
    assert (found.value, found.support) == (pytest.approx(25.0), 800)  # 200 of 800 known cells


def wall_scan(distance_m: float) -> tuple[Scan, Floats]:
    """Return 200 hits on a wall across x, seen from the lower left, and the sensor position."""
    y = np.linspace(-1.0, 1.0, 200)
    scan = Scan(0, np.hypot(distance_m, y), np.arctan2(y, distance_m), 0.0, 20.0)
    return scan, np.array([0.5, 1.5, 0.0])


def test_hits_in_free_space_of_the_other_half_are_violations() -> None:
    # the wall is at x = 3.0; half of the hits of the second half are 0.5 m in front of it
    occupied = np.zeros((60, 80), np.bool_)
    occupied[:, 60] = True
    half = grid(occupied)
    mapped = (wall_scan(2.525), wall_scan(2.525), wall_scan(2.525), wall_scan(2.025))
    found = scores(half, half, half, mapped)["cleared_percent"]
    assert found == Score(25.0, 800)


def test_hits_slightly_in_front_of_the_wall_of_the_other_half_are_noise() -> None:
    occupied = np.zeros((60, 80), np.bool_)
    occupied[:, 60] = True  # centres at x = 3.025
    half = grid(occupied)
    for distance_m, violations in ((2.43, 0.0), (2.42, 25.0)):  # hits at 2.93 and 2.92
        mapped = (wall_scan(2.525), wall_scan(2.525), wall_scan(2.525), wall_scan(distance_m))
        assert scores(half, half, half, mapped)["cleared_percent"].value == violations


def test_halves_without_common_area_have_no_violation_score() -> None:
    nowhere = OccupancyGrid(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.bool_), 0.05, 0.0, 0.0)
    found = scores(grid(band(1)), nowhere, grid(band(1)), (wall_scan(2.5), wall_scan(2.5)))
    assert found["cleared_percent"].reason == "the two halves of the run observed almost no common places"
    assert found["split_distance_m"].reason == "the two halves of the run observed almost no common places"
    both = scores(grid(band(1)), grid(band(1)), grid(band(1)), (wall_scan(2.5), wall_scan(15.0)))
    assert both["cleared_percent"].support == 200  # only the first half lies in the map of the other


@pytest.mark.parametrize("missing", [0, 1])
def test_both_halves_need_a_map(missing: int) -> None:
    halves = [None if index == missing else grid(band(1)) for index in range(2)]
    found = scores(grid(band(1)), *halves, mapped=(wall_scan(2.5), wall_scan(2.5)))
    for name in ("cleared_percent", "split_distance_m"):
        assert found[name] == Score(None, 0, "the two halves of the run have no maps")


def test_only_observed_cells_of_the_other_map_below_minus_one_are_free_space() -> None:
    """One hit in each of four cells: at the limit, below it, not observed, and outside the grid."""
    log_odds = np.array([[-1.0, -1.01, -5.0]], np.float32)
    other = OccupancyGrid(log_odds, np.array([[True, True, False]]), 1.0, 10.0, 20.0)
    hits = np.array([[10.5, 20.5], [11.5, 20.5], [12.5, 20.5], [13.5, 20.5]])
    assert consistency.cleared_share(hits, other) == (0.5, 2)
    assert consistency.cleared_share(hits[2:], other) == (0.0, 0)


def test_responses_above_the_threshold_equal_those_with_all_products_smoothed() -> None:
    rng = np.random.default_rng(0)
    x, y = (ndimage.gaussian_filter(rng.normal(0.0, 0.3, (90, 110)), 1.0).astype(np.float32) for _ in range(2))
    xx, xy, yy = (ndimage.gaussian_filter(product, 1.5)[6:-6, 6:-6] for product in (x * x, x * y, y * y))
    expected = xx * yy - xy * xy - 0.05 * (xx + yy) ** 2
    above = expected > corners.MIN_RESPONSE
    found = corners._compute_responses(x, y)
    assert all(border.any() for border in (above[0], above[-1], above[:, 0], above[:, -1]))
    assert 4096 < np.count_nonzero(above) < above.size  # more than one block
    np.testing.assert_allclose(found[above], expected[above], rtol=1e-5)  # sums in single precision
    assert (found[~above] <= corners.MIN_RESPONSE * 1.00001).all()


@pytest.mark.parametrize(("resolution_m", "walls"), [(0.004, 3), (0.03, 100), (0.05, 100), (0.3, 600)])
def test_the_share_of_hits_in_free_space_equals_brute_force(resolution_m: float, walls: int) -> None:
    rng = np.random.default_rng(0)
    log_odds = np.full((60, 70), -3.0, np.float32)
    log_odds.flat[rng.choice(log_odds.size, walls, replace=False)] = 3.0
    other = OccupancyGrid(log_odds, np.ones(log_odds.shape, np.bool_), resolution_m, -0.4, 0.7)
    hits = np.array([-0.4, 0.7]) + rng.uniform(0.0, 1.0, (3000, 2)) * resolution_m * np.array([70.0, 60.0])
    free = consistency.look_up_cells(hits, other)[0] < 0.0
    apart = np.linalg.norm(hits[:, None] - other.centres(other.occupied())[None], axis=2).min(axis=1)
    assert 100 < np.count_nonzero(free & (apart > 0.1)) < 2900
    assert consistency.cleared_share(hits, other) == (np.count_nonzero(free & (apart > 0.1)) / 3000, 3000)


def test_cells_are_looked_up_up_to_the_edges_of_the_grid() -> None:
    """A grid of one cell from (10, 20) to (11, 21)."""
    one = OccupancyGrid(np.array([[3.0]], np.float32), np.array([[True]]), 1.0, 10.0, 20.0)
    points = np.array([[10.0, 20.0], [10.99, 20.99], [9.99, 20.5], [11.0, 20.5], [10.5, 19.99], [10.5, 21.0]])
    assert consistency.look_up_cells(points, one)[1].tolist() == [True, True, False, False, False, False]
    assert consistency.look_up_cells(points, one)[0][:2].tolist() == [3.0, 3.0]


def test_halves_shifted_by_three_cells_are_fifteen_centimetres_apart() -> None:
    first, second = grid(band(1)), grid(np.roll(band(1), 3, axis=0))
    assert scores(first, first, second)["split_distance_m"].value == pytest.approx(0.15)


def test_a_missing_map_gives_every_metric_a_reason() -> None:
    nothing = scores(None)
    assert all(score.value is None and score.reason for score in nothing.values())
    unseen = OccupancyGrid(np.zeros((3, 3), np.float32), np.zeros((3, 3), np.bool_), 0.05, 0.0, 0.0)
    assert scores(unseen)["map_entropy"].reason == "the map has no occupied or no free cell"


@pytest.mark.parametrize("lacking", [0, 1])
def test_the_least_number_of_common_places_is_enough(monkeypatch: pytest.MonkeyPatch, lacking: int) -> None:
    count = consistency.MIN_SHARED - lacking
    monkeypatch.setattr(consistency, "split_distances", lambda *_: np.full(count, 0.2))
    found = scores(grid(band(1)), grid(band(1)), grid(band(1)))["split_distance_m"]
    assert (found.value, found.support) == (None if lacking else pytest.approx(0.2), count)


def test_the_entropy_of_certain_cells_is_zero() -> None:
    certain = np.array([[1000.0, -1000.0]], np.float32)
    found = consistency.map_entropy(OccupancyGrid(certain, np.ones((1, 2), np.bool_), 0.05, 0.0, 0.0))
    assert found == pytest.approx(0.0, abs=1e-9)


def test_without_a_hit_the_thickness_has_no_sample() -> None:
    assert scores(grid(band(1)))["wall_thickness_m"] == Score(None, 0, consistency.NO_HIT)
