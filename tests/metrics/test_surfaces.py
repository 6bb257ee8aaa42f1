"""Wall pieces under all scans: closed forms for two faces, double walls and walls at right angles."""

import numpy as np
import pytest
from scipy import ndimage

from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
from evalkit.core.scan import Scan
from evalkit.metrics import surfaces
from evalkit.metrics.metric import Evidence
from evalkit.metrics.neighbourhoods import build_kd_tree, compute_neighbourhoods
from evalkit.metrics.surfaces import WallPieces


def scores(mapped):
    evidence = Evidence(RunResult(np.zeros(0, STEP), 0), Truth("none"), mapped=mapped)
    return {metric.name: metric.compute(evidence) for metric in surfaces.METRICS}


def make_scan(points, sensor=(0.0, 0.0)):
    """Return a scan that hits the given points of the world, and the pose of its sensor."""
    offsets = points - np.asarray(sensor)
    ranges, angles = np.hypot(*offsets.T), np.arctan2(offsets[:, 1], offsets[:, 0])
    return Scan(0, ranges, angles, 0.0, 100.0), np.array([*sensor, 0.0])


def along_x(length_m, y, sigma_m=0.005, seed=0, count_a_metre=100):
    rng = np.random.default_rng(seed)
    count = round(length_m * count_a_metre)
    return np.column_stack([np.sort(rng.uniform(0.0, length_m, count)), rng.normal(y, sigma_m, count)])


def test_a_wall_doubled_over_half_its_length_has_a_ghost_share_of_one_half() -> None:
    once = [make_scan(along_x(20.0, 3.0, seed=seed), (10.0, 0.0)) for seed in range(20)]
    again = [make_scan(along_x(10.0, 3.2, seed=seed), (10.0, 0.0)) for seed in range(20, 40)]
    found = scores((*once, *again))
    assert found["ghost_wall_percent"].value == pytest.approx(50.0, abs=5.0)
    assert found["ghost_wall_m"].value == pytest.approx(0.20, abs=0.011)
    alone = scores(tuple(once))
    assert alone["ghost_wall_percent"].value == 0.0
    assert alone["ghost_wall_m"].reason == "no wall has a second copy"


def test_the_other_face_of_a_wall_is_not_a_ghost() -> None:
    faces = make_scan(along_x(20.0, 3.0), (10.0, 0.0)), make_scan(along_x(20.0, 3.2), (10.0, 6.0))
    assert scores(faces)["ghost_wall_percent"].value == 0.0


@pytest.mark.parametrize(("apart_m", "copied"), [(0.04, 0.0), (0.15, 100.0), (0.45, 100.0), (0.7, 0.0)])
def test_near_copies_are_noise_and_far_copies_are_other_walls(apart_m: float, copied: float) -> None:
    both = [make_scan(along_x(20.0, y, seed=round(100 * y)), (10.0, 0.0)) for y in (3.0, 3.0 + apart_m)]
    assert scores(tuple(both))["ghost_wall_percent"].value == pytest.approx(copied, abs=3.0)


def test_smearing_alone_is_not_a_ghost() -> None:
    rng = np.random.default_rng(3)
    smeared = [
        make_scan(along_x(20.0, 3.0 + shift, seed=i), (10.0, 0.0)) for i, shift in enumerate(rng.normal(0, 0.05, 40))
    ]
    assert scores(tuple(smeared))["ghost_wall_percent"].value == pytest.approx(0.0, abs=5.0)


def test_orthogonal_walls_add_their_variances_and_oblique_walls_do_not_count() -> None:
    level = along_x(20.0, 5.0, 0.03, count_a_metre=200)
    upright = along_x(20.0, -5.0, 0.01, 1, count_a_metre=200)[:, ::-1]
    turn = np.radians(45.0)
    slanted = along_x(5.0, 0.0, 0.05, 2) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    found = scores(tuple(make_scan(points + np.full(2, 30.0), (20.0, 32.0)) for points in (level, upright, slanted)))
    assert found["mom_cm2"].value == pytest.approx(9.0 + 1.0, rel=0.1)
    assert found["mpv_cm2"].value == pytest.approx(np.average([9.0, 1.0, 25.0], weights=[4000, 4000, 500]), rel=0.15)


