"""Trajectories for other evaluators: TUM (evo, rpg), KITTI and g2o, with the truth beside them where it is known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evalkit.commands.export.latex import Files, file_name
from evalkit.commands.export.results import Results
from evalkit.core import se2
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io.tum import format_tum
from evalkit.results.run_record import RunRecord


def as_tum(results: Results) -> Files:
    """``<run>.tum``, start_from_base as answered, and ``<sequence>.truth.tum``."""
    for record in results.records:
        yield (
            f"{record.key}.tum",
            format_tum(record.result.estimate, f"evalkit: {record.method} on {record.sequence}").encode(),
        )
    for name, record, true in _truths(results):
        yield f"{name}.truth.tum", format_tum(true, f"evalkit: truth on {record.sequence}").encode()


def as_kitti(results: Results) -> Files:
    """``<run>.kitti.txt``, a 3 x 4 matrix a line, and the truth at the same scans as ``<run>.truth.kitti.txt``.

    The format knows no times. Where the truth does not reach all scans, both hold only those it reaches.
    """
    for record in results.records:
        estimate, true = record.result.estimate, record.truth.trajectory
        if true is None or len(true) == 0:
            yield f"{record.key}.kitti.txt", _kitti(estimate.poses)
            continue
        reached = (estimate.stamps_ns >= true.stamps_ns[0]) & (estimate.stamps_ns <= true.stamps_ns[-1])
        yield f"{record.key}.kitti.txt", _kitti(estimate.poses[reached])
        yield f"{record.key}.truth.kitti.txt", _kitti(true.at(estimate.stamps_ns[reached]))


def as_g2o(results: Results) -> Files:
    """``<run>.g2o``: a VERTEX_SE2 a scan, an EDGE_SE2 from each to the next, the first fixed.

    The edges carry the answers' own increments with the identity as information: nothing is known of their errors.
    """
    for record in results.records:
        yield f"{record.key}.g2o", _g2o(record.result.estimate.poses)


def _truths(results: Results) -> Iterator[tuple[str, RunRecord, Trajectory]]:
    seen = set()
    for record in results.records:
        place = record.sequence, record.seed
        if record.truth.trajectory is not None and place not in seen:
            seen.add(place)
            yield run_name(*place), record, record.truth.trajectory


def run_name(sequence: str, seed: int | None) -> str:
    """Sequence and seed as part of a file's name."""
    return file_name(sequence) + ("" if seed is None else f"-s{seed}")


def _kitti(poses: Floats) -> bytes:
    lines = []
    for x, y, theta in poses.tolist():
        cos, sin = np.cos(theta), np.sin(theta)
        row = (cos, -sin, 0, x, sin, cos, 0, y, 0, 0, 1, 0)
        lines.append(" ".join(f"{value:.12g}" for value in row))
    return ("\n".join(lines) + "\n").encode()


def _g2o(poses: Floats) -> bytes:
    lines = [f"VERTEX_SE2 {at} {_words(row)}" for at, row in enumerate(poses.tolist())]
    steps = se2.between(poses[:-1], poses[1:]).tolist()
    lines += [f"EDGE_SE2 {at} {at + 1} {_words(row)} 1 0 0 1 0 1" for at, row in enumerate(steps)]
    return ("\n".join([*lines[: len(poses)], "FIX 0", *lines[len(poses) :]]) + "\n").encode()


def _words(row: list[float]) -> str:
    return " ".join(f"{value:.12g}" for value in row)


def world_poses(record: RunRecord) -> tuple[Stamps, Floats]:
    """Stamps (N,) and poses (N, 3) of the base as answered, in the frame of the truth or, without one, of the map."""
    estimate = record.result.estimate
    return estimate.stamps_ns, se2.compose(record.scores.world_from_start.row, estimate.poses)
