"""Rigid motions of the plane on rows ``(..., 3)`` of x [m], y [m], theta [rad].

A motion ``a_from_b`` transforms coordinates from frame b to frame a; adjacent names cancel:
``a_from_c = compose(a_from_b, b_from_c)``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Stamps = NDArray[np.int64]
PoseValues = tuple[float, float, float]
"""x [m], y [m], theta [rad] of one motion: arrays cost ten times as much for a single one."""


def wrap(theta: ArrayLike) -> Floats:
    """Return the angles wrapped to [-pi, pi) (rad)."""
    return np.asarray((np.asarray(theta, dtype=np.float64) + np.pi) % (2.0 * np.pi) - np.pi)


def wrap_angle(theta: float) -> float:
    """Return what ``wrap`` returns for one angle (rad)."""
    return (float(theta) + math.pi) % (2.0 * math.pi) - math.pi


def compose_one(a_from_b: PoseValues, b_from_c: PoseValues) -> PoseValues:
    """Return what ``compose`` returns for one motion, to the bit."""
    (ax, ay, a), (bx, by, b) = a_from_b, b_from_c
    cos, sin = float(np.cos(a)), float(np.sin(a))  # their last bits may differ from those of math
    return ax + cos * bx - sin * by, ay + sin * bx + cos * by, wrap_angle(a + b)


def invert_one(a_from_b: PoseValues) -> PoseValues:
    """Return what ``inverse`` returns for one motion, to the bit."""
    x, y, theta = a_from_b
    cos, sin = float(np.cos(theta)), float(np.sin(theta))
    return -cos * x - sin * y, sin * x - cos * y, wrap_angle(-theta)


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Floats:
    """Return the motions ``a_from_c``; shapes broadcast.

    >>> compose([1, 0, np.pi / 2], [1, 0, 0]).round(6).tolist()
    [1.0, 1.0, 1.570796]
    """
    a = np.asarray(a_from_b, dtype=np.float64)
    b = np.asarray(b_from_c, dtype=np.float64)
    if a.shape == b.shape == (3,):
        return np.array(compose_one(a.tolist(), b.tolist()))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def inverse(a_from_b: ArrayLike) -> Floats:
    """Return the motions ``b_from_a``."""
    a = np.asarray(a_from_b, dtype=np.float64)
    if a.shape == (3,):
        return np.array(invert_one(a.tolist()))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack([-cos * a[..., 0] - sin * a[..., 1], sin * a[..., 0] - cos * a[..., 1], wrap(-a[..., 2])], axis=-1)


def between(w_from_a: ArrayLike, w_from_b: ArrayLike) -> Floats:
    """Return the motions ``a_from_b`` between two frames given in a third."""
    return compose(inverse(w_from_a), w_from_b)


def transform(a_from_b: ArrayLike, points: ArrayLike) -> Floats:
    """Return points ``(..., N, 2)`` of frame b in frame a; one motion per leading index of ``a_from_b``."""
    a = np.asarray(a_from_b, dtype=np.float64)
    p = np.asarray(points, dtype=np.float64)
    x, y, cos, sin = a[..., 0], a[..., 1], np.cos(a[..., 2]), np.sin(a[..., 2])
    if a.ndim > 1:  # else numbers, which NumPy multiplies faster than arrays of one
        x, y, cos, sin = x[..., None], y[..., None], cos[..., None], sin[..., None]
    moved_x = cos * p[..., 0] - sin * p[..., 1] + x
    moved = np.empty((*moved_x.shape, 2))
    moved[..., 0], moved[..., 1] = moved_x, sin * p[..., 0] + cos * p[..., 1] + y
    return moved


def transform_each(a_from_b: ArrayLike, points: ArrayLike) -> Floats:
    """Return points ``(N, 2)``, each transformed by its own motion ``(N, 3)``: for beams fired at different times."""
    return transform(a_from_b, np.asarray(points, dtype=np.float64)[:, None, :])[:, 0, :]


def fraction(a_from_b: ArrayLike, share: ArrayLike) -> Floats:
    """Return the fraction ``share`` (N,), 0 to 1, of a motion along its constant-velocity arc (SE(2) exponential)."""
    x, y, theta = np.asarray(a_from_b, dtype=np.float64)
    s = np.asarray(share, dtype=np.float64)
    if abs(theta) < 1e-9:
        return np.stack([s * x, s * y, s * theta], axis=-1)
    # log: V^-1 (x, y) with V = [[sin, cos - 1], [1 - cos, sin]] / theta
    half = 0.5 * theta
    cot = half / np.tan(half)
    vx, vy = cot * x + half * y, -half * x + cot * y
    angle = s * theta
    sin, cos1 = np.sin(angle) / theta, (1.0 - np.cos(angle)) / theta
    return np.stack([sin * vx - cos1 * vy, cos1 * vx + sin * vy, wrap(angle)], axis=-1)


def interpolate(stamps_ns: Stamps, poses: ArrayLike, at_ns: ArrayLike) -> Floats:
    """Return the poses ``(K, 3)`` at times ``at_ns``: linear in x and y, the shorter rotation in theta.

    Raises ValueError for a time outside ``[stamps_ns[0], stamps_ns[-1]]``: no extrapolation.
    """
    rows = np.asarray(poses, dtype=np.float64)
    at = np.asarray(at_ns, dtype=np.int64)
    if at.size and (len(stamps_ns) == 0 or at.min() < stamps_ns[0] or at.max() > stamps_ns[-1]):
        raise ValueError("at_ns: outside the span of the stamps; nothing is extrapolated")
    if len(stamps_ns) == 1:
        return np.repeat(rows, at.size, axis=0)
    right = np.clip(np.searchsorted(stamps_ns, at, side="left"), 1, len(stamps_ns) - 1)
    left = right - 1
    share = (at - stamps_ns[left]) / (stamps_ns[right] - stamps_ns[left])
    step = rows[right] - rows[left]
    step[:, 2] = wrap(step[:, 2])
    result = rows[left] + share[:, None] * step
    result[:, 2] = wrap(result[:, 2])
    return np.asarray(result)


def to_matrix(a_from_b: ArrayLike) -> Floats:
    """Return the homogeneous matrices ``(..., 3, 3)``."""
    a = np.asarray(a_from_b, dtype=np.float64)
    matrix = np.zeros((*a.shape[:-1], 3, 3))
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 0, 2] = cos, -sin, a[..., 0]
    matrix[..., 1, 0], matrix[..., 1, 1], matrix[..., 1, 2] = sin, cos, a[..., 1]
    matrix[..., 2, 2] = 1.0
    return matrix


def from_matrix(matrix: ArrayLike) -> Floats:
    """Return the rows ``(..., 3)`` of homogeneous matrices ``(..., 3, 3)``; theta by atan2(r21, r11) (paper, eq. 7)."""
    m = np.asarray(matrix, dtype=np.float64)
    return np.stack([m[..., 0, 2], m[..., 1, 2], np.arctan2(m[..., 1, 0], m[..., 0, 0])], axis=-1)
