"""Optimise pose graphs of the plane: sparse Gauss-Newton on SE(2), and two robust variants of it.

The first pose is fixed. The residual of an edge is in the frame of its measured second pose (see
``evalkit.core.pose_graph``), as in g2o. Gauss-Newton starts from linear angles (Carlone, Aragues, Castellanos and Bona,
"A fast and accurate approximation for planar pose graph optimization", IJRR 2014), because from the raw odometry it may
end in a local minimum in which a loop is closed with a full turn too many.

Robust: dynamic covariance scaling (Agarwal, Tipaldi, Spinello, Stachniss and Burgard, ICRA 2013), which costs nothing
more, and graduated non-convexity with truncated least squares (Yang, Antonante, Tzoumas and Carlone, RA-L 2020).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Bools, Ints
from evalkit.core.pose_graph import PoseGraph
from evalkit.core.se2 import Floats

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import SuperLU

QUICK_GATE, SLOW_GATE = 6.25, 11.345
"""90 % and 99 % quantiles of chi-square with three degrees of freedom."""

_GNC_STEP = 1.4
_GNC_ROUNDS, _GNC_ITERATIONS = 60, 3
_LOOP_GROUPS = 30
MAX_POSE_STEPS = 4_000_000
"""Poses times Gauss-Newton steps of ``optimise_truncated``: 40 steps of 100,000 poses, 1 s each."""
_DAMPING = 1e-12
"""Share of the diagonal that is added to a singular matrix: a direction without any measurement does not move."""


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimised graph, its chi-square (with the weights), the iterations, and whether the last step was small.

    ``weights`` (M,): 0 to 1, the factor of each edge's information at the end; 1 without a robust kernel.
    """

    graph: PoseGraph
    chi_square: float
    iterations: int
    converged: bool
    weights: Floats


Kernel = Callable[[Floats], Floats]
"""Weights (M,) of edges with the chi-squares (M,)."""


def optimise(
    graph: PoseGraph,
    weights: Floats | None = None,
    kernel: Kernel | None = None,
    max_iterations: int = 50,
    tolerance: float = 1e-9,
) -> Solution:
    """Return the graph after Gauss-Newton from its poses; the first pose stays.

    ``weights`` (M,) multiply the information; ``kernel`` computes them anew in every iteration. It stops where the
    chi-square changes by less than the share ``tolerance``, or after ``max_iterations``: not converged. A part of the
    graph without a connection to the first pose stays where it is.
    """
    poses, free = np.array(graph.poses), free_nodes(graph)
    given = np.ones(len(graph.first)) if weights is None else weights
    share, current = given, graph
    before = np.inf
    for iteration in range(1, max_iterations + 1):
        chi = current.chi_squares()
        share = given if kernel is None else given * kernel(chi)
        after = float(share @ chi)
        if abs(before - after) <= tolerance * max(after, 1e-12):
            return Solution(current, after, iteration - 1, True, share)
        before = after
        step = _solve(current, share, free)
        if not np.isfinite(step).all():
            break
        poses = poses + step
        poses[:, 2] = se2.wrap(poses[:, 2])
        current = current.moved(poses)
    return Solution(current, float(share @ current.chi_squares()), max_iterations, False, share)


