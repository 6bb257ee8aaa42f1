"""Compiled estimation of normals in the plane, for adapters that need them."""

from __future__ import annotations

import math

import numpy as np

from evalkit.core.se2 import Floats
from evalkit_baselines.embedded.compiled import load_core

MAX_NEIGHBOURS = 64


def normals_2d(points: Floats, k: int, radius_m: float = math.inf) -> Floats:
    """Return the unit normals (N, 2) of points (N, 2): across the line through the k nearest points, itself included.

    A normal is the eigenvector for the smaller eigenvalue of the neighbours' covariance. It has y > 0, or is (-1, 0).
    Where the neighbours have no direction (a single point, coincident points, equal eigenvalues) it is (0, 1). With
    fewer than k points all are neighbours; of equally near points the lowest indices are. With a finite ``radius_m``
    points at this distance or farther are no neighbours; the normal is (0, 0) where fewer than three are left or all
    coincide. Raises ValueError for nan, infinity, a coordinate beyond 1,000 km, a radius that is not positive, and k
    outside [2, ``MAX_NEIGHBOURS``]; NotInstalled without the core.
    """
    found: Floats = load_core("double").normals(np.ascontiguousarray(points, dtype=np.float64), k, radius_m)
    return found
