"""Observability of a pose from walls, compared with hand calculations."""

import numpy as np
import pytest

from evalkit.commands.basin.observability import observability


def wall(y=1.0, count=200):
    """Return points and normals of a wall along x, seen from the origin."""
    points = np.stack([np.linspace(-5.0, 5.0, count), np.full(count, y)], axis=1)
    return points, np.tile([0.0, 1.0], (count, 1))


def both(*parts):
    points, normals = zip(*parts, strict=True)
    return np.concatenate(points), np.concatenate(normals)


def rotate(part, degrees=90.0):
    angle = np.radians(degrees)
    rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    return part[0] @ rotation, part[1] @ rotation


def test_two_parallel_walls_leave_translation_along_them_unobservable():
    found = observability([both(wall(1.0), wall(-1.0))], 0.05, 0.1)
    assert found.names() == ("shift along 0 deg",)
    assert found.shares[0] == 0.0
    assert np.isinf(found.sigma_m[0])


@pytest.mark.parametrize("degrees", [0.0, 30.0, 135.0])
def test_the_unobservable_direction_rotates_with_the_walls(degrees):
    found = observability([rotate(both(wall(1.0), wall(-1.0)), degrees)], 0.05, 0.1)
    assert found.names() == (f"shift along {degrees:.0f} deg",)


def test_a_round_room_leaves_rotation_unobservable():
    angle = np.linspace(0.0, 2.0 * np.pi, 300, endpoint=False)
    out = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    found = observability([(3.0 * out, out)], 0.05, 0.1)
    assert found.names() == ("turn",)
    assert found.shares == pytest.approx([0.0, 0.5, 0.5])


def test_in_a_square_room_half_of_the_points_observe_each_translation():
    square = both(wall(5.0), wall(-5.0), rotate(wall(5.0)), rotate(wall(-5.0)))
    found = observability([square], 0.05, 0.1)
    assert found.names() == ()
    # a wall observes the rotation along its length: mean x^2 / mean (x^2 + y^2), x even in [-5, 5] and y = 5
    assert found.shares == pytest.approx([0.25, 0.5, 0.5], abs=0.01)
    assert found.sigma_m[2] == pytest.approx(0.05 * np.sqrt(2.0) / np.sqrt(400), rel=1e-6)


def test_few_noisy_points_leave_directions_unobservable_that_many_observe():
    few = both(wall(1.0, 400), rotate(wall(1.0, 2)))
    assert observability([few], 0.05, 0.05).names() != ()
    assert observability([few], 0.0, 0.05).names() == ()


def test_errors_along_an_unobservable_direction_are_removed():
    found = observability([both(wall(1.0), wall(-1.0))], 0.05, 0.1)
    motions = np.array([[3.0, 0.2, 0.1], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(found.observable(motions), [[0.0, 0.2, 0.1], [0.0, 0.0, 0.0]], atol=1e-9)


def test_noise_along_slanted_beams_leaves_less_error_than_the_bound_for_noise_across_walls():
    points, normals = both(wall(1.0), wall(-1.0))
    sigma_m = observability([(points, normals)], 0.05, 0.1).sigma_m.min()
    across = np.abs(np.sum(points * normals, axis=1)) / np.linalg.norm(points, axis=1)  # share of a range across
    assert np.sqrt(2.0) * 0.05 / np.sqrt(np.sum(across**-2.0)) < 0.5 * sigma_m
