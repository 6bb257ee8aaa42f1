import os
import re
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.pose_graph import PoseGraph
from evalkit.io.g2o import format_g2o, read_g2o
from evalkit_baselines.slam import __main__ as slam_command
from evalkit_baselines.slam import pose_graph

GRAPHS = Path(os.environ.get("EVALKIT_DATA", "")) / "graphs"
needs_graphs = pytest.mark.skipif(
    not os.environ.get("EVALKIT_DATA") or not GRAPHS.is_dir(), reason="no published pose graphs in $EVALKIT_DATA/graphs"
)

STEP, HEADING = np.array([1.0, 0.0, 0.0]), np.radians(90.0)
INFORMATION = np.diag([100.0, 100.0, 400.0])


def square_drive(laps, noise=0.0, seed=0):
    """A drive around a square of 4 m in steps of 1 m, with a loop edge from each pose to the one a lap before."""
    turns = np.where(np.arange(16 * laps) % 4 == 3, HEADING, 0.0)
    motions = np.column_stack([np.ones(len(turns)), np.zeros(len(turns)), turns])
    true = [np.zeros(3)]
    for motion in motions:
        true.append(se2.compose(true[-1], motion))
    true = np.array(true)
    rng = np.random.default_rng(seed)
    first = np.r_[np.arange(len(motions)), np.arange(len(true) - 16)]
    second = np.r_[np.arange(1, len(true)), np.arange(16, len(true))]
    measured = se2.between(true[first], true[second]) + noise * rng.standard_normal((len(first), 3))
    poses = [np.zeros(3)]
    for motion in measured[: len(motions)]:
        poses.append(se2.compose(poses[-1], motion))
    return PoseGraph(poses, first, second, measured, np.tile(INFORMATION, (len(first), 1, 1))), true


@cache
def published(name):
    return read_g2o(GRAPHS / f"{name}.g2o").graph


# --- check values on published graphs: start, optimum (g2o gives the same digits for the first three)


@needs_graphs
@pytest.mark.parametrize(
    ("name", "start", "optimum"),
    [
        ("carlone-INTEL", 5.150e6, 215.83023),
        ("carlone-M3500", 2.567e6, 137.91295),
        ("sesync-intel", 551.736, 45.004696),
    ],
)
def test_published_graphs_have_their_published_optimum_from_odometry_and_from_linear_angles(name, start, optimum):
    graph = published(name)
    assert graph.chi_squares().sum() == pytest.approx(start, rel=2e-4)
    for begin in (graph, pose_graph.start_from_linear_angles(graph)):
        solution = pose_graph.optimise(begin)
        assert solution.converged
        assert solution.iterations <= 8
        assert solution.chi_square == pytest.approx(optimum, abs=5e-6)


@needs_graphs
def test_a_graph_without_poses_is_chained_and_has_its_published_optimum():
    file = read_g2o(GRAPHS / "sesync-manhattan.g2o")
    assert file.chained == 3500
    assert pose_graph.optimise(file.graph).chi_square == pytest.approx(3549.037, abs=5e-4)


@needs_graphs
def test_short_loops_first_find_the_full_turns_of_two_loops_that_hold_gauss_newton_in_a_local_minimum():
    graph = published("carlone-MITb")
    assert pose_graph.optimise(graph).chi_square == pytest.approx(770.66350, abs=1e-4)
    solution = pose_graph.optimise(pose_graph.start_from_linear_angles(graph))
    assert solution.chi_square == pytest.approx(41.163, abs=5e-4)  # the best known


@needs_graphs
def test_random_loops_do_not_move_the_robust_optimum():
    graph = published("carlone-INTEL")
    clean = pose_graph.optimise(graph).graph.poses
    odometry = graph.second - graph.first == 1
    loops, rng = np.flatnonzero(~odometry), np.random.default_rng(1)
    first, second = np.sort(rng.integers(0, len(graph), (25, 2)), axis=1).T
    doubted = PoseGraph(
        graph.poses,
        np.r_[graph.first, first],
        np.r_[graph.second, second],
        np.r_[graph.first_from_second, rng.uniform(-1.0, 1.0, (25, 3)) * [1.0, 1.0, np.pi]],
        np.r_[graph.information, graph.information[rng.choice(loops, 25)]],
    )
    trusted = np.r_[odometry, np.zeros(25, dtype=bool)]

    def worst(solution):
        return np.linalg.norm(solution.graph.poses[:, :2] - clean[:, :2], axis=1).max()

    assert worst(pose_graph.optimise(doubted)) > 5.0
    assert worst(pose_graph.optimise(doubted, kernel=pose_graph.dcs_kernel(10.0, trusted))) < 0.05
    truncated = pose_graph.optimise_truncated(doubted, trusted)
    assert worst(truncated) < 0.001
    assert not truncated.weights[-25:].any()
    assert truncated.weights[:-25].all()


