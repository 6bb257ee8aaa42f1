"""The compiled core compared with the NumPy reference: registrations, maps and whole sequences."""

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from evalkit.core.errors import BadParameter, NotInstalled
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.odometry import frontend, planar3d
from evalkit.plugins import registry
from evalkit.plugins.parameters import resolve_parameters
from evalkit_baselines import embedded, paper
from evalkit_baselines.embedded import compiled
from evalkit_baselines.embedded.normals import MAX_NEIGHBOURS
from evalkit_baselines.paper.grid import LogOddsGrid
from evalkit_baselines.paper.icp import Icp, line_normals

sys.path.append(str(Path(__file__).parent))
from l_shaped_room import room

needs_core = pytest.mark.skipif(bool(why := compiled.compiled_missing()), reason=why or "the core is here")

SAME = 1e-9  # m and rad: both compute in double precision, in a different order
FLOAT_M, FLOAT_RAD = 2e-4, 5e-5
"""What single precision may change 10 m around the origin: a float is good to 1e-6 m there, and the stop rule (1e-4 m)
may be met an iteration earlier or later."""

VARIANTS = (
    {},
    {"epsilon": 1e-6},
    {"error": "mean-squared", "epsilon": 1e-7},
    {"error": "rmse", "epsilon": 0.0, "max_iterations": 25},
    {"one_to_one": False, "epsilon": 1e-6},
    {"max_correspondence_m": 0.0},
    {"max_correspondence_m": 0.05, "epsilon": 1e-8},
    {"error_at": "before", "epsilon": 1e-5},
    {"metric": "line", "epsilon": 1e-6},
    {"metric": "line", "cauchy_m": 0.1, "one_to_one": False, "max_correspondence_m": 1.0, "epsilon": 1e-6},
    {"metric": "line", "share_noise": True, "one_to_one": False, "max_correspondence_m": 1.0, "epsilon": 1e-6},
    {"metric": "line", "line_neighbours": 20, "error": "rmse", "error_at": "before", "epsilon": 1e-5},
    {"min_pairs": 900},
)


def make_plugin(spec, **parameters):
    return spec.make(**resolve_parameters("embedded", spec.parameters, parameters))


def scans(seed):
    """Return a local map, a scan of it, and a guess that is some centimetres and degrees off.

    A fifth of the map's points were seen from outside the room: they have no pairs by metric "line".
    """
    rng = np.random.default_rng(seed)
    truth = Pose(*rng.normal(0.0, [0.5, 0.5, 0.5]))
    source = truth.inverse().transform(room(900, 0.02, rng))
    points, origin = room(3000, 0.02, rng), np.array([-0.3, 0.2])
    inwards = truth.transform(origin[None]) - points
    inwards *= np.random.default_rng(seed + 100).choice([1.0, -1.0], (3000, 1), p=[0.8, 0.2]) / np.linalg.norm(
        inwards, axis=1, keepdims=True
    )
    support = rng.integers(1, 40, 3000)  # counts with share_noise, and in the lines of a noisy cloud
    target = Cloud(points, support=support, seen_from=inwards, noisy=bool(seed % 2))
    return target, Cloud(source, origin=origin), truth @ Pose(*rng.normal(0.0, [0.08, 0.08, 0.04]))


def assert_close(found, twin, metres=SAME, radians=SAME):
    ours, theirs = found.target_from_source, twin.target_from_source
    assert math.hypot(ours.x - theirs.x, ours.y - theirs.y) < metres
    assert abs(Pose(0.0, 0.0, ours.theta - theirs.theta).theta) < radians
    assert found.error == pytest.approx(twin.error, abs=metres, nan_ok=True)


def assert_same(found, twin):
    assert_close(found, twin)
    assert (found.converged, found.iterations, found.inliers) == (twin.converged, twin.iterations, twin.inliers)


@needs_core
@pytest.mark.parametrize("variant", VARIANTS, ids=str)
def test_every_variant_of_the_icp_equals_the_reference(variant):
    compiled_icp, twin = make_plugin(embedded.SPEC, **variant), Icp(**variant)
    for seed in range(6):
        target, source, guess = scans(seed)
        assert_same(compiled_icp.register(target, source, guess), twin.register(target, source, guess))