def start_from_linear_angles(graph: PoseGraph) -> PoseGraph:
    """Return the graph with poses from two linear problems (LAGO): all headings, then the positions for these headings.

    The headings start along a spanning tree of the earliest edges. Then loops are added, short ones first, in up to
    ``_LOOP_GROUPS`` groups: each is assumed to close with the number of full turns that is nearest to the headings of
    the groups before, because those of a long chain may be more than half a turn off.
    """
    free = free_nodes(graph)
    if not len(free):
        return graph
    start = _chain_along_tree(graph)
    heading, stiffness = start[:, 2].copy(), graph.information[:, 2, 2]
    unwrapped, gap = graph.first_from_second[:, 2].copy(), np.abs(graph.second - graph.first)
    steps, loops = np.flatnonzero(gap <= 1), np.flatnonzero(gap > 1)
    ordered = loops[np.argsort(gap[loops], kind="stable")]
    used = np.zeros(len(gap))
    for added in (steps, *np.array_split(ordered, max(min(_LOOP_GROUPS, len(ordered)), 1))):
        along = heading[graph.second[added]] - heading[graph.first[added]]
        unwrapped[added] += 2.0 * np.pi * np.round((along - unwrapped[added]) / (2.0 * np.pi))
        used[added] = 1.0
        heading[free] = _solve_headings(graph, unwrapped, used * stiffness, free, heading)
    poses = np.column_stack([start[:, :2], se2.wrap(heading)])
    return graph.moved(poses + _solve(graph.moved(poses), np.ones(len(gap)), free, positions_only=True))


def dcs_kernel(phi: float, trusted: Bools) -> Kernel:
    """Return dynamic covariance scaling: weights min(1, 2 phi / (phi + chi^2))^2; 1 for ``trusted`` edges (M,)."""

    def weigh(chi: Floats) -> Floats:
        return np.where(trusted, 1.0, np.minimum(1.0, 2.0 * phi / (phi + chi)) ** 2)

    return weigh


