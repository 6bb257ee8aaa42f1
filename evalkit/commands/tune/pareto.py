"""What accuracy costs: the points that no other beats in both error and time."""

from __future__ import annotations

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.se2 import Floats


def frontier(costs: Floats, errors: Floats) -> Bools:
    """Which of N points no other dominates: at most as dear, at most as wrong, and better in one of the two.

    Less is better in both (Pareto). Points with a value that is not finite are never on it; of equal ones, all are.
    """
    both = np.column_stack([costs, errors]).astype(np.float64).reshape(-1, 2)
    known = np.asarray(np.isfinite(both).all(axis=1))
    no_worse = (both[None, :, :] <= both[:, None, :]).all(axis=2)
    better = (both[None, :, :] < both[:, None, :]).any(axis=2)
    dominated = (no_worse & better & known[None, :]).any(axis=1)
    return np.asarray(known & ~dominated)
