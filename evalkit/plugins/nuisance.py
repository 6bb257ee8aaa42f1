"""Small perturbations of a recording and of a method, which must not matter: their spread is the nuisance band.

Perturbation k is the same for every method. It starts the recording up to ten scans later, leaves out a tenth of the
beams of every scan, adds noise at the resolution of the range readings, and changes the lengths among the parameters of
the method by one factor within 1 %.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import islice

import numpy as np

from evalkit.core.scan import Frame
from evalkit.plugins.changed_sequence import ChangedSequence
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Sequence as SensorSequence

MAX_LATER = 10
"""scans"""
DROPPED = 0.1
"""Share of the beams that are left out."""
CHANGE = 0.01
RESOLUTION_M = (0.001, 0.05)
"""Bounds of the resolution of range readings."""
SEEN_SCANS = 20
"""The resolution is found in so many scans."""
GOLDEN = 0.6180339887498949
"""Excerpts start at the fractional part of the perturbation's number times this, which spreads them evenly."""


def perturb_parameters(
    values: Mapping[str, Value], parameters: Sequence[Parameter], perturbation: int
) -> dict[str, Value]:
    """Return the values with all lengths (unit m) changed by one factor within 1 %, inside their bounds."""
    factor = 1.0 + CHANGE * np.random.default_rng([1, perturbation]).uniform(-1.0, 1.0)
    lengths = {one.name: one for one in parameters if one.unit == "m" and isinstance(one.default, float)}
    changed = dict(values)
    for name in sorted(lengths.keys() & values.keys()):
        changed[name] = float(np.clip(factor * float(values[name]), lengths[name].low, lengths[name].high))
    return changed


def perturb_sequence(sequence: SensorSequence, perturbation: int, scans: int = 0) -> ChangedSequence:
    """Return a recording under a perturbation; ``scans``: an excerpt of so many scans, 0 for the whole recording."""
    length, later = len(sequence), int(np.random.default_rng([0, perturbation]).integers(1, MAX_LATER + 1))
    count = min(scans, length) if scans else length
    first = min(int((length - count) * (perturbation * GOLDEN % 1.0)) + later, max(length - 1, 0))
    resolution_m = cache(partial(_find_resolution, sequence))  # reads scans: not before the first frame is wanted

    def change(index: int, frame: Frame) -> Frame:
        scan, rng = frame.scan, np.random.default_rng([2, perturbation, index])
        noise = resolution_m() * rng.uniform(-0.5, 0.5, len(scan.ranges))
        ranges = np.where(scan.hits, np.clip(scan.ranges + noise, scan.range_min_m, scan.range_max_m), scan.ranges)
        ranges[rng.random(len(ranges)) < DROPPED] = np.nan
        return replace(frame, scan=replace(scan, ranges=ranges))

    return ChangedSequence(sequence, change, first, min(count, length - first))


def _find_resolution(sequence: SensorSequence) -> float:
    """Return the smallest difference (m) between two ranges in one scan, the median over the first scans."""
    steps = []
    for frame in islice(sequence.frames(), SEEN_SCANS):
        differences = np.diff(np.unique(np.round(frame.scan.ranges[frame.scan.hits], 6)))
        if len(differences):
            steps.append(float(differences.min()))
    return float(np.clip(np.median(steps) if steps else 0.0, *RESOLUTION_M))