# --- known answers without files


def test_a_drive_with_exact_motions_is_recovered_from_disturbed_poses():
    graph, true = square_drive(2)
    disturbed = graph.moved(
        true + np.random.default_rng(0).normal(0.0, 0.1, true.shape) * (np.arange(len(true)) > 0)[:, None]
    )
    solution = pose_graph.optimise(disturbed)
    assert solution.chi_square == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(se2.between(solution.graph.poses, true), 0.0, atol=1e-9)


def test_linear_angles_alone_recover_a_drive_with_exact_motions_from_useless_poses():
    graph, true = square_drive(2)
    start = pose_graph.start_from_linear_angles(graph.moved(np.zeros_like(true)))
    np.testing.assert_allclose(se2.between(start.poses, true), 0.0, atol=1e-9)


def test_two_measurements_of_one_motion_are_averaged_by_their_information():
    information = [np.eye(3), 3.0 * np.eye(3)]
    graph = PoseGraph(np.zeros((2, 3)), [0, 0], [1, 1], [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], information)
    solution = pose_graph.optimise(graph)
    np.testing.assert_allclose(solution.graph.poses[1], [1.75, 0.0, 0.0], atol=1e-12)
    assert solution.chi_square == pytest.approx(0.75**2 + 3.0 * 0.25**2)


def test_the_covariance_of_a_chain_is_the_sum_of_its_steps_and_halves_with_a_second_chain():
    steps = 4
    poses = np.column_stack([np.arange(steps + 1.0), np.zeros((steps + 1, 2))])
    rows = np.arange(steps)
    information = np.tile(np.diag([100.0, 100.0, 1e12]), (steps, 1, 1))
    chain = PoseGraph(poses, rows, rows + 1, np.tile(STEP, (steps, 1)), information)
    covariance = pose_graph.relative_covariance(chain, 0, steps)
    np.testing.assert_allclose(np.diag(covariance)[:2], steps / 100.0, rtol=1e-6)
    between_two = pose_graph.relative_covariance(chain, 1, 3)
    np.testing.assert_allclose(np.diag(between_two)[:2], 2 / 100.0, rtol=1e-6)
    twice = PoseGraph(
        poses, np.r_[rows, 0], np.r_[rows + 1, steps], np.r_[chain.first_from_second, [[4.0, 0.0, 0.0]]],
        np.r_[information, information[:1] / steps],
    )  # fmt: skip
    np.testing.assert_allclose(np.diag(pose_graph.relative_covariance(twice, 0, steps))[0], steps / 200.0, rtol=1e-6)


def test_the_heading_error_of_a_chain_moves_its_end_by_the_lever():
    poses = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [11.0, 0.0, 0.0]])
    information = np.tile(np.diag([1e12, 1e12, 1e4]), (2, 1, 1))
    chain = PoseGraph(poses, [0, 1], [1, 2], [[1.0, 0.0, 0.0], [10.0, 0.0, 0.0]], information)
    # 0.01 rad at pose 1, 10 m before the end: 0.1 m sideways
    assert np.sqrt(pose_graph.relative_covariance(chain, 0, 2)[1, 1]) == pytest.approx(0.1, rel=1e-6)


def test_a_part_without_connection_to_the_first_pose_stays_where_it_is():
    poses = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [9.0, 9.0, 1.0], [9.5, 9.0, 1.0]]
    graph = PoseGraph(poses, [0, 2], [1, 3], [STEP, STEP], [np.eye(3)] * 2)
    solution = pose_graph.optimise(graph)
    np.testing.assert_allclose(solution.graph.poses[1], STEP, atol=1e-12)
    np.testing.assert_array_equal(solution.graph.poses[2:], poses[2:])


def test_a_direction_that_no_edge_measures_does_not_move():
    along_x = np.diag([1.0, 0.0, 1.0])
    solution = pose_graph.optimise(PoseGraph([[0, 0, 0], [0.5, 0.3, 0]], [0], [1], [STEP], [along_x]))
    np.testing.assert_allclose(solution.graph.poses[1], [1.0, 0.3, 0.0], atol=1e-6)


