"""Conversion of planar points, normals, covariances and poses to 3D and back, for 3D libraries.

3D libraries estimate wrong normals for a planar cloud at z = 0: every normal is the z axis, so the residual of
point-to-plane is zero for every pose. Normals and covariances are therefore computed here, in the plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats

MIN_FOR_A_LINE = 3  # two points always lie on a line, so they do not define a wall


def points_3d(points: ArrayLike) -> Floats:
    """Return points or normals (N, 2) of the plane as a new array (N, 3) with z = 0."""
    rows = np.asarray(points, dtype=np.float64)
    space = np.zeros((len(rows), 3))
    space[:, :2] = rows
    return space


def normals(points: ArrayLike, neighbours: int, radius_m: float) -> Floats:
    """Return the unit normals (N, 2) of the walls through points (N, 2); (0, 0) where there is no wall.

    A wall is the line through the nearest ``neighbours`` points (including the point itself) within ``radius_m``; the
    normal is the direction of least variance. Fewer than three points, or coinciding points, define no wall. The sign
    is arbitrary, because the sensor's position is unknown here.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - the specs of back ends are listed without SciPy

    rows = np.asarray(points, dtype=np.float64)
    if len(rows) < MIN_FOR_A_LINE:
        return np.zeros((len(rows), 2))
    # a list keeps both dimensions for k = 1
    distance, index = cKDTree(rows).query(rows, k=list(range(1, neighbours + 1)), distance_upper_bound=radius_m)
    near = np.isfinite(distance)
    count = np.maximum(near.sum(axis=1), 1)[:, None]
    offset = np.where(near[..., None], rows[np.where(near, index, 0)] - rows[:, None, :], 0.0)
    offset = np.where(near[..., None], offset - (offset.sum(axis=1) / count)[:, None, :], 0.0)
    xx, yy, xy = (np.einsum("nk,nk->n", offset[..., i], offset[..., j]) for i, j in ((0, 0), (1, 1), (0, 1)))
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)  # principal axis of a symmetric 2x2 matrix, in closed form
    wall = (count[:, 0] >= MIN_FOR_A_LINE) & (xx + yy > 0.0)
    return np.where(wall[:, None], np.stack([-np.sin(along), np.cos(along)], axis=-1), 0.0)


def covariances_3d(wall_normals: ArrayLike, epsilon: float) -> Floats:
    """Return the covariances (N, 3, 3) ``I - (1 - epsilon) n n^T`` of upright discs with normals (N, 2).

    Segal, Haehnel and Thrun, Generalized-ICP, RSS 2009: variance epsilon across the wall, 1 along it. The
    variance along z is 1 too, as for a wall seen in full height. Every z residual is zero, so this moves nothing out of
    the plane and only keeps the 6 x 6 system regular. A normal of (0, 0) gives the unit sphere.
    """
    n = points_3d(wall_normals)
    return np.asarray(np.eye(3) - (1.0 - epsilon) * n[:, :, None] * n[:, None, :])


def matrix_4x4(a_from_b: Pose) -> Floats:
    """Return the motion as a homogeneous matrix (4, 4); its rotation is orthogonal to the precision of float64."""
    planar = se2.to_matrix(a_from_b.row)
    matrix = np.eye(4)
    matrix[:2, :2] = planar[:2, :2]
    matrix[:2, 3] = planar[:2, 2]
    return matrix


def pose_2d(matrix: ArrayLike, tolerance: float = 1e-6) -> Pose:
    """Return the planar motion of a homogeneous matrix (4, 4).

    Raises ValueError where the matrix is not a motion of the plane: z (m) or an entry of the rotation differs by more
    than ``tolerance`` from a rotation about z.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if m.shape != (4, 4):
        raise ValueError(f"matrix: expected shape (4, 4), got {m.shape}")
    if not np.isfinite(m).all():
        raise ValueError("matrix: not finite")
    pose = Pose(float(m[0, 3]), float(m[1, 3]), float(np.arctan2(m[1, 0], m[0, 0])))
    stray = float(np.abs(m - matrix_4x4(pose)).max())
    if stray > tolerance:
        raise ValueError(
            f"matrix: not a motion of the plane: z = {m[2, 3]:.3g} m, upright axis {m[:3, 2].tolist()}, "
            f"largest deviation {stray:.3g} (tolerance {tolerance:g})"
        )
    return pose
