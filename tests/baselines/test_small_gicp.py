"""small_gicp on planar clouds: both methods recover a known motion because flat points are turned into walls."""

import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import NotInstalled
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import small_gicp

sys.path.append(str(Path(__file__).parent))
from l_shaped_room import TRUTH, compute_error_m, room

METHODS = {"point-to-point": small_gicp.POINT_TO_POINT, "point-to-plane": small_gicp.POINT_TO_PLANE}

needs_small_gicp = pytest.mark.skipif(bool(why := small_gicp.small_gicp_missing()), reason=why or "small_gicp is here")


def backend(method, **parameters):
    spec = METHODS[method]
    return spec.make(**resolve_parameters(method, spec.parameters, parameters))


@needs_small_gicp
@pytest.mark.parametrize("method", METHODS)
def test_a_known_motion_is_recovered_to_the_millimetre(method):
    target = room()
    match = backend(method, max_iterations=300, translation_epsilon_m=1e-7, rotation_epsilon_deg=1e-5).register(
        Cloud(target), Cloud(TRUTH.inverse().transform(target[::2])), Pose()
    )
    assert match.converged
    assert compute_error_m(match) < 1e-3
    assert match.inliers == 600
    assert match.error < 1e-3


@needs_small_gicp
@pytest.mark.parametrize("method", METHODS)
def test_with_lidar_noise_a_known_motion_is_recovered_to_centimetres(method):
    match = backend(method).register(
        Cloud(room(3000, 0.03)), Cloud(TRUTH.inverse().transform(room(800, 0.03, seed=1))), Pose()
    )
    assert compute_error_m(match) < 0.03


@needs_small_gicp
def test_library_normals_of_a_flat_target_give_no_constraint_and_those_of_three_layers_do():
    import small_gicp as library

    target, source = room(3000, 0.01), TRUTH.inverse().transform(room(800, 0.01, seed=1))
    cloud = library.PointCloud(planar3d.points_3d(target))
    tree = library.KdTree(cloud)
    library.estimate_normals_covariances(cloud, tree)
    flat = library.align(cloud, library.PointCloud(planar3d.points_3d(source)), tree, registration_type="PLANE_ICP")
    assert np.allclose(flat.T_target_source, np.eye(4), atol=1e-9)
    assert compute_error_m(backend("point-to-plane").register(Cloud(target), Cloud(source), Pose())) < 0.01


@needs_small_gicp
def test_the_error_of_point_to_point_is_the_root_mean_square_distance():
    target = room(3000, 0.02)
    source = room(500, 0.02, seed=1)
    match = backend("point-to-point", max_correspondence_m=5.0).register(Cloud(target), Cloud(source), Pose())
    moved = match.target_from_source.transform(source)
    nearest = np.linalg.norm(moved[:, None] - target, axis=2).min(axis=1)
    assert match.inliers == len(source)
    assert match.error == pytest.approx(np.sqrt(np.mean(nearest**2)), rel=1e-2)


@needs_small_gicp
@pytest.mark.parametrize("method", METHODS)
def test_too_few_points_return_the_guess_as_not_converged(method):
    guess, none, two = Pose(0.1, 0.2, 0.3), Cloud(np.zeros((0, 2))), Cloud(np.eye(2))
    far = Cloud(room(50) + 100.0)
    for target, source in (
        (none, none),
        (Cloud(room(50)), none),
        (none, Cloud(room(50))),
        (two, two),
        (Cloud(room(50)), far),
    ):
        match = backend(method).register(target, source, guess)
        assert (match.target_from_source, match.converged) == (guess, False)
        assert match.inliers < 3


@needs_small_gicp
@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_identical_results_independent_of_earlier_calls(method):
    target, source = Cloud(room(2000, 0.02)), Cloud(room(500, 0.02, seed=1))
    one = backend(method)
    first = one.register(target, source, TRUTH)
    one.register(source, target, Pose())
    assert one.register(target, source, TRUTH).target_from_source == first.target_from_source
    assert backend(method).register(target, source, TRUTH).target_from_source == first.target_from_source


def test_a_flat_cloud_becomes_three_layers_with_vertical_walls():
    space = small_gicp.extrude_layers(np.array([[1.0, 2.0], [3.0, 4.0]]), 0.12)
    assert space.tolist() == [
        [1.0, 2.0, -0.12], [3.0, 4.0, -0.12], [1.0, 2.0, 0.0], [3.0, 4.0, 0.0], [1.0, 2.0, 0.12], [3.0, 4.0, 0.12],
    ]  # fmt: skip


@pytest.mark.parametrize("spec", METHODS.values(), ids=METHODS)
def test_a_missing_library_gives_a_reason_and_an_error_with_the_install_command(monkeypatch, spec):
    monkeypatch.setattr(small_gicp.importlib.util, "find_spec", lambda _: None)
    assert spec.missing() == "not installed: pip install 'evalkit[small-gicp]'"
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(NotInstalled, match=r"small_gicp: does not load .*; pip install"):
        spec.make(**resolve_parameters("small-gicp", spec.parameters, {}))
