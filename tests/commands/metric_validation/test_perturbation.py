"""Ways to spoil a trajectory: each does what it says, by the size it says, and nothing else."""

import numpy as np
import pytest

from evalkit.commands.metric_validation.perturbation import WAYS
from evalkit.core import se2


def line(count=101):
    """A metre every ten poses, along x, ten metres in all."""
    x = np.linspace(0.0, 10.0, count)
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


def spoiled(way, size, seed=0, poses=None):
    return WAYS[way].spoil(line() if poses is None else poses, size, np.random.default_rng(seed))


@pytest.mark.parametrize("way", WAYS)
def test_nothing_is_spoiled_by_a_size_of_nothing_and_the_start_never(way):
    assert np.allclose(spoiled(way, 0.0), line(), atol=1e-9)
    if way != "jitter":
        assert np.allclose(spoiled(way, 0.5)[0], line()[0])


@pytest.mark.parametrize("way", WAYS)
def test_the_frame_of_the_world_does_not_matter(way):
    world = np.array([3.0, -2.0, 1.0])
    moved = spoiled(way, 0.3, poses=se2.compose(world, line()))
    assert np.allclose(moved, se2.compose(world, spoiled(way, 0.3)), atol=1e-9)


def test_a_yaw_bias_turns_so_many_degrees_a_metre():
    assert np.degrees(spoiled("yaw bias", 1.5)[-1, 2]) == pytest.approx(15.0)


def test_a_scale_makes_the_path_longer_by_so_many_per_cent():
    assert spoiled("scale", 5.0)[-1] == pytest.approx([10.5, 0.0, 0.0])


def test_a_drifting_heading_is_off_by_its_size_over_a_metre():
    after = np.array([spoiled("drift", 2.0, seed)[10, 2] for seed in range(400)])
    assert np.degrees(after.std()) == pytest.approx(2.0, rel=0.1)


def test_jitter_is_noise_of_its_size_at_every_pose():
    off = spoiled("jitter", 0.1) - line()
    assert off[:, :2].std() == pytest.approx(0.1, rel=0.15)
    assert np.degrees(off[:, 2].std()) == pytest.approx(2.0, rel=0.2)


def test_a_jump_stays_and_a_ghost_comes_back():
    jumped, ghost = spoiled("jump", 0.4)[:, 1], spoiled("ghost loop", 0.4)[:, 1]
    assert np.allclose(jumped[:50], 0.0)
    assert np.allclose(jumped[50:], 0.4)
    aside = np.flatnonzero(ghost)
    assert (aside[0], aside[-1]) == (40, 69)
    assert np.allclose(ghost[aside], 0.4)
