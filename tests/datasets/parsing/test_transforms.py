"""Transforms between a base and its sensors."""

import math

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit_datasets.parsing.transforms import Mounting, Transform, TransformTree, matrix_from_quaternion

LEVEL = (0.0, 0.0, 0.0, 1.0)


def about(axis, angle):
    return (*(math.sin(angle / 2) * part for part in axis), math.cos(angle / 2))


def yaw(angle):
    return about((0, 0, 1), angle)


def tree(*static, moving=()):
    made = TransformTree()
    for parent, child, place, turn in static:
        made.add(Transform(0, parent, child, matrix_from_quaternion(place, turn)), static=True)
    for stamp, parent, child, place, turn in moving:
        made.add(Transform(stamp, parent, child, matrix_from_quaternion(place, turn)), static=False)
    return made


def test_a_chain_of_transforms_is_composed():
    made = tree(("base", "plate", (1, 0, 0.2), yaw(math.pi / 2)), ("plate", "lidar", (0.5, 0, 0.1), yaw(math.pi / 2)))
    found = made.find_mounting("base", "lidar", 0)
    np.testing.assert_allclose(found.base_from_sensor.row, [1.0, 0.5, -math.pi], atol=1e-12)
    assert not found.mirrored


def test_frames_are_connected_through_a_common_parent():
    made = tree(("foot", "base", (0.1, 0, 0), LEVEL), ("foot", "lidar", (0.3, 0, 0), LEVEL))
    np.testing.assert_allclose(made.find_mounting("base", "lidar", 0).base_from_sensor.row, [0.2, 0, 0], atol=1e-12)


def test_a_lidar_upside_down_is_mirrored():
    made = tree(("base", "lidar", (0.1, 0.2, 0.3), about((1, 0, 0), math.pi)))
    assert made.find_mounting("base", "lidar", 0) == Mounting(Pose(0.1, 0.2, 0.0), mirrored=True)


def test_mirrored_angles_and_the_planar_pose_equal_the_beams_of_the_3d_pose():
    rng = np.random.default_rng(3)
    for _ in range(20):
        heading, angle = rng.uniform(-3, 3, 2)
        turned = matrix_from_quaternion((0.4, -0.2, 0.5), yaw(heading)) @ matrix_from_quaternion(
            (0, 0, 0), about((1, 0, 0), math.pi)
        )
        made = TransformTree()
        made.add(Transform(0, "base", "lidar", turned), static=True)
        found = made.find_mounting("base", "lidar", 0)
        in_space = turned @ [2 * math.cos(angle), 2 * math.sin(angle), 0, 1]
        flat = found.base_from_sensor.transform([[2 * math.cos(-angle), 2 * math.sin(-angle)]])
        np.testing.assert_allclose(flat[0], in_space[:2], atol=1e-12)


def test_a_lidar_on_its_side_is_rejected():
    with pytest.raises(ValueError, match="'lidar' is tilted by 90 deg"):
        tree(("base", "lidar", (0, 0, 0), about((1, 0, 0), math.pi / 2))).find_mounting("base", "lidar", 0)


def test_the_last_static_and_the_nearest_moving_transform_are_used():
    made = tree(
        ("base", "arm", (1, 0, 0), LEVEL), ("base", "arm", (2, 0, 0), LEVEL),
        moving=[(10, "arm", "lidar", (0, 1, 0), LEVEL), (20, "arm", "lidar", (0, 5, 0), LEVEL)],
    )  # fmt: skip
    assert made.find_mounting("base", "lidar", 14).base_from_sensor == Pose(2.0, 1.0)
    assert made.find_mounting("base", "lidar", 16).base_from_sensor == Pose(2.0, 5.0)


def test_unconnected_frames_have_no_mounting():
    assert (
        tree(("base", "wheel", (0, 0, 0), LEVEL), ("map", "lidar", (0, 0, 0), LEVEL)).find_mounting("base", "lidar", 0)
        is None
    )


@pytest.mark.parametrize(("place", "turn"), [((0, 0, 0), (0, 0, 0, 0)), ((math.nan, 0, 0), LEVEL)])
def test_an_invalid_transform_is_rejected(place, turn):
    with pytest.raises(ValueError, match="is not a transform"):
        matrix_from_quaternion(place, turn)
