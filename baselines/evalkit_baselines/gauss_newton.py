"""Damped Gauss-Newton descent on SE(2) for matchers that score a whole scan: what the field matchers share."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.core.se2 import Floats

MIN_INLIERS = 3  # points; two fit a planar pose exactly
FLAT = 3e-4  # a step that lowers the cost by a smaller share of it ends the descent
MAX_STEP_M, MAX_STEP_RAD = 0.5, 0.2  # per step: beyond, the linearisation says nothing
DAMPING = (0.0, 0.03, 0.3, 3.0)
"""Share of the largest curvature added to all; the next is tried where a step did not lower the cost."""


class Terms(NamedTuple):
    """A cost at one pose, and how the points contribute.

    ``cost``: the value to minimise. ``slope`` (2, N), ``curvature`` (3, N): first derivative of a point's cost by its
    position, and second (xx, xy, yy). ``near``: number of points that have something to match. ``error_m``: their mean
    residual in metres. ``steep``: the curvature of these points together if every slope had one direction.
    """

    cost: float
    slope: Floats
    curvature: Floats
    near: int
    error_m: float
    steep: float


Evaluate = Callable[[Floats], Terms]
"""Evaluates the cost of points (N, 2) in the target's frame (m)."""


@dataclass(frozen=True, slots=True)
class StopRule:
    """When a descent ends, and which directions it leaves to the guess.

    A step shorter than ``step_m`` at the points' mean radius ends it. ``weak``: directions whose curvature is below
    this share of ``Terms.steep`` are not observed, and nothing moves along them.
    """

    max_iterations: int
    step_m: float
    weak: float


class Normal(NamedTuple):
    """Slope (3,) and Hessian (3, 3) by (x, y, turn about ``centre`` times ``radius``), all in metres.

    ``steep``: as in ``Terms``.
    """

    slope: Floats
    hessian: Floats
    steep: float
    centre: Floats
    radius: float


def descend(evaluate: Evaluate, source: Cloud, guess: Pose, stop: StopRule) -> Match:
    """Return the motion ``target_from_source`` that minimises a cost, starting from ``guess``.

    Not converged, with the guess as the answer, where fewer than ``MIN_INLIERS`` points have something to match. Every
    evaluation counts as an iteration. A step that does not lower the cost is repeated with more damping; where the
    strongest does not help either, the pose is a minimum as far as the cost can tell, and the descent has converged.
    """
    pose, terms = guess, evaluate(guess.transform(source.points))
    if terms.near < MIN_INLIERS:
        return Match.not_converged(guess, terms.near)
    iterations, level, converged = 1, 0, False
    normal = sum_points(guess.transform(source.points), terms)
    while iterations < stop.max_iterations:
        step = solve(normal, stop.weak, DAMPING[level])
        size_m = float(np.hypot(*step[:2]) + abs(step[2]))
        trial = turn_about(normal.centre, normal.radius, step) @ pose
        moved = trial.transform(source.points)
        found = evaluate(moved)
        iterations += 1
        gained = terms.cost - found.cost
        if found.near >= MIN_INLIERS and gained >= 0.0:
            level_off = gained < FLAT * abs(terms.cost)
            pose, terms, level = trial, found, max(level - 1, 0)
            normal = sum_points(moved, terms)
        else:
            level_off = False
            level += 1
        converged = size_m < stop.step_m or level == len(DAMPING) or level_off
        if converged:
            break
    return Match(pose, converged, iterations, terms.error_m, terms.near)


def sum_points(moved: Floats, terms: Terms) -> Normal:
    """Return the slope and Hessian of a cost from those of its points (N, 2), in the target's frame (m)."""
    x, y = moved.T
    centre = np.array([x.mean(), y.mean()])
    across_x, across_y = centre[1] - y, x - centre[0]
    radius = max(math.sqrt(float(across_x @ across_x + across_y @ across_y) / len(moved)), 1e-6)
    (gx, gy), (xx, xy, yy) = terms.slope, terms.curvature
    turn_x, turn_y = xx * across_x + xy * across_y, xy * across_x + yy * across_y
    turn = (across_x @ gx + across_y @ gy) / radius
    hxt, hyt = turn_x.sum() / radius, turn_y.sum() / radius
    htt = (across_x @ turn_x + across_y @ turn_y) / radius**2
    hxx, hxy, hyy = terms.curvature.sum(axis=1)
    hessian = np.array([[hxx, hxy, hxt], [hxy, hyy, hyt], [hxt, hyt, htt]])
    return Normal(np.array([gx.sum(), gy.sum(), turn]), hessian, terms.steep, centre, radius)


def solve(normal: Normal, weak: float, damping: float = 0.0) -> Floats:
    """Return the step (3,) in metres: (x, y, turn times radius); 0 along directions that are not observed.

    A negative curvature counts by its size, so that every step goes downhill.
    """
    values, vectors = np.linalg.eigh(normal.hessian)
    size = np.abs(values)
    largest = float(size.max())
    if largest <= 0.0:
        return np.zeros(3)
    share = np.where(size > weak * normal.steep, 1.0 / np.maximum(size + damping * largest, 1e-300), 0.0)
    step = -vectors @ (share * (vectors.T @ normal.slope))
    limit = max(float(np.hypot(*step[:2])) / MAX_STEP_M, abs(float(step[2])) / (MAX_STEP_RAD * normal.radius), 1.0)
    return np.asarray(step / limit)


def turn_about(centre: Floats, radius: float, step: Floats) -> Pose:
    """Return the motion that turns by ``step[2] / radius`` (rad) about ``centre`` (2,) and shifts by ``step[:2]``."""
    theta = float(step[2]) / radius
    cos, sin = math.cos(theta), math.sin(theta)
    (cx, cy), (x, y) = centre, step[:2]
    return Pose(float(x + cx - cos * cx + sin * cy), float(y + cy - sin * cx - cos * cy), theta)
