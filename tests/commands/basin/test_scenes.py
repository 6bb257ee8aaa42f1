"""Simulated scenes: beam ranges, and the exact fit of both scans of a pair."""

import numpy as np
import pytest

from evalkit.commands.basin import scenes
from evalkit.commands.basin.scenes import SceneModel
from evalkit.core.errors import UnknownName
from evalkit.core.pose import Pose


@pytest.mark.parametrize("name", scenes.SCENES)
def test_without_noise_both_scans_fit_the_scene_with_the_true_motion(name):
    where = scenes.find_scene(name)
    pair = scenes.draw_pair(where, np.random.default_rng(3), 360, 0.0)
    world_from_source = pair.world_from_target @ pair.target_from_source
    for cloud, world_from_sensor in ((pair.target, pair.world_from_target), (pair.source, world_from_source)):
        assert _farthest_from(where, world_from_sensor.transform(cloud.points)) < 1e-9
    met = world_from_source.row[:2] + pair.points
    np.testing.assert_allclose(met, world_from_source.transform(pair.source.points), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(pair.normals, axis=1), 1.0)


def test_the_sensor_keeps_a_distance_from_every_boundary():
    for where in scenes.SCENES.values():
        rng = np.random.default_rng(0)
        for _ in range(50):
            pair = scenes.draw_pair(where, rng, 90, 0.0)
            assert np.linalg.norm(pair.source.points, axis=1).min() > scenes.RANGE_M[0]


def test_an_unknown_scene_is_rejected_by_name():
    with pytest.raises(UnknownName, match="long-corridor"):
        scenes.find_scene("coridor")


def _farthest_from(where: SceneModel, points) -> float:
    start, side = where.world.segments[:, :2], where.world.segments[:, 2:] - where.world.segments[:, :2]
    at = np.clip(np.sum((points[:, None] - start) * side, axis=2) / np.sum(side * side, axis=1), 0.0, 1.0)
    to_walls = np.linalg.norm(points[:, None] - start - at[..., None] * side, axis=2)
    to_discs = np.abs(np.linalg.norm(points[:, None] - where.world.circles[:, :2], axis=2) - where.world.circles[:, 2])
    return float(np.concatenate([to_walls, to_discs], axis=1).min(axis=1).max())


def test_a_pair_consists_of_two_nearby_scans():
    rng = np.random.default_rng(8)
    poses = [scenes.draw_pair(scenes.find_scene("bare-room"), rng, 8, 0.05).target_from_source for _ in range(100)]
    assert np.abs([pose.row for pose in poses]).max(axis=0) == pytest.approx(scenes.NEAR.row, rel=0.1)
    assert Pose() not in poses
