"""Rigid motions of the plane, compared with matrices, SciPy and group laws."""

import doctest
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation

from evalkit.core import se2
from evalkit.core.pose import Pose

METRES = st.floats(-1e3, 1e3)
ROWS = st.tuples(METRES, METRES, st.floats(-math.pi, math.pi))


def assert_same_motion(a, b, atol=1e-9):
    """Assert that two motions are equal, with angles compared modulo a full turn."""
    np.testing.assert_allclose(np.asarray(a)[..., :2], np.asarray(b)[..., :2], atol=atol)
    np.testing.assert_allclose(se2.wrap(np.asarray(a)[..., 2] - np.asarray(b)[..., 2]), 0.0, atol=atol)


def test_the_docstring_examples_are_correct():
    assert doctest.testmod(se2).failed == 0
    assert doctest.testmod(se2).attempted > 0


@given(st.floats(-1e3, 1e3))
def test_wrapping_changes_an_angle_by_full_turns_only(theta):
    wrapped = float(se2.wrap(theta))
    assert -math.pi <= wrapped <= math.pi
    assert (wrapped - theta) / (2 * math.pi) == pytest.approx(round((wrapped - theta) / (2 * math.pi)), abs=1e-9)


def test_half_a_turn_is_minus_pi():
    assert se2.wrap([math.pi, -math.pi, 3 * math.pi]).tolist() == [-math.pi] * 3


@given(ROWS, ROWS)
def test_compose_equals_the_matrix_product(a, b):
    np.testing.assert_allclose(se2.to_matrix(se2.compose(a, b)), se2.to_matrix(a) @ se2.to_matrix(b), atol=1e-9)


@given(ROWS)
def test_inverse_equals_the_matrix_inverse_and_is_its_own_inverse(a):
    np.testing.assert_allclose(se2.to_matrix(se2.inverse(a)), np.linalg.inv(se2.to_matrix(a)), atol=1e-9)
    assert_same_motion(se2.inverse(se2.inverse(a)), a)
    assert_same_motion(se2.compose(a, se2.inverse(a)), [0, 0, 0])


@given(ROWS, ROWS, ROWS)
def test_compose_is_associative_and_between_cancels_a_common_frame(a, b, c):
    assert_same_motion(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)), atol=1e-8)
    assert_same_motion(se2.compose(a, se2.between(a, b)), b, atol=1e-8)
    assert_same_motion(se2.between(se2.compose(c, a), se2.compose(c, b)), se2.between(a, b), atol=1e-8)


@given(ROWS)
def test_a_matrix_converts_back_to_its_row(a):
    assert_same_motion(se2.from_matrix(se2.to_matrix(a)), a)


def test_points_rotate_as_in_scipy():
    rng = np.random.default_rng(0)
    rows, points = rng.uniform(-3, 3, (20, 3)), rng.normal(size=(20, 7, 2))
    spatial = np.pad(points, ((0, 0), (0, 0), (0, 1)))
    for row, before, after in zip(rows, spatial, se2.transform(rows, points), strict=True):
        turned = Rotation.from_euler("z", row[2]).apply(before)[:, :2]
        np.testing.assert_allclose(after, turned + row[:2], atol=1e-12)


def test_each_point_is_transformed_by_its_own_motion():
    moved = se2.transform_each([[1, 0, 0], [0, 0, math.pi / 2], [2, 3, math.pi]], [[5, 5], [1, 0], [1, 1]])
    np.testing.assert_allclose(moved, [[6, 5], [0, 1], [1, 2]], atol=1e-12)


@pytest.mark.parametrize("theta", [-3.1, -math.pi / 2, -0.3, -1e-8, 0.0, 1e-10, 1e-5, 0.02, 1.0, 3.1])
def test_a_fraction_equals_the_matrix_power_along_the_exponential(theta):
    motion = [0.7, -0.4, theta]
    velocity = np.real(logm(se2.to_matrix(motion)))
    shares = np.array([0.0, 0.25, 0.5, 1.0, 1.5])
    expected = [expm(share * velocity) for share in shares]
    np.testing.assert_allclose(se2.to_matrix(se2.fraction(motion, shares)), expected, atol=2e-8)


def test_half_of_a_quarter_circle_is_an_eighth():
    quarter = [1.0, 1.0, math.pi / 2]  # radius 1, forward and to the left
    eighth = [math.sin(math.pi / 4), 1 - math.cos(math.pi / 4), math.pi / 4]
    np.testing.assert_allclose(se2.fraction(quarter, [0.5]), [eighth], atol=1e-12)


def test_interpolation_is_linear_and_takes_the_shorter_rotation():
    stamps = np.array([0, 100, 300])
    poses = [[0, 0, 3.0], [1, 2, -3.0], [3, 2, -2.0]]
    gap = 2 * math.pi - 6.0
    found = se2.interpolate(stamps, poses, [0, 25, 100, 200, 300])
    assert_same_motion(found, [[0, 0, 3], [0.25, 0.5, 3.0 + gap / 4], [1, 2, -3], [2, 2, -2.5], [3, 2, -2]])


def test_interpolation_between_present_day_stamps_keeps_every_nanosecond():
    start = 1_700_000_000_123_456_789
    found = se2.interpolate(np.array([start, start + 1000]), [[0, 0, 0], [1000, 0, 0]], [start + 1, start + 999])
    assert found[:, 0].tolist() == [1.0, 999.0]


@pytest.mark.parametrize("at", [[-1], [0, 11], [11]])
def test_nothing_is_extrapolated(at):
    with pytest.raises(ValueError, match="nothing is extrapolated"):
        se2.interpolate(np.array([0, 10]), [[0, 0, 0], [1, 0, 0]], at)


def test_a_single_pose_is_known_only_at_its_own_time():
    assert se2.interpolate(np.array([5]), [[1, 2, 3]], [5, 5]).tolist() == [[1, 2, 3]] * 2
    assert se2.interpolate(np.array([5]), [[1, 2, 3]], []).shape == (0, 3)
    with pytest.raises(ValueError, match="outside"):
        se2.interpolate(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), [5])


@given(ROWS, ROWS)
def test_one_motion_alone_is_computed_as_in_an_array_to_the_bit(a_from_b, b_from_c):
    a, b = Pose(*a_from_b), Pose(*b_from_c)
    composed, inverse = se2.compose(a.row[None], b.row)[0], se2.inverse(a.row[None])[0]
    assert se2.compose(a.row, b.row).tobytes() == composed.tobytes()
    assert se2.inverse(a.row).tobytes() == inverse.tobytes()
    for found, row in ((a @ b, composed), (a.inverse(), inverse)):
        assert found.row.tobytes() == np.array([*row[:2], se2.wrap(row[2])]).tobytes()
