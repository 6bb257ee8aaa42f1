"""Where a map fits on another one of which nothing is known: tried everywhere and at every angle."""

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
from evalkit.metrics.maps import nearest_distances_m
from evalkit_baselines.paper.icp import Icp

CELL_M = 0.1
SPREAD_M = 0.15
"""How far off (1 sigma) a wall may be and still speak for a place."""

STEP_DEG = 3.0
WITHIN_M = 0.1
ELSEWHERE_M = 1.0
ELSEWHERE_DEG = 10.0


@dataclass(frozen=True, slots=True)
class Placed:
    """Where a map fits best: the pose, how far its walls are from the plan's (mean, m), the share of them within 0.1 m.

    ``rival``: how well the best place farther than 1 m or 10 deg away fits, as a share of the best; near 1 the place is
    a guess.
    """

    plan_from_map: Pose
    mean_m: float
    within: float
    rival: float


def place(walls: Floats, plan: Floats) -> Placed:
    """Where wall points (N, 2) of a map fit best on those (M, 2) of a plan: correlation everywhere, then ICP."""
    low = plan.min(axis=0) - 2.0
    shape = (np.ceil((plan.max(axis=0) + 2.0 - low) / CELL_M)).astype(int)
    free = np.ones(shape, dtype=np.bool_)
    free[tuple(((plan - low) / CELL_M).astype(int).T)] = False
    near = np.exp(-0.5 * (ndimage.distance_transform_edt(free) * CELL_M / SPREAD_M) ** 2)
    tried = [_best(walls, near, low, angle) for angle in np.radians(np.arange(-180.0, 180.0, STEP_DEG))]
    found, score = max(tried, key=lambda each: each[1])
    coarse = Pose.of(found)
    rival = max((value for pose, value in _others(walls, near, low, tried, coarse)), default=0.0)
    icp = Icp(epsilon=1e-6, one_to_one=False, max_correspondence_m=0.5, max_iterations=100)
    answer = icp.register(Cloud(plan), Cloud(walls), coarse).target_from_source
    distances = nearest_distances_m(answer.transform(walls), plan)
    return Placed(answer, float(distances.mean()), float(np.mean(distances <= WITHIN_M)), rival / score)


def _scores(walls: Floats, near: Floats, low: Floats, angle: float) -> tuple[Floats, Floats]:
    """How well (R, C) the turned walls fit at every shift, in cells, and the position (2,) of the first shift (m)."""
    turned = Pose(0.0, 0.0, angle).transform(walls)
    corner = turned.min(axis=0)
    cells: Ints = ((turned - corner) / CELL_M).astype(np.int64)
    image = np.zeros(cells.max(axis=0) + 1)
    np.add.at(image, tuple(cells.T), 1.0 / len(walls))
    return np.asarray(fftconvolve(near, image[::-1, ::-1])), low - corner - CELL_M * (np.array(image.shape) - 1)


def _best(walls: Floats, near: Floats, low: Floats, angle: float) -> tuple[Floats, float]:
    """The row (3,) ``plan_from_map`` that fits best at an angle, and how well."""
    scores, first = _scores(walls, near, low, angle)
    return _pose(scores, first, angle), float(scores.max())


def _pose(scores: Floats, first: Floats, angle: float) -> Floats:
    at = np.array(np.unravel_index(int(np.argmax(scores)), scores.shape))
    return np.array([*(first + CELL_M * at), angle])


def _others(
    walls: Floats, near: Floats, low: Floats, tried: list[tuple[Floats, float]], best: Pose
) -> list[tuple[Floats, float]]:  # fmt: skip
    """The best place of every angle that is elsewhere than the best of all."""
    others = []
    for pose, score in tried:
        apart = math.degrees(abs((best.inverse() @ Pose(0.0, 0.0, float(pose[2]))).theta))
        if apart > ELSEWHERE_DEG:
            others.append((pose, score))
            continue
        scores, first = _scores(walls, near, low, float(pose[2]))
        row, column = np.round((np.array([best.x, best.y]) - first) / CELL_M).astype(int)
        reach = int(ELSEWHERE_M / CELL_M)
        scores[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1] = 0.0
        others.append((_pose(scores, first, float(pose[2])), float(scores.max())))
    return others
