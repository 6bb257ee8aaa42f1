"""The ICP of the paper: closed form, pairs, stop rule, Table 1, and scans with nothing to match."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from evalkit.core import se2
from evalkit.core.errors import BadParameter
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import paper
from evalkit_baselines.paper import icp
from evalkit_baselines.paper.association import Association, CloudCache
from evalkit_baselines.paper.icp import MAX_SUPPORT, Icp, fit_to_lines, line_normals, share_noise

MOTION = Pose(0.12, -0.08, math.radians(5.0))


def corner():
    """Return an L of two walls, 3 m and 2 m, with a point every 2 cm: it has no symmetry to slide along."""
    long, short = np.arange(0.0, 3.0, 0.02), np.arange(0.02, 2.0, 0.02)
    walls = [np.stack([long, 0 * long], axis=1), np.stack([0 * short, short], axis=1)]
    return np.concatenate(walls)


def table_1_scene(seed):
    """Return 480 points of a room [0, 10]^2 with a circle, and the same moved by 30 deg and (4, 5) m, with noise."""
    along, none, all_ = np.linspace(0, 10, 70, endpoint=False), np.zeros(70), np.full(70, 10.0)
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    sides = [(along, none), (all_, along), (10 - along, all_), (none, 10 - along)]
    circle = (2 + 1.5 * np.cos(angle), 8 + 1.5 * np.sin(angle))
    room = np.concatenate([np.stack(part, axis=1) for part in (*sides, circle)])
    noise = np.random.default_rng(seed).normal(0.0, 0.0483, room.shape)
    return Cloud(room), Cloud(Pose(4.0, 5.0, math.radians(30.0)).inverse().transform(room) + noise)


def noisy_pair(seed=3):
    rng = np.random.default_rng(seed)
    target = corner() + rng.normal(0.0, 0.02, corner().shape)
    source = MOTION.inverse().transform(corner()) + rng.normal(0.0, 0.02, corner().shape)
    return Cloud(target), Cloud(source)


# closed form


def test_the_closed_form_equals_scipys_best_rotation():
    rng = np.random.default_rng(0)
    for _ in range(30):
        source = rng.normal(size=(15, 2))
        target = se2.transform(rng.uniform(-3, 3, 3), source) + rng.normal(0.0, 0.1, (15, 2))
        row = icp.fit_motion(source, target)
        p, q = (np.pad(points - points.mean(axis=0), ((0, 0), (0, 1))) for points in (source, target))
        best, _ = Rotation.align_vectors(q, p)
        np.testing.assert_allclose(se2.to_matrix(row)[:2, :2], best.as_matrix()[:2, :2], atol=1e-9)
        np.testing.assert_allclose(se2.transform(row, source).mean(axis=0), target.mean(axis=0), atol=1e-12)


def test_the_closed_form_equals_the_guarded_svd_of_equation_4():
    rng = np.random.default_rng(1)
    for _ in range(50):
        source, target = rng.normal(size=(2, 9, 2))
        K = (source - source.mean(axis=0)).T @ (target - target.mean(axis=0))
        U, _, Vt = np.linalg.svd(K)
        R = Vt.T @ np.diag([1.0, np.linalg.det(Vt.T @ U.T)]) @ U.T
        assert icp.fit_motion(source, target)[2] == pytest.approx(math.atan2(R[1, 0], R[0, 0]), abs=1e-9)


def test_equation_4_as_printed_rotates_in_the_wrong_direction():
    source = corner()
    target = Pose(0.0, 0.0, 0.3).transform(source)
    K = (source - source.mean(axis=0)).T @ (target - target.mean(axis=0))
    U, _, Vt = np.linalg.svd(K)
    printed = U @ Vt
    assert math.atan2(printed[1, 0], printed[0, 0]) == pytest.approx(-0.3)
    assert icp.fit_motion(source, target)[2] == pytest.approx(0.3)


def test_a_single_wall_is_never_mirrored():
    wall = np.stack([np.linspace(0, 2, 30), np.zeros(30)], axis=1)
    assert icp.fit_motion(wall, wall + np.array([0.0, 0.1])) == pytest.approx([0.0, 0.1, 0.0])


# pairs


def test_one_to_one_pairs_equal_brute_force():
    rng = np.random.default_rng(2)
    for _ in range(30):
        nearest = rng.integers(0, 12, 40)
        distance = rng.integers(0, 4, 40) / 4.0  # many ties
        kept = {}
        for row in range(40):
            best = kept.get(nearest[row])
            if best is None or distance[row] < distance[best]:
                kept[nearest[row]] = row
        assert icp.select_closest(nearest, distance, 12).tolist() == sorted(kept.values())


def test_one_to_one_pairs_of_empty_clouds_are_empty():
    assert icp.select_closest(np.empty(0, dtype=np.int64), np.empty(0), 5).size == 0


@pytest.mark.parametrize("limit", [math.inf, 0.1])
def test_cached_neighbours_equal_a_new_search(limit):
    rng = np.random.default_rng(4)
    targets, points = rng.uniform(0, 1, (200, 2)), rng.uniform(-0.3, 1.3, (300, 2))
    tree = cKDTree(targets)
    association = Association(tree, 300, limit)
    for size in (0.0, 0.3, 0.05, 0.01, 0.001, 0.001, 1e-5, 0.2, 0.0):
        points = points + rng.normal(0.0, size, points.shape)
        nearest, distance = association.find(points)
        fresh, expected = tree.query(points, distance_upper_bound=limit)
        np.testing.assert_allclose(distance, fresh, atol=1e-12)
        found = np.isfinite(fresh)
        assert (nearest[found] == np.asarray(expected)[found]).all()


def test_a_neighbour_is_kept_without_a_query_until_another_point_may_be_nearer():
    class Counting:
        def __init__(self, tree):
            self.data, self.tree, self.points = tree.data, tree, []

        def query(self, points, **kwargs):
            self.points += points[:, 0].tolist()
            return self.tree.query(points, **kwargs)

    tree = Counting(cKDTree([[0.0, 0.0], [1.0, 0.0]]))
    association = Association(tree, 1)
    for x in (0.1, -0.34, 0.49, 0.51):  # 0.1 from the one and 0.9 from the other; 0.34 + 0.44 and 0.49 + 0.39 are less
        association.find(np.array([[x, 0.0]]))
    assert tree.points == [0.1, 0.51]


def test_a_single_target_point_is_the_neighbour_of_every_point():
    nearest, distance = Association(cKDTree([[1.0, 0.0]]), 2).find(np.array([[0.0, 0.0], [1.0, 3.0]]))
    assert nearest.tolist() == [0, 0]
    assert distance.tolist() == [1.0, 3.0]


def test_an_index_is_built_once_per_cloud_object_and_again_for_an_equal_one():
    built, recent = [], CloudCache(size=2)
    a, b, c = (Cloud(corner()) for _ in range(3))
    for cloud in (a, b, a, c, a, b):
        recent.get(cloud, lambda cloud: built.append(cloud) or len(built))
    assert [["a", "b", "c"][[a, b, c].index(cloud)] for cloud in built] == ["a", "b", "c", "b"]


def test_the_trace_contains_pairs_only_if_enabled():
    target, source = noisy_pair()
    traced = Icp(trace=True).register(target, source, Pose()).history[-1]
    assert traced.pairs is not None
    assert traced.pairs.shape == (traced.inliers, 2)
    assert len(set(traced.pairs[:, 1].tolist())) == traced.inliers  # one to one
    assert Icp().register(target, source, Pose()).history[-1].pairs is None


# registration


def test_a_cloud_on_itself_gives_the_identity_after_two_iterations():
    match = Icp().register(Cloud(corner()), Cloud(corner()), Pose())
    assert match.target_from_source.row == pytest.approx([0, 0, 0], abs=1e-12)
    assert (match.converged, match.iterations, match.inliers) == (True, 2, len(corner()))
    assert match.error == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("parameters", "motion"),
    [
        (
            {},
            Pose(0.01, -0.007, math.radians(0.3)),
        ),  # point to point: within the point spacing, otherwise it may converge one point off
        ({"one_to_one": False}, Pose(0.01, -0.007, math.radians(0.3))),
        ({"metric": "line"}, MOTION),
        ({"metric": "line", "cauchy_m": 0.1}, MOTION),
    ],
)
def test_a_known_motion_of_a_noise_free_corner_is_recovered(parameters: dict[str, Any], motion):
    source = Cloud(motion.inverse().transform(corner()))
    match = Icp(epsilon=1e-12, max_iterations=300, **parameters).register(Cloud(corner()), source, Pose())
    assert match.converged
    assert match.target_from_source.row == pytest.approx(motion.row, abs=1e-6)


def test_a_moved_target_frame_moves_the_result_equally():
    target, source = noisy_pair()
    new_from_old = Pose(3.0, -7.0, 2.5)
    match = Icp().register(target, source, Pose())
    moved = Icp().register(Cloud(new_from_old.transform(target.points)), source, new_from_old)
    assert moved.iterations == match.iterations
    assert moved.target_from_source.row == pytest.approx((new_from_old @ match.target_from_source).row, abs=1e-9)
    assert moved.error == pytest.approx(match.error, abs=1e-9)


def test_cached_data_does_not_change_later_results():
    target, source = noisy_pair()
    other = Cloud(source.points + 0.05)
    registration = Icp()
    first = registration.register(target, source, Pose())
    registration.register(other, target, MOTION)
    again = registration.register(target, source, Pose())
    assert again.target_from_source == first.target_from_source
    assert [step.error for step in again.history] == [step.error for step in first.history]


def test_point_to_line_keeps_the_guess_along_a_single_wall():
    wall = np.stack([np.linspace(0, 4, 200), np.zeros(200)], axis=1)
    source = Cloud(wall[50:150] - np.array([0.0, 0.2]))
    match = Icp(metric="line", epsilon=1e-9).register(Cloud(wall), source, Pose(0.005, 0.0, 0.0))
    assert match.target_from_source.row == pytest.approx([0.005, 0.2, 0.0], abs=1e-9)


def test_the_cauchy_weight_reduces_the_influence_of_a_displaced_third():
    source = corner()
    target = source.copy()
    target[-80:] += [0.1, 0.0]
    plain = Icp(metric="line", epsilon=1e-9).register(Cloud(target), Cloud(source), Pose())
    robust = Icp(metric="line", epsilon=1e-9, cauchy_m=0.01).register(Cloud(target), Cloud(source), Pose())
    assert abs(robust.target_from_source.x) < 0.5 * abs(plain.target_from_source.x)


@pytest.mark.parametrize(("seen", "viewer", "behind"), [(-1.0, 2.0, True), (1.0, 2.0, False), (-1.0, -2.0, False)])
def test_a_face_of_a_thin_wall_has_no_pairs_with_the_other_face(seen, viewer, behind):
    """The lower face, y = 0, is in the map alone; a scan sees the upper one, y = 0.1, ``viewer`` m above the lower."""
    along = np.linspace(-3.0, 3.0, 61)
    ceiling, lower = (np.column_stack([along, np.full(61, y)]) for y in (4.0, 0.0))
    sides = np.concatenate([np.column_stack([np.full(61, x), along + 3.5]) for x in (-3.0, 3.0)])
    room = Cloud(
        np.concatenate([ceiling, sides, lower]),
        seen_from=np.repeat([[0.0, np.sign(viewer)], [0.0, seen]], [183, 61], axis=0),
    )
    base = Pose(0.5, -1.0, 0.2)  # below the wall: the lidar is not at the base
    points, origin = (base.inverse().transform(each) for each in (room.points, np.array([[0.0, viewer]])))
    points[-61:] = base.inverse().transform(lower + np.array([0.0, 0.1]))
    match = Icp(metric="line", epsilon=1e-9, one_to_one=False).register(room, Cloud(points, origin=origin[0]), base)
    away = match.target_from_source.y - base.y
    assert abs(away) < 1e-6 if behind else away < -0.03


def test_pairs_with_the_same_target_point_share_its_noise():
    onto = np.array([0, 1, 0, 0])
    assert share_noise(onto, Cloud([[0.0, 0.0], [1.0, 0.0]])) == pytest.approx([0.25, 0.5, 0.25, 0.25])
    means = Cloud([[0.0, 0.0], [1.0, 0.0]], support=[3, 40])  # at most 20 points count
    assert share_noise(onto, means) == pytest.approx([0.5, 20 / 21, 0.5, 0.5])


def test_a_mean_counts_in_a_line_as_the_points_it_is_the_mean_of():
    points = np.array([[0.0, 0.0], [1.0, 0.1], [2.0, -0.1], [2.0, 0.9]])  # a wall and a stray point
    support = np.array([3, MAX_SUPPORT, 7, 1])
    _, across = np.linalg.eigh(np.cov(np.repeat(points, support, axis=0).T))
    for counts in (support, np.array([3, 1000, 7, 1])):
        normals = line_normals(cKDTree(points), 4, counts)
        assert np.abs(normals @ across[:, 0]) == pytest.approx(np.ones(4), abs=1e-12)
    assert np.abs(line_normals(cKDTree(points), 4) @ across[:, 0]).max() < 0.99
    assert line_normals(cKDTree(points), 4, np.full(4, 5)) == pytest.approx(line_normals(cKDTree(points), 4), abs=1e-12)


def test_lines_of_means_count_their_points_only_in_a_noisy_cloud():
    points, support = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [2.0, 0.9]], np.array([20, 20, 20, 1])
    source = Cloud([[0.0, 0.1], [1.0, 0.1], [2.0, 0.1]])
    matcher = Icp(metric="line", line_neighbours=4, max_iterations=1)
    for noisy, counts in ((True, support), (False, None)):
        target = Cloud(points, support=support, noisy=noisy)
        moved = matcher.register(target, source, Pose()).target_from_source
        normal = line_normals(cKDTree(target.points), 4, counts)[0]  # of all, and all points are 0.1 m off
        assert [moved.x, moved.y] == pytest.approx(-0.1 * normal[1] * normal, abs=1e-9)


def test_points_beyond_the_end_of_a_wall_pull_less_where_pairs_share_noise():
    """Three points are 1 m before their wall and one is on its own; all lie on one line, so that no rotation helps."""
    source, target = np.zeros((4, 2)), np.array([[1.0, 0.0]] * 3 + [[0.0, 0.0]])
    normals, share = np.array([[1.0, 0.0]] * 4), share_noise(np.array([0, 0, 0, 1]), Cloud([[1.0, 0.0], [0.0, 0.0]]))
    assert fit_to_lines(source, target, normals) == pytest.approx([0.75, 0.0, 0.0])
    assert fit_to_lines(source, target, normals, share=share) == pytest.approx([0.75 / 1.25, 0.0, 0.0])


def test_equal_shares_change_nothing():
    target = corner()
    apart, moved = Cloud(target), Cloud(MOTION.inverse().transform(target))
    one, other = (
        Icp(metric="line", epsilon=1e-9, share_noise=share).register(apart, moved, MOTION) for share in (False, True)
    )  # fmt: skip
    assert one.inliers == len(target)  # each point has a target point of its own
    assert other.target_from_source.row == pytest.approx(one.target_from_source.row, abs=1e-12)


# stop rule


@pytest.mark.parametrize("parameters", [{}, {"error": "rmse"}, {"error": "mean-squared"}, {"error_at": "before"}])
def test_iteration_stops_at_the_first_change_of_error_below_epsilon(parameters: dict[str, Any]):
    target, source = noisy_pair()
    epsilon = 1e-5
    match = Icp(epsilon=epsilon, **parameters).register(target, source, Pose())
    power = 2 if parameters.get("error") == "mean-squared" else 1
    changes = np.abs(np.diff([step.error**power for step in match.history]))
    assert match.converged
    assert changes[-1] < epsilon
    assert (changes[:-1] >= epsilon).all()
    assert match.iterations == len(match.history) >= 3


def test_the_first_error_is_that_of_the_guess_and_decreases_after_a_step():
    wall = Cloud(corner())
    source = Cloud(
        corner() + np.array([0.004, 0.0])
    )  # 4 mm to the same point everywhere; the nearest other point is 20 mm away
    before = Icp(error_at="before").register(wall, source, Pose()).history[0]
    after = Icp(error_at="after").register(wall, source, Pose()).history[0]
    assert before.error == pytest.approx(0.004)
    assert after.error == pytest.approx(0.0, abs=1e-12)
    assert before.target_from_source.row == pytest.approx([-0.004, 0, 0], abs=1e-12)


def test_the_three_error_definitions_of_known_residuals():
    residuals = np.array([[3.0, 4.0], [0.0, 1.0]])
    assert Icp(error="mean")._error(residuals, None) == pytest.approx(3.0)
    assert Icp(error="mean-squared")._error(residuals, None) == pytest.approx(13.0)
    assert Icp(error="rmse")._error(residuals, None) == pytest.approx(math.sqrt(13.0))
    assert Icp()._error(residuals, np.array([[1.0, 0.0], [0.0, 1.0]])) == pytest.approx(2.0)


def test_reaching_the_iteration_limit_gives_a_result_that_did_not_converge():
    target, source = noisy_pair()
    match = Icp(epsilon=0.0, max_iterations=3).register(target, source, Pose())
    assert (match.converged, match.iterations, len(match.history)) == (False, 3, 3)
    assert match.target_from_source == match.history[-1].target_from_source


# nothing to match


@pytest.mark.parametrize(
    ("target", "source", "pairs"),
    [
        (np.empty((0, 2)), corner(), 0),
        (corner(), np.empty((0, 2)), 0),
        (corner(), corner()[:2], 2),
        (corner(), corner() + 50.0, 0),
        (corner()[:1], corner(), 1),
    ],
    ids=["no target", "no source", "two points", "too far", "one target point"],
)
@pytest.mark.parametrize("metric", ["point", "line"])
def test_with_too_few_pairs_the_guess_is_returned_as_not_converged(target, source, pairs, metric):
    guess = Pose(0.001, 0.0, 0.0)
    match = Icp(metric=metric).register(Cloud(target), Cloud(source), guess)
    assert (match.target_from_source, match.converged, match.iterations, match.inliers) == (guess, False, 0, pairs)
    assert math.isnan(match.error)


def test_coincident_points_give_a_pure_translation():
    source, target = Cloud(np.zeros((5, 2))), Cloud(np.full((5, 2), 0.1))
    match = Icp(one_to_one=False).register(target, source, Pose())
    assert match.target_from_source.row == pytest.approx([0.1, 0.1, 0.0])


# parameters


def test_the_defaults_of_the_class_are_those_of_its_parameters():
    assert Icp() == paper.SPEC.make(**resolve_parameters("icp", icp.PARAMETERS, {}))


def test_a_wrong_parameter_is_reported_by_name():
    with pytest.raises(BadParameter, match="error_at"):
        paper.SPEC.make(error_at="sometimes")


def test_the_four_readings_differ_only_in_the_documented_settings():
    def settings(spec) -> dict[str, Any]:
        return resolve_parameters("paper", spec.parameters, {})

    plain = settings(paper.SPEC)
    for spec, other in (
        (paper.LITERAL, {"error": "mean-squared"}),
        (paper.TIGHT, {"epsilon": 1e-6}),
        (paper.MAP, {"epsilon": 1e-6, "one_to_one": False, "max_correspondence_m": 0.2}),
    ):
        assert settings(spec) == plain | other
        assert spec.make(**settings(spec)) == paper.SPEC.make(**other)


# Table 1


def table_1_rows(**parameters: Any):
    registration = Icp(max_correspondence_m=0.0, **parameters)
    matches = [registration.register(*table_1_scene(seed), Pose()) for seed in range(20)]
    assert all(match.converged for match in matches)
    rows = [(m.iterations, m.history[0].error, m.error, *m.target_from_source.row) for m in matches]
    return np.array(rows)


def test_table_1_equals_the_mean_distance_with_one_to_one_pairs():
    k, first, last, x, y, theta = table_1_rows().T
    assert k.mean() == pytest.approx(24.2, abs=1.0)
    assert k.min() <= 25 <= k.max()
    assert first.mean() == pytest.approx(2.824, abs=0.053)
    assert last.mean() == pytest.approx(0.0467, abs=0.0013)
    assert np.degrees(theta).mean() == pytest.approx(29.96, abs=0.06)
    assert (x.mean(), y.mean()) == pytest.approx((4.0, 5.0), abs=0.004)


@pytest.mark.parametrize(
    ("parameters", "iterations", "first", "last"),
    [
        ({"error_at": "before"}, 24.7, 2.884, 0.0467),
        ({"error": "rmse"}, 24.8, 3.261, 0.0539),
        ({"error": "mean-squared"}, 21.6, math.sqrt(10.63), math.sqrt(0.00294)),
        ({"one_to_one": False}, 19.3, 2.505, 0.0499),
    ],
)
def test_table_1_fits_the_other_readings_worse(parameters: dict[str, Any], iterations, first, last):
    rows = table_1_rows(**parameters)
    assert rows[:, 0].mean() == pytest.approx(iterations, abs=1.0)
    assert rows[:, 1].mean() == pytest.approx(first, rel=0.02)
    assert rows[:, 2].mean() == pytest.approx(last, rel=0.03)
