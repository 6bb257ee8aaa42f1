"""Export trajectories for other evaluators: TUM (evo, rpg), KITTI and g2o, with the ground truth if there is one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evalkit.commands.export.latex import Files, file_name
from evalkit.commands.export.results import ExportSelection
from evalkit.core import se2
from evalkit.core.pose_graph import PoseGraph
from evalkit.core.run_result import RunResult
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io import g2o
from evalkit.io.tum import format_tum
from evalkit.metrics.loop_closures import find_corrections
from evalkit.results.run_record import RunRecord

NO_INFORMATION = "all edges have the identity as information, because the method reports no uncertainty"


def format_tum_files(results: ExportSelection) -> Files:
    """Yield ``<run>.tum``, of a SLAM ``<run>.final.tum`` (start_from_base), and ``<sequence>.truth.tum``."""
    for run in results.runs:
        text = f"evalkit: {run.method} on {run.sequence}"
        yield f"{run.key}.tum", format_tum(run.result.estimate, text).encode()
        if run.result.final is not None:
            yield f"{run.key}.final.tum", format_tum(run.result.final, f"{text}, corrected poses").encode()
    for name, run, true in _true_trajectories(results):
        yield f"{name}.truth.tum", format_tum(true, f"evalkit: truth on {run.sequence}").encode()


def format_kitti(results: ExportSelection) -> Files:
    """Yield ``<run>.kitti.txt``, a 3 x 4 matrix per line, and the ground truth at the same scans.

    The format has no times. If the ground truth does not cover all scans, both files hold only the covered ones.
    """
    for run in results.runs:
        estimate, true = run.result.estimate, run.truth.trajectory
        if true is None or len(true) == 0:
            yield f"{run.key}.kitti.txt", _kitti(estimate.poses)
            continue
        reached = (estimate.stamps_ns >= true.stamps_ns[0]) & (estimate.stamps_ns <= true.stamps_ns[-1])
        yield f"{run.key}.kitti.txt", _kitti(estimate.poses[reached])
        yield f"{run.key}.truth.kitti.txt", _kitti(true.at(estimate.stamps_ns[reached]))


def format_g2o(results: ExportSelection) -> Files:
    """Yield ``<run>.g2o``: one VERTEX_SE2 per scan, one EDGE_SE2 from each to the next, the first vertex fixed.

    The vertices are the corrected poses of a SLAM, else the answers. The edges are the increments of the answers and,
    of a SLAM, the accepted loop closures as measured. All have identity information, because no method reports its
    uncertainty; the first line, a comment, says so.
    Where an update of a SLAM moved earlier poses, its answer is in another frame than the one before: there the edge is
    the increment of the corrected poses.
    """
    for run in results.runs:
        note = f"# evalkit: {run.method} on {run.sequence}; {NO_INFORMATION}\n"
        yield f"{run.key}.g2o", (note + g2o.format_g2o(_make_graph(run.result))).encode()


def _true_trajectories(results: ExportSelection) -> Iterator[tuple[str, RunRecord, Trajectory]]:
    seen = set()
    for run in results.runs:
        name = run.sequence, run.seed
        if run.truth.trajectory is not None and name not in seen:
            seen.add(name)
            yield run_name(*name), run, run.truth.trajectory


def run_name(sequence: str, seed: int | None) -> str:
    """Return sequence and seed as part of a file name."""
    return file_name(sequence) + ("" if seed is None else f"-s{seed}")


def _kitti(poses: Floats) -> bytes:
    lines = []
    for x, y, theta in poses.tolist():
        cos, sin = np.cos(theta), np.sin(theta)
        row = (cos, -sin, 0, x, sin, cos, 0, y, 0, 0, 1, 0)
        lines.append(" ".join(f"{value:.12g}" for value in row))
    return ("\n".join(lines) + "\n").encode()


def _make_graph(result: RunResult) -> PoseGraph:
    answers, path = result.estimate, result.estimate if result.final is None else result.final
    rows = np.arange(len(path))
    row_of = dict(zip(path.stamps_ns.tolist(), rows.tolist(), strict=True))
    loops = [
        (row_of[loop.other_stamp_ns], row_of[loop.stamp_ns], loop.other_from_base.row)
        for loop in result.loop_closures
        if loop.accepted and loop.other_stamp_ns in row_of and loop.stamp_ns in row_of
    ]
    first, second = (np.array([each[end] for each in loops], dtype=np.int64) for end in (0, 1))
    steps = se2.between(answers.poses[:-1], answers.poses[1:])
    corrected = find_corrections(result) if result.final is not None else None
    if corrected is not None:
        steps = np.where(corrected[1:, None], se2.between(path.poses[:-1], path.poses[1:]), steps)
    motions = np.concatenate([steps, np.array([each[2] for each in loops]).reshape(-1, 3)])
    information = np.tile(np.eye(3), (len(motions), 1, 1))
    return PoseGraph(path.poses, np.r_[rows[:-1], first], np.r_[rows[1:], second], motions, information)


def world_poses(run: RunRecord) -> tuple[Stamps, Floats]:
    """Return stamps (N,) and poses (N, 3) of the base, in the frame of the ground truth or else of the map."""
    estimate = run.result.estimate
    return estimate.stamps_ns, se2.compose(run.scores.world_from_start.row, estimate.poses)