def test_the_families_are_the_two_orthogonal_directions_with_most_pieces() -> None:
    directions = np.radians([0.0] * 50 + [30.0] * 8 + [120.0] * 9 + [93.0] * 3)
    level, upright = surfaces.find_orthogonal_families(directions)
    assert {len(level), len(upright)} == {8, 9}


def test_mean_variance_equals_brute_force() -> None:
    points = np.random.default_rng(0).normal(0.0, [1.0, 0.3], (60, 2))
    middles = points
    small = []
    for middle in middles:
        near = points[np.linalg.norm(points - middle, axis=1) <= 0.5]
        if len(near) >= 5:
            small.append(np.linalg.eigvalsh(np.cov(near.T, bias=True))[0])
    value, places = surfaces.mean_variance(points, middles)
    assert (places, value) == (len(small), pytest.approx(np.mean(small)))
    assert (
        compute_neighbourhoods(points, middles).counts.min() < 5 < compute_neighbourhoods(points, middles).counts.max()
    )


def test_scans_without_walls_give_a_reason() -> None:
    nothing = scores((make_scan(np.zeros((0, 2))),))
    assert {score.reason for score in nothing.values()} == {"no mapped scan has a hit"}
    dots = scores((make_scan(np.random.default_rng(0).uniform(-3.0, 3.0, (50, 2))),))
    assert dots["mom_cm2"].reason == "single scans contain too few walls at right angles to each other"
    assert dots["ghost_wall_percent"].reason.startswith("single scans contain only")
    assert (
        len(
            surfaces.find_second_copies(
                np.zeros((0, 2)), np.zeros((0, 2)), WallPieces(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)))
            )
        )
        == 0
    )


@pytest.mark.parametrize("count", [0, 5])
def test_without_walls_in_two_directions_no_place_is_measured(count: int) -> None:
    parallel = WallPieces(np.zeros((count, 2)), np.zeros(count), np.zeros((count, 2)))
    variance, places = surfaces.orthogonal_variance(along_x(1.0, 0.0), parallel)
    assert np.isnan(variance)
    assert places == 0


def test_forty_pieces_of_each_of_a_hundred_scans_are_examined() -> None:
    wall = make_scan(along_x(2.0, 3.0, 0.0), (1.0, 0.0))
    found = surfaces.find_wall_pieces((wall,) * 101)
    assert len(found) == 100 * 40
    assert len(surfaces.find_wall_pieces((wall,) * 3)) == 3 * 40
    np.testing.assert_allclose(found.sensors, np.tile([1.0, 0.0], (4000, 1)))
    np.testing.assert_allclose(found.middles[:, 1], 3.0)
    np.testing.assert_allclose(np.sin(found.direction), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("away", "height", "valley", "found_m"),
    [(9, 0.9, 0.1, None), (10, 0.9, 0.1, 0.1), (50, 0.9, 0.1, 0.5), (51, 0.9, 0.1, None), (20, 0.26, 0.1, 0.2),
     (20, 0.24, 0.1, None), (20, 0.8, 0.4, 0.2), (20, 0.8, 0.41, None), (-30, 0.9, 0.1, 0.3)],
)  # fmt: skip
def test_a_second_copy_is_10_to_50_cm_away_a_quarter_as_high_and_apart_by_a_valley_of_half(
    away, height, valley, found_m
) -> None:
    """Bins of 1 cm; the highest peak has the density 1."""
    density = np.zeros(121)
    low, high = sorted((60, 60 + away))
    density[low : high + 1] = valley
    density[60], density[60 + away] = 1.0, height
    found = surfaces._find_second_mode(density)
    assert found == pytest.approx(found_m) if found_m else np.isnan(found)


def test_of_two_copies_the_higher_separate_one_counts_and_a_single_peak_has_none() -> None:
    density = np.zeros(121)
    density[[60, 75, 90]] = 1.0, 0.4, 0.6
    assert surfaces._find_second_mode(density) == pytest.approx(0.3)
    density[60:91] = 0.55
    density[[60, 90]], density[89] = 1.0, 0.1  # a valley beside the second peak, deep enough
    assert surfaces._find_second_mode(density) == pytest.approx(0.3)
    density[60:91] = 0.0
    density[60] = 1.0
    assert np.isnan(surfaces._find_second_mode(density))