def test_two_loops_that_contradict_each_other_are_not_both_kept():
    graph, true = square_drive(2)
    graph = PoseGraph(
        graph.poses,
        *(values[:32] for values in (graph.first, graph.second, graph.first_from_second, graph.information)),
    )
    sides = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]  # of the last pose from the first: the true one, and one 3 m away
    contradicting = PoseGraph(
        graph.poses, np.r_[graph.first, 0, 0, 0], np.r_[graph.second, 32, 32, 31],
        np.r_[graph.first_from_second, sides, [true[31]]], np.r_[graph.information, np.tile(INFORMATION, (3, 1, 1))],
    )  # fmt: skip
    trusted = np.arange(35) < 32
    solution = pose_graph.optimise_truncated(contradicting, trusted)
    assert solution.weights[32:].tolist() == [1.0, 0.0, 1.0]
    np.testing.assert_allclose(solution.graph.poses[32, :2], [0.0, 0.0], atol=1e-6)


@pytest.mark.parametrize("steps", [8, 40])
def test_contradicting_loops_of_a_large_graph_take_a_bounded_number_of_steps(monkeypatch, steps):
    graph, true = square_drive(4)
    wrong = np.array([[4.0, 3.0, 0.5], [4.0, 3.0, 0.5]])
    graph = PoseGraph(
        graph.poses, np.r_[graph.first, 3, 9], np.r_[graph.second, 50, 55],
        np.r_[graph.first_from_second, wrong], np.r_[graph.information, np.tile(INFORMATION, (2, 1, 1))],
    )  # fmt: skip
    trusted = np.arange(len(graph.first)) < 64
    monkeypatch.setattr(pose_graph, "MAX_POSE_STEPS", steps * len(graph))
    solution = pose_graph.optimise_truncated(graph, trusted)
    assert solution.iterations <= steps
    assert not solution.weights[-2:].any()
    assert solution.weights[:-2].all()
    np.testing.assert_allclose(se2.between(solution.graph.poses, true), 0.0, atol=1e-6)


def test_the_optimum_does_not_depend_on_the_frame_of_the_first_pose():
    graph, _ = square_drive(3, noise=0.02)
    moved = graph.moved(se2.compose([5.0, -3.0, 2.0], graph.poses))
    assert pose_graph.optimise(moved).chi_square == pytest.approx(pose_graph.optimise(graph).chi_square, rel=1e-9)


def test_an_empty_graph_and_a_single_pose_are_their_own_optimum():
    for poses in (np.zeros((0, 3)), np.array([[1.0, 2.0, 0.5]])):
        graph = PoseGraph(poses, [], [], np.zeros((0, 3)), np.zeros((0, 3, 3)))
        assert pose_graph.optimise(graph).chi_square == 0.0
        np.testing.assert_array_equal(pose_graph.start_from_linear_angles(graph).poses, poses)


# --- independent oracles


def test_gtsam_finds_the_same_optimum():
    gtsam = pytest.importorskip("gtsam", reason="not installed: gtsam; .ci/oracles installs it")
    graph, _ = square_drive(3, noise=0.05)
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for i, j, motion, information in zip(
        graph.first, graph.second, graph.first_from_second, graph.information, strict=True
    ):
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose2(int(i), int(j), gtsam.Pose2(*motion), noise))
    factors.add(gtsam.NonlinearEqualityPose2(0, gtsam.Pose2(*graph.poses[0])))
    for row, pose in enumerate(graph.poses):
        values.insert(row, gtsam.Pose2(*pose))
    parameters = gtsam.GaussNewtonParams()
    parameters.setRelativeErrorTol(1e-14)
    found = gtsam.GaussNewtonOptimizer(factors, values, parameters).optimize()
    ours = pose_graph.optimise(graph, tolerance=1e-14)
    assert ours.chi_square == pytest.approx(2.0 * factors.error(found), rel=1e-3)  # its residual is the full logarithm
    last = found.atPose2(len(graph) - 1)
    np.testing.assert_allclose(ours.graph.poses[-1], [last.x(), last.y(), last.theta()], atol=1e-3)


def test_g2o_reads_the_written_file_and_has_the_same_chi_square(tmp_path):
    g2o = pytest.importorskip("g2opy", reason="not installed: g2opy; .ci/oracles installs it")
    graph, _ = square_drive(2, noise=0.05)
    skewed = np.array([[90.0, 5.0, -7.0], [5.0, 120.0, 11.0], [-7.0, 11.0, 300.0]])  # finds a wrong order
    graph = PoseGraph(
        graph.poses, graph.first, graph.second, graph.first_from_second, np.tile(skewed, (len(graph.first), 1, 1))
    )
    path = tmp_path / "graph.g2o"
    path.write_text(format_g2o(graph))
    optimizer = g2o.SparseOptimizer()
    optimizer.set_algorithm(g2o.OptimizationAlgorithmGaussNewton(g2o.BlockSolverSE2(g2o.LinearSolverEigenSE2())))
    assert optimizer.load(str(path))
    optimizer.initialize_optimization()
    optimizer.compute_active_errors()
    assert graph.chi_squares().sum() == pytest.approx(optimizer.chi2(), rel=1e-9)
    optimizer.optimize(20)
    assert pose_graph.optimise(graph).chi_square == pytest.approx(optimizer.chi2(), rel=1e-8)


