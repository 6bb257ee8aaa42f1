"""Export the runs of one sequence as a rerun recording: paths, scans at the estimated poses, maps and errors."""

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
from evalkit.io.map_server import draw_pixels
from evalkit.io.output_files import staging_folder
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.report.html.method_colours import Strokes
from evalkit.results.run_record import RunRecord

TIMELINE = "recording"
MAX_SCANS = 500
"""Scans in the file; more make it larger without being visible."""


def import_rerun() -> Any:
    """Import rerun. Raises NotInstalled with the command that installs it."""
    try:
        return importlib.import_module("rerun")
    except ImportError as error:
        raise NotInstalled("rerun", f"cannot be imported ({error})", "pip install 'evalkit[rerun]'") from error


def write_rerun(path: Path, runs: Sequence[RunRecord], sequence: SensorSequence | None, strokes: Strokes) -> Path:
    """Write the ``.rrd`` file of a sequence's runs of one seed (at least one); return its path.

    Entities: world/truth, world/<method> with path, base, scan and walls of the map, maps/<method> (the map as an
    image), errors/<method>. Metres, z up; seconds since the first scan on the timeline "recording".
    """
    rerun = import_rerun()
    begin = min(int(run.result.steps["stamp_ns"][0]) for run in runs)
    with staging_folder(path.parent, path.parent) as place:
        place.mkdir()
        stream = rerun.RecordingStream("evalkit", recording_id=path.stem, send_properties=False)
        stream.save(place / path.name)
        stream.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        true = next((run.truth.trajectory for run in runs if run.truth.trajectory is not None), None)
        if true is not None and len(true):
            stream.log("world/truth", rerun.LineStrips3D([_add_z(true.poses[:, :2])], colors=[[0, 0, 0]]), static=True)
        for run in runs:
            _log(rerun, stream, run, sequence, _rgb(strokes[run.method].colour), begin)
        stream.flush()
        stream.disconnect()
    return path


def _log(
    rerun: Any, stream: Any, run: RunRecord, sequence: SensorSequence | None, colour: list[int], begin: int
) -> None:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", run.method)
    stamps, poses = world_poses(run)
    stream.log(f"world/{name}/path", rerun.LineStrips3D([_add_z(poses[:, :2])], colors=[colour]), static=True)
    if run.scores.grid is not None:
        walls = _add_z(run.scores.grid.centres(run.scores.grid.occupied()))
        dots = rerun.Points3D(walls, radii=0.5 * run.scores.grid.resolution_m, colors=[120, 120, 120])
        stream.log(f"world/{name}/map", dots, static=True)
        stream.log(f"maps/{name}", rerun.Image(draw_pixels(run.scores.grid), color_model="L"), static=True)
    scans = _scans(sequence, stamps.tolist())
    for at, (stamp, row) in enumerate(zip(stamps.tolist(), poses, strict=True)):
        stream.set_time(TIMELINE, duration=np.timedelta64(stamp - begin, "ns"))
        point = rerun.Points3D(_add_z(row[None, :2]), radii=0.08, colors=[colour])
        stream.log(f"world/{name}/base", point)
        if run.scores.errors_m is not None and np.isfinite(run.scores.errors_m[at]):
            stream.log(f"errors/{name}", rerun.Scalars(float(run.scores.errors_m[at])))
        if stamp in scans:
            seen = _add_z(se2.transform(row, scans[stamp]))
            stream.log(f"world/{name}/scan", rerun.Points3D(seen, radii=0.02, colors=[colour]))


def _scans(sequence: SensorSequence | None, stamps: list[int]) -> dict[int, Floats]:
    """Return hits (N, 2) in the base frame by stamp, of at most about ``MAX_SCANS`` evenly spaced scans."""
    if sequence is None:
        return {}
    shown = set(stamps[:: max(len(stamps) // MAX_SCANS, 1)])
    return {
        frame.scan.stamp_ns: frame.points_in_base(None) for frame in sequence.frames() if frame.scan.stamp_ns in shown
    }


def _add_z(points: Floats) -> Floats:
    return np.column_stack([points, np.zeros(len(points))])


def _rgb(colour: str) -> list[int]:
    return [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
