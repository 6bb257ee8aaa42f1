"""Tests and effect sizes of two series over the same units: signed rank, Holm, A12, detectable difference."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from evalkit.core.se2 import Floats
from evalkit.stats.ranks import rank_values

MAX_EXACT, MAX_EXACT_TIED = 50, 13
"""Largest number of differences of which a p value is exact: all of different sizes, or some of the same size."""

POWER = 0.8
"""Probability with which a difference that is called detectable is detected."""


@dataclass(frozen=True, slots=True)
class SignedRankTest:
    """Wilcoxon's signed-rank test of one pair of series.

    ``pairs``: number of units with different values. ``p``: of this test alone. ``p_holm``: adjusted by Holm for all
    tests made together.
    """

    pairs: int
    p: float
    p_holm: float


def adjust_by_holm(p: Sequence[float]) -> tuple[float, ...]:
    """Return p values adjusted for the number of tests (Holm, Scand. J. Stat. 6, 1979), in the order given."""
    order = np.argsort(np.asarray(p, dtype=np.float64), kind="stable")
    scaled = np.asarray(p, dtype=np.float64)[order] * np.arange(len(p), 0, -1)
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(np.maximum.accumulate(scaled), 1.0)
    return tuple(adjusted.tolist())


def signed_rank_tests(pairs: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> dict[str, SignedRankTest]:
    """Apply Wilcoxon's two-sided signed-rank test to each named pair of series (N,), adjusted by Holm.

    An infinite value is a failure: larger than any number, and equal to another failure.
    """
    single = {name: _test_signed_ranks(_compute_differences(a, b)) for name, (a, b) in pairs.items()}
    adjusted = adjust_by_holm([p for _, p in single.values()])
    return {name: SignedRankTest(n, p, by) for (name, (n, p)), by in zip(single.items(), adjusted, strict=True)}


def vargha_delaney_a12(a: ArrayLike, b: ArrayLike) -> float:
    """Return the probability that a value of a is larger than a value of b, ties counted half.

    Vargha and Delaney, J. Educ. Behav. Stat. 25, 2000 (A12). Raises ValueError if a series is empty.
    """
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    if not (first.size and second.size):
        raise ValueError("vargha_delaney_a12: both series need a value")
    larger = first[:, None] > second[None, :]
    return float(np.mean(larger + 0.5 * (first[:, None] == second[None, :])))


def smallest_detectable_difference(differences: ArrayLike, alpha: float = 0.05) -> float:
    """Return the mean difference that a paired design with these differences detects with 80 % power at ``alpha``.

    By the two-sided paired t test, from the standard deviation and the number of the differences. Infinite for fewer
    than two differences.
    """
    series = np.asarray(differences, dtype=np.float64)
    if len(series) < 2 or not np.isfinite(series).all():
        return math.inf
    error = float(series.std(ddof=1)) / math.sqrt(len(series))
    return error * detectable_standard_errors(len(series) - 1, alpha=alpha)


def least_p(runs: int) -> float:
    """Return the smallest p that Wilcoxon's signed-rank test can have: all of so many differences have one sign."""
    return 2.0 ** (1 - runs)


@cache
def detectable_standard_errors(freedom: float, power: float = POWER, alpha: float = 0.05) -> float:
    """Return the smallest difference, in standard errors, that a two-sided t test detects with probability ``power``.

    ``freedom``: degrees of freedom of the standard error.
    """
    from scipy import optimize

    largest = 4.0 * float(_compute_thresholds(freedom, alpha).max()) + 10.0
    return float(optimize.brentq(lambda shift: compute_power(shift, freedom, alpha) - power, 0.0, largest))


def compute_power(shift: float, freedom: float, alpha: float = 0.05) -> float:
    """Return the probability that a two-sided t test detects a difference of ``shift`` standard errors.

    Averaged over 4,000 possible standard errors.
    """
    from scipy.special import ndtr

    thresholds = _compute_thresholds(freedom, alpha)
    return float(np.mean(ndtr(shift - thresholds) + ndtr(-thresholds - shift)))


@cache
def _compute_thresholds(freedom: float, alpha: float) -> Floats:
    from scipy.special import gammaincinv, stdtrit

    quantiles = (np.arange(4000) + 0.5) / 4000.0
    critical = float(stdtrit(freedom, 1.0 - alpha / 2.0))
    chi_square = 2.0 * gammaincinv(0.5 * freedom, quantiles)
    return np.asarray(critical * np.sqrt(chi_square / freedom))


def _compute_differences(a: ArrayLike, b: ArrayLike) -> Floats:
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    same = first == second
    return np.asarray(np.subtract(first, second, out=np.zeros_like(first), where=~same))


def _test_signed_ranks(differences: Floats) -> tuple[int, float]:
    """The number of differences other than 0, and p; exact up to ``MAX_EXACT`` and ``MAX_EXACT_TIED`` of them.

    Beyond, the sum of the ranks is taken as normal, its variance corrected for ties.
    """
    nonzero = differences[differences != 0.0]
    count = len(nonzero)
    sizes = np.abs(nonzero)
    ranks = rank_values(sizes)  # instead of sizes, so that infinite ones are valid
    tied = np.unique(sizes, return_counts=True)[1].astype(np.float64)
    positive = float(ranks[nonzero > 0.0].sum())
    if count <= (MAX_EXACT if len(tied) == count else MAX_EXACT_TIED):
        return count, _compute_exact_p(ranks, positive)
    variance = count * (count + 1.0) * (2.0 * count + 1.0) / 24.0 - float((tied**3 - tied).sum()) / 48.0
    return count, math.erfc(abs(positive - 0.25 * count * (count + 1.0)) / math.sqrt(2.0 * variance))


def _compute_exact_p(ranks: Floats, positive: float) -> float:
    """Twice the probability of a sum of ranks at least as far from its mean, where each sign is equally probable."""
    doubled = np.rint(2.0 * ranks).astype(np.int64)  # whole numbers with ties, too
    ways = np.zeros(int(doubled.sum()) + 1)
    ways[0] = 1.0
    for rank in doubled:
        ways[rank:] += ways[: len(ways) - rank].copy()
    at = round(2.0 * positive)
    return min(2.0 * float(min(ways[: at + 1].sum(), ways[at:].sum())) / 2.0 ** len(ranks), 1.0)
