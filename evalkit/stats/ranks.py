"""Ranks: mean ranks and Friedman's test over data sets, quantiles of errors with failures, rank correlation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats

MIN_DATA_SETS = 8
"""With fewer data sets, the chi-square approximation of Friedman's test and the critical difference are too optimistic.
"""

MIN_METHODS = 3

ALPHA = 0.05
"""Share of equal methods that the critical difference of ranks would tell apart."""


@dataclass(frozen=True, slots=True)
class FriedmanTest:
    """Friedman's test of mean ranks (1: best).

    ``critical_difference``: mean ranks of two methods that differ by less are statistically tied.
    """

    mean_ranks: tuple[float, ...]
    statistic: float
    p: float
    critical_difference: float
    data_sets: int


@dataclass(frozen=True, slots=True)
class NotTested:
    """A test without sufficient data, and the reason."""

    reason: str


def compute_ranks(errors: ArrayLike) -> Floats:
    """Return the rank (N, K) of K methods on each of N data sets (N, K): 1 for the least error, ties share the mean."""
    table = np.asarray(errors, dtype=np.float64)
    own, others = table[:, :, np.newaxis], table[:, np.newaxis, :]
    return np.asarray(0.5 + (others < own).sum(axis=2) + 0.5 * (others == own).sum(axis=2))


def rank_values(values: ArrayLike) -> Floats:
    """Return the ranks (..., N) of values (..., N) along the last axis: 1 for the least, ties share the mean."""
    table = np.asarray(values, dtype=np.float64)
    order = np.argsort(table, axis=-1, kind="stable")
    ordered = np.take_along_axis(table, order, axis=-1)
    places = np.broadcast_to(np.arange(1.0, table.shape[-1] + 1.0), table.shape)
    begins = np.ones(table.shape, dtype=bool)
    begins[..., 1:] = ordered[..., 1:] != ordered[..., :-1]
    ends = np.roll(begins, -1, axis=-1)  # the last value ends a group because the first begins one
    first = np.maximum.accumulate(np.where(begins, places, 1.0), axis=-1)
    last = np.minimum.accumulate(np.where(ends, places, np.inf)[..., ::-1], axis=-1)[..., ::-1]
    ranks = np.empty(table.shape)
    np.put_along_axis(ranks, order, 0.5 * (first + last), axis=-1)
    return ranks


def friedman_test(errors: ArrayLike) -> FriedmanTest | NotTested:
    """Apply Friedman's test to errors of K methods over N data sets (N, K); lower is better.

    With Nemenyi's critical difference q sqrt(K (K + 1) / 6 N) (Demsar, JMLR 7, 2006). An infinite error is a failure
    and shares the last rank. Fewer than 8 sequences or 3 methods are not tested.
    """
    table = np.asarray(errors, dtype=np.float64)
    data_sets, methods = table.shape
    if data_sets < MIN_DATA_SETS:
        return NotTested(f"ranks with a critical difference need at least {MIN_DATA_SETS} data sets, found {data_sets}")
    if methods < MIN_METHODS:
        return NotTested(f"a test of ranks needs at least {MIN_METHODS} methods, found {methods}")
    from scipy import stats

    ranks = compute_ranks(table)
    statistic, p = (0.0, 1.0) if (ranks == ranks[:, :1]).all() else stats.friedmanchisquare(*ranks.T)
    q = stats.studentized_range.ppf(1.0 - ALPHA, methods, np.inf) / math.sqrt(2.0)
    critical = float(q) * math.sqrt(methods * (methods + 1) / (6.0 * data_sets))
    return FriedmanTest(tuple(ranks.mean(axis=0).tolist()), float(statistic), float(p), critical, data_sets)


def success_quantiles(errors: ArrayLike, shares: Sequence[float] = (0.5, 0.75, 0.95)) -> tuple[float, ...]:
    """Return the errors that these shares of all trials do not exceed: A50, A75 and A95.

    Pomerleau et al., Auton. Robots 34, 2013. The smallest error reached by at least that share; infinite if too many
    trials failed. Raises ValueError without a trial.
    """
    ordered = np.sort(np.asarray(errors, dtype=np.float64))
    if not ordered.size:
        raise ValueError("success_quantiles: there is no trial")
    return tuple(float(ordered[max(math.ceil(share * len(ordered) - 1e-9), 1) - 1]) for share in shares)


def spearman_correlation(a: Floats, b: Floats) -> Floats:
    """Return Spearman's rank correlation (...,) along the last axis of series (..., N); nan if a series is constant."""
    first, second = rank_values(a), rank_values(b)
    first = first - first.mean(axis=-1, keepdims=True)
    second = second - second.mean(axis=-1, keepdims=True)
    sizes = np.sqrt((first**2).sum(axis=-1) * (second**2).sum(axis=-1))
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(sizes > 0.0, (first * second).sum(axis=-1) / sizes, np.nan))
