"""Pedestrians in simulated worlds: their paths and the beams that hit them."""

import numpy as np
import pytest

from evalkit_datasets.worlds import floorplans
from evalkit_datasets.worlds.pedestrians import FROM_ROBOT_M, RADIUS_M, Walk, plan_walks
from evalkit_datasets.worlds.robot import RouteDrive

S = 1_000_000_000


@pytest.fixture(scope="module")
def lab():
    plan = floorplans.load_plan("lab")
    drive = RouteDrive(plan.route, 0.3, 0.5)
    return plan, drive, plan_walks(3, plan.world, drive, 1.2, np.random.default_rng(4))


def test_a_walk_is_straight_with_constant_speed_between_its_points():
    walk = Walk(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]), np.array([0.0, 2.0, 3.0]))
    found = walk.at([0, S, 2 * S, int(2.5 * S), 9 * S])
    np.testing.assert_allclose(found, [[0, 0], [1, 0], [2, 0], [2, 0.5], [2, 1]])


def test_a_beam_hits_the_near_side_of_a_pedestrian_at_its_own_time():
    walk = Walk(np.array([[0.0, 3.0], [4.0, 3.0]]), np.array([0.0, 4.0]))
    origins, up = np.array([[2.0, 0.0]] * 4), np.full(4, np.pi / 2)
    found = walk.cast(origins, up, [2 * S, int(1.9 * S), int(1.7 * S), 3 * S])
    np.testing.assert_allclose(found, [2.75, 3.0 - np.sqrt(RADIUS_M**2 - 0.01), np.inf, np.inf])


def test_a_beam_in_another_direction_hits_no_pedestrian():
    walk = Walk(np.array([[0.0, 3.0]]), np.array([0.0]))
    assert walk.cast(np.zeros((1, 2)), np.array([-np.pi / 2]), [0]).tolist() == [np.inf]


def test_pedestrians_walk_at_their_speed_for_the_whole_drive(lab):
    _, drive, people = lab
    for walk in people:
        speeds = np.hypot(*np.diff(walk.points, axis=0).T) / np.diff(walk.seconds)
        np.testing.assert_allclose(speeds, 1.2)
        assert walk.seconds[-1] >= drive.duration_ns * 1e-9


def test_pedestrians_walk_neither_through_walls_nor_into_the_robot(lab):
    plan, drive, people = lab
    stamps = np.arange(0, drive.duration_ns, S // 20)
    robot = drive.poses(stamps)[:, :2]
    for walk in people:
        where = walk.at(stamps)
        assert plan.world.clearance(where).min() > RADIUS_M - 0.01
        assert np.hypot(*(where - robot).T).min() > FROM_ROBOT_M - 0.1  # sampled ten times a second
