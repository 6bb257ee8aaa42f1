"""The files of a SLAM's run: its corrected poses (final.npy) and its loop closures (loop_closures.json)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.se2 import Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io import untrusted_io

FINAL, CLOSURES = "final.npy", "loop_closures.json"


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
