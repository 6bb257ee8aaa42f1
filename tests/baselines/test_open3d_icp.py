"""Open3D on planar clouds: each method recovers a known motion, and none is degraded by z = 0."""

import importlib.metadata
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import NotInstalled
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.odometry import planar3d
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import open3d_icp, planar_registration

sys.path.append(str(Path(__file__).parent))
from l_shaped_room import TRUTH, compute_error_m, room

METHODS = {
    "point-to-point": open3d_icp.POINT_TO_POINT,
    "point-to-plane": open3d_icp.POINT_TO_PLANE,
    "generalized": open3d_icp.GENERALIZED,
}

needs_open3d = pytest.mark.skipif(bool(why := open3d_icp.plane_missing()), reason=why or "open3d is here")


def backend(method, **parameters):
    spec = METHODS[method]
    return spec.make(**resolve_parameters(method, spec.parameters, parameters))


@needs_open3d
@pytest.mark.parametrize("method", METHODS)
def test_a_known_motion_is_recovered_to_the_millimetre(method):
    target = room()
    source = TRUTH.inverse().transform(target[::2])
    match = backend(method, max_iterations=300, relative_rmse=1e-9).register(Cloud(target), Cloud(source), Pose())
    assert match.converged
    assert compute_error_m(match) < 1e-3
    assert match.inliers == len(source)
    assert match.error < 1e-3


@needs_open3d
@pytest.mark.parametrize("method", METHODS)
def test_with_lidar_noise_a_known_motion_is_recovered_to_centimetres(method):
    match = backend(method).register(
        Cloud(room(3000, 0.03)), Cloud(TRUTH.inverse().transform(room(800, 0.03, seed=1))), Pose()
    )
    assert compute_error_m(match) < 0.03


@needs_open3d
def test_normals_from_open3d_return_the_guess_with_perfect_fitness_and_ours_do_not():
    import open3d as o3d

    target, source = room(3000, 0.01), TRUTH.inverse().transform(room(800, 0.01, seed=1))
    fixed, moving = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(planar3d.points_3d(points))) for points in (target, source)
    )
    fixed.estimate_normals()
    methods = o3d.pipelines.registration
    trapped = methods.registration_icp(moving, fixed, 0.5, np.eye(4), methods.TransformationEstimationPointToPlane())
    assert trapped.fitness > 0.99
    assert np.allclose(trapped.transformation, np.eye(4), atol=1e-9)
    ours = backend("point-to-plane").register(Cloud(target), Cloud(source), Pose())
    assert compute_error_m(ours) < 0.01


@needs_open3d
def test_planar_covariances_make_generalized_icp_differ_from_point_to_point():
    target, source = Cloud(room(3000, 0.03)), Cloud(TRUTH.inverse().transform(room(800, 0.03, seed=1)))
    answers = [backend(method).register(target, source, Pose()).target_from_source.row for method in METHODS]
    assert np.abs(answers[2] - answers[0]).max() > 1e-4


@needs_open3d
@pytest.mark.parametrize("method", METHODS)
def test_a_single_wall_keeps_the_guess_along_the_wall(method):
    along = np.random.default_rng(0).uniform(-5.0, 5.0, 1500)
    wall = Cloud(np.stack([along, np.zeros_like(along)], axis=-1))
    match = backend(method).register(wall, Cloud(Pose(0.0, 0.05).transform(wall.points[::3])), Pose())
    assert abs(match.target_from_source.y + 0.05) < 1e-3
    assert abs(match.target_from_source.x) < 0.02
    assert abs(match.target_from_source.theta) < 1e-3


@needs_open3d
@pytest.mark.parametrize("method", METHODS)
def test_the_same_input_gives_identical_results_independent_of_earlier_calls(method):
    target, source = Cloud(room(3000, 0.03)), Cloud(TRUTH.inverse().transform(room(800, 0.03, seed=1)))
    before = target.points.tobytes(), source.points.tobytes()
    used = backend(method)
    first = used.register(target, source, Pose())
    used.register(Cloud(room(500, 0.03, seed=5)), source, Pose(0.1, 0.1, 0.1))
    used.register(source, target, Pose())
    again, fresh = used.register(target, source, Pose()), backend(method).register(target, source, Pose())
    assert first.target_from_source == again.target_from_source == fresh.target_from_source
    assert (first.error, first.inliers) == (again.error, again.inliers) == (fresh.error, fresh.inliers)
    assert (target.points.tobytes(), source.points.tobytes()) == before


@needs_open3d
def test_the_normals_of_a_cloud_are_computed_once_for_both_stages_and_released_with_it(monkeypatch):
    made, normals, kept = [], open3d_icp.normals_2d, len(planar_registration._prepared)
    monkeypatch.setattr(open3d_icp, "normals_2d", lambda *a: made.append(len(a[0])) or normals(*a))
    first, second = backend("generalized"), backend("generalized")
    last, source, target = Cloud(room(700)), Cloud(room(200)), Cloud(room(900))
    for stage, against in ((first, last), (second, target), (first, last)):
        stage.register(against, source, Pose())
    assert made == [700, 200, 900]  # each cloud once
    backend("generalized", normal_neighbours=7).register(target, source, Pose())
    assert made == [700, 200, 900, 900, 200]  # other settings, other normals
    del last, source, target, against
    assert len(planar_registration._prepared) == kept


