"""Ray casting in a world of walls and circles."""

import numpy as np
import pytest

from evalkit.core.world import World, closed_outline

ROOM = World(closed_outline([(0, 0), (4, 0), (4, 3), (0, 3)]))


def cast(world, origin, *degrees):
    return world.cast(np.tile(origin, (len(degrees), 1)), np.radians(degrees))


def test_beams_in_a_rectangle_measure_its_sides():
    expected = [2.0, np.sqrt(2) * 2.0, 2.0, 2.0, 1.0]
    np.testing.assert_allclose(cast(ROOM, (2.0, 1.0), 0, 45, 90, 180, 270), expected, atol=1e-12)


def test_every_beam_starts_at_its_own_origin():
    ranges = ROOM.cast([(1.0, 1.0), (3.0, 1.0), (3.0, 2.5)], [0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(ranges, [3.0, 1.0, 0.5], atol=1e-12)


def test_a_circle_is_hit_on_its_near_side_from_outside_and_on_its_far_side_from_inside():
    world = World(np.zeros((0, 4)), [[5.0, 0.0, 1.0]])
    ranges = world.cast([(0.0, 0.0), (0.0, 0.6), (5.0, 0.0), (5.5, 0.0)], [0.0, 0.0, 1.0, np.pi])
    np.testing.assert_allclose(ranges, [4.0, 4.2, 1.0, 1.5], atol=1e-12)


def test_beams_that_miss_or_point_away_return_nothing():
    world = World([[2.0, -1.0, 2.0, 1.0]], [[5.0, 4.0, 1.0]])
    origins = [(0.0, 0.0), (0.0, 1.1), (0.0, 5.001), (2.0, -3.0)]
    assert np.isposinf(world.cast(origins, [np.pi, 0.0, 0.0, np.pi / 2])).all()
    assert np.isfinite(world.cast([(0.0, 4.999), (0.0, 0.999)], [0.0, 0.0])).all()


def test_a_grazing_beam_hits_a_wall_far_away():
    # 1 m from a wall at 0.5 degrees: 1 / sin 0.5 degrees
    world = World([[-500.0, 1.0, 500.0, 1.0]])
    np.testing.assert_allclose(cast(world, (0.0, 0.0), 0.5), 1.0 / np.sin(np.radians(0.5)), rtol=1e-9)


def test_no_beam_escapes_through_a_corner():
    generator = np.random.default_rng(0)
    origins = generator.uniform([0.1, 0.1], [3.9, 2.9], (400, 2))
    corners = ROOM.segments[generator.integers(0, 4, 400), :2]
    ranges = ROOM.cast(origins, np.arctan2(*(corners - origins).T[::-1]))
    np.testing.assert_allclose(ranges, np.linalg.norm(corners - origins, axis=1), atol=1e-6)


def cast_one_by_one(world, origin, angle):
    """Return the nearest intersection from a linear solver for walls and polynomial roots for circles."""
    direction = np.array([np.cos(angle), np.sin(angle)])
    found = [np.inf]
    for x1, y1, x2, y2 in world.segments:
        t, u = np.linalg.solve(
            np.array([[direction[0], x1 - x2], [direction[1], y1 - y2]]), [x1 - origin[0], y1 - origin[1]]
        )
        found += [t] if t >= 0 and 0 <= u <= 1 else []
    for x, y, radius in world.circles:
        offset = origin - [x, y]
        roots = np.roots([1.0, 2.0 * direction @ offset, offset @ offset - radius**2])
        found += [root.real for root in roots if abs(root.imag) < 1e-12 and root.real >= 0]
    return min(found)


def test_random_beams_agree_with_a_solver_for_single_beams():
    generator = np.random.default_rng(1)
    world = World(
        generator.uniform(-5, 5, (20, 4)),
        np.column_stack([generator.uniform(-5, 5, (8, 2)), generator.uniform(0.1, 1.0, 8)]),
    )
    origins, angles = generator.uniform(-5, 5, (300, 2)), generator.uniform(-10, 10, 300)
    expected = [cast_one_by_one(world, origin, angle) for origin, angle in zip(origins, angles, strict=True)]
    np.testing.assert_allclose(world.cast(origins, angles), expected, atol=1e-9)


@pytest.mark.parametrize("beams", [400, 1600])
def test_skipping_boundaries_outside_the_sector_changes_nothing(beams):
    generator = np.random.default_rng(beams)
    world = World(
        generator.uniform(-8, 8, (60, 4)),
        np.column_stack([generator.uniform(-8, 8, (20, 2)), generator.uniform(0.05, 1.0, 20)]),
    )
    origins = np.linspace([0.0, 0.0], [0.6, -0.3], beams)  # a sensor that moves while it turns
    angles = 1.0 - np.linspace(0.0, 2.5 * np.pi, beams)
    alone = np.concatenate([world.cast(origins[[k]], angles[[k]]) for k in range(beams)])
    shuffled = generator.permutation(beams)  # no sector is narrow: nothing is skipped
    np.testing.assert_allclose(world.cast(origins, angles), alone, atol=1e-9)
    np.testing.assert_allclose(world.cast(origins[shuffled], angles[shuffled]), alone[shuffled], atol=1e-9)


def test_a_world_without_boundaries_returns_nothing():
    assert np.isposinf(cast(World(np.zeros((0, 4))), (0.0, 0.0), 0, 90)).all()


def test_clearance_is_the_distance_to_the_nearest_wall_end_or_circle():
    world = World([[0.0, 0.0, 2.0, 0.0]], [[10.0, 0.0, 1.0]])
    np.testing.assert_allclose(
        world.clearance([(1.0, 3.0), (-3.0, 4.0), (8.0, 0.0), (10.0, 0.25)]), [3.0, 5.0, 1.0, 0.75]
    )


@pytest.mark.parametrize(
    ("segments", "circles", "word"),
    [([[0, 0, 0, 0]], [], "wall"), ([[0, 0, np.nan, 1]], [], "finite"), ([[0, 0, 1, 1]], [[0, 0, 0]], "radius")],
)
def test_a_world_with_an_invalid_boundary_is_rejected(segments, circles, word):
    with pytest.raises(ValueError, match=word):
        World(np.array(segments, dtype=float), np.array(circles, dtype=float))


def test_normals_belong_to_the_nearest_wall_or_circle():
    world = World([[2.0, -1.0, 2.0, 1.0], [5.0, -1.0, 5.0, 1.0]], [[0.0, 3.0, 1.0]])
    ranges = cast(world, (0.0, 0.0), 0, 90, 180)
    assert ranges.tolist() == [2.0, 2.0, np.inf]
    normals = world.normals([(2.0, 0.0), (0.0, 2.0)])
    assert np.abs(normals).tolist() == [[1.0, 0.0], [0.0, 1.0]]
    assert normals[1].tolist() == [0.0, -1.0]
