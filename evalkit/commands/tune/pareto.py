"""The Pareto front of error and cost."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats


def find_pareto_front(costs: Floats, errors: Floats) -> Bools:
    """Marks (N,) of the points on the Pareto front; smaller is better in both.

    A point dominates another if it is no worse in both and better in one. Points with a value that is not finite are
    not on the front; equal points are on it together.
    """
    both = np.column_stack([costs, errors]).astype(np.float64).reshape(-1, 2)
    known = np.asarray(np.isfinite(both).all(axis=1))
    no_worse = (both[None, :, :] <= both[:, None, :]).all(axis=2)
    better = (both[None, :, :] < both[:, None, :]).any(axis=2)
    dominated = (no_worse & better & known[None, :]).any(axis=1)
    return np.asarray(known & ~dominated)
