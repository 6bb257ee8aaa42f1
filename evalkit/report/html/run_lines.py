"""Lines of runs for charts: paths in the world, errors and residuals over time, thinned to what is visible."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.se2 import Floats
from evalkit.results.run_record import RunRecord

POINTS = 600  # of a line: more are not visible at this size
STRETCHES = 150  # of a noisy line: more cannot be distinguished
PLAN_RATIO = 1.5  # width to height of the view from above


MAX_DRAWN_M = 1e9
"""Positions beyond are drawn there: outside every frame, and far from overflow."""


def world_path(record: RunRecord) -> Floats:
    """Return the estimated positions (N, 2) in the frame of the ground truth (m), within ``MAX_DRAWN_M``."""
    steps = record.result.steps
    poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1).astype(np.float64)
    poses = poses[np.isfinite(poses).all(axis=1)]
    poses[:, :2] = poses[:, :2].clip(-MAX_DRAWN_M, MAX_DRAWN_M)
    return se2.compose(record.scores.world_from_start.row, poses)[:, :2]


def seconds_of(record: RunRecord) -> Floats:
    """Return the times (N,) of a run's answers since its first one (s)."""
    stamps = record.result.steps["stamp_ns"]
    return np.asarray((stamps - stamps[0]) * 1e-9)


def find_frame(paths: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Return the corners of the figure: all paths with a margin, except paths above twice the median size."""
    corners = np.array([[*path.min(axis=0), *path.max(axis=0)] for path in paths if len(path)])
    sides = np.hypot(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    usual = corners[sides <= max(2.0 * float(np.median(sides)), 0.1)]
    low, high = usual[:, :2].min(axis=0), usual[:, 2:].max(axis=0)
    margin = max(0.06 * float((high - low).max()), 0.05)
    side = high - low + 2.0 * margin
    side = np.maximum(side, side[::-1] * [PLAN_RATIO, 1.0 / PLAN_RATIO])
    middle = 0.5 * (low + high)
    return middle - 0.5 * side, middle + 0.5 * side


def thin_points(points: Floats) -> Floats:
    """Return at most POINTS of the points (N, 2), evenly spaced in index, with the first and the last."""
    if len(points) <= POINTS:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, POINTS).round().astype(int)])


def bin_series(seconds: Floats, values: Floats, of: Callable[[Floats], Any], most: int) -> tuple[Floats, Floats]:
    """Return at most so many stretches of a series: their mean time, and ``of`` applied to their finite values."""
    finite = np.isfinite(values)
    seconds, values = seconds[finite], values[finite]
    if len(values) <= most:
        return seconds, values
    edges = np.linspace(0, len(values), most + 1).round().astype(int)
    pieces = list(itertools.pairwise(edges))
    return (
        np.array([seconds[a:b].mean() for a, b in pieces]),
        np.array([float(of(values[a:b])) for a, b in pieces]),
    )