def test_a_step_of_a_graph_of_100_000_poses_takes_bounded_time():
    rows, count = np.arange(99_999), 100_000
    poses = np.column_stack([np.arange(count) * 0.3, np.zeros((count, 2))])
    loops = np.arange(1_000, count, 100)
    first, second = np.r_[rows, loops - 1_000], np.r_[rows + 1, loops]
    motions = np.column_stack([0.3 * (second - first), np.zeros((len(first), 2))])
    graph = PoseGraph(poses * 1.01, first, second, motions, np.tile(INFORMATION, (len(first), 1, 1)))
    began = time.process_time()
    solution = pose_graph.optimise(graph, max_iterations=1)
    assert time.process_time() - began < 300.0  # measured: 1 s; it only ends what would take for ever
    assert solution.iterations == 1
    np.testing.assert_allclose(solution.graph.poses[-1], poses[-1], atol=1e-3)


@pytest.mark.parametrize("count", [1_000, pytest.param(100_000, marks=pytest.mark.thorough)])
def test_a_loop_that_is_metres_off_takes_none_of_the_right_ones_with_it(count):
    """A chain of motions of 1 m, two loops that agree with it and with each other, and one 4 m short of both."""
    far = count * 6 // 10
    first, second = np.r_[np.arange(count - 1), 0, 1, 0], np.r_[np.arange(1, count), far, far + 1, far + 2]
    motions = np.zeros((count + 2, 3))
    motions[:, 0] = [*np.ones(count - 1), far + 0.3, far + 0.3, far - 4.0]
    information = np.tile(np.diag([2.5e3, 2.5e3, 3.6e4]), (count + 2, 1, 1))
    poses = np.column_stack([np.arange(count, dtype=np.float64), np.zeros((count, 2))])
    began = time.process_time()
    solution = pose_graph.optimise_truncated(
        PoseGraph(poses, first, second, motions, information), np.arange(count + 2) < count - 1
    )
    assert time.process_time() - began < 600.0  # measured: 5 s for 100,000 poses
    np.testing.assert_array_equal(solution.weights[-3:], [1.0, 1.0, 0.0])
    np.testing.assert_allclose(solution.graph.poses[far, 0], far + 0.3, atol=0.02)


TWICE = (
    "VERTEX_SE2 5 0 0 0\nVERTEX_SE2 7 1 0 0\n{fixed}"
    "EDGE_SE2 5 7 1.0 0 0 100 0 0 100 0 100\nEDGE_SE2 5 7 1.2 0 0 100 0 0 100 0 100\n"
)
"""A motion measured as 1.0 m and as 1.2 m: chi-square 4 at 1.0 m, and at the optimum, 1.1 m, 2."""


def test_the_command_prints_the_chi_square_before_and_after_and_writes_the_graph(tmp_path, capsys):
    begin, end = tmp_path / "a.g2o", tmp_path / "b.g2o"
    begin.write_text(TWICE.format(fixed="FIX 5\n"))
    slam_command.main([str(begin), str(end)])
    assert re.search(
        r": chi-square 4 before, 2 after \d iterations from linear angles, converged$", capsys.readouterr().out
    )
    file = read_g2o(end)
    assert file.ids.tolist() == [5, 7]
    np.testing.assert_allclose(file.graph.poses, [[0, 0, 0], [1.1, 0, 0]], atol=1e-9)


def test_the_command_refuses_a_graph_that_fixes_another_pose(tmp_path, capsys):
    begin = tmp_path / "a.g2o"
    begin.write_text(TWICE.format(fixed="FIX 7\n"))
    with pytest.raises(SystemExit):
        slam_command.main([str(begin)])
    assert "it fixes the poses 7; fix its first pose" in " ".join(capsys.readouterr().err.split())


def test_the_command_says_how_many_poses_no_edges_connect_with_the_first_one(tmp_path, capsys):
    """Each part has an edge that is 2 m and 1 m too long: chi-square 4 + 1 before, 1 is left in the second part."""
    begin = tmp_path / "a.g2o"
    begin.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 3 0 0\nVERTEX_SE2 5 0 0 0\nVERTEX_SE2 6 1 0 0\n"
        "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\nEDGE_SE2 5 6 2 0 0 1 0 0 1 0 1\n"
    )
    slam_command.main([str(begin)])
    assert re.search(
        r"chi-square 5 before, 1 after \d iterations from linear angles, converged; "
        r"2 of 4 poses did not move: no edges connect them with the first one$",
        capsys.readouterr().out,
    )