@needs_core
@pytest.mark.parametrize("variant", VARIANTS[:-1], ids=str)
def test_single_precision_stays_within_its_error_budget(variant):
    narrow = make_plugin(embedded.FLOAT, **variant)
    for seed in range(6):
        target, source, guess = scans(seed)
        if variant.get("epsilon", 1.0) < 1e-5:  # below the rounding of a float: both then iterate until the limit
            narrow_, wide = (make_plugin(s, **variant | {"epsilon": 0.0}) for s in (embedded.FLOAT, embedded.SPEC))
            assert_close(narrow_.register(target, source, guess), wide.register(target, source, guess), 1e-3, 1e-4)
        else:
            twin = Icp(**variant).register(target, source, guess)
            assert_close(narrow.register(target, source, guess), twin, FLOAT_M, FLOAT_RAD)


@needs_core
@pytest.mark.parametrize("error", ["mean", "mean-squared", "rmse"])
def test_the_trace_contains_the_same_iterations_and_pairs_as_the_reference(error):
    target, source, guess = scans(3)
    found = make_plugin(embedded.SPEC, trace=True, error=error).register(target, source, guess)
    twin = Icp(trace=True, error=error).register(target, source, guess)
    assert len(found.history) == found.iterations == len(twin.history)
    for ours, theirs in zip(found.history, twin.history, strict=True):
        assert ours.error == pytest.approx(theirs.error, abs=SAME)
        assert ours.target_from_source.row == pytest.approx(theirs.target_from_source.row, abs=SAME)
        assert np.asarray(ours.pairs).tolist() == np.asarray(theirs.pairs).tolist()


COORDINATES = st.integers(-40, 40).map(lambda k: k / 8.0)  # exact in binary; many points coincide or lie on a line
CLOUDS = st.lists(st.tuples(COORDINATES, COORDINATES), max_size=40).map(lambda rows: Cloud(np.reshape(rows, (-1, 2))))


@needs_core
@settings(max_examples=150)
@given(CLOUDS, CLOUDS, st.tuples(*[st.floats(-0.4, 0.4)] * 3))
def test_for_any_clouds_the_result_is_finite_repeatable_and_within_the_tolerance(target, source, guess):
    icp = make_plugin(embedded.SPEC, one_to_one=False, max_correspondence_m=0.0, epsilon=1e-6)
    found = icp.register(target, source, Pose(*guess))
    again = make_plugin(embedded.SPEC, one_to_one=False, max_correspondence_m=0.0, epsilon=1e-6)
    repeated = again.register(target, source, Pose(*guess))
    assert found.target_from_source == repeated.target_from_source
    if not len(target) or len(source) < 3:
        assert (found.target_from_source, found.converged) == (Pose(*guess), False)
        return
    assert found.inliers == len(source)  # no limit, many-to-one: every point has a pair
    assert np.isfinite([*found.target_from_source.row, found.error]).all()
    nearest = np.linalg.norm(Pose(*guess).transform(source.points)[:, None] - target.points, axis=2).min(axis=1)
    assert found.error <= math.sqrt(np.mean(nearest**2)) + 1e-9  # each step reduces the squared distances


@needs_core
@pytest.mark.parametrize("spec", [embedded.SPEC, embedded.FLOAT], ids=["double", "float"])
def test_empty_and_unmatchable_clouds_return_the_exact_guess(spec):
    icp, guess, none = make_plugin(spec), Pose(0.1, 0.2, 0.3), Cloud(np.zeros((0, 2)))
    some, far = Cloud(np.eye(2).repeat(5, axis=0)), Cloud(np.full((9, 2), 50.0))
    for target, source in ((none, some), (some, none), (none, none), (some, far)):
        match = icp.register(target, source, guess)
        assert (match.target_from_source, match.converged, match.inliers) == (guess, False, 0)
        assert math.isnan(match.error)


