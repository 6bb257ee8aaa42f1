"""The scans that the page's player shows: their hits in whole steps, and where they lie in the world."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats, Stamps
from evalkit.plugins.protocols import Sequence
from evalkit.report.html.array_encoding import NONE, Steps, dequantise, pack_array, quantise

METRE, RADIAN, MILLISECOND = 1e-3, 1e-5, 1_000_000
"""Steps of positions and ranges (m), of angles (rad), of times (ns)."""


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """The hits of scans, in steps: ``ranges`` (N, B), 0 for a beam without a hit; ``angles`` (N, B) in the sensor.

    ``base_from_sensor`` (N, 3). ``sweep`` (N,): duration of a scan. ``every``: one in ``every`` beams is kept.
    """

    ranges: Steps
    angles: Steps
    base_from_sensor: Steps
    sweep: Steps
    every: int


def load_beams(sequence: Sequence, stamps: Stamps, most_ranges: int) -> Beams:
    """Load the scans at those times (N,), with beams thinned evenly to at most so many ranges."""
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
        ranges[row, : len(hits)] = quantise(hits, METRE)
        angles[row, : len(hits)] = quantise(frame.scan.angles[taken], RADIAN)
        sensor[row] = quantise_poses(frame.base_from_sensor.row)
        sweep[row] = frame.scan.duration_ns // MILLISECOND
    return Beams(ranges, angles, sensor, sweep, every)


def place_hits(beams: Beams, poses: Floats, stamps: Stamps) -> Floats:
    """Return the hits in the world (N, B, 2) for poses (N, 3), nan without a hit, as the page draws them.

    The motion within a scan is compensated with the speed between each kept pose and the next; for the last pose,
    between the previous one and it.
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


@lru_cache(maxsize=1)  # the same hits for every method
def _in_base(beams: Beams) -> Floats:
    """Return the hits (N * B, 2) in the base frame (m), nan without a hit."""
    ranges, angles = (beams.ranges * METRE).ravel(), (beams.angles * RADIAN).ravel()
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)
    points[ranges <= 0.0] = np.nan
    sensors = np.repeat(dequantise_poses(beams.base_from_sensor), beams.ranges.shape[1], axis=0)
    return se2.transform_each(sensors, points)


def quantise_poses(poses: Floats) -> Steps:
    """Return poses (..., 3) in steps of 1 mm and 1e-5 rad; all ``NONE`` if one number is missing."""
    steps = quantise(poses, np.array([METRE, METRE, RADIAN]))
    return np.where((steps == NONE).any(axis=-1, keepdims=True), NONE, steps).astype(np.int32)


def dequantise_poses(steps: Steps) -> Floats:
    """Return the poses of ``quantise_poses``, nan where missing."""
    return dequantise(steps, np.array([METRE, METRE, RADIAN]))


def pack_beams(beams: Beams) -> dict[str, Any]:
    """Return the scans as the page reads them."""
    return {
        "width": beams.ranges.shape[1],
        "ranges": pack_array(beams.ranges.ravel()),
        "angles": pack_array(beams.angles),
        "sensor": pack_array(beams.base_from_sensor),
        "sweep": pack_array(beams.sweep),
    }
