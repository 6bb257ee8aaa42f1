"""Export trajectories for other evaluators: TUM (evo, rpg), KITTI and g2o, with the ground truth if there is one."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evalkit.commands.export.latex import Files, file_name
from evalkit.commands.export.results import ExportSelection
from evalkit.core import se2
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io.tum import format_tum
from evalkit.results.run_record import RunRecord


def format_tum_files(results: ExportSelection) -> Files:
    """Yield ``<run>.tum`` (start_from_base) and ``<sequence>.truth.tum``."""
    for run in results.runs:
        yield (
            f"{run.key}.tum",
            format_tum(run.result.estimate, f"evalkit: {run.method} on {run.sequence}").encode(),
        )
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

    The edges are the increments of the estimate, with identity information because their errors are unknown.
    """
    for run in results.runs:
        yield f"{run.key}.g2o", _g2o(run.result.estimate.poses)


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


def _g2o(poses: Floats) -> bytes:
    lines = [f"VERTEX_SE2 {at} {_format_row(row)}" for at, row in enumerate(poses.tolist())]
    steps = se2.between(poses[:-1], poses[1:]).tolist()
    lines += [f"EDGE_SE2 {at} {at + 1} {_format_row(row)} 1 0 0 1 0 1" for at, row in enumerate(steps)]
    return ("\n".join([*lines[: len(poses)], "FIX 0", *lines[len(poses) :]]) + "\n").encode()


def _format_row(row: list[float]) -> str:
    return " ".join(f"{value:.12g}" for value in row)


def world_poses(run: RunRecord) -> tuple[Stamps, Floats]:
    """Return stamps (N,) and poses (N, 3) of the base, in the frame of the ground truth or else of the map."""
    estimate = run.result.estimate
    return estimate.stamps_ns, se2.compose(run.scores.world_from_start.row, estimate.poses)
