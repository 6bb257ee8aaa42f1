"""What the page's player shows of a sequence: poses, residuals, scans and faults of the maps, thinned to a budget."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Several
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from evalkit.core import se2
from evalkit.core.arrays import Ints
from evalkit.core.grid import OccupancyGrid
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.consistency import CLEARED, look_up_cells
from evalkit.metrics.maps import nearest_distances_m
from evalkit.plugins.protocols import Sequence
from evalkit.report.html.array_encoding import NONE, Steps, packed, quantised, restored
from evalkit.report.html.maps import Window, pixel_m
from evalkit.report.html.palette import Stroke
from evalkit.results.run_record import RunRecord

METRE, RADIAN, RESIDUAL, MILLISECOND = 1e-3, 1e-5, 1e-4, 1_000_000
"""Steps of positions and ranges (m), of angles (rad), of residuals and errors (m), of times (ns)."""
MAX_SCANS = 2000
MAX_RANGES = 400_000
MAX_ON_PAGE = 4_000_000
"""Ranges in a sequence and on the page: at about 1.5 bytes each the page stays below 15 MB."""
MAX_CELLS = 8000
QUANTITIES = (("error", "error"), ("s2s", "S2S residual"), ("s2m", "S2M residual"))
FARTHEST_M = 1e6
"""A pose beyond is no pose: whoever ran away so far cannot be drawn."""
GHOST_M = 0.2
"""An occupied cell this far from every true wall is a ghost, and a hit this far from every wall of the map a violation
where the map is free: four times the range noise (1 sigma) or more."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The hits of scans, as steps: ``ranges`` (N, B), 0 where a beam hit nothing; ``angles`` (N, B) in the sensor.

    ``base_from_sensor`` (N, 3). ``sweep`` (N,): how long a scan took. ``every``: one in so many beams is here.
    """

    ranges: Steps
    angles: Steps
    base_from_sensor: Steps
    sweep: Steps
    every: int


@dataclass(frozen=True, slots=True)
class Player:
    """A sequence as the page's player reads it: JSON, whom and what it can show, and what its caption must tell.

    ``quantities``: pairs of name in the JSON and name for the reader. ``preferred``, ``rival``: whom it begins with.
    ``maps``: methods that are a map alone.
    """

    content: str
    methods: tuple[str, ...]
    quantities: tuple[tuple[str, str], ...]
    has_truth: bool
    has_true_map: bool
    told: str
    preferred: str
    rival: str
    maps: tuple[str, ...]


def player(
    records: Several[RunRecord],
    scans: Callable[[], Sequence] | None,
    shown: Window | None,
    lines: Mapping[str, Stroke],
    most_ranges: int = MAX_RANGES,
    preferred: str = "",
) -> Player | None:
    """What is shown of each method's first run; None where nobody answered a scan.

    ``scans`` makes the sequence again; without it, or where it fails, everything but the scans is there. ``preferred``
    places the scans at first.
    """
    answered = [record for record in records if len(record.result.steps)]
    if not answered:
        return None
    stamps = np.unique(np.concatenate([record.result.steps["stamp_ns"] for record in answered]))
    rows = chosen(disagreement(np.stack([world_poses(record, stamps) for record in answered])), MAX_SCANS)
    kept = stamps[rows]
    beams, why = _beams_of(scans, kept, most_ranges)
    alone = [record for record in records if not len(record.result.steps) and record.scores.grid is not None]
    true = next((t.truth.trajectory for t in answered if t.truth.trajectory is not None), None)
    content: dict[str, Any] = {
        "times": packed(quantised((kept - kept[0]) / MILLISECOND, 1.0)),
        "numbers": packed((rows + 1).astype(np.int32)),
        "of": len(stamps),
        "beams": None if beams is None else _packed_beams(beams),
        "truth": None if true is None else packed(pose_steps(_at(true, kept))),
        "runs": [_run(record, kept, beams, lines) for record in answered],
        "maps": [{"label": record.method} | _map(record) for record in alone],
        "window": None if shown is None else [shown.x_min, shown.x_max, shown.y_min, shown.y_max],
        "pixels": _pixels(records, shown),
    }
    labels = tuple(record.method for record in answered)
    first, second = _two(content["runs"], preferred)
    return Player(
        content=json.dumps(content, separators=(",", ":"), allow_nan=False),
        methods=labels,
        quantities=tuple((key, name) for key, name in QUANTITIES if any(run[key] for run in content["runs"])),
        has_truth=true is not None,
        has_true_map="" in content["pixels"],
        told=_told(len(stamps), len(kept), beams, why, [record.method for record in alone]),
        preferred=first,
        rival=second,
        maps=tuple(record.method for record in alone),
    )


def budget(sequences: int) -> int:
    """How many ranges of each of so many sequences a page may hold."""
    return min(MAX_RANGES, MAX_ON_PAGE // max(sequences, 1))


def world_poses(record: RunRecord, stamps: Stamps) -> Floats:
    """The poses ``world_from_base`` (N, 3) a run answered at those times, nan where it did not."""
    steps = record.result.steps
    poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1).astype(np.float64)
    poses[~(np.abs(poses) < FARTHEST_M).all(axis=1)] = np.nan
    found = np.full((len(stamps), 3), np.nan)
    found[np.searchsorted(stamps, steps["stamp_ns"])] = se2.compose(record.scores.world_from_start.row, poses)
    return found


def disagreement(poses: Floats) -> Floats:
    """By how many metres the motions (C, N, 3) of C methods since the scan before differ at most (N,); 0 at first.

    Motions are compared each in its own frame, so that what went apart once does not differ for ever after.
    """
    moved = se2.between(poses[:, :-1], poses[:, 1:])[..., :2]
    apart = np.zeros(poses.shape[1])
    for first in moved:
        between = np.nan_to_num(np.linalg.norm(moved - first, axis=-1))
        apart[1:] = np.maximum(apart[1:], between.max(axis=0))
    return apart


def chosen(apart: Floats, most: int) -> Ints:
    """The indices of at most so many scans, rising: of each stretch the one of most disagreement, and both ends."""
    count = len(apart)
    if count <= most:
        return np.arange(count, dtype=np.int64)
    edges = np.linspace(1, count - 1, most - 1).round().astype(int)
    inner = [a + int(np.argmax(apart[a:b])) for a, b in itertools.pairwise(edges)]
    return np.array([0, *inner, count - 1], dtype=np.int64)


def beams_at(sequence: Sequence, stamps: Stamps, most_ranges: int) -> Beams:
    """The scans of a sequence at those times (N,), their beams thinned evenly until at most so many ranges are left."""
    row_of = {stamp: row for row, stamp in enumerate(stamps.tolist())}
    found = {}
    for frame in sequence.frames():
        if frame.scan.stamp_ns in row_of:
            found[row_of[frame.scan.stamp_ns]] = frame
        if frame.scan.stamp_ns >= stamps[-1]:
            break
    count = max((len(frame.scan.ranges) for frame in found.values()), default=0)
    every = max(-(-count * len(stamps) // most_ranges), 1)
    shape = (len(stamps), -(-count // every))
    ranges, angles = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.int32)
    sensor, sweep = np.zeros((len(stamps), 3), dtype=np.int32), np.zeros(len(stamps), dtype=np.int32)
    for row, frame in found.items():
        taken = slice(None, None, every)
        hits = np.where(frame.scan.hits, frame.scan.ranges, 0.0)[taken]
        ranges[row, : len(hits)] = quantised(hits, METRE)
        angles[row, : len(hits)] = quantised(frame.scan.angles[taken], RADIAN)
        sensor[row] = pose_steps(frame.base_from_sensor.row)
        sweep[row] = frame.scan.duration_ns // MILLISECOND
    return Beams(ranges, angles, sensor, sweep, every)


def placed(beams: Beams, poses: Floats, stamps: Stamps) -> Floats:
    """Where the hits lie in the world (N, B, 2), nan where there is none: what the page draws for poses (N, 3).

    The motion within a scan is undone at the speed from each kept pose to the next one, or to the last from before it.
    """
    count, width = beams.ranges.shape
    after = np.minimum(np.arange(count) + 1, count - 1)
    before = np.maximum(after - 1, 0)
    step = poses[after] - poses[before]
    step[:, 2] = se2.wrap(step[:, 2])
    elapsed = np.maximum((stamps[after] - stamps[before]) / MILLISECOND, 1.0)
    share = np.minimum(beams.sweep / elapsed, 1.0)[:, None] * np.arange(width) / max(width - 1, 1)
    moving = poses[:, None] + share[..., None] * np.nan_to_num(step)[:, None]
    return se2.transform_each(moving.reshape(-1, 3), _in_base(beams)).reshape(count, width, 2)


@lru_cache(maxsize=1)  # every method places the same hits
def _in_base(beams: Beams) -> Floats:
    """The hits (N * B, 2) seen from the base (m), nan where there is none."""
    ranges, angles = (beams.ranges * METRE).ravel(), (beams.angles * RADIAN).ravel()
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)
    points[ranges <= 0.0] = np.nan
    return se2.transform_each(np.repeat(_poses(beams.base_from_sensor), beams.ranges.shape[1], axis=0), points)


def ghosts(mapped: OccupancyGrid, true: OccupancyGrid) -> Floats:
    """Centres (K, 2) of occupied cells farther than ``GHOST_M`` from every true wall (m)."""
    ours, theirs = mapped.centres(mapped.occupied()), true.centres(true.occupied())
    if not len(ours) or not len(theirs):
        return ours
    return np.asarray(ours[nearest_distances_m(ours, theirs) > GHOST_M])


def violations(points: Floats, grid: OccupancyGrid) -> Floats:
    """Centres (K, 2) of the map's cells in which hits (N, 2) lie though the run as a whole has found them free.

    Free is what consistency calls cleared, log-odds below -1, without an occupied cell within ``GHOST_M``.
    """
    log_odds, observed = look_up_cells(points, grid)
    suspects = points[observed & (log_odds < CLEARED)]
    walls = grid.centres(grid.occupied())
    if len(walls) and len(suspects):
        suspects = suspects[np.isinf(cKDTree(walls).query(suspects, distance_upper_bound=GHOST_M)[0])]
    origin, step = np.array([grid.origin_x, grid.origin_y]), grid.resolution_m
    columns, rows = np.floor((suspects - origin) / step).T
    high = grid.shape[0]
    cells = np.unique(columns * high + rows)  # whole numbers: by far quicker than pairs
    return np.asarray(origin + (np.stack([cells // high, cells % high], axis=-1) + 0.5) * step)


def pose_steps(poses: Floats) -> Steps:
    """Poses (..., 3) in steps of a millimetre and 1e-5 rad; all ``NONE`` where one number is missing."""
    steps = quantised(poses, np.array([METRE, METRE, RADIAN]))
    return np.where((steps == NONE).any(axis=-1, keepdims=True), NONE, steps).astype(np.int32)


def _poses(steps: Steps) -> Floats:
    return restored(steps, np.array([METRE, METRE, RADIAN]))


def _beams_of(scans: Callable[[], Sequence] | None, stamps: Stamps, most: int) -> tuple[Beams | None, str]:
    """The scans, or None and why there are none."""
    if scans is None:
        return None, "the recording was not at hand"
    try:
        return beams_at(scans(), stamps, most), ""
    except Exception as error:  # noqa: BLE001 - a reader is a third party's code, and the page stands without it
        return None, f"the recording cannot be read ({error})"


def _packed_beams(beams: Beams) -> dict[str, Any]:
    return {
        "width": beams.ranges.shape[1],
        "ranges": packed(beams.ranges.ravel()),
        "angles": packed(beams.angles),
        "sensor": packed(beams.base_from_sensor),
        "sweep": packed(beams.sweep),
    }


def _run(record: RunRecord, stamps: Stamps, beams: Beams | None, lines: Mapping[str, Stroke]) -> dict[str, Any]:
    rows = np.searchsorted(record.result.steps["stamp_ns"], stamps)
    rows[rows == len(record.result.steps)] = 0
    there = record.result.steps["stamp_ns"][rows] == stamps

    def series(values: Floats | None) -> str | None:
        if values is None or not np.isfinite(values).any():
            return None
        return packed(quantised(np.where(there, np.asarray(values, dtype=np.float64)[rows], np.nan), RESIDUAL))

    steps = pose_steps(world_poses(record, record.result.steps["stamp_ns"])[rows])
    steps[~there] = NONE
    stroke = lines[record.method]
    return {
        "label": record.method,
        "colour": stroke.colour,
        "dash": list(stroke.dash),
        "poses": packed(steps),
        "s2s": series(record.result.steps["s2s_error"]),
        "s2m": series(record.result.steps["s2m_error"]),
        "error": series(record.scores.errors_m),
        **_map(record),
        "violations": _cells(_violations_of(record, _poses(steps), stamps, beams)),
    }


def _map(record: RunRecord) -> dict[str, Any]:
    """The side of the map's cells (m) and its ghost walls."""
    side = METRE if record.scores.grid is None else record.scores.grid.resolution_m
    return {"cell": side, "ghosts": _cells(_ghosts_of(record))}


