"""Landmark metrics: OSPA by hand and by brute force, and signed wall offsets of known size."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.metrics import landmarks
from evalkit.metrics.metric import NO_POSES, Evidence, MissingMap

SETS = st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)), max_size=4).map(
    lambda points: np.array(points).reshape(-1, 2)
)


def test_ospa_of_small_sets_equals_the_hand_calculation() -> None:
    corners = [[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]]
    assert landmarks.ospa(corners, corners[::-1]) == 0.0
    assert landmarks.ospa(corners, corners[:2]) == pytest.approx(0.5 / 3)  # one point is missing
    moved = [[0.3, 0.0], [4.0, 0.0], [9.0, 3.0]]
    assert landmarks.ospa(corners, moved) == pytest.approx(
        (0.3 + 0.0 + 0.5) / 3
    )  # a point far away costs as much as a missing one
    assert landmarks.ospa(corners, moved, 1.0, 2.0) == pytest.approx(np.sqrt((0.09 + 1.0) / 3))
    assert landmarks.ospa([], corners) == 0.5
    assert landmarks.ospa([], []) == 0.0


@given(SETS, SETS)
def test_ospa_is_a_distance_and_the_minimum_over_all_assignments(one, other) -> None:
    found = landmarks.ospa(one, other)
    short, long = sorted((one, other), key=len)
    if len(long):
        costs = np.minimum(np.linalg.norm(short[:, None] - long[None], axis=2), 0.5).reshape(len(short), len(long))
        best = min(sum(costs[i, j] for i, j in enumerate(p)) for p in permutations(range(len(long)), len(short)))
        assert found == pytest.approx((best + 0.5 * (len(long) - len(short))) / len(long))
    assert found == pytest.approx(landmarks.ospa(other, one))
    assert 0.0 <= found <= 0.5


@given(SETS, SETS, SETS)
def test_ospa_satisfies_the_triangle_inequality(one, two, three) -> None:
    assert landmarks.ospa(one, three) <= landmarks.ospa(one, two) + landmarks.ospa(two, three) + 1e-9


def square(side_m=4.0, resolution_m=0.01):
    """Return the walls of a square room around the origin, one cell thick."""
    cells = round(side_m / resolution_m) + 1
    occupied = np.zeros((cells, cells), np.bool_)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    log_odds = np.where(occupied, 5.0, -5.0).astype(np.float32)
    corner = -0.5 * side_m - 0.5 * resolution_m
    return OccupancyGrid(log_odds, np.ones_like(occupied), resolution_m, corner, corner)


def scan(side_m, count=1000):
    """Return a scan of a square room from its centre."""
    angles = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    ranges = 0.5 * side_m / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))
    return Scan(0, ranges, angles, 0.0, 20.0), np.zeros(3)


def scores(mapped, true, grid=None):
    run = RunResult(np.zeros(0, STEP), 0)
    evidence = Evidence(run, Truth("exact", grid=true), grid=grid or MissingMap(NO_POSES), mapped=mapped)
    return {metric.name: metric.compute(evidence) for metric in landmarks.METRICS}


@pytest.mark.parametrize("off_m", [-0.1, -0.03, 0.03, 0.1])
def test_a_room_mapped_too_large_has_its_walls_behind_the_true_walls(off_m: float) -> None:
    found = scores((scan(4.0 + 2.0 * off_m),), square())["map_wall_offset_m"]
    assert found.value == pytest.approx(off_m, abs=0.005)
    assert found.support == 1000


@pytest.mark.parametrize(("count", "enough"), [(100, True), (99, False)])
def test_an_offset_needs_a_hundred_hits_within_half_a_metre(count: int, enough: bool) -> None:
    found = scores((scan(4.0, count),), square())["map_wall_offset_m"]
    assert (found.value is not None, found.support) == (enough, count)
    assert scores((scan(4.96),), square())["map_wall_offset_m"].support > 500  # 0.48 m behind
    assert scores((scan(5.04),), square())["map_wall_offset_m"].support == 0


def test_cells_far_from_every_true_wall_have_no_signed_offset() -> None:
    assert scores((scan(8.0),), square())["map_wall_offset_m"].reason.startswith("only 0 hits are within 0.5 m")
    assert scores((), square())["map_wall_offset_m"].reason == "no mapped scan has a hit"


def test_the_corners_of_the_true_map_are_at_their_known_positions() -> None:
    room = np.zeros((120, 120), np.bool_)
    room[20:100, 20:23] = room[20:100, 97:100] = room[20:23, 20:100] = room[97:100, 20:100] = True
    grid = OccupancyGrid(np.where(room, 5.0, -5.0).astype(np.float32), np.ones_like(room), 0.05, -1.0, 2.0)
    moved = OccupancyGrid(grid.log_odds, grid.observed, 0.05, -0.9, 2.0)
    assert scores((), grid, grid)["map_corner_ospa_m"].value == 0.0
    assert scores((), grid, moved)["map_corner_ospa_m"].value == pytest.approx(0.1)
    assert scores((), grid, moved)["map_corner_ospa_m"].support == 8
    blank = OccupancyGrid(np.full((9, 9), -5.0, np.float32), np.ones((9, 9), np.bool_), 0.05, 0.0, 0.0)
    assert scores((), blank, grid)["map_corner_ospa_m"] == Score(None, 4, "the ground-truth map has no corner")
    assert scores((scan(4.0),), blank)["map_wall_offset_m"].reason == "the ground-truth map has no wall"
    assert scores((scan(4.0),), None)["map_wall_offset_m"].reason == "no ground-truth map"
    inner = np.array([(x, y) for x in (0.15, 3.85) for y in (3.15, 6.85)])
    assert landmarks.ospa(landmarks.find_corners(grid), inner) < 0.05
