"""Rank correlation of two series."""

from __future__ import annotations

import numpy as np

from evalkit.core.se2 import Floats


def spearman_correlation(a: Floats, b: Floats) -> Floats:
    """Return Spearman's rank correlation (...,) along the last axis of series (..., N); nan if a series is constant."""
    from scipy import stats

    first, second = (stats.rankdata(series, axis=-1) for series in (a, b))
    first = first - first.mean(axis=-1, keepdims=True)
    second = second - second.mean(axis=-1, keepdims=True)
    sizes = np.sqrt((first**2).sum(axis=-1) * (second**2).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(sizes > 0.0, (first * second).sum(axis=-1) / sizes, np.nan))