@needs_open3d
def test_the_time_of_the_normals_is_reported_apart_from_the_conversion():
    target, source = Cloud(room(3000)), Cloud(room(300))
    cost = backend("point-to-plane").register(target, source, Pose()).cost
    assert cost.preparation_ns > 0
    assert backend("point-to-point").register(target, source, Pose()).cost.preparation_ns == 0


@needs_open3d
def test_open3d_loads_its_drawing_in_a_browser_only_where_it_draws():
    """In a process of its own; afterwards the names of Open3D are its own functions again."""
    program = (
        "import sys, numpy\nfrom evalkit_baselines import open3d_icp\n"
        "open3d_icp.POINT_TO_POINT.make()\nimport open3d\n"
        "points = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(numpy.zeros((7, 3))))\n"
        "for name in ('dash', 'plotly'): print(name in sys.modules)\n"
        "print(len(open3d.visualization.get_plotly_fig([points]).data[0].x), 'dash' in sys.modules)\n"
        "print(open3d.visualization.draw_plotly.__module__, open3d.visualization.draw_plotly_server.__name__)"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == [
        "False", "False", "7", "True", "open3d.visualization.draw_plotly", "draw_plotly_server",
    ]  # fmt: skip


@needs_open3d
@pytest.mark.parametrize("method", METHODS)
def test_too_few_points_return_the_guess(method):
    guess, enough, none = Pose(0.1, 0.2, 0.3), Cloud(room(200)), Cloud(np.zeros((0, 2)))
    for target, source in (
        (none, enough), (enough, none), (none, none), (enough, Cloud(enough.points[:2])),
        (enough, Cloud(enough.points + 100.0)),
    ):  # fmt: skip
        match = backend(method).register(target, source, guess)
        assert not match.converged
        assert match.target_from_source == guess
        assert match.inliers == 0


@needs_open3d
@pytest.mark.parametrize("kernel", ["none", "tukey", "huber", "cauchy"])
def test_every_kernel_recovers_the_motion(kernel):
    source = Cloud(TRUTH.inverse().transform(room()[::2]))
    for method in ("point-to-plane", "generalized"):
        match = backend(method, kernel=kernel).register(Cloud(room()), source, Pose())
        assert compute_error_m(match) < 5e-3


def test_a_missing_package_is_reported_with_its_install_command(monkeypatch):
    monkeypatch.setattr(open3d_icp.importlib.util, "find_spec", lambda _name: None)
    assert open3d_icp.open3d_missing() == "not installed: pip install 'evalkit[open3d]'"


def test_a_missing_system_library_is_reported_with_its_install_command(monkeypatch):
    monkeypatch.setattr(open3d_icp.importlib.util, "find_spec", lambda _name: object())
    monkeypatch.setattr(open3d_icp, "_read_version", lambda: (0, 20))
    monkeypatch.setattr(open3d_icp.sys, "platform", "linux")
    monkeypatch.setattr(open3d_icp, "_can_load", lambda name: name != "libusb-1.0.so.0")
    assert open3d_icp.open3d_missing() == (
        "open3d needs missing system libraries (libusb-1.0.so.0): "
        "apt-get install -y --no-install-recommends libgl1 libegl1 libx11-6 libusb-1.0-0"
    )


def test_a_version_without_a_thread_limit_is_reported_with_its_replacement(monkeypatch):
    monkeypatch.setattr(open3d_icp.importlib.util, "find_spec", lambda _name: object())
    monkeypatch.setattr(open3d_icp.importlib.metadata, "version", lambda _name: "0.19.0+1e7b174")
    assert open3d_icp.open3d_missing() == (
        "open3d 0.19 cannot be limited to one thread, 0.20 can: pip install 'evalkit[open3d]'"
    )
    # its requirement names the version; --upgrade would also replace evalkit by PyPI's project of this name
    extra = [one for one in importlib.metadata.requires("evalkit") if re.search("extra == .open3d.", one)]
    assert extra
    assert all(">=0.20" in one for one in extra)


def test_a_library_that_does_not_exist_is_not_loaded():
    assert not open3d_icp._can_load("libno-such-thing.so.77")


@pytest.mark.parametrize("method", METHODS)
def test_a_failing_import_raises_not_installed(method, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(NotInstalled, match="does not load"):
        backend(method)


@needs_open3d
def test_a_result_that_flips_the_plane_is_not_accepted():
    """A rough wall and its mirror image: half a turn about the wall fits best in 3D, but leaves the plane."""
    wall = np.array([[0.0, 0.01], [1.0, -0.01], [2.0, 0.01], [3.0, -0.01]])
    guess = Pose(0.001, 0.0, 0.0)
    match = backend("point-to-point").register(Cloud(wall), Cloud(wall * [1.0, -1.0]), guess)
    assert not match.converged
    assert match.inliers == 0
    assert match.target_from_source == guess
