"""Entropies of clouds and of directions: closed forms for Gaussians, doubled walls and bundles of directions."""

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.metrics import clouds
from evalkit.metrics.consistency import NO_OVERLAP, sample_neighbourhoods
from evalkit.metrics.metric import Evidence
from evalkit.metrics.neighbourhoods import compute_neighbourhoods


def compute_scores(mapped):
    evidence = Evidence(RunResult(np.zeros(0, STEP), 0), Truth("none"), mapped=mapped)
    return {metric.name: metric.compute(evidence) for metric in clouds.METRICS}


def make_wall(sigma_m, count=20_000, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(0.0, 20.0, count), rng.normal(0.0, sigma_m, count)])


def average_entropies(points):
    return clouds.average_entropies(sample_neighbourhoods(points))


def make_scan(points):
    ranges, angles = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    return Scan(0, ranges, angles, 0.0, 100.0), np.zeros(3)


def test_entropy_equals_the_closed_form_of_a_gaussian() -> None:
    points = np.random.default_rng(1).normal(0.0, [0.2, 0.05], (3000, 2))
    found = compute_neighbourhoods(points, np.zeros((1, 2)), 9.0)
    values, enough = clouds.entropies(found)
    expected = 0.5 * np.log(np.linalg.det(2.0 * np.pi * np.e * np.cov(points.T, bias=True)))
    assert values[0] == pytest.approx(expected)
    assert enough.tolist() == [True]


def test_a_wall_e_times_as_thick_has_one_more_nat_of_entropy() -> None:
    thin, thick = (average_entropies(make_wall(sigma))[0] for sigma in (0.01, 0.01 * np.e))
    assert thick - thin == pytest.approx(1.0, abs=0.01)


def test_entropy_is_the_same_in_every_frame() -> None:
    points = make_wall(0.03)
    here, moved = (average_entropies(cloud)[0] for cloud in (points, se2.transform([3.0, -1.0, 0.7], points)))
    assert moved == pytest.approx(here)


@pytest.mark.parametrize("apart_m", [0.0, 0.05, 0.2])
def test_a_second_wall_adds_the_entropy_of_the_combined_variance(apart_m) -> None:
    sigma = 0.03
    first, second = make_wall(sigma, 8000), np.add(make_wall(sigma, 8000, seed=1), [0.0, apart_m])
    added, places = clouds.joint_minus_separate(first, second)
    assert added == pytest.approx(0.5 * np.log(1.0 + apart_m**2 / (4.0 * sigma**2)), abs=0.05)
    assert places == 1000


def test_walls_without_common_area_are_not_scored() -> None:
    assert clouds.joint_minus_separate(make_wall(0.03, 500), np.add(make_wall(0.03, 500), [0.0, 5.0])) == (0.0, 0)


def test_evenly_spread_directions_have_the_entropy_of_half_a_turn() -> None:
    assert clouds.direction_entropy(np.linspace(0.0, np.pi, 5000, endpoint=False)) == pytest.approx(np.log(np.pi))


@pytest.mark.parametrize("turn", [0.0, 0.3, 3.1])
def test_two_bundles_of_directions_have_the_entropy_of_their_widths(turn) -> None:
    width = np.radians(30.0)
    bundle = np.random.default_rng(0).uniform(0.0, width, 4000)
    both = np.concatenate([bundle, bundle + np.pi / 2.0]) + turn
    assert clouds.direction_entropy(both) == pytest.approx(np.log(2.0 * width), abs=0.08)


def test_rotated_scans_increase_the_entropy_of_wall_directions() -> None:
    scan, _ = make_scan(np.column_stack([np.linspace(-3.0, 3.0, 400), np.full(400, 2.0)]))
    still = tuple((scan, np.zeros(3)) for _ in range(30))
    turning = tuple((scan, np.array([0.0, 0.0, turn])) for turn in np.radians(np.linspace(-10.0, 10.0, 30)))
    one, other = (compute_scores(mapped)["direction_spread_nat"] for mapped in (still, turning))
    assert one.value == pytest.approx(0.5 * np.log(2.0 * np.pi * np.e) + np.log(np.radians(1.0)), abs=1e-3)
    assert other.value == pytest.approx(np.log(np.radians(20.0)), abs=0.15)
    assert one.support == other.support > 1000


def test_missing_hits_give_a_reason() -> None:
    found = compute_scores(())
    assert found["mme_nat"].reason == found["coral_nat"].reason == "no mapped scan has a hit"
    assert found["direction_spread_nat"].reason == "the scans contain 0 pieces of wall, at least 100 are needed"
    lonely = tuple(make_scan(np.array([[5.0 * k, 1.0], [5.0 * k + 2.0, 2.0]])) for k in range(1, 5))
    assert compute_scores(lonely)["mme_nat"].reason == "only 0 % of the hits have 5 others within 0.5 m"


@pytest.mark.parametrize("turn", [1, -1])
def test_a_half_without_hits_is_told_from_one_without_common_places(turn) -> None:
    wall, none, one = (make_scan(points) for points in (make_wall(0.01, 500) + 1.0, np.zeros((0, 2)), np.ones((1, 2))))
    assert compute_scores((wall, none)[::turn])["coral_nat"].reason == "no mapped scan has a hit"
    assert compute_scores((wall, one)[::turn])["coral_nat"].reason == NO_OVERLAP


def test_a_share_of_hits_at_the_limit_is_enough(monkeypatch) -> None:
    mapped = (make_scan(make_wall(0.01, 500) + 1.0),)
    for share, scored in ((clouds.MIN_SHARE, True), (np.nextafter(clouds.MIN_SHARE, 0.0), False)):
        monkeypatch.setattr(clouds, "average_entropies", lambda _, share=share: (1.0, 500, share))
        assert (compute_scores(mapped)["mme_nat"].value is not None) == scored


def test_only_neighbourhoods_of_five_points_have_an_entropy_of_at_least_a_millimetre():
    """A line of hits 1 cm apart with a lonely pair beside it: 1/2 ln(2 pi e)^2 s2 of 1 mm and of the length."""
    line = np.column_stack([np.arange(11) * 0.01, np.zeros(11)])
    value, places, share = average_entropies(np.concatenate([line, [[9.0, 0.0], [9.01, 0.0]]]))
    expected = np.log(2.0 * np.pi * np.e) + np.log(1e-3) + 0.5 * np.log(np.var(line[:, 0]))
    assert (value, places, share) == (pytest.approx(expected), 11, pytest.approx(11 / 13))
    assert average_entropies(line[:4]) == (0.0, 0, 0.0)


@pytest.mark.parametrize(("count", "enough"), [(50, True), (49, False)])
def test_a_hundred_common_places_and_pieces_of_wall_are_enough(count, enough):
    wall = np.column_stack([np.linspace(1.0, 2.0, count), np.full(count, 1.0)])
    found = compute_scores((make_scan(wall), make_scan(wall)))
    assert found["coral_nat"].support == 2 * count
    assert (found["coral_nat"].value is not None) == enough
    if enough:
        assert found["coral_nat"].value == pytest.approx(0.0, abs=1e-9)
    pieces = compute_scores(tuple(make_scan(wall[:20]) for _ in range(5)))["direction_spread_nat"]
    assert (pieces.value is not None, pieces.support) == (True, 100)
    fewer = (*(make_scan(wall[:20]) for _ in range(4)), make_scan(wall[:19]))
    assert compute_scores(fewer)["direction_spread_nat"] == Score(
        None, 99, "the scans contain 99 pieces of wall, at least 100 are needed"
    )
