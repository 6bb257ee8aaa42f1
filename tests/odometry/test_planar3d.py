"""Conversion between 2D and 3D: lossless for planar motions, an error for all others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from evalkit.core.pose import Pose
from evalkit.odometry import planar3d

METRES = st.floats(-1e3, 1e3)
RADIANS = st.floats(-np.pi, np.pi, exclude_max=True)


def wall(angle: float, n: int = 30) -> np.ndarray:
    along = np.linspace(-1.0, 1.0, n)[:, None]
    return along * [np.cos(angle), np.sin(angle)] + [3.0, -2.0]


def test_points_keep_x_and_y_and_get_z_zero_in_new_memory():
    flat = np.array([[1.0, 2.0], [3.0, 4.0]])
    space = planar3d.points_3d(flat)
    assert space.tolist() == [[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]
    space[:] = 9.0
    assert flat.tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert planar3d.points_3d(np.zeros((0, 2))).shape == (0, 3)


@given(METRES, METRES, RADIANS)
def test_a_pose_survives_conversion_to_a_matrix_and_back(x, y, theta):
    pose = Pose(x, y, theta)
    back = planar3d.pose_2d(planar3d.matrix_4x4(pose))
    assert (back.x, back.y) == (pose.x, pose.y)
    assert abs((back.inverse() @ pose).theta) < 1e-14


@given(RADIANS)
def test_a_matrix_is_orthogonal_to_the_last_bits(theta):
    rotation = planar3d.matrix_4x4(Pose(1.0, 2.0, theta))[:3, :3]
    assert np.abs(rotation @ rotation.T - np.eye(3)).max() < 4e-16


def test_a_matrix_moves_points_like_its_pose():
    pose = Pose(0.3, -0.7, 2.0)
    points = wall(0.4)
    homogeneous = np.column_stack([planar3d.points_3d(points), np.ones(len(points))])
    assert np.allclose((homogeneous @ planar3d.matrix_4x4(pose).T)[:, :2], pose.transform(points), atol=1e-14)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda m: m.__setitem__((2, 3), 0.01), "z = 0.01 m"),
        (lambda m: m.__setitem__((slice(1, 3), slice(1, 3)), [[0.8, -0.6], [0.6, 0.8]]), "not a motion of the plane"),
        (lambda m: m.__setitem__((slice(0, 2), slice(0, 2)), 1.1 * m[:2, :2]), "not a motion of the plane"),
        (lambda m: m.__setitem__((slice(0, 2), 1), -m[:2, 1]), "not a motion of the plane"),
        (lambda m: m.__setitem__((0, 0), np.nan), "not finite"),
    ],
    ids=["lifted", "tilted", "scaled", "mirrored", "nan"],
)
def test_a_matrix_outside_the_plane_is_rejected(spoil, says):
    matrix = planar3d.matrix_4x4(Pose(1.0, 2.0, 0.5))
    spoil(matrix)
    with pytest.raises(ValueError, match=says):
        planar3d.pose_2d(matrix)


def test_a_matrix_of_another_shape_is_rejected():
    with pytest.raises(ValueError, match=r"expected shape \(4, 4\), got \(3, 3\)"):
        planar3d.pose_2d(np.eye(3))


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 135.0, -20.0])
def test_the_normals_of_a_straight_wall_are_perpendicular_to_it(degrees):
    angle = np.radians(degrees)
    normals = planar3d.normals(wall(angle), neighbours=5, radius_m=1.0)
    assert np.allclose(np.abs(normals @ [-np.sin(angle), np.cos(angle)]), 1.0, atol=1e-12)


def test_the_normals_of_a_circle_point_to_its_centre():
    angles = np.linspace(0.0, 2.0 * np.pi, 90, endpoint=False)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    normals = planar3d.normals(2.0 * directions + [1.0, 5.0], neighbours=5, radius_m=1.0)
    assert np.allclose(np.abs((normals * directions).sum(axis=1)), 1.0, atol=1e-9)


def test_normals_agree_with_eigenvectors_of_brute_force_neighbours():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2))
    normals = planar3d.normals(points, neighbours=8, radius_m=0.3)
    for point, normal in zip(points, normals, strict=True):
        distance = np.linalg.norm(points - point, axis=1)
        near = points[np.argsort(distance)[:8]]
        near = near[np.linalg.norm(near - point, axis=1) < 0.3]
        if len(near) < 3:
            assert normal.tolist() == [0.0, 0.0]
        else:
            least = np.linalg.eigh(np.cov(near.T))[1][:, 0]
            assert abs(normal @ least) == pytest.approx(1.0, abs=1e-9)


def test_points_without_a_wall_get_no_normal():
    assert planar3d.normals(np.zeros((0, 2)), 5, 1.0).shape == (0, 2)
    assert not planar3d.normals([[0.0, 0.0], [0.1, 0.0]], 5, 1.0).any()  # two points
    assert not planar3d.normals(np.ones((6, 2)), 5, 1.0).any()  # six identical points
    far = np.vstack([wall(0.0), [[30.0, 30.0]]])
    assert planar3d.normals(far, 5, 1.0).any(axis=1).tolist() == [True] * 30 + [False]  # a single point


def test_covariances_are_thin_across_a_wall_and_isotropic_elsewhere():
    covariances = planar3d.covariances_3d([[0.0, 1.0], [0.6, 0.8], [0.0, 0.0]], epsilon=0.01)
    assert np.allclose(covariances[0], np.diag([1.0, 0.01, 1.0]))
    assert np.allclose(np.linalg.eigvalsh(covariances[1]), [0.01, 1.0, 1.0])
    assert np.allclose(covariances[1] @ [0.6, 0.8, 0.0], [0.006, 0.008, 0.0])
    assert np.allclose(covariances[2], np.eye(3))


def test_a_matrix_may_differ_from_a_motion_of_the_plane_by_the_tolerance():
    matrix = np.eye(4)
    matrix[2, 3] = 0.25
    assert planar3d.pose_2d(matrix, tolerance=0.25) == Pose()
    with pytest.raises(ValueError, match=r"z = 0\.25 m"):
        planar3d.pose_2d(matrix, tolerance=np.nextafter(0.25, 0.0))
