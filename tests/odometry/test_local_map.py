"""Local maps, compared with hand calculations."""

import numpy as np
import pytest

from evalkit.core.errors import BadParameter
from evalkit.core.pose import Pose
from evalkit.odometry.local_map import GridMap, KeyframeMap, VoxelMap, voxel_means
from evalkit.plugins import registry


def sort_points(points):
    return sorted(np.round(points, 9).tolist())


# voxel means


def test_every_cell_keeps_the_mean_of_its_points():
    points = np.array([[0.1, 0.1], [0.9, 0.3], [1.5, 0.5], [-0.2, 0.4], [-0.4, -0.1]])
    assert sort_points(voxel_means(points, 1.0)) == [[-0.4, -0.1], [-0.2, 0.4], [0.5, 0.2], [1.5, 0.5]]


def test_voxel_means_equal_those_of_a_dictionary_and_are_ordered_by_cell():
    points = np.random.default_rng(0).uniform(-3, 3, (500, 2))
    cells = {}
    for point in points:
        cells.setdefault(tuple(np.floor(point / 0.5)), []).append(point)
    expected = [np.mean(cells[cell], axis=0) for cell in sorted(cells)]
    np.testing.assert_allclose(voxel_means(points, 0.5), expected, atol=1e-12)


def test_empty_clouds_have_no_voxel_means():
    assert voxel_means(np.empty((0, 2)), 0.1).shape == (0, 2)


# keyframes


def test_the_oldest_keyframe_is_removed():
    local_map = KeyframeMap(2, 0.0)
    for x in (1.0, 2.0, 3.0):
        local_map.add(np.array([[0.0, 0.0]]), Pose(x, 0.0, 0.0))
    assert local_map.cloud(Pose()).points.tolist() == [[2.0, 0.0], [3.0, 0.0]]


def test_keyframes_are_in_the_start_frame():
    local_map = KeyframeMap(2, 0.0)
    local_map.add(np.array([[1.0, 0.0]]), Pose(5.0, 0.0, np.pi / 2))
    np.testing.assert_allclose(local_map.cloud(Pose()).points, [[5.0, 1.0]], atol=1e-12)
    assert local_map.cloud(Pose()).frame == "start"


def test_keyframes_may_be_reduced_together():
    local_map = KeyframeMap(2, 1.0)
    local_map.add(np.array([[0.2, 0.2]]), Pose())
    local_map.add(np.array([[0.4, 0.6], [3.5, 0.5]]), Pose())
    np.testing.assert_allclose(local_map.cloud(Pose()).points, [[0.3, 0.4], [3.5, 0.5]])


def test_the_local_map_object_is_reused_until_a_keyframe_is_added():
    local_map = KeyframeMap(3, 0.0)
    local_map.add(np.zeros((1, 2)), Pose())
    before = local_map.cloud(Pose())
    assert local_map.cloud(Pose(9.0, 9.0, 1.0)) is before
    local_map.add(np.zeros((1, 2)), Pose())
    assert local_map.cloud(Pose()) is not before


# the persistent map


def test_an_open_voxel_is_the_mean_of_all_its_points():
    lasting = VoxelMap(1.0, 10.0, max_points=3)
    lasting.add(np.array([[0.2, 0.2], [0.4, 0.4]]), Pose())
    lasting.add(np.array([[0.6, 0.9]]), Pose())
    np.testing.assert_allclose(lasting.cloud(Pose()).points, [[0.4, 0.5]])


def test_a_settled_voxel_is_fixed_while_new_ones_open():
    lasting = VoxelMap(1.0, 10.0, max_points=2)
    lasting.add(np.array([[0.2, 0.2], [0.4, 0.4]]), Pose())
    lasting.add(np.array([[0.9, 0.9], [1.5, 0.5]]), Pose())
    np.testing.assert_allclose(lasting.cloud(Pose()).points, [[0.3, 0.3], [1.5, 0.5]])
    assert lasting.cloud(Pose()).support.tolist() == [2, 1]


def test_a_persistent_map_that_never_settles_is_the_voxel_mean_of_all_points():
    rng = np.random.default_rng(1)
    batches, lasting = rng.uniform(-20, 20, (40, 100, 2)), VoxelMap(0.5, 100.0, max_points=10**9)
    for points in batches:
        lasting.add(points, Pose())
    points = lasting.cloud(Pose()).points
    assert len(points) > 1024  # more voxels than the first allocation holds
    np.testing.assert_allclose(sort_points(points), sort_points(voxel_means(batches.reshape(-1, 2), 0.5)), atol=1e-8)


def test_a_map_that_keeps_views_says_from_where_its_points_were_seen():
    lasting, turned = VoxelMap(1.0, 10.0, keeps_views=True), Pose(0.5, 0.5, np.pi / 2)
    points = np.array([[0.0, 2.0], [0.0, -2.0], [3.0, 4.0]])
    for sensor in (Pose(), Pose(3.0, -2.0, 1.0)):
        lasting.add(points, turned, sensor)
    cloud = lasting.cloud(Pose())
    order = [int(np.argmin(np.hypot(*(cloud.points - place).T))) for place in turned.transform(points)]
    np.testing.assert_allclose(cloud.seen_from[order], [[0.9, 0.3], [-0.5, 0.5], [0.9, -0.3]])  # means of both, turned
    lasting.add(np.array([[0.0, 2.0]]), turned, Pose(0.0, 2.0, 0.0))  # from where it is: no direction
    np.testing.assert_allclose(lasting.cloud(Pose()).seen_from[order[0]], [0.6, 0.2])
    assert VoxelMap(1.0, 10.0).cloud(Pose()).seen_from is None