def optimise_truncated(graph: PoseGraph, trusted: Bools) -> Solution:
    """Return the graph after graduated non-convexity with truncated least squares.

    ``trusted`` (M,): edges that are never doubted. Others end with weight 1 or 0: within ``SLOW_GATE`` or not. There
    are at most 60 rounds of three iterations of Gauss-Newton. Graphs of more than 14,000 poses have fewer and larger
    rounds of one iteration: all steps together are at most ``MAX_POSE_STEPS``.
    """
    steps = max(MAX_POSE_STEPS // max(len(graph), 1), 8)
    is_large = steps < 100 + _GNC_ROUNDS * _GNC_ITERATIONS
    ends, rounds = (max(steps // 4, 2), steps // 2) if is_large else (50, _GNC_ROUNDS)
    solution = optimise(graph, max_iterations=ends)
    largest = float(solution.graph.chi_squares()[~trusted].max(initial=0.0))
    mu = SLOW_GATE / max(2.0 * largest - SLOW_GATE, 1e-12)
    iterations, growth = solution.iterations, max(_GNC_STEP, (1e4 / mu) ** (1.0 / rounds))
    for _ in range(rounds):
        chi = solution.graph.chi_squares()
        weights = np.where(trusted, 1.0, _truncated_weights(chi, mu))
        solution = optimise(solution.graph, weights, max_iterations=1 if is_large else _GNC_ITERATIONS)
        iterations += solution.iterations
        if mu > 1e4 or not ((weights > 0.0) & (weights < 1.0)).any():  # small weights are not yet decided
            break
        mu *= growth if is_large else _GNC_STEP
    kept = np.where(trusted | (solution.graph.chi_squares() <= SLOW_GATE), 1.0, 0.0)
    final = optimise(solution.graph, kept, max_iterations=ends)
    return Solution(final.graph, final.chi_square, iterations + final.iterations, final.converged, kept)


def relative_covariance(graph: PoseGraph, first: int, second: int) -> Floats:
    """Return the covariance (3, 3) of the residual of an edge between two poses, as the graph predicts it.

    First-order, at the graph's poses: what a measured motion ``first_from_second`` must agree with (m^2, m rad, rad^2).
    """
    free = free_nodes(graph)
    normal, _ = _normal_equations(graph, np.ones(len(graph.first)), free)
    jacobians = _edge_jacobians(graph.poses[[first]], graph.poses[[second]], np.zeros((1, 3)), relative=True)
    columns = np.zeros((3 * len(free), 3))
    for node, jacobian in zip((first, second), jacobians, strict=True):
        at = np.searchsorted(free, node)
        if at < len(free) and free[at] == node:
            columns[3 * at : 3 * at + 3] += jacobian[0].T
    return np.asarray(columns.T @ _factorise(normal).solve(columns))


def _truncated_weights(chi: Floats, mu: float) -> Floats:
    low, high = mu / (mu + 1.0) * SLOW_GATE, (mu + 1.0) / mu * SLOW_GATE
    between = np.sqrt(SLOW_GATE * mu * (mu + 1.0) / np.maximum(chi, 1e-30)) - mu
    return np.where(chi <= low, 1.0, np.where(chi >= high, 0.0, np.clip(between, 0.0, 1.0)))


def free_nodes(graph: PoseGraph) -> Ints:
    """Return the rows (K,), ascending, of the poses that edges connect with the first one, without the first."""
    from scipy.sparse import coo_matrix  # noqa: PLC0415 - specs are listed without SciPy
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415 - likewise

    size = len(graph)
    links = coo_matrix((np.ones(len(graph.first)), (graph.first, graph.second)), shape=(size, size))
    _, part = connected_components(links, directed=False)
    return np.flatnonzero(part == part[:1])[1:]


def _edge_jacobians(first: Floats, second: Floats, measured: Floats, relative: bool = False) -> tuple[Floats, Floats]:
    """Return the derivatives (M, 3, 3) of the residual by both poses, each pose as x, y, theta of the world.

    ``relative``: of the motion ``first_from_second`` itself, in the frame of the expected second pose.
    """
    turned = second[:, 2] if relative else first[:, 2] + measured[:, 2]
    cos, sin = np.cos(turned), np.sin(turned)
    zero = np.zeros_like(cos)
    rotation = np.stack([np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)], axis=-2)
    arm = second[:, :2] - first[:, :2]
    by_first, by_second = np.zeros((2, len(first), 3, 3))
    by_first[:, :2, :2], by_second[:, :2, :2] = -rotation, rotation
    # d/dtheta of R(theta)^T arm = R^T (arm_y, -arm_x)
    by_first[:, :2, 2] = np.einsum("mij,mj->mi", rotation, np.stack([arm[:, 1], -arm[:, 0]], axis=-1))
    by_first[:, 2, 2], by_second[:, 2, 2] = zero - 1.0, zero + 1.0
    return by_first, by_second


def _normal_equations(graph: PoseGraph, weights: Floats, free: Ints) -> tuple[csc_matrix, Floats]:
    """Return H (3K, 3K) and the right-hand side (3K,) of the step of all free poses."""
    from scipy.sparse import csc_matrix  # noqa: PLC0415 - specs are listed without SciPy

    number = np.full(len(graph), -1)
    number[free] = np.arange(len(free))
    used = np.flatnonzero((weights > 0.0) & ((number[graph.first] >= 0) | (number[graph.second] >= 0)))
    ends = graph.first[used], graph.second[used]
    information = graph.information[used] * weights[used, None, None]
    residual = graph.residuals()[used]
    jacobians = _edge_jacobians(graph.poses[ends[0]], graph.poses[ends[1]], graph.first_from_second[used])
    weighted = [np.einsum("mki,mkl->mil", jacobian, information) for jacobian in jacobians]
    right = np.zeros((len(free) + 1, 3))
    rows, columns, blocks = [], [], []
    for a in (0, 1):
        np.add.at(right, number[ends[a]], -np.einsum("mij,mj->mi", weighted[a], residual))  # row -1 is not used
        for b in (0, 1):
            inside = (number[ends[a]] >= 0) & (number[ends[b]] >= 0)
            i, j = number[ends[a]][inside], number[ends[b]][inside]
            blocks.append((weighted[a][inside] @ jacobians[b][inside]).ravel())
            rows.append((3 * i[:, None, None] + np.arange(3)[None, :, None] + np.zeros((1, 1, 3), np.int64)).ravel())
            columns.append((3 * j[:, None, None] + np.arange(3)[None, None, :] + np.zeros((1, 3, 1), np.int64)).ravel())
    size = 3 * len(free)
    normal = csc_matrix(
        (np.concatenate(blocks), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size), dtype=np.float64
    )
    return normal, right[:-1].ravel()


def _factorise(normal: csc_matrix) -> SuperLU:
    from scipy.sparse import diags  # noqa: PLC0415 - specs are listed without SciPy
    from scipy.sparse.linalg import splu  # noqa: PLC0415 - likewise

    def decompose(matrix: csc_matrix) -> SuperLU:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})

    try:
        return decompose(normal)
    except RuntimeError:  # singular
        diagonal = normal.diagonal()
        return decompose((normal + diags(_DAMPING * diagonal + max(_DAMPING * float(diagonal.max()), 1e-300))).tocsc())