@needs_core
@pytest.mark.parametrize("spec", [embedded.SPEC, embedded.FLOAT], ids=["double", "float"])
def test_earlier_calls_do_not_change_a_result(spec):
    icp = make_plugin(spec)
    (first, second) = (scans(seed) for seed in (1, 2))
    alone = icp.register(*first)
    icp.register(*second)
    icp.register(Cloud(np.eye(2)), Cloud(np.eye(2)), Pose())
    after = icp.register(*first)
    assert (alone.target_from_source, alone.error) == (after.target_from_source, after.error)


@needs_core
def test_a_coordinate_beyond_the_limit_raises_with_the_message_of_the_core():
    icp, some = make_plugin(embedded.SPEC), Cloud(np.eye(2))
    with pytest.raises(ValueError, match="registration: a parameter is outside its range"):
        icp.register(some, Cloud(np.full((3, 2), 2e6)), Pose())
    with pytest.raises(ValueError, match="target: a parameter is outside its range"):
        icp.register(Cloud(np.full((3, 2), 2e6)), some, Pose())
    with pytest.raises(ValueError, match="nan or infinite"):  # 1e39 m is infinite in single precision
        make_plugin(embedded.FLOAT).register(some, Cloud(np.full((3, 2), 1e39)), Pose())


@needs_core
@pytest.mark.parametrize("k", [2, 5, 8, 20])
def test_compiled_normals_equal_those_of_numpy_and_scipy(k):
    points = room(1500, 0.02, k)
    expected = line_normals(cKDTree(points), k)
    found = embedded.normals_2d(points, k)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, rtol=0.0, atol=1e-15)
    _, near = cKDTree(points).query(points, k=k)
    spreads = np.linalg.eigvalsh(np.stack([np.cov(points[row].T) for row in near]))
    clear = spreads[:, 0] < 0.9 * spreads[:, 1]  # elsewhere the direction is rounding
    assert clear.mean() > 0.9
    np.testing.assert_allclose(found[clear], expected[clear], rtol=0.0, atol=1e-12)


@needs_core
@pytest.mark.parametrize(("k", "radius_m"), [(20, 0.5), (8, 0.2), (5, 0.05)])
def test_compiled_normals_within_a_radius_equal_those_of_the_harness(k, radius_m):
    points = room(1500, 0.02, k)
    points = np.vstack([points, [[30.0, 30.0], [30.1, 30.0]]])  # two points far from all
    expected, found = planar3d.normals(points, k, radius_m), embedded.normals_2d(points, k, radius_m)
    np.testing.assert_array_equal(found.any(axis=1), expected.any(axis=1))
    assert not found[-2:].any()
    assert np.abs(np.sum(found * expected, axis=1))[expected.any(axis=1)] == pytest.approx(1.0, abs=1e-9)
    assert not embedded.normals_2d(np.ones((6, 2)), k, radius_m).any()  # coincident points
    with pytest.raises(ValueError, match="neighbours: a parameter is outside its range"):
        embedded.normals_2d(points, k, 0.0)


@needs_core
def test_normals_of_degenerate_clouds_are_defined():
    up = [0.0, 1.0]
    assert embedded.normals_2d(np.zeros((0, 2)), 8).shape == (0, 2)
    assert embedded.normals_2d(np.array([[3.0, 4.0]]), 8).tolist() == [up]
    assert embedded.normals_2d(np.full((5, 2), 0.1), 4).tolist() == [up] * 5
    assert embedded.normals_2d(np.array([[0.0, 0.0], [0.0, 2.0]]), 8).tolist() == [[-1.0, 0.0]] * 2
    for wrong in (np.nan, np.inf, 2e6):
        with pytest.raises(ValueError, match="target: "):
            embedded.normals_2d(np.array([[0.0, wrong], [1.0, 1.0]]), 2)
    for k in (-1, 1, MAX_NEIGHBOURS + 1):
        with pytest.raises(ValueError, match="neighbours: a parameter is outside its range"):
            embedded.normals_2d(np.eye(2), k)


def test_the_parameters_equal_those_of_the_paper():
    for ours, theirs in ((embedded.SPEC, paper.SPEC), (embedded.MAP_LINE, paper.MAP_LINE)):
        expected = {p.name: (p.default, p.unit, p.low, p.high, p.choices) for p in theirs.parameters}
        expected["line_neighbours"] = (*expected["line_neighbours"][:3], MAX_NEIGHBOURS, ())
        assert {p.name: (p.default, p.unit, p.low, p.high, p.choices) for p in ours.parameters} == expected
        assert ours.frontend == theirs.frontend