def test_only_voxels_within_the_radius_are_matched():
    lasting = VoxelMap(0.1, 2.0)
    lasting.add(np.array([[0.05, 0.05], [1.95, 0.05], [2.45, 0.05]]), Pose())
    assert len(lasting.cloud(Pose())) == 2
    np.testing.assert_allclose(lasting.cloud(Pose(4.0, 0.0, 0.0)).points, [[2.45, 0.05]])
    upright = VoxelMap(0.1, 2.0)
    upright.add(np.array([[0.05, 3.05], [0.05, -3.05]]), Pose())
    np.testing.assert_allclose(upright.cloud(Pose(0.0, 4.0, 0.0)).points, [[0.05, 3.05]])


def test_the_persistent_map_object_is_reused_until_it_grows_or_the_pose_moves():
    lasting = VoxelMap(0.1, 10.0)
    lasting.add(np.zeros((1, 2)), Pose())
    before = lasting.cloud(Pose())
    assert lasting.cloud(Pose(0.9, 0.0, 3.0)) is before
    moved_on = lasting.cloud(Pose(1.1, 0.0, 0.0))
    assert moved_on is not before
    lasting.add(np.zeros((1, 2)), Pose())
    assert lasting.cloud(Pose(1.1, 0.0, 0.0)) is not moved_on


# occupied cells


def test_collected_points_are_shown_after_the_next_keyframe_or_when_the_pose_moves():
    lasting, seen = VoxelMap(1.0, 10.0), Pose(0.2, 0.0, 0.0)
    lasting.add(np.array([[0.1, 0.5]]), Pose())
    cloud = lasting.cloud(Pose())
    lasting.collect(np.array([[0.3, 0.5]]), seen)
    assert lasting.cloud(Pose(1.0, 0.0, 0.0)) is cloud
    assert lasting.cloud(Pose(1.1, 0.0, 0.0)).points.tolist() == [pytest.approx([0.3, 0.5])]
    lasting.collect(np.array([[0.4, 0.5]]), seen)
    lasting.add(np.array([[7.5, 0.5]]), Pose())
    assert lasting.cloud(Pose()).points.tolist() == [pytest.approx([0.4, 0.5]), pytest.approx([7.5, 0.5])]


def map_points(*adds, probability=0.5, radius_m=9.0):
    """Return the matched cells, ordered by position, after scans of single points."""
    local_map = GridMap(registry.mapper("log-odds").make(resolution_m=0.5), probability, radius_m)
    for point, *poses in adds:
        local_map.add(np.array([point]), *poses)
    return sort_points(local_map.cloud(Pose()).points)


AT_REST = (Pose(), Pose())


def test_a_hit_adds_the_centre_of_its_cell_as_a_point():
    assert map_points(([2.1, 0.1], *AT_REST)) == [[2.25, 0.25]]
    assert map_points(([2.1, 0.1], Pose(1.0, 1.0, np.pi / 2), Pose())) == [[0.75, 3.25]]


def test_beams_through_a_cell_remove_its_point():
    hit, past = ([2.1, 0.1], *AT_REST), ([4.1, 0.1], *AT_REST)
    assert map_points(hit, past, past) == [[4.25, 0.25]]  # -0.847 after two free observations, which removes the point
    from_aside = Pose(4.0, 3.0, 0.0)
    assert map_points(hit, *[([4.1, 0.1], Pose(), from_aside)] * 2) == [[2.25, 0.25], [4.25, 0.25]]


def test_only_cells_above_the_probability_are_matched():
    once, twice = ([2.1, 0.1], *AT_REST), ([0.1, 2.1], *AT_REST)
    assert map_points(once, twice, twice, probability=0.8) == [[0.25, 2.25]]  # 0.70 and 0.84


def test_only_cells_within_the_radius_are_matched_against():
    assert map_points(([2.1, 0.1], *AT_REST), ([0.1, 5.1], *AT_REST), radius_m=3.0) == [[2.25, 0.25]]


@pytest.mark.parametrize(
    "local_map",
    [KeyframeMap(2, 0.1), VoxelMap(0.1, 5.0), GridMap(registry.mapper("log-odds").make(), 0.5, 5.0)],
)
def test_a_scan_without_a_hit_is_a_keyframe_without_points(local_map):
    local_map.add(np.empty((0, 2)), Pose())
    assert len(local_map.cloud(Pose())) == 0


def test_the_cells_around_the_robot_are_matched_wherever_it_is():
    local_map = GridMap(registry.mapper("log-odds").make(resolution_m=0.5), 0.5, 3.0)
    local_map.add(np.array([[2.1, 0.1], [8.1, 4.1], [8.1, 8.1]]), *AT_REST)
    assert sort_points(local_map.cloud(Pose(7.0, 3.0, 1.0)).points) == [[8.25, 4.25]]


def test_a_voxel_of_a_persistent_map_takes_twenty_points():
    lasting = VoxelMap(1.0, 10.0)
    for x in (*np.full(19, 0.2), 0.4, 0.9):
        lasting.add(np.array([[x, 0.5]]), Pose())
    np.testing.assert_allclose(lasting.cloud(Pose()).points, [[0.21, 0.5]])  # (19 0.2 + 0.4) / 20


@pytest.mark.parametrize("voxel_m", [0.0, -1.0])
def test_a_persistent_map_without_voxels_is_refused(voxel_m):
    with pytest.raises(BadParameter, match="local_map_voxel_m"):
        VoxelMap(voxel_m, 10.0)


def test_cells_far_apart_in_both_directions_are_different():
    points = np.array([[x, y] for x in (-40000.5, 0.5, 40000.5) for y in (-40000.5, 0.5, 40000.5)])
    np.testing.assert_allclose(voxel_means(points, 1.0), points)