def _solve(graph: PoseGraph, weights: Floats, free: Ints, positions_only: bool = False) -> Floats:
    """Return the Gauss-Newton step (N, 3) of all poses, zero for those that are not free."""
    step = np.zeros((len(graph), 3))
    if not len(free):
        return step
    normal, right = _normal_equations(graph, weights, free)
    kept = np.arange(len(right))
    if positions_only:
        kept = kept[kept % 3 != 2]
        normal = normal[kept][:, kept].tocsc()
    solved = np.zeros(3 * len(free))
    solved[kept] = _factorise(normal).solve(right[kept])
    step[free] = solved.reshape(-1, 3)
    return step


def _solve_headings(graph: PoseGraph, turns: Floats, weights: Floats, free: Ints, start: Floats) -> Floats:
    """Return the headings (K,) of the free poses that fit the unwrapped turns (M,) with weights (M,)."""
    from scipy.sparse import csc_matrix  # noqa: PLC0415 - specs are listed without SciPy

    number = np.full(len(graph), -1)
    number[free] = np.arange(len(free))
    edges = np.arange(len(turns))
    wanted = turns - (start[graph.second] - start[graph.first])
    entries = []
    for ends, sign in ((graph.first, -1.0), (graph.second, 1.0)):
        inside = number[ends] >= 0
        root = np.sqrt(weights[inside])
        entries.append((sign * root, edges[inside], number[ends][inside]))
    values, rows, columns = (np.concatenate(each) for each in zip(*entries, strict=True))
    design = csc_matrix((values, (rows, columns)), shape=(len(turns), len(free)))
    normal = csc_matrix(design.T @ design)
    right: Floats = design.T @ (np.sqrt(weights) * wanted)
    solved: Floats = _factorise(normal).solve(right)
    return start[free] + solved


def _chain_along_tree(graph: PoseGraph) -> Floats:
    """Return poses (N, 3), headings not wrapped, chained along a tree of the earliest edges; others stay."""
    from scipy.sparse import coo_matrix  # noqa: PLC0415 - specs are listed without SciPy
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree  # noqa: PLC0415 - likewise

    size, edges = len(graph), len(graph.first)
    low, high = np.minimum(graph.first, graph.second), np.maximum(graph.first, graph.second)
    _, earliest = np.unique(low * size + high, return_index=True)
    links = coo_matrix((1.0 + earliest, (low[earliest], high[earliest])), shape=(size, size)).tocsr()
    tree = minimum_spanning_tree(links)
    order, parent = breadth_first_order(tree, 0, directed=False, return_predecessors=True)
    if not edges:
        return np.array(graph.poses)
    tree = (tree + tree.T).tocsr()
    poses = np.array(graph.poses)
    for node in order[1:].tolist():
        above = int(parent[node])
        edge = round(float(tree[above, node])) - 1
        motion = graph.first_from_second[edge]
        if graph.first[edge] != above:
            motion = se2.inverse(motion)
        heading = poses[above, 2] + motion[2]
        poses[node] = se2.compose(poses[above], motion)
        poses[node, 2] = heading
    return poses
