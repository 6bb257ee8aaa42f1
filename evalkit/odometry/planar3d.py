"""The plane as a slice of space, for back ends that only know 3D: points, normals, covariances and poses both ways.

A planar cloud at z = 0 breaks what 3D libraries estimate for themselves: the normal of such a cloud in space is
the z axis everywhere, so a point-to-plane residual is zero for every pose. Normals and covariances are therefore made
here, in the plane.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats

MIN_FOR_A_LINE = 3  # two points always lie on a line: they say nothing about the wall


def points_3d(points: ArrayLike) -> Floats:
    """Points or normals (N, 2) of the plane as rows (N, 3) with z = 0, in memory of their own."""
    rows = np.asarray(points, dtype=np.float64)
    space = np.zeros((len(rows), 3))
    space[:, :2] = rows
    return space


def normals(points: ArrayLike, neighbours: int, radius_m: float) -> Floats:
    """The unit normals (N, 2) of the walls that points (N, 2) lie on; (0, 0) where there is no wall to see.

    A wall is the line through the nearest ``neighbours`` points (the point itself counts) within ``radius_m``: the
    normal is the direction of least variance. Fewer than three points, or points that coincide, make no wall. The sign
    is arbitrary: no sensor position is known here.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - the specs of back ends are listed without SciPy

    rows = np.asarray(points, dtype=np.float64)
    if len(rows) < MIN_FOR_A_LINE:
        return np.zeros((len(rows), 2))
    # both dimensions must survive k = 1, hence the list
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
    """The shapes (N, 3, 3) ``I - (1 - epsilon) n n^T`` of small discs standing upright on normals (N, 2).

    Segal, Haehnel and Thrun, Generalized-ICP, RSS 2009: variance epsilon across the wall, 1 along it. Upright means
    variance 1 along z too, as if the wall were seen in full height: every z residual is zero, so this pulls nothing
    out of the plane and only keeps the 6 x 6 system regular. A normal of (0, 0) gives the unit sphere.
    """
    n = points_3d(wall_normals)
    return np.asarray(np.eye(3) - (1.0 - epsilon) * n[:, :, None] * n[:, None, :])


def matrix_4x4(a_from_b: Pose) -> Floats:
    """The motion as a homogeneous matrix (4, 4), its rotation orthogonal to the last bit that float64 can tell."""
    planar = se2.to_matrix(a_from_b.row)
    matrix = np.eye(4)
    matrix[:2, :2] = planar[:2, :2]
    matrix[:2, 3] = planar[:2, 2]
    return matrix


def pose_2d(matrix: ArrayLike, tolerance: float = 1e-6) -> Pose:
    """The planar motion of a homogeneous matrix (4, 4).

    Raises ValueError where the matrix is not a motion of the plane: z (m) or any entry of the rotation is further than
    ``tolerance`` from what a rotation about z has. A back end that tilts has not answered the question asked.
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