def _ghosts_of(record: RunRecord) -> Floats | None:
    if record.scores.grid is None or record.truth.grid is None:
        return None
    return ghosts(record.scores.grid, record.truth.grid)


def _violations_of(record: RunRecord, poses: Floats, stamps: Stamps, beams: Beams | None) -> Floats | None:
    if record.scores.grid is None or beams is None:
        return None
    points = placed(beams, poses, stamps).reshape(-1, 2)
    return violations(points[np.isfinite(points).all(axis=1)], record.scores.grid)


def _cells(centres: Floats | None) -> str | None:
    """Places (K, 2) in millimetres, at most ``MAX_CELLS`` of them; None where nobody can tell."""
    if centres is None:
        return None
    taken = np.unique(np.linspace(0, len(centres) - 1, min(len(centres), MAX_CELLS)).astype(int))
    return packed(quantised(centres[taken], METRE))


def _at(true: Trajectory, stamps: Stamps) -> Floats:
    """The true poses (N, 3) at those times, nan beyond the truth's span."""
    found = np.full((len(stamps), 3), np.nan)
    inside = (stamps >= true.stamps_ns[0]) & (stamps <= true.stamps_ns[-1]) if len(true) else np.zeros(0, dtype=int)
    found[inside] = true.at(stamps[inside])
    return found


