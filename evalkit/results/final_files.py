"""The files of a SLAM's run: its corrected poses, its loop closures, and its path before and after each correction."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

import numpy as np

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io import untrusted_io

FINAL, CLOSURES, PATHS = "final.npy", "loop_closures.json", "path_corrections.npy"


def format_final(trajectory: Trajectory, closures: tuple[LoopClosure, ...]) -> dict[str, bytes]:
    """The content of both files by name; stamps are those of the run's steps."""
    body = BytesIO()
    np.save(body, trajectory.poses)
    return {FINAL: body.getvalue(), CLOSURES: json.dumps([_as_dict(one) for one in closures]).encode()}


def parse_final(files: Mapping[str, bytes], stamps_ns: Stamps) -> tuple[Trajectory, tuple[LoopClosure, ...]]:
    """The corrected trajectory at the stamps of all steps and the closures; raises ValueError with the damaged file."""
    try:
        poses = untrusted_io.parse_array(files[FINAL])
        if poses.dtype != np.float64:
            raise ValueError(f"an array of {poses.dtype}, expected float64")
        trajectory = Trajectory(stamps_ns, poses, "start", "base")
    except ValueError as error:
        raise ValueError(f"{FINAL} is damaged: {error}") from None
    try:
        return trajectory, tuple(_from_dict(one) for one in untrusted_io.parse_json(files[CLOSURES]))
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"{CLOSURES} is damaged: {error}") from None


def format_paths(corrections: Sequence[PathCorrection], stamps_ns: Stamps) -> bytes:
    """The content of ``PATHS``: a row for each kept pose of each correction; stamps are those of the run's steps.

    A row (8,) has the numbers of two steps, the one that corrected and that of the pose, and the pose before and after.
    """
    rows: list[Floats] = [np.zeros((0, 8))]
    for one in corrections:
        numbers = np.searchsorted(stamps_ns, one.stamps_ns)
        corrected = np.full(len(numbers), np.searchsorted(stamps_ns, one.stamp_ns))
        steps = np.stack([corrected, numbers], axis=-1).astype(np.float64)
        rows.append(np.hstack([steps, one.before, one.after]))
    body = BytesIO()
    np.save(body, np.concatenate(rows))
    return body.getvalue()


def parse_paths(content: bytes, stamps_ns: Stamps) -> tuple[PathCorrection, ...]:
    """The corrections of ``format_paths`` in the order of time; raises ValueError where the file is damaged."""
    try:
        rows = untrusted_io.parse_floats(content, 2)
        if rows.shape[1] != 8:
            raise ValueError(f"rows of {rows.shape[1]} numbers, expected 8")
        if not np.isin(rows[:, :2], np.arange(len(stamps_ns))).all():
            raise ValueError(f"a number of a step that is not one of 0 to {len(stamps_ns) - 1}")
        if (np.diff(rows[:, 0]) < 0).any():
            raise ValueError("corrections that are not in the order of time")
        numbers = rows[:, :2].astype(np.int64)
        _, begins = np.unique(numbers[:, 0], return_index=True)
        parts = np.split(np.arange(len(rows)), begins[1:]) if len(rows) else []
        return tuple(
            PathCorrection(
                int(stamps_ns[numbers[part[0], 0]]), stamps_ns[numbers[part, 1]], rows[part, 2:5], rows[part, 5:]
            )
            for part in parts
        )
    except ValueError as error:
        raise ValueError(f"{PATHS} is damaged: {error}") from None


def _as_dict(closure: LoopClosure) -> dict[str, Any]:
    return {
        "stamp_ns": int(closure.stamp_ns), "other_stamp_ns": int(closure.other_stamp_ns),
        "other_from_base": closure.other_from_base.row.tolist(), "accepted": bool(closure.accepted),
        "reason": closure.reason, "found_again": None if closure.found_again is None else bool(closure.found_again),
    }  # fmt: skip


def _from_dict(content: Mapping[str, Any]) -> LoopClosure:
    stamps = content["stamp_ns"], content["other_stamp_ns"]
    accepted, found_again = content["accepted"], content.get("found_again")  # not in files of earlier versions
    if not all(type(stamp) is int for stamp in stamps) or type(accepted) is not bool:
        raise ValueError("expected whole stamps, and true or false")
    if found_again is not None and type(found_again) is not bool:
        raise ValueError("found_again: expected true, false or null")
    return LoopClosure(
        *stamps, Pose.of(content["other_from_base"]), accepted, str(content["reason"]), found_again=found_again
    )