def test_profiles_across_walls_are_those_of_a_plain_count() -> None:
    """Hits within 25 cm along each wall, seen from its own side, by the distance across towards the sensor in cm."""
    rng = np.random.default_rng(6)
    hits, sensors = rng.uniform(-1.0, 1.0, (3000, 2)), rng.uniform(-4.0, 4.0, (3000, 2))
    middles, directions = rng.uniform(-0.5, 0.5, (70, 2)), rng.uniform(0.0, np.pi, 70)
    own = rng.uniform(-4.0, 4.0, (70, 2))
    own[0] = middles[0]  # on the wall: its left side counts
    normals, expected = np.zeros((70, 2)), np.zeros((70, 121))
    for row in range(70):
        along = np.array([np.cos(directions[row]), np.sin(directions[row])])
        normals[row] = [-along[1], along[0]]
        normals[row] *= -1.0 if (own[row] - middles[row]) @ normals[row] < 0.0 else 1.0
        for hit, sensor in zip(hits - middles[row], sensors - middles[row], strict=True):
            at = round(float(hit @ normals[row]) * 100.0) + 60
            if abs(hit @ along) <= 0.25 and sensor @ normals[row] > 0.0 and 0 <= at <= 120:
                expected[row, at] += 1
    tree = build_kd_tree(hits)
    assert expected.sum() > 5000
    counts = surfaces._count_across(hits, sensors, tree, middles, normals)
    assert counts[:, 1:-1].tolist() == expected[:, 1:-1].tolist()  # the outermost bins are cut by a circle
    profiles = surfaces._compute_profiles(hits, sensors, WallPieces(middles, directions, own))
    smooth = ndimage.gaussian_filter1d(counts, 2.0, axis=1, mode="constant")
    np.testing.assert_allclose(profiles, smooth, atol=1e-12)


def short_walls(*counts, turned=False):
    """Return hits 5 cm apart on short walls along x, or ``turned`` along y, 4 m from each other."""
    walls = [[4.0 * wall + 0.05 * hit, 3.0] for wall, count in enumerate(counts) for hit in range(count)]
    return np.array(walls)[:, ::-1] if turned else np.array(walls)


@pytest.mark.parametrize(("last", "enough"), [((5, 5), True), ((9,), False)])
def test_twenty_places_are_enough_for_a_variance(last: tuple[int, ...], enough: bool) -> None:
    """20 or 19 hits are a place with five hits around it; at right angles to them are 20."""
    along, turned = short_walls(5, 5, *last), short_walls(5, 5, 5, 5, turned=True)
    for name, hits, places in (
        ("mpv_cm2", along, len(along)),
        ("mom_cm2", np.concatenate([along, turned]), len(along)),
    ):
        found = scores((make_scan(hits),))[name]
        assert (found.value, found.support) == (pytest.approx(0.0, abs=1e-9) if enough else None, places)


@pytest.mark.parametrize(("count", "enough"), [(20, True), (19, False)])
def test_twenty_stretches_of_wall_are_enough_for_a_share_of_copies(count: int, enough: bool) -> None:
    found = scores((make_scan(short_walls(*[5] * count)),))
    assert (found["ghost_wall_percent"].value, found["ghost_wall_percent"].support) == (0.0 if enough else None, count)
    reason = "no wall has a second copy" if enough else "single scans contain only 19 stretches of wall"
    assert found["ghost_wall_m"].reason == reason


def test_pieces_represent_a_stretch_of_25_cm_along_50_cm_across_and_10_degrees() -> None:
    """The first piece stands for those near it; each beyond one of the limits stands for itself."""
    level = [[0.0, 0.0], [0.24, 0.0], [0.26, 0.0], [0.0, 0.49], [-0.24, -0.49], [0.0, 0.6]]
    pieces = WallPieces(np.array(level), np.zeros(6), np.zeros((6, 2)))
    assert surfaces._choose_spaced(pieces).tolist() == [0, 2, 5]
    turned = WallPieces(np.zeros((4, 2)), np.radians([0.0, 9.9, 10.1, 170.1]), np.zeros((4, 2)))
    assert surfaces._choose_spaced(turned).tolist() == [0, 2]


@pytest.mark.parametrize(("degrees", "members"), [(9.9, 2), (10.1, 1)])
def test_a_family_of_walls_is_within_ten_degrees_of_its_direction(degrees: float, members: int) -> None:
    directions = np.radians([180.0 - degrees, degrees, 90.0 - degrees, 90.0 + degrees])
    assert [len(family) for family in surfaces.find_orthogonal_families(directions)] == [members, members]
