"""Runs of one sequence as a rerun recording: everybody's path, scans where each believes them, maps and errors."""

from __future__ import annotations

import importlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.commands.export.poses import world_poses
from evalkit.core import se2
from evalkit.core.errors import NotInstalled
from evalkit.core.se2 import Floats
from evalkit.plugins.protocols import Sequence as Recording
from evalkit.report.html.figures import Strokes
from evalkit.results.run_record import RunRecord

TIMELINE = "recording"
MAX_SCANS = 500
"""Scans shown: more make the file big without being seen."""


def installed() -> Any:
    """The library; NotInstalled says how to get it."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise NotInstalled("rerun", f"cannot be imported ({error})", "pip install 'evalkit[rerun]'") from error


def write(path: Path, records: Sequence[RunRecord], recording: Recording | None, strokes: Strokes) -> Path:
    """The ``.rrd`` file of a sequence's runs of one seed; at least one.

    Entities: world/truth, world/<method> with path, base, scan and map, errors/<method>. Metres, z up; seconds
    since the first scan on the timeline "recording".
    """
    rerun = installed()
    path.parent.mkdir(parents=True, exist_ok=True)
    begin = min(int(record.result.steps["stamp_ns"][0]) for record in records)
    stream = rerun.RecordingStream("evalkit", recording_id=path.stem, send_properties=False)
    stream.save(path)
    stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    true = next((record.truth.trajectory for record in records if record.truth.trajectory is not None), None)
    if true is not None and len(true):
        stream.log("world/truth", rerun.LineStrips3D([_lifted(true.poses[:, :2])], colors=[[0, 0, 0]]), static=True)
    for record in records:
        _log(rerun, stream, record, recording, _rgb(strokes[record.method].colour), begin)
    stream.flush()
    stream.disconnect()
    return path


def _log(
    rerun: Any, stream: Any, record: RunRecord, recording: Recording | None, colour: list[int], begin: int
) -> None:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", record.method)
    stamps, poses = world_poses(record)
    stream.log(f"world/{name}/path", rerun.LineStrips3D([_lifted(poses[:, :2])], colors=[colour]), static=True)
    if record.scores.grid is not None:
        walls = _lifted(record.scores.grid.centres(record.scores.grid.occupied()))
        dots = rerun.Points3D(walls, radii=0.5 * record.scores.grid.resolution_m, colors=[120, 120, 120])
        stream.log(f"world/{name}/map", dots, static=True)
    scans = _scans(recording, stamps.tolist())
    for at, (stamp, row) in enumerate(zip(stamps.tolist(), poses, strict=True)):
        stream.set_time(TIMELINE, duration=np.timedelta64(stamp - begin, "ns"))
        point = rerun.Points3D(_lifted(row[None, :2]), radii=0.08, colors=[colour])
        stream.log(f"world/{name}/base", point)
        if record.scores.errors_m is not None and np.isfinite(record.scores.errors_m[at]):
            stream.log(f"errors/{name}", rerun.Scalars(float(record.scores.errors_m[at])))
        if stamp in scans:
            seen = _lifted(se2.transform(row, scans[stamp]))
            stream.log(f"world/{name}/scan", rerun.Points3D(seen, radii=0.02, colors=[colour]))


def _scans(recording: Recording | None, stamps: list[int]) -> dict[int, Floats]:
    """Hits (N, 2) in the base's frame by stamp, at most so many scans, evenly spaced."""
    if recording is None:
        return {}
    shown = set(stamps[:: max(len(stamps) // MAX_SCANS, 1)])
    return {
        frame.scan.stamp_ns: frame.base_from_sensor.transform(frame.scan.points())
        for frame in recording.frames()
        if frame.scan.stamp_ns in shown
    }


def _lifted(points: Floats) -> Floats:
    return np.column_stack([points, np.zeros(len(points))])


def _rgb(colour: str) -> list[int]:
    return [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
