"""Residuals between scans: known distances, brute force, and values reported by back ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.core.se2 import Floats
from evalkit.metrics import registration
from evalkit.metrics.metric import Evidence, PlacedScans

ANGLES = np.linspace(-np.pi, np.pi, 400, endpoint=False)


def scan_room(x: float, y: float, theta: float, half_m: float = 3.0) -> Scan:
    """Return the scan of an ideal lidar at a pose in a square room around the origin."""
    cos, sin = np.cos(ANGLES + theta), np.sin(ANGLES + theta)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0.0, half_m - x, -half_m - x) / cos
        to_y = np.where(sin > 0.0, half_m - y, -half_m - y) / sin
    return Scan(0, np.minimum(to_x, to_y), ANGLES, 0.0, 20.0)


def map_scans(poses: Floats, shown: Floats | None = None) -> PlacedScans:
    """Map scans taken at poses (N, 3) as if taken at the poses ``shown`` (N, 3)."""
    return tuple(
        (scan_room(*pose), place) for pose, place in zip(poses, poses if shown is None else shown, strict=True)
    )


def scores(mapped: PlacedScans, steps: NDArray[np.void] | None = None) -> dict[str, Score]:
    record = np.zeros(0, STEP) if steps is None else steps
    run = RunResult(record, len(record))
    evidence = Evidence(run, Truth("exact"), mapped=mapped, successive=tuple(pairwise(mapped)))
    return {metric.name: metric.compute(evidence) for metric in registration.METRICS}


def test_each_target_keeps_only_its_closest_source() -> None:
    source = np.array([[0.0, 0.1], [0.0, 0.2], [1.0, 0.3], [5.0, 5.0]])
    target = cKDTree([[0.0, 0.0], [1.0, 0.0], [9.0, 9.0]])
    assert registration.keep_one_to_one(*registration.find_nearest(source, target)) == pytest.approx([0.1, 0.3])


def test_one_to_one_pairs_equal_brute_force() -> None:
    rng = np.random.default_rng(0)
    source, target = rng.uniform(size=(60, 2)), rng.uniform(size=(40, 2))
    distances = np.linalg.norm(source[:, None] - target[None], axis=2)
    best = {}
    for row in distances:
        column = int(row.argmin())
        if row[column] < 0.05:
            best[column] = min(best.get(column, np.inf), row[column])
    found = registration.keep_one_to_one(*registration.find_nearest(source, cKDTree(target), 0.05))
    assert sorted(found) == pytest.approx(sorted(best.values()))
    assert len(found) > 5


def test_a_scan_registered_on_itself_has_no_residual_in_any_frame() -> None:
    poses = np.tile([0.3, -0.2, 0.7], (5, 1))
    elsewhere = se2.compose([5.0, 1.0, 2.0], poses)
    for mapped in (map_scans(poses), map_scans(poses, elsewhere)):
        found = scores(mapped)
        assert found["s2s_m"].value == pytest.approx(0.0, abs=1e-9)
        assert found["s2m_m"].value == pytest.approx(0.0, abs=1e-9)
        assert found["s2m_paired_percent"].value == 100.0


def test_the_residual_grows_with_the_error_of_the_estimate() -> None:
    poses = np.column_stack([np.linspace(-1.0, 1.0, 21), np.zeros(21), np.linspace(0.0, 0.5, 21)])
    residuals = []
    for sigma in (0.0, 0.03, 0.1):
        noise = np.random.default_rng(0).normal(0.0, sigma, poses.shape) * [1, 1, 0]
        found = scores(map_scans(poses, poses + noise))
        residuals.append((found["s2s_m"].value, found["s2m_m"].value))
    assert residuals == sorted(residuals)
    assert residuals[2][1] > 2.0 * residuals[0][1]  # type: ignore[operator]


def test_a_wall_mapped_three_centimetres_off_has_a_residual_of_three_centimetres() -> None:
    angles = np.radians([-1.0, -0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0])
    wall = Scan(0, 2.0 / np.cos(angles), angles, 0.0, 20.0)
    steps = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.0, 0, 0]])
    assert scores(tuple((wall, pose) for pose in steps))["s2s_m"].value == pytest.approx(0.03, abs=1e-6)


def test_keyframes_are_half_a_metre_or_twenty_degrees_apart() -> None:
    straight = np.column_stack([np.arange(0, 2.05, 0.25), np.zeros((9, 2))])
    assert registration.find_keyframes(straight).tolist() == [0, 2, 4, 6, 8]
    turning = np.column_stack([np.zeros((9, 2)), np.radians(np.arange(0, 85, 10.0) * 1.001)])
    assert registration.find_keyframes(turning).tolist() == [0, 2, 4, 6, 8]


def test_scans_too_far_apart_or_too_few_give_a_reason() -> None:
    far = np.array([[0.0, 0, 0], [2.5, 0, 0], [0.0, 0, 0]])
    found = scores(map_scans(far))
    assert found["s2s_m"].reason == "successive scans are 2.5 m apart: too far to overlap"
    assert found["s2m_m"].reason == "mapped scans are 2.5 m apart: too far to overlap"
    assert scores(())["s2s_m"].reason == "no two successive scans have poses"
    assert scores(())["s2m_m"].reason == "fewer than two mapped scans"
    near = np.array([[0.0, 0, 0], [0.1, 0, 0]])
    nowhere = map_scans(near, np.array([[0.0, 0, 0], [1.5, 1.5, 0.4]]))
    assert scores(nowhere)["s2s_m"].reason == "successive scans are 2.1 m apart: too far to overlap"


def test_reported_residuals_are_passed_on_and_missing_ones_give_a_reason() -> None:
    steps = np.zeros(5, STEP)
    steps["s2s_error"] = [np.nan, 0.01, 0.02, 0.03, 0.5]
    steps["s2s_iterations"] = [0, 1, 5, 6, 9]
    steps["s2m_error"] = np.nan
    found = scores((), steps)
    assert found["own_s2s_m"] == Score(0.025, 4)
    assert found["s2s_iterations"] == Score(5.5, 4)
    assert found["own_s2m_m"].reason == "not reported by the back end"
    assert found["s2m_iterations"].reason == "not reported by the back end"


def test_the_last_stage_with_a_residual_provides_the_residual_of_the_guess() -> None:
    steps = np.zeros(5, STEP)
    steps["s2s_accepted"] = steps["s2s_converged"] = [-1, 0, 0, 0, 1]
    steps["s2m_accepted"] = [-1, 1, 1, 1, 0]
    steps["s2m_converged"] = -1
    found = scores((), steps)
    assert found["guess_kept_percent"] == Score(25.0, 4)
    assert found["not_converged_percent"] == Score(75.0, 4)


def test_a_scan_meets_the_ten_keyframes_before_it() -> None:
    """Scans of one point a metre apart, each seen at its own place: the local map holds the last ten before a scan."""
    point = Scan(0, np.array([0.001]), np.array([0.0]), 0.0, 20.0)
    mapped = tuple((point, np.array([float(k), 0.0, 0.0])) for k in range(14))
    for index, (source, tree) in enumerate(registration._iterate_local_maps(mapped), start=1):
        assert source.tolist() == [[index + 0.001, 0.0]]
        assert tree.data[:, 0].tolist() == pytest.approx([k + 0.001 for k in range(max(index - 10, 0), index)])


@pytest.mark.parametrize(("count", "enough"), [(10, True), (9, False)])
def test_a_residual_needs_ten_pairs_and_successive_scans_at_most_two_metres_apart(count: int, enough: bool) -> None:
    angles = np.linspace(-0.5, 0.5, count)
    few = Scan(0, np.full(count, 5.0), angles, 0.0, 20.0)
    still = scores(tuple((few, np.zeros(3)) for _ in range(3)))
    for name, support in (("s2s_m", 2), ("s2m_m", 2)):
        reason = "no scan has 10 pairs within 0.5 m"
        assert still[name] == (Score(0.0, support) if enough else Score(None, reason=reason))
    assert still["s2m_paired_percent"] == Score(100.0, 2)
    apart = scores(map_scans(np.array([[-1.0, 0, 0], [1.0, 0, 0]])))
    assert apart["s2s_m"].support == apart["s2m_m"].support == 1  # 2 m, not farther