def _pixels(records: Several[RunRecord], shown: Window | None) -> Mapping[str, float]:
    """Metres per pixel of each map's picture, "" for the true one."""
    if shown is None:
        return {}
    grids = {record.method: record.scores.grid for record in records if record.scores.grid is not None}
    true = next((record.truth.grid for record in records if record.truth.grid is not None), None)
    return {label: pixel_m(grid, shown) for label, grid in (grids | ({} if true is None else {"": true})).items()}


def _two(runs: Several[Mapping[str, Any]], preferred: str) -> tuple[str, str]:
    """Whom the page compares at first: who is preferred, else the first, and another; with residuals if any."""
    labels = [run["label"] for run in sorted(runs, key=lambda run: run["s2m"] is None)]
    first = preferred if preferred in labels else labels[0]
    return first, next((label for label in labels if label != first), first)


def _told(answered: int, kept: int, beams: Beams | None, why: str, alone: Several[str]) -> str:
    """What the reader must know of what was left out."""
    sentences = []
    if kept < answered:
        sentences.append(f"{kept:,} of {answered:,} scans: of each stretch the one in which methods differ most.")
    if beams is None:
        sentences.append(f"Without the scans themselves: {why}.")
    elif beams.every > 1:
        sentences.append(f"One beam in {beams.every} is shown.")
    if alone:
        sentences.append(f"Without a path to play, because a map alone was given: {', '.join(alone)}.")
    return " ".join(sentences)
