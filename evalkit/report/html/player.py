"""The content of the page's player for a sequence: poses, residuals, scans and map defects, thinned to a budget."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Several
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import Ints, spread_indices
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.protocols import Sequence
from evalkit.report.html.array_encoding import NONE, pack_array, quantise
from evalkit.report.html.corrected_runs import SUFFIX
from evalkit.report.html.map_defects import find_ghosts, find_violations
from evalkit.report.html.maps import MapWindow, pixel_m
from evalkit.report.html.method_colours import Stroke
from evalkit.report.html.shown_corrections import ShownCorrection, describe_corrections, list_corrections
from evalkit.report.html.shown_scans import (
    METRE,
    MILLISECOND,
    Beams,
    dequantise_poses,
    load_beams,
    pack_beams,
    place_hits,
    quantise_poses,
)
from evalkit.results.run_record import RunRecord

RESIDUAL = 1e-4
"""Step of residuals and errors (m)."""
MAX_SCANS = 1000
MAX_RANGES = 300_000
MAX_ON_PAGE = 600_000
"""Ranges in a sequence and on the page: a page of thirteen methods on ten sequences stays below 8 MB."""
MAX_CELLS = 3000
QUANTITIES = (("error", "error"), ("s2s", "S2S residual"), ("s2m", "S2M residual"))
FARTHEST_M = 1e6
"""Poses beyond this distance are not drawn."""


@dataclass(frozen=True, slots=True)
class Player:
    """A sequence as the page's player reads it: JSON, methods, quantities, and remarks for the caption.

    ``quantities``: pairs of name in the JSON and label. ``preferred``, ``rival``: the methods shown first. ``maps``:
    methods that consist of a map without a path. ``corrections``: lists of the corrections of each SLAM by its label.
    """

    content: str
    methods: tuple[str, ...]
    quantities: tuple[tuple[str, str], ...]
    has_truth: bool
    has_true_map: bool
    remarks: str
    preferred: str
    rival: str
    maps: tuple[str, ...]
    corrections: Mapping[str, Several[ShownCorrection]]


def build_player(
    records: Several[RunRecord],
    scans: Callable[[], Sequence] | None,
    shown: MapWindow | None,
    lines: Mapping[str, Stroke],
    most_ranges: int = MAX_RANGES,
    preferred: str = "",
    rival: str = "",
) -> Player | None:
    """Build the player from each method's first run; None if no run answered a scan.

    ``scans`` opens the sequence; without it, or if it fails, the player shows no scans. ``preferred``: the method that
    places the scans at first; ``rival``: the one it is compared with.
    """
    answered = [record for record in records if len(record.result.steps)]
    if not answered:
        return None
    stamps = np.unique(np.concatenate([record.result.steps["stamp_ns"] for record in answered]))
    rows = choose_scans(motion_disagreement(np.stack([world_poses(record, stamps) for record in answered])), MAX_SCANS)
    kept = stamps[rows]
    beams, why = _beams_of(scans, kept, most_ranges)
    alone = [record for record in records if not len(record.result.steps) and record.scores.grid is not None]
    omitted = _describe_omissions(len(stamps), len(kept), beams, why, [record.method for record in alone])
    corrections = list_corrections(answered, stamps)
    true = next((t.truth.trajectory for t in answered if t.truth.trajectory is not None), None)
    content: dict[str, Any] = {
        "times": pack_array(quantise((kept - kept[0]) / MILLISECOND, 1.0)),
        "numbers": pack_array((rows + 1).astype(np.int32)),
        "of": len(stamps),
        "beams": None if beams is None else pack_beams(beams),
        "truth": None if true is None else pack_array(quantise_poses(_at(true, kept))),
        "runs": [_run(record, kept, beams, lines) for record in answered],
        "maps": [{"label": record.method} | _map(record) for record in alone],
        "window": None if shown is None else [shown.x_min, shown.x_max, shown.y_min, shown.y_max],
        "pixels": _pixels(records, shown),
        "corrections": [one.content for one in corrections],
    }
    first, second = _two(content["runs"], preferred, rival)
    return Player(
        content=json.dumps(content, separators=(",", ":"), allow_nan=False),
        methods=tuple(record.method for record in answered),
        quantities=tuple((key, name) for key, name in QUANTITIES if any(run[key] for run in content["runs"])),
        has_truth=true is not None,
        has_true_map="" in content["pixels"],
        remarks=" ".join([*omitted, *describe_corrections(answered)]),
        preferred=first,
        rival=second,
        maps=tuple(record.method for record in alone),
        corrections={method: tuple(own) for method, own in itertools.groupby(corrections, key=lambda one: one.method)},
    )


def ranges_per_sequence(sequences: int) -> int:
    """Return the number of ranges of each sequence that a page of so many sequences holds."""
    return min(MAX_RANGES, MAX_ON_PAGE // max(sequences, 1))


def world_poses(record: RunRecord, stamps: Stamps) -> Floats:
    """Return the estimated poses ``world_from_base`` (N, 3) at those times, nan without an answer."""
    steps = record.result.steps
    poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1).astype(np.float64)
    poses[~(np.abs(poses) < FARTHEST_M).all(axis=1)] = np.nan
    found = np.full((len(stamps), 3), np.nan)
    found[np.searchsorted(stamps, steps["stamp_ns"])] = se2.compose(record.scores.world_from_start.row, poses)
    return found


def motion_disagreement(poses: Floats) -> Floats:
    """Return the largest difference (N,) in metres of the motions since the previous scan, for poses (C, N, 3).

    The first is 0. Each motion is expressed in its own frame, so that one jump does not affect later scans.
    """
    moved = se2.between(poses[:, :-1], poses[:, 1:])[..., :2]
    apart = np.zeros(poses.shape[1])
    for first in moved:
        between = np.nan_to_num(np.linalg.norm(moved - first, axis=-1))
        apart[1:] = np.maximum(apart[1:], between.max(axis=0))
    return apart


def choose_scans(apart: Floats, most: int) -> Ints:
    """Return increasing indices of at most so many scans: in each stretch the largest disagreement, and both ends."""
    count = len(apart)
    if count <= most:
        return np.arange(count, dtype=np.int64)
    edges = np.linspace(1, count - 1, most - 1).round().astype(int)
    inner = [a + int(np.argmax(apart[a:b])) for a, b in itertools.pairwise(edges)]
    return np.array([0, *inner, count - 1], dtype=np.int64)


def _beams_of(scans: Callable[[], Sequence] | None, stamps: Stamps, most: int) -> tuple[Beams | None, str]:
    """Return the scans, or None and the reason."""
    if scans is None:
        return None, "the sequence is not available"
    try:
        return load_beams(scans(), stamps, most), ""
    except Exception as error:  # noqa: BLE001 - third-party code of a reader; the page works without scans
        return None, f"the sequence cannot be read ({error})"


def _run(record: RunRecord, stamps: Stamps, beams: Beams | None, lines: Mapping[str, Stroke]) -> dict[str, Any]:
    rows = np.searchsorted(record.result.steps["stamp_ns"], stamps)
    rows[rows == len(record.result.steps)] = 0
    there = record.result.steps["stamp_ns"][rows] == stamps

    def series(values: Floats | None) -> str | None:
        if values is None or not np.isfinite(values).any():
            return None
        return pack_array(quantise(np.where(there, np.asarray(values, dtype=np.float64)[rows], np.nan), RESIDUAL))

    steps = quantise_poses(world_poses(record, record.result.steps["stamp_ns"])[rows])
    steps[~there] = NONE
    stroke = lines[record.method]
    return {
        "label": record.method,
        "map": record.method.removesuffix(SUFFIX),
        "colour": stroke.css,
        "dash": list(stroke.dash),
        "poses": pack_array(steps),
        "s2s": series(record.result.steps["s2s_error"]),
        "s2m": series(record.result.steps["s2m_error"]),
        "error": series(record.scores.errors_m),
        **_map(record),
        "violations": _cells(_violations_of(record, dequantise_poses(steps), stamps, beams)),
    }


def _map(record: RunRecord) -> dict[str, Any]:
    """Return the size of the map's cells (m) and its ghost walls."""
    side = METRE if record.scores.grid is None else record.scores.grid.resolution_m
    return {"cell": side, "ghosts": _cells(_ghosts_of(record))}