@needs_core
def test_a_single_wall_does_not_move_along_itself():
    wall, steps = np.linspace(-3.0, 3.0, 61), np.zeros(61)
    target, source = Cloud(np.stack([wall, steps], axis=1)), Cloud(np.stack([wall + 0.013, steps + 0.04], axis=1))
    found = make_plugin(embedded.MAP_LINE).register(target, source, Pose(0.0, 0.0, 0.01))
    assert_same(found, make_plugin(paper.MAP_LINE).register(target, source, Pose(0.0, 0.0, 0.01)))
    assert found.target_from_source.row == pytest.approx([0.0, -0.04, 0.0], abs=1e-3)


@needs_core
def test_on_a_lasting_map_the_lines_give_the_trajectory_of_the_reference():
    ours, theirs = (
        frontend.make_odometry(spec, frontend.complete_parameters(name, spec, {}))
        for name, spec in (("embedded-map-line", embedded.MAP_LINE), ("paper-map-line", paper.MAP_LINE))
    )
    off = [np.abs((theirs.update(f).pose.inverse() @ ours.update(f).pose).row).max() for f in lab(60)]
    assert max(off) < 1e-8


def lab(scans_wanted=120, every=1):
    frames = (
        registry.dataset("lab")
        .make(**{p.name: p.default for p in registry.dataset("lab").parameters} | {"laps": 0.12, "seed": 5})
        .frames()
    )
    return [frame for index, frame in enumerate(frames) if index < scans_wanted * every][::every]


