"""Every perturbation changes a trajectory as described, by its size."""

import numpy as np
import pytest

from evalkit.commands.metric_validation.perturbation import PERTURBATIONS
from evalkit.core import se2


def line(count=101):
    """Return poses along x, ten per metre, ten metres long."""
    x = np.linspace(0.0, 10.0, count)
    return np.stack([x, 0.0 * x, 0.0 * x], axis=1)


def perturb_line(name, size, seed=0, poses=None):
    return PERTURBATIONS[name].perturb(line() if poses is None else poses, size, np.random.default_rng(seed))


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_size_zero_changes_nothing_and_the_start_stays(name):
    assert np.allclose(perturb_line(name, 0.0), line(), atol=1e-9)
    if name != "jitter":
        assert np.allclose(perturb_line(name, 0.5)[0], line()[0])


@pytest.mark.parametrize("name", PERTURBATIONS)
def test_perturbations_are_independent_of_the_world_frame(name):
    world = np.array([3.0, -2.0, 1.0])
    moved = perturb_line(name, 0.3, poses=se2.compose(world, line()))
    assert np.allclose(moved, se2.compose(world, perturb_line(name, 0.3)), atol=1e-9)


def test_a_yaw_bias_rotates_by_its_size_per_metre():
    assert np.degrees(perturb_line("yaw bias", 1.5)[-1, 2]) == pytest.approx(15.0)


def test_a_scale_lengthens_the_path_by_its_size():
    assert perturb_line("scale", 5.0)[-1] == pytest.approx([10.5, 0.0, 0.0])


def test_heading_drift_has_its_size_after_a_metre():
    after = np.array([perturb_line("drift", 2.0, seed)[10, 2] for seed in range(400)])
    assert np.degrees(after.std()) == pytest.approx(2.0, rel=0.1)


def test_jitter_is_noise_of_its_size():
    off = perturb_line("jitter", 0.1) - line()
    assert off[:, :2].std() == pytest.approx(0.1, rel=0.15)
    assert np.degrees(off[:, 2].std()) == pytest.approx(2.0, rel=0.2)


def test_a_jump_stays_and_a_ghost_loop_ends():
    jumped, ghost = perturb_line("jump", 0.4)[:, 1], perturb_line("ghost loop", 0.4)[:, 1]
    assert np.allclose(jumped[:50], 0.0)
    assert np.allclose(jumped[50:], 0.4)
    aside = np.flatnonzero(ghost)
    assert (aside[0], aside[-1]) == (40, 69)
    assert np.allclose(ghost[aside], 0.4)
