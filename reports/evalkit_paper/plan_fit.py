"""Fit a map on a plan with unknown transform: correlation at every position and angle, then ICP."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.signal import fftconvolve

from evalkit.core.arrays import Ints
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats
from evalkit.metrics.neighbourhoods import nearest_distances_m
from evalkit_baselines.paper.icp import Icp

CELL_M = 0.1
SPREAD_M = 0.15
"""Width (1 sigma, m) of the score around a wall of the plan."""

STEP_DEG = 3.0
WITHIN_M = 0.1
ELSEWHERE_M = 1.0
ELSEWHERE_DEG = 10.0


@dataclass(frozen=True, slots=True)
class PlanFit:
    """Best fit of a map on a plan: pose, mean distance of its walls to the plan's (m), share of them within 0.1 m.

    ``rival``: score of the best place farther than 1 m or 10 deg away, relative to the best; near 1 the fit is
    ambiguous.
    """

    plan_from_map: Pose
    mean_m: float
    within: float
    rival: float


def fit_on_plan(walls: Floats, plan: Floats) -> PlanFit:
    """Fit the wall points (N, 2) of a map on those (M, 2) of a plan."""
    low = plan.min(axis=0) - 2.0
    shape = (np.ceil((plan.max(axis=0) + 2.0 - low) / CELL_M)).astype(int)
    free = np.ones(shape, dtype=np.bool_)
    free[tuple(((plan - low) / CELL_M).astype(int).T)] = False
    near = np.exp(-0.5 * (ndimage.distance_transform_edt(free) * CELL_M / SPREAD_M) ** 2)
    tried = [_find_best_shift(walls, near, low, angle) for angle in np.radians(np.arange(-180.0, 180.0, STEP_DEG))]
    found, score = max(tried, key=lambda each: each[1])
    coarse = Pose.of(found)
    rival = max((value for pose, value in _find_rivals(walls, near, low, tried, coarse)), default=0.0)
    icp = Icp(epsilon=1e-6, one_to_one=False, max_correspondence_m=0.5, max_iterations=100)
    answer = icp.register(Cloud(plan), Cloud(walls), coarse).target_from_source
    distances = nearest_distances_m(answer.transform(walls), plan)
    return PlanFit(answer, float(distances.mean()), float(np.mean(distances <= WITHIN_M)), rival / score)


def _score_shifts(walls: Floats, near: Floats, low: Floats, angle: float) -> tuple[Floats, Floats]:
    """Scores (R, C) of the rotated walls at every shift (in cells), and the position (2,) of the first shift (m)."""
    turned = Pose(0.0, 0.0, angle).transform(walls)
    corner = turned.min(axis=0)
    cells: Ints = ((turned - corner) / CELL_M).astype(np.int64)
    image = np.zeros(cells.max(axis=0) + 1)
    np.add.at(image, tuple(cells.T), 1.0 / len(walls))
    return np.asarray(fftconvolve(near, image[::-1, ::-1])), low - corner - CELL_M * (np.array(image.shape) - 1)


def _find_best_shift(walls: Floats, near: Floats, low: Floats, angle: float) -> tuple[Floats, float]:
    """Best ``plan_from_map`` (3,) at an angle, and its score."""
    scores, first = _score_shifts(walls, near, low, angle)
    return _pose_at_maximum(scores, first, angle), float(scores.max())


def _pose_at_maximum(scores: Floats, first: Floats, angle: float) -> Floats:
    at = np.array(np.unravel_index(int(np.argmax(scores)), scores.shape))
    return np.array([*(first + CELL_M * at), angle])


def _find_rivals(
    walls: Floats, near: Floats, low: Floats, tried: list[tuple[Floats, float]], best: Pose
) -> list[tuple[Floats, float]]:  # fmt: skip
    """Best place of every angle outside the neighbourhood of the overall best."""
    others = []
    for pose, score in tried:
        apart = math.degrees(abs((best.inverse() @ Pose(0.0, 0.0, float(pose[2]))).theta))
        if apart > ELSEWHERE_DEG:
            others.append((pose, score))
            continue
        scores, first = _score_shifts(walls, near, low, float(pose[2]))
        row, column = np.round((np.array([best.x, best.y]) - first) / CELL_M).astype(int)
        reach = int(ELSEWHERE_M / CELL_M)
        scores[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 0.0
        others.append((_pose_at_maximum(scores, first, float(pose[2])), float(scores.max())))
    return others