def _ghosts_of(record: RunRecord) -> Floats | None:
    if record.scores.grid is None or record.truth.grid is None:
        return None
    return find_ghosts(record.scores.grid, record.truth.grid)


def _violations_of(record: RunRecord, poses: Floats, stamps: Stamps, beams: Beams | None) -> Floats | None:
    if record.scores.grid is None or beams is None:
        return None
    points = place_hits(beams, poses, stamps).reshape(-1, 2)
    return find_violations(points[np.isfinite(points).all(axis=1)], record.scores.grid)


def _cells(centres: Floats | None) -> str | None:
    """Return at most ``MAX_CELLS`` positions (K, 2) in millimetres; None if unknown."""
    if centres is None:
        return None
    return pack_array(quantise(centres[spread_indices(len(centres), MAX_CELLS)], METRE))


def _at(true: Trajectory, stamps: Stamps) -> Floats:
    """Return the true poses (N, 3) at those times, nan outside the time span of the ground truth."""
    found = np.full((len(stamps), 3), np.nan)
    inside = (stamps >= true.stamps_ns[0]) & (stamps <= true.stamps_ns[-1]) if len(true) else np.zeros(0, dtype=int)
    found[inside] = true.at(stamps[inside])
    return found


def _pixels(records: Several[RunRecord], shown: MapWindow | None) -> Mapping[str, float]:
    """Return metres per pixel of each map's image; the true map has the name ""."""
    if shown is None:
        return {}
    grids = {record.method: record.scores.grid for record in records if record.scores.grid is not None}
    true = next((record.truth.grid for record in records if record.truth.grid is not None), None)
    return {label: pixel_m(grid, shown) for label, grid in (grids | ({} if true is None else {"": true})).items()}


def _two(runs: Several[Mapping[str, Any]], preferred: str, rival: str) -> tuple[str, str]:
    """Return the methods compared first: the preferred or the first one, and another; with residuals if possible."""
    labels = [run["label"] for run in sorted(runs, key=lambda run: run["s2m"] is None)]
    first = preferred if preferred in labels else labels[0]
    others = [label for label in (rival, *labels) if label in labels and label != first]
    return first, next(iter(others), first)


def _describe_omissions(answered: int, kept: int, beams: Beams | None, why: str, alone: Several[str]) -> list[str]:
    """Return sentences on what is left out."""
    sentences = []
    if kept < answered:
        sentences.append(
            f"{kept:,} of {answered:,} scans are shown: in each stretch the one with the largest difference."
        )
    if beams is None:
        sentences.append(f"Scans are not shown: {why}.")
    elif beams.every > 1:
        sentences.append(f"One beam in {beams.every} is shown.")
    if alone:
        sentences.append(f"Maps without a path: {', '.join(alone)}.")
    return sentences
