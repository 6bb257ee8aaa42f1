"""The compiled pose graph: the poses of the SciPy solver, which forms the normal equations of all poses."""

import os
from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.pose_graph import PoseGraph
from evalkit.io.g2o import read_g2o
from evalkit_baselines.slam import pose_graph

core64 = pytest.importorskip("evalkit_baselines.embedded._core64")
core32 = pytest.importorskip("evalkit_baselines.embedded._core32")

GRAPHS = Path(os.environ.get("EVALKIT_DATA", "")) / "graphs"
needs_graphs = pytest.mark.skipif(
    not os.environ.get("EVALKIT_DATA") or not GRAPHS.is_dir(), reason="no published pose graphs in $EVALKIT_DATA/graphs"
)
UPPER = np.triu_indices(3)


def solve(core, graph, **settings):
    """Optimise a graph of steps, in order, and then loops, by the core."""
    steps = len(graph) - 1
    np.testing.assert_array_equal(graph.second[:steps] - graph.first[:steps], 1)
    real = [graph.poses, graph.first_from_second, graph.information[:, *UPPER]]
    poses, motions, information = (np.ascontiguousarray(each, dtype=core.REAL) for each in real)
    ends = np.stack([graph.first, graph.second], axis=1)[steps:].astype(np.uint32)
    return core.optimise_graph(
        poses, motions[:steps], information[:steps], ends, motions[steps:], information[steps:], **settings
    )


def first_chain(graph):
    """The graph with the first edge between neighbours as step, and the others, later pose second, as loops."""
    neighbours = np.flatnonzero(graph.second - graph.first == 1)
    _, at = np.unique(graph.first[neighbours], return_index=True)
    order = np.r_[neighbours[at], np.setdiff1d(np.arange(len(graph.first)), neighbours[at])]
    assert (graph.second > graph.first).all()
    return PoseGraph(
        graph.poses, graph.first[order], graph.second[order], graph.first_from_second[order], graph.information[order]
    )


def worst(poses, expected):
    return np.abs(se2.between(expected, poses)).max()


def random_drive(count, loops, seed):
    """A drive of noisy steps with full information matrices, and a tenth of its loops wrong."""
    rng = np.random.default_rng(seed)
    true = [np.zeros(3)]
    for turn in rng.normal(0.0, 0.3, count - 1):
        true.append(se2.compose(true[-1], [0.5, 0.0, turn]))
    first, second = np.sort([rng.choice(count, 2, replace=False) for _ in range(loops)], axis=1).T
    ends = np.r_[np.arange(count - 1), first], np.r_[np.arange(1, count), second]
    motions = se2.between(np.array(true)[ends[0]], np.array(true)[ends[1]])
    motions = se2.compose(motions, rng.normal(0.0, 0.02, motions.shape))
    motions[count - 1 :: 10] = se2.compose(motions[count - 1 :: 10], [0.8, -0.6, 0.5])
    root = rng.normal(0.0, 1.0, (len(motions), 3, 3)) * [20.0, 20.0, 40.0] + np.diag([30.0, 30.0, 60.0])
    information = root @ root.transpose(0, 2, 1)
    poses = [np.zeros(3)]
    for motion in motions[: count - 1]:
        poses.append(se2.compose(poses[-1], motion))
    return PoseGraph(poses, *ends, motions, 0.5 * (information + information.transpose(0, 2, 1)))


@needs_graphs
def test_a_published_graph_has_its_published_optimum_after_as_many_iterations():
    graph = first_chain(read_g2o(GRAPHS / "carlone-INTEL.g2o").graph)
    expected = pose_graph.optimise(graph)
    poses, chi_square, iterations, converged, _ = solve(core64, graph, max_iterations=50, tolerance=1e-9)
    assert converged
    assert (iterations, chi_square) == (expected.iterations, pytest.approx(215.83023, abs=5e-6))
    assert worst(poses, expected.graph.poses) < 1e-8


def square_drive(count, loops, seed):
    """A drive around a square in steps of 0.3 m, with the noise of matched scans. Loops lead to the lap before."""
    rng = np.random.default_rng(seed)
    true = [np.zeros(3)]
    for step in range(count - 1):
        true.append(se2.compose(true[-1], [0.3, 0.0, np.pi / 2 if step % 50 == 49 else 0.0]))
    second = np.sort(rng.choice(np.arange(200, count), loops, replace=False))
    ends = np.r_[np.arange(count - 1), second - 200], np.r_[np.arange(1, count), second]
    sigma = np.r_[np.tile([0.011, 0.011, 0.003], (count - 1, 1)), np.tile([0.015, 0.015, 0.004], (loops, 1))]
    motions = se2.between(np.array(true)[ends[0]], np.array(true)[ends[1]])
    motions = se2.compose(motions, sigma * rng.standard_normal(sigma.shape))
    poses = [np.zeros(3)]
    for motion in motions[: count - 1]:
        poses.append(se2.compose(poses[-1], motion))
    return PoseGraph(poses, *ends, motions, np.eye(3) / sigma[:, None] ** 2)


def test_single_precision_is_within_a_tenth_of_a_millimetre_after_300_m():
    graph = square_drive(1000, 30, seed=1)
    expected = pose_graph.optimise(graph, max_iterations=10)
    poses, *_ = solve(core32, graph, max_iterations=10, tolerance=1e-9)
    assert worst(poses, expected.graph.poses) < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_a_drive_with_wrong_loops_has_the_poses_and_weights_of_the_reference_in_every_iteration(seed):
    graph = random_drive(80, 20, seed)
    trusted = np.arange(len(graph.first)) < 79
    for limit in (1, 3, 30):
        expected = pose_graph.optimise(graph, kernel=pose_graph.dcs_kernel(10.0, trusted), max_iterations=limit)
        settings = {"max_iterations": limit, "tolerance": 1e-9, "phi": 10.0, "slice_work": 50}
        poses, chi_square, iterations, converged, weights = solve(core64, graph, **settings)
        assert worst(poses, expected.graph.poses) < 1e-7
        assert iterations == expected.iterations
        if expected.converged:
            assert converged
            assert chi_square == pytest.approx(expected.chi_square, rel=1e-9)
            np.testing.assert_allclose(weights[:, 0], expected.weights[79:], atol=1e-7)


def test_arrays_that_do_not_match_and_loops_between_no_poses_are_errors():
    graph = random_drive(10, 3, 0)
    with pytest.raises(ValueError, match="the shapes of its arrays do not match"):
        core64.optimise_graph(
            graph.poses, graph.poses, graph.poses, np.zeros((0, 2), np.uint32), graph.poses[:0], graph.poses[:0],
            max_iterations=1, tolerance=0.0,
        )  # fmt: skip
    backward = np.r_[graph.first[:9], graph.second[9:]], np.r_[graph.second[:9], graph.first[9:]]
    wrong = PoseGraph(graph.poses, *backward, graph.first_from_second, graph.information)
    with pytest.raises(ValueError, match="loops: a parameter is outside its range"):
        solve(core64, wrong, max_iterations=1, tolerance=0.0)