@needs_core
@pytest.mark.parametrize("clear", [False, True])
def test_the_map_equals_the_reference_cell_by_cell(clear):
    ours, theirs = make_plugin(embedded.MAPPER, clear_no_returns=clear), LogOddsGrid(clear_no_returns=clear)
    for index, frame in enumerate(lab(25, every=5)):
        # not on cell corners, where rounding decides; and far enough away that the map grows
        pose = Pose(30.0 * (index // 13) - 7.2931, 0.02 * index + 0.00113, 0.0977 * index)
        ours.update(frame.scan, pose)
        theirs.update(frame.scan, pose)
    found, twin = ours.grid(), theirs.grid()
    assert (found.origin_x, found.origin_y, found.resolution_m) == (twin.origin_x, twin.origin_y, twin.resolution_m)
    assert np.array_equal(found.observed, twin.observed)
    assert found.log_odds.dtype == np.float32
    assert np.abs(found.log_odds - twin.log_odds).max() < 1e-5
    assert found.observed.sum() > 10_000


@needs_core
@pytest.mark.parametrize("clear", [False, True])
def test_the_map_grows_like_the_reference_when_the_robot_slowly_crosses_its_edge(clear):
    ours, theirs = make_plugin(embedded.MAPPER, clear_no_returns=clear), LogOddsGrid(clear_no_returns=clear)
    angles = np.arange(36) * 0.1737
    for step in range(60):
        ranges = np.where(np.arange(36) % 9 == step % 9, np.inf, 0.71 + 0.013 * step + 0.2 * np.cos(5.0 * angles))
        scan = Scan(step, ranges, angles, 0.1, 2.0)
        pose = Pose(11.0317 - 0.37 * step, 9.0131 + 0.11 * step, 0.0377 * step)
        ours.update(scan, pose)
        theirs.update(scan, pose)
        assert np.array_equal(ours.grid().observed, theirs.grid().observed)
    assert np.abs(ours.grid().log_odds - theirs.grid().log_odds).max() < 1e-5


@needs_core
def test_a_map_without_scans_is_empty_and_one_that_is_too_large_raises():
    mapper = make_plugin(embedded.MAPPER)
    assert mapper.grid().shape == (0, 0)
    mapper.update(Scan(0, np.array([np.inf, np.nan]), np.zeros(2), 0.0, 12.0), Pose())
    assert mapper.grid().shape == (0, 0)
    one = Scan(0, np.ones(1), np.zeros(1), 0.0, 12.0)
    mapper.update(one, Pose())
    before = mapper.grid()
    for far in (1e4, 1e9, 1e300):
        with pytest.raises(BadParameter, match="larger cells"):
            mapper.update(one, Pose(far, 0.0, 0.0))
    assert np.array_equal(mapper.grid().log_odds, before.log_odds)


@needs_core
def test_a_beam_longer_than_all_earlier_ones_is_mapped_completely():
    mapper, twin = make_plugin(embedded.MAPPER), LogOddsGrid()
    for length in (1.0, 30.0, 3.0):
        scan = Scan(0, np.full(3, length), np.arange(3.0), 0.0, length)
        mapper.update(scan, Pose())
        twin.update(scan, Pose())
    assert np.array_equal(mapper.grid().observed, twin.grid().observed)


@needs_core
def test_the_polygon_mapper_frees_the_cells_between_the_beams_and_keeps_the_walls():
    rays, polygon = make_plugin(embedded.MAPPER), make_plugin(embedded.POLYGON_MAPPER)
    frame = lab(1)[0]
    for mapper in (rays, polygon):
        mapper.update(frame.scan, Pose(0.0213, 0.0117, 0.3))
    both = [mapper.grid() for mapper in (rays, polygon)]
    occupied = [set(map(tuple, np.round(grid.centres(grid.log_odds > 0.0), 6))) for grid in both]
    free = [set(map(tuple, np.round(grid.centres(grid.observed & (grid.log_odds < 0.0)), 6))) for grid in both]
    assert occupied[0] == occupied[1]
    assert len(free[0] & free[1]) > 0.95 * len(free[0] | free[1])
    narrow = make_plugin(embedded.POLYGON_MAPPER, widest_gap_deg=0.0)  # every beam is then drawn by itself
    narrow.update(frame.scan, Pose(0.0213, 0.0117, 0.3))
    assert np.array_equal(narrow.grid().log_odds, both[0].log_odds)


@needs_core
@pytest.mark.parametrize("odometry", [True, False])
def test_the_pipeline_follows_a_sequence_like_the_reference_behind_the_front_end(odometry):
    frames = [
        Frame(f.scan, f.base_from_sensor, f.odom_from_base, f.start_from_end)
        if odometry
        else Frame(f.scan, f.base_from_sensor)
        for f in lab(90)
    ]
    twin = frontend.make_odometry(paper.SPEC, frontend.complete_parameters("paper", paper.SPEC, {}))
    pipeline = make_plugin(embedded.PIPELINE)
    worst = max(np.abs((twin.update(f).pose.inverse() @ pipeline.update(f).pose).row).max() for f in frames)
    assert worst < 1e-8
    narrow, wide = make_plugin(embedded.PIPELINE, precision="float"), make_plugin(embedded.PIPELINE)
    off = max(np.abs((wide.update(f).pose.inverse() @ narrow.update(f).pose).row).max() for f in frames)
    assert 0.0 < off < 0.02  # m and rad: an iteration more or less changes all later poses


@needs_core
@pytest.mark.parametrize(
    "settings", [{}, {"share_noise": True}, {"local_map": "keyframes", "local_map_voxel_m": 0.0, "keyframes": 3}]
)
def test_the_pipeline_of_lines_follows_a_sequence_like_paper_map_line(settings):
    complete = frontend.complete_parameters("paper-map-line", paper.MAP_LINE, settings | {"local_map_radius_m": 5.0})
    twin, pipeline = (
        frontend.make_odometry(paper.MAP_LINE, complete),
        make_plugin(embedded.PIPELINE_LINE, **settings | {"local_map_radius_m": 5.0}),
    )
    for frame in lab(40):
        expected, reported = twin.update(frame), pipeline.update(frame)
        assert np.abs((expected.pose.inverse() @ reported.pose).row).max() < 1e-8
        for name, stage in reported.stages.items():
            theirs = expected.stages[name]
            assert (stage.accepted, stage.iterations, stage.inliers) == (
                theirs.accepted,
                theirs.iterations,
                theirs.inliers,
            )


@needs_core
def test_a_lasting_map_that_is_full_and_one_of_no_voxels_are_refused():
    frame = lab(1)[0]
    with pytest.raises(ValueError, match="the lasting map is full: 20 voxels; set 'voxels' to more"):
        make_plugin(embedded.PIPELINE_LINE, voxels=20).update(frame)
    with pytest.raises(BadParameter, match="local_map_voxel_m"):
        make_plugin(embedded.PIPELINE_LINE, local_map_voxel_m=0.0)
    with pytest.raises(BadParameter, match="keyframes are not thinned"):
        make_plugin(embedded.PIPELINE, local_map_voxel_m=0.1)


@needs_core
def test_the_pipeline_reports_both_stages_like_the_front_end():
    twin = frontend.make_odometry(paper.SPEC, frontend.complete_parameters("paper", paper.SPEC, {"min_inliers": 60}))
    pipeline = make_plugin(embedded.PIPELINE, min_inliers=60)
    nothing = np.full(50, np.inf)
    for index, frame in enumerate(lab(12)):
        if index in (5, 6):  # one scan without returns, and one with too few returns
            ranges = nothing if index == 5 else np.concatenate([nothing, frame.scan.ranges[:40]])
            scan = Scan(frame.scan.stamp_ns, ranges, frame.scan.angles[: len(ranges)], 0.15, 12.0)
            frame = Frame(scan, frame.base_from_sensor, frame.odom_from_base)  # noqa: PLW2901
        expected, reported = twin.update(frame), pipeline.update(frame)
        assert reported.accepted == expected.accepted
        assert len(reported.stages) == (2 if index else 0)
        assert index != 5 or not any(stage.accepted for stage in reported.stages.values())
        for name, stage in reported.stages.items():
            theirs = expected.stages[name]
            assert (stage.accepted, stage.converged) == (theirs.accepted, theirs.converged)
            assert (stage.iterations, stage.inliers) == (theirs.iterations, theirs.inliers)
            assert stage.residual_m == pytest.approx(theirs.residual_m, abs=1e-8, nan_ok=True)


@needs_core
def test_a_scan_without_beams_returns_the_guess_and_one_with_too_many_raises():
    pipeline = make_plugin(embedded.PIPELINE, beams=300)
    walls = Scan(0, np.full(300, 2.0), np.linspace(0.0, 6.0, 300), 0.0, 12.0)
    assert pipeline.update(Frame(walls, odom_from_base=Pose())).pose == Pose()
    none = Scan(1, np.zeros(0), np.zeros(0), 0.0, 12.0)
    assert pipeline.update(Frame(none, odom_from_base=Pose(0.1, 0.0, 0.0))).pose.x == pytest.approx(0.1)
    long = Scan(2, np.full(301, 2.0), np.zeros(301), 0.0, 12.0)
    with pytest.raises(ValueError, match="more points or beams than the capacity"):
        pipeline.update(Frame(long))


def test_a_package_without_the_compiled_core_is_built_from_a_checkout_not_from_the_index(tmp_path, monkeypatch):
    monkeypatch.setattr(compiled, "MODULES", {"double": "_core_absent"})
    assert "--editable" in compiled.compiled_missing()
    monkeypatch.setattr(compiled, "__file__", str(tmp_path / "site" / "evalkit_baselines" / "embedded" / "compiled.py"))
    assert compiled.compiled_missing().endswith("--no-deps . (in a checkout of evalkit)")


def test_without_the_compiled_core_every_method_is_unavailable_and_has_no_substitute(monkeypatch):
    monkeypatch.setattr(compiled, "MODULES", {"double": "_core_absent"})
    for spec in (embedded.SPEC, embedded.FLOAT, embedded.PIPELINE, embedded.PIPELINE_LINE, embedded.MAPPER):
        assert spec.missing().startswith(
            "not installed: the compiled core was not built (needs a C and a C++ compiler)"
        )
        assert "pip install" in spec.missing()
    monkeypatch.setitem(sys.modules, "evalkit_baselines.embedded._core64", None)
    monkeypatch.delattr(embedded, "_core64", raising=False)
    with pytest.raises(NotInstalled, match="does not load"):
        make_plugin(embedded.SPEC)
